"""Scene files: a boundary-value problem on a standard geometry or a gmsh mesh, as TOML."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from .. import tensors
from ..checks import is_number, refuse
from ..core import STATE
from ..material import Material
from ..paths import INITIAL, attempt, read_initial, read_material, read_toml, table_of
from . import meshes
from ._compat import gmsh_mesh
from .cellwise import on_rank_0
from .checkpoint import Checkpoint, resume
from .conditions import Displacement, Periodic, Pressure, Tied, Traction, polar, rotation
from .control import run
from .errors import SolveError
from .output import FIELDS, Fields, Pictures, Probe, Reactions
from .problem import Problem

# Per kind of mesh: the keys that it needs, and those that it may have.
MESHES = {"box": (("size", "cells"), ("cell",)), "annulus": (("radii", "cells"), ("height", "cell", "grading")),
          "gmsh": (("file",), ())}
TABLES = ("material", "mesh", "initial", "problem", "condition", "run", "output")
SIDES = {2: {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)},
         3: {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}}
CARTESIAN, POLAR = ("x", "y", "z"), ("radial", "circumferential", "z")
KINDS = ("displacement", "rotation", "platen", "pressure", "traction", "periodic")
NEAR = 1e-6                         # of the body's size: so close to a side's place, a facet lies on it


@dataclass(frozen=True)
class Function:
    """A piecewise linear function of pseudo-time; constant before its first time and after its last."""

    times: tuple
    values: tuple

    def __call__(self, t):
        return float(np.interp(t, self.times, self.values))


@dataclass(frozen=True)
class Scene:
    """What a scene file says, not yet on a mesh."""

    path: Path
    material: Material
    state: object
    mesh: dict
    settings: dict
    conditions: list
    until: float
    increment: Function
    smallest: float | None
    output: dict
    events: tuple


def read_scene(path):
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
    mesh = attempt(faults, "[mesh]: ", _mesh, content, path.parent) or {}
    kind, d = _kind(content.get("mesh"))
    settings = attempt(faults, "[problem]: ", _settings, content, d) or {}
    state = attempt(faults, "", _initial, content, material, kind, d, settings)
    entries = content.get("condition", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        faults.append("condition: must be tables [[condition]]")
        entries = []
    conditions = []
    for number, entry in enumerate(entries, 1):
        conditions += attempt(faults, f"condition {number}: ", _condition, entry, kind, d) or []
    control = attempt(faults, "[run]: ", _run, content) or (0.0, Function((0.0,), (1.0,)), None)
    output = attempt(faults, "[output]: ", _output, content, d) or {}
    refuse(f"{path} cannot be run", faults)
    kinks = {t for entry in conditions for function in entry["functions"] for t in function.times}
    events = tuple(sorted(t for t in kinks | set(output["times"]) if 0 < t < control[0]))
    return Scene(path, material, state, mesh, settings, conditions, *control, output, events)


def _check_keys(table, required, optional, faults):
    faults += [f"unknown key {key!r}: allowed are {', '.join((*required, *optional)) or 'none'}"
               for key in table if key not in (*required, *optional)]
    faults += [f"{key} is missing" for key in required if key not in table]


def _is_finite(value):
    return is_number(value) and np.isfinite(value)


def _are_numbers(value, count):
    return isinstance(value, list) and len(value) == count and all(map(_is_finite, value))


def _check_number(table, key, words, allowed, faults):
    if key in table and not (_is_finite(table[key]) and allowed(table[key])):
        faults.append(f"{key} = {table[key]!r}: must be {words}")


def _function(value, name, faults, start=None):
    """The function of time that a number or a table [[t, value], ...] is; `start`: what it must be at t = 0."""
    if _is_finite(value):
        function = Function((0.0,), (float(value),))
    elif (isinstance(value, list) and value and all(_are_numbers(row, 2) for row in value)
          and all(np.diff([row[0] for row in value]) > 0)):
        function = Function(*(tuple(map(float, column)) for column in zip(*value)))
    else:
        faults.append(f"{name} = {value!r}: must be a number or a table [[t, value], ...] with increasing times")
        return Function((0.0,), (0.0,))
    if start is not None and function(0.0) != start:
        faults.append(f"{name} = {value!r}: must be {start:g} at t = 0; give a table [[0, {start:g}], [t, value], ...]")
    return function


def _mesh(content, directory):
    table, faults = table_of(content, "mesh"), []
    kind = table.get("kind")
    if kind not in MESHES:
        raise ValueError(f"kind = {kind!r}: must be one of {', '.join(MESHES)}")
    _check_keys(table, ("kind", *MESHES[kind][0]), MESHES[kind][1], faults)
    lists = {"size": (2, 3), "radii": (2,), "cells": (2, 3)}
    for name, counts in lists.items():
        if name in table and not any(_are_numbers(table[name], count) for count in counts):
            faults.append(f"{name} = {table[name]!r}: must be {' or '.join(map(str, counts))} numbers")
    for name in ("height", "grading"):
        _check_number(table, name, "a number above 0", lambda value: value > 0, faults)
    if kind == "gmsh" and "file" in table and not (isinstance(table["file"], str) and (directory / table["file"]).is_file()):
        faults.append(f"file = {table['file']!r}: there is no such file")
    refuse("is wrong", faults)
    arguments = {name: value for name, value in table.items() if name != "kind"}
    if kind != "gmsh":
        {"box": meshes.check_box, "annulus": meshes.check_annulus}[kind](**arguments)
    return table | ({"file": directory / table["file"]} if kind == "gmsh" else {})


def _kind(mesh):
    """Kind of the mesh, and 2 or 3, None where only the mesh itself knows; also of a table with faults."""
    if not isinstance(mesh, dict) or mesh.get("kind") not in MESHES:
        return None, None
    if mesh["kind"] == "box":
        return "box", 3 if isinstance(mesh.get("size"), list) and len(mesh["size"]) == 3 else 2
    return mesh["kind"], {"annulus": 3 if "height" in mesh else 2}.get(mesh["kind"])


def _settings(content, d):
    table, faults = table_of(content, "problem"), []
    _check_keys(table, (), ("degree", "gravity", "rate_term", "solver"), faults)
    if table.get("degree", 1) not in (1, 2):
        faults.append(f"degree = {table['degree']!r}: must be 1 or 2")
    _check_number(table, "rate_term", "a number, at least 0", lambda value: value >= 0, faults)
    if "gravity" in table and not any(_are_numbers(table["gravity"], count) for count in ((d,) if d else (2, 3))):
        faults.append(f"gravity = {table['gravity']!r}: must be {d or '2 or 3'} finite numbers")
    if not isinstance(table.get("solver", {}), dict):
        faults.append("solver: must be a table of PETSc options")
    refuse("is wrong", faults)
    return table


def _initial(content, material, kind, d, settings):
    """The initial state, or a function of the problem's mesh that makes it: a state of depth below the surface."""
    table = table_of(content, "initial")
    if table.get("state") not in (*INITIAL, "K0"):
        raise ValueError(f"[initial]: state = {table.get('state')!r}: must be one of {', '.join(INITIAL)}, K0")
    if table["state"] != "K0":
        state = read_initial(material, content)
        if table["state"] == "steady" and kind != "box":
            raise ValueError("[initial]: state = 'steady' is uniform shear along x, of a box only; elsewhere it is a function of "
                             "x, to be given in Python")
        return _in_plane(state) if state is not None and table["state"] == "steady" and d == 2 else state
    faults = []
    _check_keys(table, ("state", "phi", "pressure"), ("K0",), faults)
    _check_number(table, "phi", "a number in (0, 1)", lambda value: 0 < value < 1, faults)
    _check_number(table, "pressure", "a number, at least 0", lambda value: value >= 0, faults)
    _check_number(table, "K0", "a number above 0", lambda value: value > 0, faults)
    gravity = settings.get("gravity")
    if gravity is None or any(gravity[:-1]) or gravity[-1] > 0:
        faults.append("state = 'K0' needs a gravity in [problem], downward along the last axis")
    elif material is not None and material.closure == "critical":
        faults.append("state = 'K0': the critical closure's pressure follows from phi alone")
    refuse("[initial]", faults)
    return None if material is None else lambda top: resting(material, table["phi"], -gravity[-1], top, table["pressure"],
                                                             table.get("K0", 1.0))


def _in_plane(state):
    """Shear in x-z as shear in x-y."""
    turned = np.array(state).reshape(1).view(np.recarray)[0]
    for name in ("stress", "fabric", "direction"):
        turned[name] = state[name][[0, 2, 1, 4, 3, 5]]
    return turned


def resting(material, volume_fraction, weight, top, pressure=0.0, k0=1.0):
    """State for Problem: at rest under gravity, isotropic fabric, horizontal stresses k0 times the vertical one.

    Parameters
    ----------
    material : Material
        With e_r = 0 the stress is the model's from the first increment on: then k0 = 1 alone is at rest.
    volume_fraction : float
    weight : float
        Of the solid per volume of the solid, as Problem's gravity, along the last axis.
    top : float
        Height of the free surface.
    pressure : float
        Vertical stress there.
    k0 : float

    Returns
    -------
    function of x (points, d) that gives records (points) of dtype STATE
    """
    def state(x):
        vertical = pressure + volume_fraction * weight * (top - x[:, -1])
        if (vertical < 0).any():
            raise ValueError(f"top = {top!r}: there are points above it")
        states = np.zeros(len(x), STATE).view(np.recarray)
        axis = x.shape[1] - 1
        states.stress[:, :3] = -k0 * vertical[:, None]
        states.stress[:, axis] = -vertical
        states.coordination_number = material.coordination_number(-tensors.trace(states.stress) / 3)
        states.volume_fraction = volume_fraction
        return states
    return state


def _condition(entry, kind, d):
    """One dict a side: its name, functions of (where, size of the body) that make conditions, the functions of time in them."""
    faults = []
    _check_keys(entry, ("on",), ("center", *KINDS), faults)
    if not any(key in entry for key in KINDS):
        faults.append(f"says nothing: give at least one of {', '.join(KINDS)}")
    on = entry.get("on", [])
    on = on if isinstance(on, list) else [on]
    sides = {"box": tuple(SIDES.get(d, ())), "annulus": ("inner", "outer", *(("bottom", "top") if d == 3 else ()))}.get(kind)
    if ("on" in entry and not on) or not all(isinstance(name, str) or (sides is None and isinstance(name, int)) for name in on):
        faults.append(f"on = {entry['on']!r}: must be a side or a list of sides")
    elif sides is not None:
        faults += [f"on: {name!r} is no side: must be one of {', '.join(sides)}" for name in on if name not in sides]
    axes, local = (POLAR, polar()) if kind == "annulus" else (CARTESIAN, None)
    names = axes if d != 2 else axes[:2]
    made, functions = [], []

    def components(key, start=None):
        table = entry[key]
        if not isinstance(table, dict) or not table or any(name not in names for name in table):
            faults.append(f"{key} = {table!r}: must be a table with some of {', '.join(names)}")
            return {}
        return {names.index(name): _function(value, f"{key} {name}", faults, start) for name, value in table.items()}

    if "displacement" in entry:
        given = components("displacement", 0.0)
        functions += given.values()
        if given:
            made.append(lambda where, size: Displacement(where, _vectors(given, kind), sorted(given), local))
    if "rotation" in entry:
        angle = _function(entry["rotation"], "rotation", faults, 0.0)
        functions.append(angle)
        center = entry.get("center", [0.0, 0.0])
        if not _are_numbers(center, 2):
            faults.append(f"center = {center!r}: must be 2 numbers")
        if isinstance(entry.get("displacement"), dict) and set(entry["displacement"]) - {"z"}:
            faults.append("rotation gives the displacement in the plane x y: beside it displacement may have z only")
        made.append(lambda where, size: Displacement(where, rotation(angle, center), [0, 1]))
    elif "center" in entry:
        faults.append("center belongs to rotation")
    if "platen" in entry:
        if entry["platen"] not in names:
            faults.append(f"platen = {entry['platen']!r}: must be the component that is the same on the whole side, "
                          f"one of {', '.join(names)}")
        else:
            made.append(lambda where, size: Tied(where, names.index(entry["platen"]), local))
    if "pressure" in entry:
        pressure = _function(entry["pressure"], "pressure", faults)
        functions.append(pressure)
        made.append(lambda where, size: Pressure(where, pressure))
    if "traction" in entry:
        if kind == "annulus":
            faults.append("traction: on a ring only pressure; a traction there is to be given in Python")
        traction = components("traction") if kind != "annulus" else {}
        functions += traction.values()
        made.append(lambda where, size: Traction(
            where, lambda t: [traction[i](t) if i in traction else 0.0 for i in range(len(size))]))
    if "periodic" in entry:
        pairs = [{"left", "right"}, {"front", "back"}, {"bottom", "top"}]
        if entry["periodic"] is not True or kind != "box" or set(on) not in pairs or len(on) != 2 or len(entry) != 2:
            faults.append("periodic = true stands alone with on = [\"left\", \"right\"] or another two opposite sides of a box")
    refuse("is wrong", faults)
    if "periodic" in entry:
        axis = SIDES[d][on[0]][0]
        second = next(name for name in on if SIDES[d][name][1] == 1)

        def partner(size):
            shift = np.zeros(d)
            shift[axis] = size[axis]
            return lambda x: x - shift
        return [{"on": second, "make": [lambda where, size: Periodic(where, partner(size))], "functions": [], "held": False}]
    held = any(key in entry for key in ("displacement", "rotation", "platen"))
    return [{"on": name, "make": made, "functions": functions, "held": held} for name in on]


def _vectors(given, kind):
    """Value for Displacement from functions of time by component; of a ring along polar axes."""
    def value(x, t):
        vectors = np.zeros_like(x)
        for component, function in given.items():
            vectors[:, component] = function(t)
        return np.einsum("nij,nj->ni", polar()(x), vectors) if kind == "annulus" else vectors
    return value


def _run(content):
    table, faults = table_of(content, "run"), []
    _check_keys(table, ("until", "increment"), ("smallest",), faults)
    _check_number(table, "until", "a number above 0", lambda value: value > 0, faults)
    increment = _function(table.get("increment", 1.0), "increment", faults)
    if min(increment.values) <= 0 and not any(fault.startswith("increment") for fault in faults):
        faults.append(f"increment = {table['increment']!r}: must be above 0")
    _check_number(table, "smallest", "a number above 0", lambda value: value > 0, faults)
    refuse("is wrong", faults)
    return float(table["until"]), increment, table.get("smallest")


def _output(content, d):
    table, faults = table_of(content, "output"), []
    _check_keys(table, (), ("every", "times", "pictures", "probes", "center", "checkpoint"), faults)

    def check_every(value, name):
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            faults.append(f"{name} = {value!r}: must be an integer, at least 1")

    times = table.get("times", [])
    if not isinstance(times, list) or not all(_is_finite(t) and t >= 0 for t in times):
        faults.append(f"times = {times!r}: must be a list of numbers, at least 0")
        times = []
    if "every" in table:
        check_every(table["every"], "every")
    pictures = table.get("pictures", [])
    names = [name for name in FIELDS if name != "A_direction"]
    if not isinstance(pictures, list) or any(name not in names for name in pictures):
        faults.append(f"pictures = {pictures!r}: must be a list of some of {', '.join(names)}")
    probes = table.get("probes", {})
    if not isinstance(probes, dict) or not all(any(_are_numbers(x, count) for count in ((d,) if d else (2, 3)))
                                               for x in probes.values()):
        faults.append(f"probes = {probes!r}: must be a table of names and positions of {d or '2 or 3'} numbers")
    elif any(not name.replace("-", "_").isidentifier() for name in probes):
        faults.append("probes: their names may have letters, digits, - and _")
    if "center" in table and not any(_are_numbers(table["center"], count) for count in ((d,) if d else (2, 3))):
        faults.append(f"center = {table['center']!r}: must be {d or '2 or 3'} numbers")
    checkpoint = table.get("checkpoint", {"seconds": 600})
    if not isinstance(checkpoint, dict) or not checkpoint:
        faults.append(f"checkpoint = {checkpoint!r}: must be a table with every (increments), seconds or both")
    else:
        _check_keys(checkpoint, (), ("every", "seconds"), faults)
        if "every" in checkpoint:
            check_every(checkpoint["every"], "checkpoint every")
        _check_number(checkpoint, "seconds", "a number, at least 0", lambda value: value >= 0, faults)
    refuse("is wrong", faults)
    return {"every": table.get("every", None if times else 10), "times": tuple(map(float, times)), "pictures": pictures,
            "probes": probes, "center": table.get("center"), "checkpoint": checkpoint}


# ---- on the mesh -----------------------------------------------------------------------------------------------------

def problem_of(scene, comm):
    """The scene's Problem, and `where` of every named side that conditions hold."""
    mesh, tags, names = _make_mesh(scene.mesh, comm)
    d = mesh.geometry.dim
    size = [comm.allreduce(mesh.geometry.x[:, axis].max(initial=-np.inf), MPI.MAX) for axis in range(d)]
    if scene.mesh["kind"] == "gmsh":
        wheres = {entry["on"]: names.get(entry["on"], entry["on"]) for entry in scene.conditions}
        refuse(f"{scene.path} does not fit {scene.mesh['file']}", [
            f"on: there are no facets {name!r}: the file names {', '.join(names) or 'none'}"
            for name, tag in wheres.items() if isinstance(tag, str)])
    else:
        wheres = {entry["on"]: _side(scene.mesh, d, entry["on"]) for entry in scene.conditions}
    conditions = [make(wheres[entry["on"]], size) for entry in scene.conditions for make in entry["make"]]
    state = scene.state(size[-1]) if callable(scene.state) else scene.state
    problem = Problem(mesh, scene.material, state, conditions, facet_tags=tags, **scene.settings)
    held = {str(entry["on"]): wheres[entry["on"]] for entry in scene.conditions if entry["held"]}
    return problem, held


def _make_mesh(table, comm):
    arguments = {name: value for name, value in table.items() if name != "kind"}
    if table["kind"] == "gmsh":
        return gmsh_mesh(comm, table["file"])
    return (meshes.box if table["kind"] == "box" else meshes.annulus)(comm, **arguments), None, {}


def _side(table, d, name):
    """Function of x (3, n) for a named side."""
    if table["kind"] == "box" or name in ("bottom", "top"):
        axis, end = SIDES[d][name]
        size = table["size"] if table["kind"] == "box" else [0, 0, table["height"]]
        return lambda x: abs(x[axis] - end * size[axis]) < NEAR * max(size)
    radius = table["radii"][name == "outer"]
    return lambda x: abs(np.hypot(x[0], x[1]) - radius) < NEAR * table["radii"][1]


def solve(path, out, resumed=False, comm=MPI.COMM_WORLD, progress=None):
    """Runs a scene file; what it gives is in the directory `out`.

    Parameters
    ----------
    path, out : path
    resumed : bool
        Whether to go on from the checkpoint in `out`.
    comm : MPI communicator
    progress : stream, optional

    Returns
    -------
    Problem, and list of Path (what was written)

    Raises
    ------
    ValueError, OSError
        Names everything that is wrong with the file at once.
    SolveError
        Where it cannot be brought further; fields and a checkpoint of the last accepted increment are written.
    """
    scene, out = read_scene(path), Path(out)
    problem, held = problem_of(scene, comm)
    when = {"every": scene.output["every"], "times": (*scene.output["times"], 0.0, scene.until)}
    outputs = [Fields(out / "fields.xdmf", **when)]
    outputs += [Reactions(out / "reactions.csv", held, scene.output["center"])] if held else []
    outputs += [Probe(out / f"probe-{name}.csv", x) for name, x in scene.output["probes"].items()]
    outputs += [Pictures(out, field, **when) for field in scene.output["pictures"]]
    checkpoint = Checkpoint(out / "checkpoint.npz", outputs, **scene.output["checkpoint"])

    def prepare():
        if resumed and not checkpoint.path.exists():
            raise FileNotFoundError(f"there is no {checkpoint.path} to go on from: run it without --resume")
        out.mkdir(parents=True, exist_ok=True)
        if not resumed:
            checkpoint.path.unlink(missing_ok=True)              # of an earlier run
    on_rank_0(comm, prepare)
    if resumed:
        resume(checkpoint.path, problem, outputs)
    written = [output.path for output in outputs if not isinstance(output, Pictures)] + [checkpoint.path]
    try:
        run(problem, scene.until, scene.increment, smallest=scene.smallest, events=scene.events,
            observers=[*outputs, checkpoint], progress=progress)
    except SolveError as error:
        _write_all(problem, outputs, checkpoint)
        raise SolveError(f"{error}\neverything up to t = {problem.t:g} is in {out}: "
                         f"{', '.join(path.name for path in written)}; --resume goes on from there") from None
    _write_all(problem, outputs, checkpoint)
    return problem, written


def _write_all(problem, outputs, checkpoint):
    for output in outputs:
        output.write(problem)
    checkpoint.write(problem)
