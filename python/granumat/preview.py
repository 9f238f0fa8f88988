"""What a path or scene file would run, without running it."""

from pathlib import Path
from typing import Any

from .ladder import is_scene
from .paths import read_path_file


def preview(file: str | Path) -> dict[str, Any]:
    """Read a path or scene file and say what it would run; a scene's mesh and conditions are made, too. Collective for a scene.

    Parameters
    ----------
    file : path

    Returns
    -------
    dict
        "kind", "path" or "scene"; of a path "steps" (names), "increments" and "quantities" (names); of a scene "cells", "unknowns",
        "until", "increment" and "quantities".

    Raises
    ------
    ValueError
        Names everything that is wrong with the file.
    OSError
        If it cannot be read.
    """
    if is_scene(file):
        from .fem.preview import preview as preview_scene
        return preview_scene(file)
    path = read_path_file(file)
    return {"kind": "path", "steps": [step.name for step in path.steps], "increments": sum(map(len, path.steps)),
            "quantities": [quantity.name for quantity in path.quantities]}


def in_words(found: dict[str, Any]) -> str:
    """One line that says what `preview` has found."""
    quantities = f"; quantities: {', '.join(found['quantities'])}" if found["quantities"] else ""
    if found["kind"] == "path":
        return f"a path, steps: {len(found['steps'])}, increments: {found['increments']}{quantities}"
    end = found["until"] if isinstance(found["until"], str) else f"t = {found['until']:g}"
    return (f"a scene, cells: {found['cells']}, unknowns: {found['unknowns']}, to {end}, first increment: "
            f"{found['increment']:g}{quantities}")
