"""Builds what a scene file says on its mesh, and runs it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from ..checks import refuse
from ..core import STATE
from ..material import Material
from ..quantities import QUANTITIES_FILE
from . import meshes
from ._compat import FacetTags
from .cellwise import on_rank_0
from .checkpoint import Checkpoint, resume
from .conditions import Displacement, Periodic, Pressure, Tied, Traction, Where, polar, rotation
from .control import run
from .errors import SolveError
from .fields import Fields
from .output import Output
from .pictures import Pictures
from .problem import Problem
from .quantities import Quantities
from .reduction import modelled
from .scene_data import BOX_SIDES, Function, Resting, Scene, SideConditions
from .scene_file import read_scene
from .tables import Probe, Reactions

DEPTH_STEPS = 20                    # over which the weight is summed where phi depends on the depth
ON_SIDE = 1e-6                      # over the body's size: a facet as close as that to a side's place lies on it


def resting(material: Material, volume_fraction: float, weight: float, top: float, pressure: float = 0.0,
            k0: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
    """State for Problem: at rest under gravity, isotropic fabric, horizontal stresses k0 times the vertical one.

    In the critical closure phi follows from the pressure, and the weight from phi.

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
        It raises ValueError where points lie above the surface.
    """
    def state(x: np.ndarray) -> np.ndarray:
        depth, vertical = top - x[:, -1], np.full(len(x), float(pressure))
        if (pressure + volume_fraction * weight * depth < 0).any():
            raise ValueError(f"top = {top!r}: there are points above it")

        def packing(vertical: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Phi and Z2 under vertical stresses."""
            z2 = material.coordination_number((1 + 2 * k0) / 3 * vertical)
            return material.volume_fraction(volume_fraction, z2), z2

        for _ in range(DEPTH_STEPS):                         # the weight above: midpoint rule, of a phi that hardly changes
            step = weight * depth / DEPTH_STEPS
            vertical += step * packing(np.maximum(vertical + packing(vertical)[0] * step / 2, 0))[0]
        states = np.zeros(len(x), STATE).view(np.recarray)
        states["stress"][:, :3] = -k0 * vertical[:, None]
        states["stress"][:, x.shape[1] - 1] = -vertical
        states["volume_fraction"], states["coordination_number"] = packing(vertical)
        return states
    return state


def problem_of(scene: Scene, comm: MPI.Comm) -> tuple[Problem, dict[str, Where]]:
    """The Problem of the part of a scene that is modelled, and the `where` of every side that conditions hold, by name.

    Raises
    ------
    ValueError
        A gmsh file lacks facets that conditions name.
    """
    scene, _ = modelled(scene)
    mesh, tags, names = _make_mesh(scene.mesh, comm)
    d = mesh.geometry.dim
    size = [comm.allreduce(mesh.geometry.x[:, axis].max(initial=-np.inf), MPI.MAX) for axis in range(d)]
    sides = list(dict.fromkeys(entry.on for entry in scene.conditions))
    wheres: dict[str | int, Where]
    if scene.mesh["kind"] == "gmsh":
        refuse(f"{scene.path} does not fit {scene.mesh['file']}", [
            f"on: there are no facets {side!r}: the file names {', '.join(names) or 'none'}"
            for side in sides if isinstance(side, str) and side not in names])
        wheres = {side: names[side] if isinstance(side, str) else side for side in sides}
    else:
        wheres = {side: _side(scene.mesh, d, str(side)) for side in sides}
    conditions = [condition for entry in scene.conditions
                  for condition in _conditions(entry, wheres[entry.on], size, scene.mesh["kind"])]
    if "angle" in scene.mesh:
        conditions.append(_tie_of_sector(scene.mesh["angle"]))
    initial: Any = scene.initial
    if isinstance(initial, Resting):
        initial = resting(scene.material, initial.volume_fraction, initial.weight, size[-1], initial.pressure, initial.k0)
    problem = Problem(mesh, scene.material, initial, conditions, facet_tags=tags, **scene.settings)
    return problem, {str(entry.on): wheres[entry.on] for entry in scene.conditions if entry.is_held}


def _make_mesh(table: dict[str, Any], comm: MPI.Comm) -> tuple[dolfinx.mesh.Mesh, FacetTags | None, dict[str, int]]:
    """Mesh, facet tags, and the tags of the facets' names."""
    arguments = {name: value for name, value in table.items() if name != "kind"}
    if table["kind"] == "gmsh":
        return meshes.from_gmsh(comm, **arguments)
    return (meshes.box if table["kind"] == "box" else meshes.annulus)(comm, **arguments), None, {}


def _side(table: dict[str, Any], d: int, name: str) -> Callable[[np.ndarray], np.ndarray]:
    """Function of x (3, n) for a named side."""
    if table["kind"] == "box" or name in ("bottom", "top"):
        axis, end = BOX_SIDES[d][name]
        size = table["size"] if table["kind"] == "box" else [0, 0, table["height"]]
        return lambda x: abs(x[axis] - end * size[axis]) < ON_SIDE * max(size)
    radius = table["radii"][name == "outer"]
    return lambda x: abs(np.hypot(x[0], x[1]) - radius) < ON_SIDE * table["radii"][1]


def _conditions(entry: SideConditions, where: Where, size: Sequence[float], kind: str) -> list[object]:
    """The conditions of one side of a body of a size (d)."""
    local_axes = polar() if kind == "annulus" else None
    conditions: list[object] = []
    if entry.displacement:
        value = _displacement(entry.displacement, kind)
        conditions.append(Displacement(where, value, sorted(entry.displacement), local_axes))
    if entry.gradient:
        conditions.append(Displacement(where, _affine(entry.gradient), sorted({i for i, _ in entry.gradient})))
    if entry.rotation is not None:
        conditions.append(Displacement(where, rotation(entry.rotation, entry.center), [0, 1]))
    if entry.platen is not None:
        conditions.append(Tied(where, entry.platen, local_axes))
    if entry.pressure is not None:
        conditions.append(Pressure(where, entry.pressure))
    if entry.traction:
        components = [entry.traction.get(i, Function((0.0,), (0.0,))) for i in range(len(size))]
        conditions.append(Traction(where, lambda t: [component(t) for component in components]))
    if entry.periodic is not None:
        shift = np.zeros(len(size))
        shift[entry.periodic] = size[entry.periodic]
        conditions.append(Periodic(where, lambda x: x - shift))
    return conditions


def _tie_of_sector(angle: float) -> Periodic:
    """Ties the side of a sector that is at an angle to the one at the x axis, turned by the angle."""
    return Periodic(lambda x: abs(np.arctan2(x[1], x[0]) - angle) < ON_SIDE,
                    lambda x: np.column_stack([np.hypot(x[:, 0], x[:, 1]), 0 * x[:, 1], x[:, 2:]]), polar())


def _displacement(components: dict[int, Function], kind: str) -> Callable[[np.ndarray, float], np.ndarray]:
    """Value for Displacement from functions by component; of a ring along polar axes."""
    def value(x: np.ndarray, t: float) -> np.ndarray:
        vectors = np.zeros_like(x)
        for component, function in components.items():
            vectors[:, component] = function(t)
        return np.einsum("nij,nj->ni", polar()(x), vectors) if kind == "annulus" else vectors
    return value


def _affine(gradient: dict[tuple[int, int], Function]) -> Callable[[np.ndarray, float], np.ndarray]:
    """Value for Displacement from displacement gradients by component and axis."""
    def value(x: np.ndarray, t: float) -> np.ndarray:
        vectors = np.zeros_like(x)
        for (i, j), function in gradient.items():
            vectors[:, i] += function(t) * x[:, j]
        return vectors
    return value


def solve(path: str | Path, out: str | Path, resumed: bool = False, comm: MPI.Comm = MPI.COMM_WORLD,
          progress: TextIO | None = None) -> tuple[Problem, list[Path]]:
    """Runs a scene file; what it gives is in the directory `out`.

    Parameters
    ----------
    path, out : path
    resumed : bool
        Whether to go on from the checkpoint in `out`.
    comm : MPI communicator
    progress : text stream, optional
        As in run.

    Returns
    -------
    problem : Problem
    files : list of Path
        What was written, pictures excepted.

    Raises
    ------
    ValueError, OSError
        Names everything that is wrong with the file at once.
    SolveError
        Where it cannot be brought further; fields and a checkpoint of the last accepted increment are written.
    """
    scene, out = read_scene(path), Path(out)
    problem, held = problem_of(scene, comm)
    outputs = _outputs(scene, held, out)
    checkpoint = Checkpoint(out / "checkpoint.npz", outputs, **scene.output.checkpoint)

    def prepare() -> None:
        if resumed and not checkpoint.path.exists():
            raise FileNotFoundError(f"there is no {checkpoint.path} to go on from: run it without --resume")
        out.mkdir(parents=True, exist_ok=True)
        if not resumed:
            checkpoint.path.unlink(missing_ok=True)              # of an earlier run
    on_rank_0(comm, prepare)
    if resumed:
        resume(checkpoint.path, problem, outputs)
    files = [output.path for output in outputs if not isinstance(output, Pictures)] + [checkpoint.path]
    try:
        run(problem, scene.run.until, scene.run.increment, smallest=scene.run.smallest, events=scene.events,
            observers=[*outputs, checkpoint], progress=progress)
    except SolveError as error:
        _write_all(problem, outputs, checkpoint)
        raise SolveError(f"{error}\neverything up to t = {problem.t:g} is in {out}: "
                         f"{', '.join(file.name for file in files)}; --resume goes on from there") from None
    _write_all(problem, outputs, checkpoint)
    return problem, files


def _outputs(scene: Scene, held: dict[str, Where], out: Path) -> list[Output]:
    """The observers that write into the directory `out` what the scene asks for."""
    request, (_, symmetry) = scene.output, modelled(scene)
    times = (*request.times, 0.0, scene.run.until)
    outputs: list[Output] = [Fields(out / "fields.xdmf", request.every, times, request.fields)]
    if held:
        outputs.append(Reactions(out / "reactions.csv", held, request.center, symmetry=symmetry))
    outputs += [Probe(out / f"probe-{name}.csv", x, symmetry=symmetry) for name, x in request.probes.items()]
    if scene.quantities:
        outputs.append(quantities_of(scene, held, out / QUANTITIES_FILE))
    return outputs + [Pictures(out, field, request.every, times) for field in request.pictures]


def quantities_of(scene: Scene, held: dict[str, Where], path: Path) -> Quantities:
    """The observer that writes the scene's quantities of interest; `held` as from problem_of."""
    part, symmetry = modelled(scene)
    regions = {region.name: region for region in part.regions}
    return Quantities(path, scene.quantities, held, scene.output.probes, regions, scene.output.center, symmetry)


def _write_all(problem: Problem, outputs: list[Output], checkpoint: Checkpoint) -> None:
    """Writes what the last increment has brought, unless it is written."""
    for output in outputs:
        output.write(problem)
    checkpoint.write(problem)
