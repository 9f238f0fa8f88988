"""TOML: what a path or scene file says, read from text and written as text."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .checks import is_number
from .files import replacing


def read_toml(filename: str | Path) -> dict[str, Any]:
    """What a TOML file says; ValueError if it is not one."""
    return parse_toml(filename, Path(filename).read_bytes())


def parse_toml(filename: str | Path, text: bytes) -> dict[str, Any]:
    """What the text of a TOML file says; ValueError, with the name of the file, if it is not one."""
    try:
        return tomllib.loads(text.decode("utf-8-sig"))        # editors may begin UTF-8 with a mark of it
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{filename}: not a TOML file: {error}") from None


def table_of(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """A table of a file by its name, empty if it is not there; ValueError if it is no table."""
    table = content.get(name, {})
    if not isinstance(table, dict):
        raise ValueError(f"{name}: must be a table [{name}]")
    return table


def tables_of(content: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """The tables [[name]] of a file, none if there is none; ValueError if there is something else by that name."""
    tables = content.get(name, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ValueError(f"{name}: must be tables [[{name}]]")
    return tables


def format_value(value: Any) -> str:
    """A value as TOML has it; numbers in full.

    Parameters
    ----------
    value : bool, int, float, str, sequence or mapping of such
        NumPy's numbers and arrays too.
    """
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if is_number(value):
        return repr(float(value))
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {format_value(item)}" for name, item in value.items()) + " }" if value else "{}"
    return "[" + ", ".join(format_value(item) for item in value) + "]"


def format_content(content: Mapping[str, Any]) -> str:
    """The text of a file: keys first, then a table for each mapping and an array of tables for each list of mappings."""
    lines = [f"{_key(name)} = {format_value(value)}" for name, value in content.items() if not _is_table(value)]
    for name, value in content.items():
        for table in [value] if isinstance(value, Mapping) else value if _is_table(value) else []:
            lines += ["", f"[{_key(name)}]" if isinstance(value, Mapping) else f"[[{_key(name)}]]"]
            lines += [f"{_key(key)} = {format_value(item)}" for key, item in table.items()]
    return "\n".join(lines).lstrip("\n") + "\n"


def write_content(filename: str | Path, content: Mapping[str, Any], comments: Sequence[str] = ()) -> None:
    """Write a file of a content; the comments come first, a line each. An old file is replaced at once."""
    text = "".join(f"# {comment}".rstrip() + "\n" for comment in comments) + format_content(content)
    with replacing(filename) as partial:
        partial.write_text(text, encoding="utf-8")


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value))


def _key(name: str) -> str:
    bare = bool(name) and all((character.isalnum() and character.isascii()) or character in "-_" for character in name)
    return name if bare else format_value(name)
