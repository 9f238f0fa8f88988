"""Scene files: a boundary-value problem on a standard geometry or a gmsh mesh, as TOML; read and checked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import is_number, refuse
from ..material import Material
from ..paths import INITIAL, attempt, read_initial, read_material, read_toml, table_of
from . import meshes
from .fields import SCALAR_FIELDS

TABLES = ("material", "mesh", "initial", "problem", "condition", "run", "output")
# By kind of mesh: the keys that it needs, and those that it may have.
MESH_KEYS = {"box": (("size", "cells"), ("cell",)), "annulus": (("radii", "cells"), ("height", "cell", "grading")),
             "gmsh": (("file",), ())}
# By dimension: the axis across each side of a box, and 0 or 1 where the coordinate along it is 0 or the box's size.
BOX_SIDES = {2: {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)},
             3: {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}}
OPPOSITE_SIDES = ({"left", "right"}, {"front", "back"}, {"bottom", "top"})
CARTESIAN, POLAR = ("x", "y", "z"), ("radial", "circumferential", "z")
CONDITION_KEYS = ("displacement", "rotation", "platen", "pressure", "traction", "periodic")
CHECKPOINT_SECONDS = 600            # between two checkpoints, if the file says nothing else


@dataclass(frozen=True)
class Function:
    """A piecewise linear function of pseudo-time; constant before its first time and after its last."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, t: float) -> float:
        return float(np.interp(t, self.times, self.values))


@dataclass(frozen=True)
class Resting:
    """An initial state at rest under gravity; its surface is the top of the mesh. Arguments of scene.resting.

    Attributes
    ----------
    volume_fraction : float
    weight : float
        Of the solid per volume of the solid, in units of stress per length.
    pressure : float
        Vertical stress at the surface.
    k0 : float
        Horizontal over vertical stress.
    """

    volume_fraction: float
    weight: float
    pressure: float
    k0: float


@dataclass(frozen=True)
class SideConditions:
    """What holds and loads one side of the body.

    Attributes
    ----------
    on : str or int
        Name of the side, or of a gmsh file's facets, or their number there.
    displacement : dict of int to Function
        By component: x y z of a box, radial circumferential z of an annulus.
    rotation : Function or None
        Angle in radians.
    center : sequence of 2 floats
        Of the rotation.
    platen : int or None
        The displacement component that is the same on the whole side.
    pressure : Function or None
        In units of stress.
    traction : dict of int to Function
        By component, in units of stress.
    periodic : int or None
        The axis across the side, if it has the displacement of the opposite side.
    """

    on: str | int
    displacement: dict[int, Function]
    rotation: Function | None
    center: Sequence[float]
    platen: int | None
    pressure: Function | None
    traction: dict[int, Function]
    periodic: int | None

    @property
    def is_held(self) -> bool:
        """Whether displacements are prescribed or tied, so that there is a reaction."""
        return bool(self.displacement) or self.rotation is not None or self.platen is not None

    @property
    def functions(self) -> list[Function]:
        """All functions of pseudo-time."""
        functions = [*self.displacement.values(), *self.traction.values()]
        return functions + [function for function in (self.rotation, self.pressure) if function is not None]


@dataclass(frozen=True)
class RunControl:
    """Arguments of control.run: end, largest increment and smallest one, in pseudo-time."""

    until: float
    increment: Function
    smallest: float | None


@dataclass(frozen=True)
class OutputRequest:
    """What is to be written.

    Attributes
    ----------
    every : int or None
        Increments from one record of fields and pictures to the next.
    times : tuple of float
        Pseudo-times of further records.
    pictures : list of str
        Fields to be drawn.
    probes : dict of str to list of float
        Positions of points at the start, by name.
    center : list of float or None
        Of the moments of reactions.
    checkpoint : dict
        Arguments of Checkpoint: every, seconds.
    """

    every: int | None
    times: tuple[float, ...]
    pictures: list[str]
    probes: dict[str, list[float]]
    center: list[float] | None
    checkpoint: dict[str, Any]


@dataclass(frozen=True)
class Scene:
    """What a scene file says, not yet on a mesh.

    Attributes
    ----------
    path : Path
        Of the file.
    material : Material
    initial : record of dtype STATE, or Resting
    mesh : dict
        Its kind, and arguments of meshes.box, meshes.annulus or meshes.from_gmsh.
    settings : dict
        Further arguments of Problem.
    conditions : list of SideConditions
    run : RunControl
    output : OutputRequest
    """

    path: Path
    material: Material
    initial: np.void | Resting
    mesh: dict[str, Any]
    settings: dict[str, Any]
    conditions: list[SideConditions]
    run: RunControl
    output: OutputRequest

    @property
    def events(self) -> list[float]:
        """Pseudo-times that the run meets exactly: kinks of the functions, and times of the output."""
        kinks = {t for condition in self.conditions for function in condition.functions for t in function.times}
        return sorted(t for t in kinks | set(self.output.times) if 0 < t < self.run.until)


def read_scene(path: str | Path) -> Scene:
    """Reads a scene file.

    Raises
    ------
    ValueError
        Names everything that is wrong with it at once.
    """
    path = Path(path)
    content = read_toml(path)
    faults = [f"unknown table or key {name!r}: allowed are {', '.join(TABLES)}" for name in content if name not in TABLES]
    material = attempt(faults, "", read_material, content)
    mesh = attempt(faults, "[mesh]: ", _mesh, content, path.parent)
    kind, d = _kind_and_dimension(content.get("mesh"))
    settings = attempt(faults, "[problem]: ", _settings, content, d)
    initial = attempt(faults, "", _initial, content, material, kind, d, settings or {})
    entries = content.get("condition", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        faults.append("condition: must be tables [[condition]]")
        entries = []
    conditions: list[SideConditions] = []
    for number, entry in enumerate(entries, 1):
        conditions += attempt(faults, f"condition {number}: ", _side_conditions, entry, kind, d) or []
    run = attempt(faults, "[run]: ", _run, content)
    output = attempt(faults, "[output]: ", _output, content, d)
    refuse(f"{path} cannot be run", faults)
    return Scene(path, material, initial, mesh, settings, conditions, run, output)


# ---- checks of keys and values: each appends what is wrong to faults -------------------------------------------------

def _check_keys(table: dict[str, Any], required: Sequence[str], optional: Sequence[str], faults: list[str]) -> None:
    faults += [f"unknown key {key!r}: allowed are {', '.join((*required, *optional)) or 'none'}"
               for key in table if key not in (*required, *optional)]
    faults += [f"{key} is missing" for key in required if key not in table]


def _check_number(table: dict[str, Any], key: str, allowed_values: str, allowed: Callable[[float], bool],
                  faults: list[str]) -> None:
    if key in table and not (_is_finite(table[key]) and allowed(table[key])):
        faults.append(f"{key} = {table[key]!r}: must be {allowed_values}")


def _check_count(table: dict[str, Any], key: str, name: str, faults: list[str]) -> None:
    value = table.get(key, 1)
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        faults.append(f"{name} = {value!r}: must be an integer, at least 1")


def _is_finite(value: object) -> bool:
    return is_number(value) and bool(np.isfinite(value))


def _are_numbers(value: object, *counts: int) -> bool:
    """Whether a value is a list of as many numbers as one of counts."""
    return isinstance(value, list) and len(value) in counts and all(map(_is_finite, value))


def _vector_lengths(d: int | None) -> tuple[int, ...]:
    """How many components vectors may have in d dimensions, which only the mesh knows if d is None."""
    return (d,) if d else (2, 3)


def _function(value: object, name: str, faults: list[str], start: float | None = None) -> Function:
    """The function of pseudo-time that a number or a table [[t, value], ...] is; `start`: what it must be at t = 0."""
    if is_number(value) and np.isfinite(value):
        function = Function((0.0,), (float(value),))
    elif (isinstance(value, list) and value and all(_are_numbers(row, 2) for row in value)
          and all(np.diff([row[0] for row in value]) > 0)):
        times, values = zip(*value)
        function = Function(tuple(map(float, times)), tuple(map(float, values)))
    else:
        faults.append(f"{name} = {value!r}: must be a number or a table [[t, value], ...] with increasing times")
        return Function((0.0,), (0.0,))
    if start is not None and function(0.0) != start:
        faults.append(f"{name} = {value!r}: must be {start:g} at t = 0; give a table [[0, {start:g}], [t, value], ...]")
    return function


# ---- the tables ------------------------------------------------------------------------------------------------------

def _mesh(content: dict[str, Any], directory: Path) -> dict[str, Any]:
    table = table_of(content, "mesh")
    faults: list[str] = []
    kind = table.get("kind")
    if kind not in MESH_KEYS:
        raise ValueError(f"kind = {kind!r}: must be one of {', '.join(MESH_KEYS)}")
    _check_keys(table, ("kind", *MESH_KEYS[kind][0]), MESH_KEYS[kind][1], faults)
    for name, lengths in {"size": (2, 3), "radii": (2,), "cells": (2, 3)}.items():
        if name in table and not _are_numbers(table[name], *lengths):
            faults.append(f"{name} = {table[name]!r}: must be {' or '.join(map(str, lengths))} numbers")
    for name in ("height", "grading"):
        _check_number(table, name, "a number above 0", lambda value: value > 0, faults)
    if kind == "gmsh" and "file" in table and not (isinstance(table["file"], str) and (directory / table["file"]).is_file()):
        faults.append(f"file = {table['file']!r}: there is no such file")
    refuse("is wrong", faults)
    if kind == "gmsh":
        return table | {"file": directory / table["file"]}
    arguments = {name: value for name, value in table.items() if name != "kind"}
    (meshes.check_box if kind == "box" else meshes.check_annulus)(**arguments)
    return table


def _kind_and_dimension(mesh: object) -> tuple[str | None, int | None]:
    """Kind of the mesh, and 2 or 3; None where there is none, or only the mesh knows. Also of a table with faults."""
    if not isinstance(mesh, dict) or mesh.get("kind") not in MESH_KEYS:
        return None, None
    if mesh["kind"] == "box":
        return "box", 3 if isinstance(mesh.get("size"), list) and len(mesh["size"]) == 3 else 2
    return mesh["kind"], {"annulus": 3 if "height" in mesh else 2}.get(mesh["kind"])


def _settings(content: dict[str, Any], d: int | None) -> dict[str, Any]:
    table = table_of(content, "problem")
    faults: list[str] = []
    _check_keys(table, (), ("degree", "gravity", "rate_term", "solver"), faults)
    if table.get("degree", 1) not in (1, 2):
        faults.append(f"degree = {table['degree']!r}: must be 1 or 2")
    _check_number(table, "rate_term", "a number, at least 0", lambda value: value >= 0, faults)
    if "gravity" in table and not _are_numbers(table["gravity"], *_vector_lengths(d)):
        faults.append(f"gravity = {table['gravity']!r}: must be {d or '2 or 3'} finite numbers")
    if not isinstance(table.get("solver", {}), dict):
        faults.append("solver: must be a table of PETSc options")
    refuse("is wrong", faults)
    return table


def _initial(content: dict[str, Any], material: Material | None, kind: str | None, d: int | None,
             settings: dict[str, Any]) -> np.void | Resting | None:
    """The initial state; None if the material, which it depends on, has faults of its own."""
    table = table_of(content, "initial")
    if table.get("state") not in (*INITIAL, "K0"):
        raise ValueError(f"[initial]: state = {table.get('state')!r}: must be one of {', '.join(INITIAL)}, K0")
    if table["state"] == "K0":
        return _resting(table, settings.get("gravity"))
    state = read_initial(material, content)
    if table["state"] == "steady" and kind != "box":
        raise ValueError("[initial]: state = 'steady' is uniform shear along x, of a box only; elsewhere it is a function of "
                         "x, to be given in Python")
    return _in_plane(state) if state is not None and table["state"] == "steady" and d == 2 else state


def _resting(table: dict[str, Any], gravity: list[float] | None) -> Resting:
    faults: list[str] = []
    _check_keys(table, ("state", "phi", "pressure"), ("K0",), faults)
    _check_number(table, "phi", "a number in (0, 1)", lambda value: 0 < value < 1, faults)
    _check_number(table, "pressure", "a number, at least 0", lambda value: value >= 0, faults)
    _check_number(table, "K0", "a number above 0", lambda value: value > 0, faults)
    if gravity is None or any(gravity[:-1]) or gravity[-1] > 0:
        faults.append("state = 'K0' needs a gravity in [problem], downward along the last axis")
    refuse("[initial]", faults)
    assert gravity is not None
    return Resting(table["phi"], -gravity[-1], table["pressure"], table.get("K0", 1.0))


def _in_plane(state: np.void) -> np.void:
    """A state of shear in x-z as one of shear in x-y."""
    rotated = np.array(state).reshape(1).view(np.recarray)[0]
    for name in ("stress", "fabric", "direction"):
        rotated[name] = state[name][[0, 2, 1, 4, 3, 5]]
    return rotated


def _run(content: dict[str, Any]) -> RunControl:
    table = table_of(content, "run")
    faults: list[str] = []
    _check_keys(table, ("until", "increment"), ("smallest",), faults)
    _check_number(table, "until", "a number above 0", lambda value: value > 0, faults)
    increment = _function(table.get("increment", 1.0), "increment", faults)
    if min(increment.values) <= 0 and not any(fault.startswith("increment") for fault in faults):
        faults.append(f"increment = {table['increment']!r}: must be above 0")
    _check_number(table, "smallest", "a number above 0", lambda value: value > 0, faults)
    refuse("is wrong", faults)
    return RunControl(float(table["until"]), increment, table.get("smallest"))


def _output(content: dict[str, Any], d: int | None) -> OutputRequest:
    table = table_of(content, "output")
    faults: list[str] = []
    _check_keys(table, (), ("every", "times", "pictures", "probes", "center", "checkpoint"), faults)
    times = table.get("times", [])
    if not isinstance(times, list) or not all(_is_finite(t) and t >= 0 for t in times):
        faults.append(f"times = {times!r}: must be a list of numbers, at least 0")
    _check_count(table, "every", "every", faults)
    pictures = table.get("pictures", [])
    if not isinstance(pictures, list) or any(name not in SCALAR_FIELDS for name in pictures):
        faults.append(f"pictures = {pictures!r}: must be a list of some of {', '.join(SCALAR_FIELDS)}")
    probes = table.get("probes", {})
    if not isinstance(probes, dict) or not all(_are_numbers(x, *_vector_lengths(d)) for x in probes.values()):
        faults.append(f"probes = {probes!r}: must be a table of names and positions of {d or '2 or 3'} numbers")
    elif any(not name.replace("-", "_").isidentifier() for name in probes):
        faults.append("probes: their names may have letters, digits, - and _")
    if "center" in table and not _are_numbers(table["center"], *_vector_lengths(d)):
        faults.append(f"center = {table['center']!r}: must be {d or '2 or 3'} numbers")
    checkpoint = table.get("checkpoint", {"seconds": CHECKPOINT_SECONDS})
    if not isinstance(checkpoint, dict) or not checkpoint:
        faults.append(f"checkpoint = {checkpoint!r}: must be a table with every (increments), seconds or both")
    else:
        _check_keys(checkpoint, (), ("every", "seconds"), faults)
        _check_count(checkpoint, "every", "checkpoint every", faults)
        _check_number(checkpoint, "seconds", "a number, at least 0", lambda value: value >= 0, faults)
    refuse("is wrong", faults)
    return OutputRequest(table.get("every", None if times else 10), tuple(map(float, times)), pictures, probes, table.get("center"),
                         checkpoint)


# ---- conditions ------------------------------------------------------------------------------------------------------

def _side_conditions(entry: dict[str, Any], kind: str | None, d: int | None) -> list[SideConditions]:
    """What a [[condition]] says of each of its sides."""
    faults: list[str] = []
    _check_keys(entry, ("on",), ("center", *CONDITION_KEYS), faults)
    if not any(key in entry for key in CONDITION_KEYS):
        faults.append(f"says nothing: give at least one of {', '.join(CONDITION_KEYS)}")
    sides = _sides(entry, kind, d, faults)
    axes = POLAR if kind == "annulus" else CARTESIAN
    names = axes if d != 2 else axes[:2]
    displacement = _components(entry, "displacement", names, faults, start=0.0)
    rotation = _rotation(entry, faults)
    platen = _platen(entry, names, faults)
    pressure = _function(entry["pressure"], "pressure", faults) if "pressure" in entry else None
    traction = {}
    if "traction" in entry and kind == "annulus":
        faults.append("traction: on a ring only pressure; a traction there is to be given in Python")
    else:
        traction = _components(entry, "traction", names, faults)
    if "periodic" in entry and not (entry["periodic"] is True and kind == "box" and set(map(str, sides)) in OPPOSITE_SIDES
                                    and len(sides) == 2 and len(entry) == 2):
        faults.append("periodic = true stands alone with on = [\"left\", \"right\"] or another two opposite sides of a box")
    refuse("is wrong", faults)
    axis = None
    if "periodic" in entry and d is not None:                   # the side away from 0 has the displacement of the other one
        axis, sides = BOX_SIDES[d][sides[0]][0], [side for side in sides if BOX_SIDES[d][side][1] == 1]
    return [SideConditions(side, displacement, rotation, entry.get("center", [0.0, 0.0]), platen, pressure, traction, axis)
            for side in sides]


def _sides(entry: dict[str, Any], kind: str | None, d: int | None, faults: list[str]) -> list[Any]:
    """Names (or in gmsh files numbers) of the sides that a condition is on."""
    on = entry.get("on", [])
    on = on if isinstance(on, list) else [on]
    allowed = None
    if kind == "box":
        allowed = tuple(BOX_SIDES[d or 2])
    elif kind == "annulus":
        allowed = ("inner", "outer", *(("bottom", "top") if d == 3 else ()))
    if ("on" in entry and not on) or not all(isinstance(side, str) or (allowed is None and isinstance(side, int)) for side in on):
        faults.append(f"on = {entry['on']!r}: must be a side or a list of sides")
    elif allowed is not None:
        faults += [f"on: {side!r} is no side: must be one of {', '.join(allowed)}" for side in on if side not in allowed]
    return on


def _components(entry: dict[str, Any], key: str, names: Sequence[str], faults: list[str],
                start: float | None = None) -> dict[int, Function]:
    """Functions by component of a table by the components' names."""
    table = entry.get(key, {})
    if key in entry and (not isinstance(table, dict) or not table or any(name not in names for name in table)):
        faults.append(f"{key} = {table!r}: must be a table with some of {', '.join(names)}")
        return {}
    return {names.index(name): _function(value, f"{key} {name}", faults, start) for name, value in table.items()}


def _rotation(entry: dict[str, Any], faults: list[str]) -> Function | None:
    if "rotation" not in entry:
        if "center" in entry:
            faults.append("center belongs to rotation")
        return None
    angle = _function(entry["rotation"], "rotation", faults, 0.0)
    if "center" in entry and not _are_numbers(entry["center"], 2):
        faults.append(f"center = {entry['center']!r}: must be 2 numbers")
    if isinstance(entry.get("displacement"), dict) and set(entry["displacement"]) - {"z"}:
        faults.append("rotation gives the displacement in the plane x y: beside it displacement may have z only")
    return angle


def _platen(entry: dict[str, Any], names: Sequence[str], faults: list[str]) -> int | None:
    if "platen" not in entry:
        return None
    if entry["platen"] not in names:
        faults.append(f"platen = {entry['platen']!r}: must be the component that is the same on the whole side, "
                      f"one of {', '.join(names)}")
        return None
    return names.index(entry["platen"])
