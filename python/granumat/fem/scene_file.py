"""Scene files: a boundary-value problem on a standard geometry or a gmsh mesh, as TOML; read and checked."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import COUNT, attempt, is_finite_number, is_positive_integer, refuse, repetitions
from ..coarsen import claimed_symmetries
from ..material import Material
from ..paths import INITIAL, initial_table, read_initial, read_material
from ..quantities import Quantity, read_quantities
from ..toml import read_toml, table_of, tables_of
from . import meshes
from .fields import COMPONENTS, FIELDS, SCALAR_FIELDS, check_fields
from .motion import KINDS, motion_faults
from .problem import Tolerances
from .quantities import read_source
from .reduction import reduction_faults
from .scene_data import BOX_SIDES, Function, OutputRequest, Region, Resting, RunControl, Scene, SideConditions
from .symmetry import exchange_y_z

TABLES = ("material", "mesh", "initial", "problem", "motion", "condition", "run", "output", "region", "quantity", "ladder")
# By kind of mesh: the keys that it needs, and those that it may have.
MESH_KEYS = {"box": (("size", "cells"), ("cell", "grading", "layer", "plane")),
             "annulus": (("radii", "cells"), ("height", "cell", "grading", "sector", "plane")), "gmsh": (("file",), ())}
REDUCTIONS = ("sector", "layer", "plane")
OPPOSITE_SIDES = ({"left", "right"}, {"front", "back"}, {"bottom", "top"})
CARTESIAN, POLAR = ("x", "y", "z"), ("radial", "circumferential", "z")
CONDITION_KEYS = ("displacement", "gradient", "rotation", "platen", "pressure", "traction", "periodic", "inflow",
                  "outflow")
ON_SIDE = 1e-6                      # over the body's size: a place as close as that to a side is on it
CHECKPOINT_SECONDS = 600            # between two checkpoints, if the file says nothing else


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
    material = attempt(faults, "", read_material, content, path.parent)
    mesh = attempt(faults, "[mesh]: ", _mesh, content, path.parent)
    kind, d = _kind_and_dimension(content.get("mesh"))
    settings = attempt(faults, "[problem]: ", _settings, content, d)
    motion = attempt(faults, "[motion]: ", _motion, content)
    initial = attempt(faults, "", _initial, content, material, kind, d, settings or {})
    entries = attempt(faults, "", tables_of, content, "condition") or []
    conditions = [attempt(faults, f"condition {number}: ", _side_conditions, entry, kind, d)
                  for number, entry in enumerate(entries, 1)]
    run = attempt(faults, "[run]: ", _run, content)
    output = attempt(faults, "[output]: ", _output, content, d)
    regions = attempt(faults, "", _regions, content, d)
    sides = None if None in conditions else [side for of_entry in conditions for side in of_entry or []]
    quantities = attempt(faults, "", _quantities, content, d, sides, run, output, regions)
    attempt(faults, "", claimed_symmetries, content)
    if motion is not None and mesh is not None and settings is not None and kind != "gmsh":
        faults += [f"[motion]: {fault}" for fault in motion_faults(
            motion, mesh.get("cell") or meshes.CELL_SHAPES[d or 2][0], settings.get("degree", 1),
            any(side.opening for side in sides or ()))]
    if mesh is not None:
        faults += [f"[mesh]: {fault}" for fault in reduction_faults(
            mesh, settings, initial, sides, regions or [], [quantity.of for quantity in quantities or []])]
        faults += [f"[output]: probes: {name} = {x!r}: is outside the body"
                   for name, x in (output.probes if output else {}).items() if _is_outside(mesh, x)]
    refuse(f"{path} cannot be run", faults)
    assert (motion is not None and material is not None and initial is not None and mesh is not None and settings is not None
            and sides is not None and run is not None and output is not None and regions is not None
            and quantities is not None)                          # or there were faults
    return Scene(path, material, initial, mesh, settings | {"motion": motion}, sides, run, output, regions, quantities)


# ---- checks of keys and values: each appends what is wrong to faults -------------------------------------------------

def _check_keys(table: dict[str, Any], required: Sequence[str], optional: Sequence[str], faults: list[str]) -> None:
    faults += [f"unknown key {key!r}: allowed are {', '.join((*required, *optional)) or 'none'}"
               for key in table if key not in (*required, *optional)]
    faults += [f"{key} is missing" for key in required if key not in table]


def _check_number(table: dict[str, Any], key: str, allowed_values: str, allowed: Callable[[float], bool],
                  faults: list[str]) -> None:
    if key in table and not (is_finite_number(table[key]) and allowed(table[key])):
        faults.append(f"{key} = {table[key]!r}: must be {allowed_values}")


def _check_count(table: dict[str, Any], key: str, name: str, faults: list[str]) -> None:
    value = table.get(key, 1)
    if not is_positive_integer(value):
        faults.append(f"{name} = {value!r}: must be {COUNT}")


def _are_numbers(value: object, *counts: int) -> bool:
    """Whether a value is a list of as many numbers as one of counts."""
    return isinstance(value, list) and len(value) in counts and all(map(is_finite_number, value))


def _vector_lengths(d: int | None) -> tuple[int, ...]:
    """How many components vectors may have in d dimensions, which only the mesh knows if d is None."""
    return (d,) if d else (2, 3)


def _function(value: object, name: str, faults: list[str], start: float | None = None) -> Function:
    """The function of pseudo-time that a number or a table [[t, value], ...] is; `start`: what it must be at t = 0."""
    if is_finite_number(value):
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
    if not isinstance(kind, str) or kind not in MESH_KEYS:
        raise ValueError(f"kind = {kind!r}: must be one of {', '.join(MESH_KEYS)}")
    _check_keys(table, ("kind", *MESH_KEYS[kind][0]), MESH_KEYS[kind][1], faults)
    for name, lengths in {"size": (2, 3), "radii": (2,), "cells": (2, 3)}.items():
        if name in table and not _are_numbers(table[name], *lengths):
            faults.append(f"{name} = {table[name]!r}: must be {' or '.join(map(str, lengths))} numbers")
    _check_number(table, "height", "a number above 0", lambda value: value > 0, faults)
    if kind == "box" and "grading" in table and not faults:
        table = table | {"grading": _grading(table["grading"], len(table["size"]), faults)}
    elif kind == "annulus":
        _check_number(table, "grading", "a number above 0", lambda value: value > 0, faults)
    faults += [f"{name} = {table[name]!r}: must be true or false" for name in REDUCTIONS
               if not isinstance(table.get(name, False), bool)]
    if kind == "gmsh" and "file" in table and not (isinstance(table["file"], str) and (directory / table["file"]).is_file()):
        faults.append(f"file = {table['file']!r}: there is no such file")
    refuse("is wrong", faults)
    if kind == "gmsh":
        return table | {"file": directory / table["file"]}
    arguments = {name: value for name, value in table.items() if name not in ("kind", *REDUCTIONS)}
    (meshes.check_box if kind == "box" else meshes.check_annulus)(**arguments)
    return table


def _grading(value: object, d: int, faults: list[str]) -> list[float]:
    """Ratios of widths along all d axes, from a list or a table by some axes."""
    axes = CARTESIAN[:d]
    if isinstance(value, dict) and value and all(axis in axes for axis in value):
        value = [value.get(axis, 1.0) for axis in axes]
    if isinstance(value, list) and _are_numbers(value, d) and min(value) > 0:
        return value
    faults.append(f"grading = {value!r}: must be {d} numbers above 0, the last cell's width over the first's along each axis, or a "
                  f"table of some of {', '.join(axes)}")
    return [1.0] * d


def _is_outside(mesh: dict[str, Any], x: Sequence[float]) -> bool:
    """Whether a position is outside the body of a table [mesh]; not of a gmsh file, which is not read yet."""
    if mesh["kind"] == "gmsh":
        return False
    if mesh["kind"] == "box":
        low, high, place = [0.0] * len(mesh["size"]), list(mesh["size"]), list(x)
    else:                                                        # between two nodes the inner side is nearer to the axis
        inner, outer = mesh["radii"]
        low, high = [inner * np.cos(np.pi / mesh["cells"][1]), 0.0], [outer, mesh.get("height", 0.0)]
        place = [float(np.hypot(x[0], x[1])), *x[2:]]
    slack = ON_SIDE * max(high)
    return any(not start - slack <= value <= end + slack for start, value, end in zip(low, place, high))


def _kind_and_dimension(mesh: object) -> tuple[str | None, int | None]:
    """Kind of the mesh, and 2 or 3; None where there is none, or only the mesh knows. Also of a table with faults."""
    if not isinstance(mesh, dict) or mesh.get("kind") not in tuple(MESH_KEYS):
        return None, None
    if mesh["kind"] == "box":
        return "box", 3 if isinstance(mesh.get("size"), list) and len(mesh["size"]) == 3 else 2
    return mesh["kind"], {"annulus": 3 if "height" in mesh else 2}.get(mesh["kind"])


def _settings(content: dict[str, Any], d: int | None) -> dict[str, Any]:
    table = table_of(content, "problem")
    faults: list[str] = []
    _check_keys(table, (), ("degree", "gravity", "rate_term", "length", "solver", "tolerances"), faults)
    if table.get("degree", 1) not in (1, 2):
        faults.append(f"degree = {table['degree']!r}: must be 1 or 2")
    for name in ("rate_term", "length"):
        _check_number(table, name, "a number, at least 0", lambda value: value >= 0, faults)
    if "gravity" in table and not _are_numbers(table["gravity"], *_vector_lengths(d)):
        faults.append(f"gravity = {table['gravity']!r}: must be {d or '2 or 3'} finite numbers")
    if not isinstance(table.get("solver", {}), dict):
        faults.append("solver: must be a table of PETSc options")
    tolerances = table.get("tolerances", {})
    if not isinstance(tolerances, dict):
        faults.append("tolerances: must be a table of force, correction and iterations")
    else:
        _check_keys(tolerances, (), ("force", "correction", "iterations"), faults)
        for name in ("force", "correction"):
            _check_number(tolerances, name, "a number in (0, 1)", lambda value: 0 < value < 1, faults)
        _check_count(tolerances, "iterations", "iterations", faults)
    refuse("is wrong", faults)
    return table | {"tolerances": Tolerances(**tolerances)}


def _motion(content: dict[str, Any]) -> str:
    table = table_of(content, "motion")
    faults: list[str] = []
    _check_keys(table, (), ("kind",), faults)
    kind = table.get("kind", "lagrangian")
    if kind not in KINDS:
        faults.append(f"kind = {kind!r}: must be one of {', '.join(KINDS)}")
    refuse("is wrong", faults)
    return kind


def _initial(content: dict[str, Any], material: Material | None, kind: str | None, d: int | None,
             settings: dict[str, Any]) -> np.void | Resting | None:
    """The initial state; None if the material, which it depends on, has faults of its own."""
    table = initial_table(content)
    if table.get("state") not in (*INITIAL, "K0"):
        raise ValueError(f"[initial]: state = {table.get('state')!r}: must be one of {', '.join(INITIAL)}, K0")
    if table["state"] == "K0":
        return _resting(table, settings.get("gravity"))
    state = read_initial(material, content)
    if table["state"] == "steady" and kind != "box":
        raise ValueError("[initial]: state = 'steady' is uniform shear along x, of a box only; elsewhere it is a function of "
                         "x, to be given in Python")
    if state is not None and table["state"] == "steady" and d == 2:
        return exchange_y_z(np.array(state).reshape(1)).view(np.recarray)[0]         # shear in x-z as shear in x-y
    return state


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


def _run(content: dict[str, Any]) -> RunControl:
    table = table_of(content, "run")
    faults: list[str] = []
    _check_keys(table, ("until", "increment"), ("smallest", "unjammed"), faults)
    if table.get("until") != "steady":
        _check_number(table, "until", "a number above 0, or 'steady'", lambda value: value > 0, faults)
    _check_number(table, "unjammed", "a number from 0 to 1", lambda value: 0 <= value <= 1, faults)
    increment = _function(table.get("increment", 1.0), "increment", faults)
    if min(increment.values) <= 0 and not any(fault.startswith("increment") for fault in faults):
        faults.append(f"increment = {table['increment']!r}: must be above 0")
    _check_number(table, "smallest", "a number above 0", lambda value: value > 0, faults)
    refuse("is wrong", faults)
    until = np.inf if table["until"] == "steady" else float(table["until"])
    return RunControl(until, increment, table.get("smallest"), table.get("unjammed"))


def _output(content: dict[str, Any], d: int | None) -> OutputRequest:
    table = table_of(content, "output")
    faults: list[str] = []
    _check_keys(table, (), ("every", "times", "fields", "pictures", "probes", "center", "checkpoint"), faults)
    times = table.get("times", [])
    if not isinstance(times, list) or not all(is_finite_number(t) and t >= 0 for t in times):
        faults.append(f"times = {times!r}: must be a list of numbers, at least 0")
    _check_count(table, "every", "every", faults)
    for key, allowed in (("fields", [*FIELDS, *COMPONENTS]), ("pictures", SCALAR_FIELDS)):
        names = table.get(key, [])
        if isinstance(names, list):
            unknown: list[str] = []
            check_fields(names, allowed, unknown)
            faults += [f"{key}: {fault}" for fault in unknown]
        else:
            faults.append(f"{key} = {names!r}: must be a list of fields")
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
    return OutputRequest(table.get("every", None if times else 10), tuple(map(float, times)),
                         table.get("fields"), table.get("pictures", []), probes, table.get("center"), checkpoint)


def _regions(content: dict[str, Any], d: int | None) -> list[Region]:
    entries = tables_of(content, "region")
    faults: list[str] = []
    regions = [attempt(faults, f"region {number}: ", _region, entry, d) for number, entry in enumerate(entries, 1)]
    faults += repetitions("region", [entry.get("name") for entry in entries])
    if faults:
        raise ValueError("\n".join(faults))
    return [region for region in regions if region is not None]


def _region(entry: dict[str, Any], d: int | None) -> Region:
    faults: list[str] = []
    _check_keys(entry, ("name",), ("box", "ring"), faults)
    if not isinstance(entry.get("name", ""), str):
        faults.append(f"name = {entry['name']!r}: must be a text in quotes")
    if ("box" in entry) == ("ring" in entry):
        faults.append("must have either box or ring")
    box, ring = entry.get("box"), entry.get("ring")
    if box is not None and not (isinstance(box, list) and len(box) == 2 and all(_are_numbers(x, *_vector_lengths(d)) for x in box)
                                and len(box[0]) == len(box[1]) and (np.subtract(*box) < 0).all()):
        faults.append(f"box = {box!r}: must be the lowest and the highest position, of {d or '2 or 3'} numbers each")
    if ring is not None and not (_are_numbers(ring, 2) and 0 <= ring[0] < ring[1]):
        faults.append(f"ring = {ring!r}: must be two radii, the smaller first")
    refuse("is wrong", faults)
    return Region(entry["name"], None if box is None else (box[0], box[1]), None if ring is None else (ring[0], ring[1]))


def _quantities(content: dict[str, Any], d: int | None, sides: list[SideConditions] | None, run: RunControl | None,
                output: OutputRequest | None, regions: list[Region] | None) -> list[Quantity]:
    """The quantities, checked against what of the file is without faults, so that none is named twice."""
    held = None if sides is None else list(dict.fromkeys(str(side.on) for side in sides if side.is_held))

    def check_of(of: str) -> None:
        read_source(of, d, held, None if output is None else output.probes, None if regions is None else [
            region.name for region in regions])

    def check_time(t: float) -> None:
        if not 0 < t <= (np.inf if run is None else run.until):
            raise ValueError("must be above 0" + ("" if run is None else f", and at most until = {run.until:g} in [run]"))
    return read_quantities(content, check_of, check_time)


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
    gradient = _gradient(entry, names if kind != "annulus" else (), faults)
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
    openings = [key for key in ("inflow", "outflow") if key in entry]
    faults += [f"{key} = {entry[key]!r}: must be true" for key in openings if entry[key] is not True]
    if len(openings) == 2:
        faults.append("inflow and outflow cannot be given together")
    refuse("is wrong", faults)
    axis = None
    if "periodic" in entry and d is not None:                   # the side away from 0 has the displacement of the other one
        axis, sides = BOX_SIDES[d][sides[0]][0], [side for side in sides if BOX_SIDES[d][side][1] == 1]
    return [SideConditions(side, displacement, gradient, rotation, entry.get("center", [0.0, 0.0]), platen, pressure, traction,
                           axis, next(iter(openings), None)) for side in sides]


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


def _gradient(entry: dict[str, Any], names: Sequence[str], faults: list[str]) -> dict[tuple[int, int], Function]:
    """Functions by component and axis of a table such as { xy = ... }; `names` of the axes, none of a ring."""
    if "gradient" not in entry:
        return {}
    if not names:
        faults.append("gradient: not on a ring")
        return {}
    table, allowed = entry["gradient"], {i + j: (names.index(i), names.index(j)) for i in names for j in names}
    if not isinstance(table, dict) or not table or any(name not in allowed for name in table):
        faults.append(f"gradient = {table!r}: must be a table with some of {', '.join(allowed)}")
        return {}
    twice = sorted({name[0] for name in table} & set(entry["displacement"] if isinstance(entry.get("displacement"), dict) else ()))
    faults += [f"{name} is given by both displacement and gradient" for name in twice]
    if "rotation" in entry:
        faults.append("gradient and rotation cannot be given together")
    return {allowed[name]: _function(value, f"gradient {name}", faults, 0.0) for name, value in table.items()}


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
