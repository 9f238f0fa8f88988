"""Path and scene files to start from, which come with the package."""

from pathlib import Path

FOLDERS = {folder: Path(__file__).with_name(folder) for folder in ("paths", "scenes")}


def example_files() -> dict[str, Path]:
    """The files by their names, paths first."""
    return {file.stem: file for folder in FOLDERS.values() for file in sorted(folder.glob("*.toml"), key=lambda file: file.stem)}


def first_words(file: Path) -> str:
    """What the first line of an example says it is."""
    return file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
