"""Coarser models of a path or a scene: what can be left out of a file, as changes of its content.

An *axis* is one kind of simplification, such as the mesh or the closure, and its *rungs* are the models along it, from the finest
or richest down. A rung changes the content of a file, a dictionary as it is read from TOML, and returns a new one.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .calibrations import is_calibration_file
from .checks import refuse
from .material import TURNING, UNUSED

Content = dict[str, Any]

DIMENSION, NUMERICS, MODEL, CONSTANT = "dimension", "numerics", "model", "constant"
SYMMETRIES = {"axial": "one sector of the ring", "layer": "two columns of the layer", "plane": "plane strain"}


@dataclass(frozen=True)
class Rung:
    """A model along an axis.

    Attributes
    ----------
    name : str
    change : function of a content that returns another
    size : float
        Of the increments or the smallest cells, in any unit; of a sequence.
    """

    name: str
    change: Callable[[Content], Content]
    size: float = 1.0


def unchanged(content: Content) -> Content:
    """The change that changes nothing."""
    return content


@dataclass(frozen=True)
class Axis:
    """One kind of simplification.

    Attributes
    ----------
    name : str
    kind : str
        DIMENSION, NUMERICS or MODEL; CONSTANT for what is no simplification but a constant or a choice that nobody knows better.
    rungs : tuple of Rung
        From the finest or richest down.
    start : int
        The rung that is looked at first; of a sequence the coarsest of the first three.
    is_sequence : bool
        Whether the size of what is discretised doubles from one rung to the next, so that errors can be extrapolated.
    own : Rung
        The file's own, which may be none of the rungs.
    mesh : Rung or None
        Of a DIMENSION: the mesh on which its rungs are compared.
    """

    name: str
    kind: str
    rungs: tuple[Rung, ...]
    start: int = 0
    is_sequence: bool = False
    own: Rung = Rung("as in the file", unchanged)
    mesh: Rung | None = None


# ---- the material, of paths and scenes ----------------------------------------------------------------------------------

CLOSURES = ("full", "n2", "basic", "critical")
MU_FACTOR = 1.1                     # by which mu is known at best
ELASTIC_FACTOR = 3.0                # the same for e_r, which the paper does not have
LENGTH_FACTOR = 1.25                # the same for the length of a scene, docs/length-and-grains.md


def with_material(content: Content, **values: Any) -> Content:
    """The content with other keys in [material]; constants without a role in its closure are left out."""
    table = {**content.get("material", {}), **values}
    unused = UNUSED[table.get("closure", "full")] if "closure" in values else ()
    return {**content, "material": {key: value for key, value in table.items() if key not in unused}}


def _material(**values: Any) -> Callable[[Content], Content]:
    return lambda content: with_material(content, **values)


def closures(content: Content) -> Axis:
    """The closure: from the file's own if that is not of the paper, else "full", down to no microstructure at all."""
    own = content.get("material", {}).get("closure", "full")
    names = (own if own in ("kinematic", *TURNING) else "full", *CLOSURES[1:])
    rungs = [Rung(name, unchanged if name == own else _material(closure=name)) for name in names[:-1]]
    rungs.append(Rung("critical", unchanged if own == "critical" else _critical))
    return Axis("closure", MODEL, tuple(rungs), own=Rung(own, unchanged))


def _critical(content: Content) -> Content:
    """The content with the critical closure, in which pressure and volume fraction follow from each other.

    Where nothing is free to change the volume the initial volume fraction stays as it is, otherwise the initial pressure.
    """
    content = with_material(content, closure="critical")
    steps = content.get("step")
    if not steps or any(_frees(entry) for entry in steps) or content.get("initial", {}).get("state") != "isotropic":
        return content
    given_otherwise = ("pressure", "Z2", "coordination_number")
    return {**content, "initial": {key: value for key, value in content["initial"].items() if key not in given_otherwise}}


def _frees(entry: Mapping[str, Any]) -> bool:
    """Whether a step of a path leaves a deformation free."""
    test = entry.get("test")
    is_free_test = (str(test).endswith("-drained") or (test == "isotropic" and "pressure" in entry)
                    or (test == "oedometer" and "sigma_zz" in entry) or (test == "dss" and "control" not in entry))
    return bool(entry.get("free")) or entry.get("control", "volume") != "volume" or is_free_test


def relaxation(content: Content) -> Axis | None:
    """The elastic strain, with and without; None if the file has none, or a closure that needs it."""
    value = content.get("material", {}).get("elastic_strain", 0.0)
    if value == 0 or content["material"].get("closure") in TURNING:
        return None
    return Axis("elastic strain", MODEL, (Rung(f"{value:g}", unchanged), Rung("none", _material(elastic_strain=0.0))))


def constants(content: Content) -> list[Axis]:
    """What is known badly: friction, elastic strain, a scene's length, the closure, of which "kinematic" or "full" is the other."""
    table = content.get("material", {})
    mu, e_r, length = table.get("mu", 0.5), table.get("elastic_strain", 0.0), content.get("problem", {}).get("length", 0.0)
    closure = table.get("closure", "full")
    other = "full" if closure == "kinematic" else "kinematic"
    found = [("mu", f"{mu:g}", [(f"{value:g}", _material(mu=value)) for value in (mu / MU_FACTOR, min(mu * MU_FACTOR, 1.0))
                               if value != mu])]
    if e_r > 0:
        found.append(("e_r", f"{e_r:g}", [(f"{value:.3g}", _material(elastic_strain=value))
                                          for value in (e_r / ELASTIC_FACTOR, e_r * ELASTIC_FACTOR)]))
    if length > 0:
        found.append(("l", f"{length:g}", [(f"{value:.3g}", _problem(length=value))
                                                for value in (length / LENGTH_FACTOR, length * LENGTH_FACTOR)]))
    found.append(("choice of closure", closure, [(other, _material(closure=other))]))
    return [Axis(name, CONSTANT, (Rung(own, unchanged), *(Rung(*rung) for rung in rungs))) for name, own, rungs in found if rungs]


# ---- paths --------------------------------------------------------------------------------------------------------------

DEFAULT_INCREMENTS = {"cycles": 100, "test": {"isotropic": 100}}
STEP_INCREMENTS = 200
PATH_FACTORS = (0.25, 0.5, 1, 2, 4, 8, 16, 32)
PATH_TOLERANCES = (1e-8, 1e-6, 1e-4, 1e-3)
TOLERANCE = 1e-6                    # of path files that say nothing


def path_axes(content: Content) -> list[Axis]:
    """The axes of a path file's content."""
    increments = tuple(Rung(_times(factor), _path_increments(factor), factor) for factor in PATH_FACTORS)
    distinct = [rung for number, rung in enumerate(increments)
                if PATH_FACTORS[number] <= 1 or rung.change(content) != increments[number - 1].change(content)]
    axes = [Axis("increment", NUMERICS, tuple(distinct), min(4, len(distinct) - 1), True)] if len(distinct) > 3 else []
    if any(_frees(step) for step in content.get("step", [])):
        own = content.get("tolerance", TOLERANCE)
        values = sorted({*PATH_TOLERANCES, own})
        rungs = tuple(Rung(f"{value:g}", _path_tolerance(value)) for value in values if value <= max(own, PATH_TOLERANCES[-1]))
        axes.append(Axis("tolerance", NUMERICS, rungs, own=Rung(f"{own:g}", unchanged)))
    return [axis for axis in (*axes, closures(content), relaxation(content)) if axis]


def _path_tolerance(value: float) -> Callable[[Content], Content]:
    return lambda content: {**content, "tolerance": value}


def _path_increments(factor: float) -> Callable[[Content], Content]:
    def change(content: Content) -> Content:
        first, steps = 0, []
        for entry in content["step"]:
            number = 2 * entry["cycles"] if "cycles" in entry else 1
            steps.append(_with_increments(entry, factor, _times_within(content, first, number)))
            first += number
        return {**content, "step": steps}
    return change


def _times_within(content: Content, first: int, number: int) -> list[float]:
    """Where in a step (0 to 1) the file's quantities are wanted; of cycles in any of their steps."""
    times = [t for quantity in content.get("quantity", []) if isinstance(quantity.get("at"), list) for t in quantity["at"]]
    return [t % 1 for t in times if first < t < first + number and t % 1]


def _with_increments(entry: Mapping[str, Any], factor: float, times: Sequence[float]) -> Content:
    """A step with increments that are `factor` times as large, or less where times would not be met.

    A step that a condition ends keeps its increments, since it is only looked at where one of them ends.
    """
    if "csv" in entry or "pause" in entry or "until" in entry or factor == 1:
        return dict(entry)
    kind = next((kind for kind in entry if kind in DEFAULT_INCREMENTS), "")
    default: Any = DEFAULT_INCREMENTS.get(kind, STEP_INCREMENTS)
    own = entry.get("increments", default.get(entry["test"], STEP_INCREMENTS) if isinstance(default, dict) else default)
    if factor < 1:
        return {**entry, "increments": round(own / factor)}
    return {**entry, "increments": own // math.gcd(own, int(factor), *(round(own * t) for t in times))}


# ---- files that a file refers to ----------------------------------------------------------------------------------------

def referred_files(content: Content) -> list[str]:
    """Names of files in a content: tables of steps, a mesh, a calibration."""
    return [table[key] for table, key in _references(content)]


def relocated(content: Content, move: Callable[[str], str | Path]) -> Content:
    """The content with other names of the files that it refers to."""
    content = copy.deepcopy(content)
    for table, key in _references(content):
        table[key] = str(move(table[key]))
    return content


def _references(content: Content) -> list[tuple[dict[str, Any], str]]:
    """The tables, and their keys, that name a file."""
    places = [(entry, "csv") for entry in _steps(content)] + [
        (content.get(name), key) for name, key in (("mesh", "file"), ("material", "calibration"))]
    return [(table, key) for table, key in places if isinstance(table, dict) and isinstance(table.get(key), str)
            and (key != "calibration" or is_calibration_file(table[key]))]


def _steps(content: Content) -> list[Any]:
    steps = content.get("step", [])
    return [entry for entry in steps if isinstance(entry, dict)] if isinstance(steps, list) else []


# ---- scenes -------------------------------------------------------------------------------------------------------------

REDUCED_FACTORS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8)     # cell size over the file's, where cells cost little
PLANE_FACTORS = (1 / 4, 1 / 2, 1, 2, 4, 8)
SOLID_FACTORS = (1, 2, 4, 8)
SCENE_INCREMENTS = (1 / 4, 1 / 2, 1, 2, 4, 8, 16, 32)
NEWTON = ((1e-6, 1e-3), (1e-4, 1e-2))                           # force, correction
FIRST_FACTOR = 4                    # of the coarsest of the first three increments or meshes
RING_GRADING = 16.0                 # what costs little and resolves the shear at the inner wall
LARGEST_ASPECT = 4                  # of the cells of such a sector
CHECK_FACTOR = 4                    # cells where a symmetry is checked, over the file's
NOISE = 1e-4                        # of the initial volume fraction
FEWEST_CELLS = {"ring": 8, "other": 2}                          # round a ring, along other directions


def claimed_symmetries(content: Content) -> list[str]:
    """The symmetries that a scene claims in [ladder]; ValueError where there are none such."""
    table = content.get("ladder", {})
    claimed = table.get("symmetry", []) if isinstance(table, Mapping) else None
    names = [claimed] if isinstance(claimed, str) else claimed
    if not isinstance(names, list) or any(name not in SYMMETRIES for name in names) or set(table) - {"symmetry"}:
        raise ValueError(f"[ladder]: must have nothing but symmetry, one or a list of {', '.join(SYMMETRIES)}")
    mesh = content.get("mesh", {})
    kind, cells = (mesh.get("kind"), mesh.get("cells", [])) if isinstance(mesh, Mapping) else (None, [])
    wanted = {"axial": (kind == "annulus", "a ring"), "layer": (kind == "box", "a box"),
              "plane": (kind in ("box", "annulus") and np.size(cells) == 3, "a box or ring in three dimensions")}
    refuse("[ladder]", [f"symmetry {name!r} needs {wanted[name][1]}" for name in names if not wanted[name][0]])
    return names


def scene_axes(content: Content) -> list[Axis]:
    """The axes of a scene file's content; ValueError where it claims a symmetry that its mesh cannot have."""
    axes: list[Axis] = []
    names = claimed_symmetries(content)
    if names:
        words = ", ".join(SYMMETRIES[name] for name in names)
        everywhere = range(len(content["mesh"]["cells"]))
        axes.append(Axis("dimension", DIMENSION, (Rung("as in the file", unchanged), Rung(words, _reduction(names))),
                         mesh=Rung("a quarter of the cells each way", _cells(CHECK_FACTOR, everywhere))))
    problem = content.get("problem", {})
    axes.append(Axis("Newton's tolerance", NUMERICS, (Rung("as in the file", unchanged),
                                                      *(Rung(f"{force:g}, {correction:g}", _newton(force, correction))
                                                        for force, correction in NEWTON))))
    increments = tuple(Rung(_times(factor), _scene_increment(factor), factor) for factor in SCENE_INCREMENTS)
    axes.append(Axis("increment", NUMERICS, increments, SCENE_INCREMENTS.index(FIRST_FACTOR), True))
    if content.get("mesh", {}).get("kind") in ("box", "annulus"):
        axes.append(mesh_axis(content, names))
    axes += [Axis(name, MODEL, (Rung(f"{problem[key]:g}", unchanged), Rung("none", _problem(**{key: 0.0}))))
             for name, key in (("length", "length"), ("rate term", "rate_term")) if problem.get(key, 0) > 0]
    return axes + [axis for axis in (closures(content), relaxation(content)) if axis]


def mesh_axis(content: Content, symmetries: Sequence[str]) -> Axis:
    """The mesh, refined and coarsened by factors of two along the directions that the symmetries leave."""
    mesh = content["mesh"]
    left = _directions_left(mesh, symmetries)
    factors = {1: REDUCED_FACTORS, 2: PLANE_FACTORS, 3: SOLID_FACTORS}[len(left)]
    grading = max(mesh.get("grading", 1.0), RING_GRADING) if "axial" in symmetries else None
    rungs: list[Rung] = []
    for factor in factors:
        change = _cells(factor, left, grading)
        table = change(content)["mesh"]
        cells = table["cells"]
        if rungs and cells == rungs[-1].change(content)["mesh"]["cells"]:
            break
        name = " x ".join(str(cells[axis]) for axis in left) + " cells" + (f", graded {table['grading']:.3g}:1" if grading else "")
        rungs.append(Rung(name, change, _smallest_ring(table) if grading else factor))
    start = min(factors.index(FIRST_FACTOR), len(rungs) - 1)
    own = " x ".join(str(mesh["cells"][axis]) for axis in left) + " cells, as in the file"
    return Axis("mesh", NUMERICS, tuple(rungs), start, True, Rung(own, unchanged))


def _times(factor: float) -> str:
    return "as in the file" if factor == 1 else f"{factor:g} times the file's"


def _directions_left(mesh: Mapping[str, Any], symmetries: Sequence[str]) -> list[int]:
    """The directions of `cells` that the symmetries leave."""
    left = list(range(len(mesh["cells"])))
    if "axial" in symmetries:
        left.remove(1)
    if "layer" in symmetries:
        left.remove(0)
    if "plane" in symmetries:
        left.remove(_plane_direction(mesh))
    return left


def _plane_direction(mesh: Mapping[str, Any]) -> int:
    """The direction of `cells` along which a body in three dimensions is the same, so that it becomes plane strain."""
    return 1 if mesh["kind"] == "box" else 2


def _reduction(symmetries: Sequence[str]) -> Callable[[Content], Content]:
    keys = {"axial": "sector", "layer": "layer", "plane": "plane"}
    return lambda content: {**content, "mesh": {**content["mesh"], **{keys[name]: True for name in symmetries}}}


def _cells(factor: float, left: Sequence[int], grading: float | None = None) -> Callable[[Content], Content]:
    """Cells that are `factor` times as large along the directions that are left, and graded anew if that is given."""
    def change(content: Content) -> Content:
        mesh = dict(content["mesh"])
        kinds = ["ring" if mesh["kind"] == "annulus" and axis == 1 else "other" for axis in range(len(mesh["cells"]))]
        fewest = [FEWEST_CELLS[kind] for kind in kinds]
        mesh["cells"] = [max(min(fewest[axis], count), round(count / factor)) if axis in left else count
                         for axis, count in enumerate(mesh["cells"])]
        if grading is not None:
            mesh["grading"] = grading ** (1 - 1 / mesh["cells"][0])                   # so that two cells are one of the next mesh
            mesh["cells"][1] = max(mesh["cells"][1], _sectors(mesh))
        return {**content, "mesh": mesh}
    return change


def _sectors(mesh: Mapping[str, Any]) -> int:
    """Sectors of a ring of which one is modelled, so that it is not much wider than the innermost ring of cells.

    They cost nothing, and cells that are long and thin are turned inside out when they are sheared round a ring.
    """
    return math.ceil(2 * math.pi * mesh["radii"][0] / (LARGEST_ASPECT * _smallest_ring(mesh)))


def _smallest_ring(mesh: Mapping[str, Any]) -> float:
    """Width of the innermost ring of cells, which is the smallest."""
    widths = np.geomspace(1, mesh["grading"], mesh["cells"][0])
    return float((mesh["radii"][1] - mesh["radii"][0]) * widths[0] / widths.sum())


def _newton(force: float, correction: float) -> Callable[[Content], Content]:
    def change(content: Content) -> Content:
        tolerances = content.get("problem", {}).get("tolerances", {})
        return _problem(tolerances={**tolerances, "force": force, "correction": correction})(content)
    return change


def _problem(**values: Any) -> Callable[[Content], Content]:
    return lambda content: {**content, "problem": {**content.get("problem", {}), **values}}


def _scene_increment(factor: float) -> Callable[[Content], Content]:
    def change(content: Content) -> Content:
        run = dict(content["run"])
        value = run["increment"]
        run["increment"] = [[t, factor * size] for t, size in value] if isinstance(value, list) else factor * value
        return {**content, "run": run}
    return change


def with_noise(content: Content) -> Content:
    """The content with a little noise in its initial state, which the runner of a ladder makes."""
    return {**content, "ladder": {**content.get("ladder", {}), "noise": NOISE}}


def bare(content: Content) -> Content:
    """The content without what a run would write besides its quantities, so that the time of a run is that of computing.

    Also without tolerances and scales of quantities, with which a run has nothing to do.
    """
    output = {key: value for key, value in content.get("output", {}).items() if key in ("probes", "center", "acoustic")}
    if "mesh" in content:                                        # a record of the fields at the start and at the end
        output["every"] = 10**9
    quantities = [{key: value for key, value in entry.items() if key not in ("tolerance", "scale")}
                  for entry in content.get("quantity", [])]
    return {**content, "output": output, **({"quantity": quantities} if quantities else {})}
