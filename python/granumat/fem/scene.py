"""Builds what a scene file says on its mesh, and runs it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from ..checks import refuse
from ..core import STATE
from ..errors import InterruptedRunError
from ..files import clear, locked_by_one, run_files
from ..material import Material
from ..quantities import QUANTITIES_FILE
from . import meshes
from ._compat import FacetTags
from .cellwise import on_rank_0
from .checkpoint import Checkpoint, resume
from .conditions import Displacement, Inflow, Outflow, Periodic, Pressure, Tied, Traction, Where, polar, rotation
from .control import run
from .errors import SolveError
from .fields import Fields
from .output import Output
from .pictures import Pictures
from .problem import Problem
from .quantities import Quantities
from .reduction import modelled
from .scene_data import BOX_SIDES, Function, Resting, Scene, SideConditions
from .scene_file import ON_SIDE, read_scene
from .tables import Probe, Reactions

WAYS_OUT = "give --resume to go on with it, --overwrite to replace it, or another directory"
CHECKPOINT = "checkpoint.npz"
DEPTH_STEPS = 20                    # over which the weight is summed where phi depends on the depth
ZERO = Function((0.0,), (0.0,))


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
    initial: Any = scene.initial
    if isinstance(initial, Resting):
        initial = resting(scene.material, initial.volume_fraction, initial.weight, size[-1], initial.pressure, initial.k0)
    conditions = [condition for entry in scene.conditions
                  for condition in _conditions(entry, wheres[entry.on], size, scene.mesh["kind"], initial)]
    if "angle" in scene.mesh:
        conditions.append(_tie_of_sector(scene.mesh["angle"]))
    problem = Problem(mesh, scene.material, initial, conditions, facet_tags=tags, origin=scene.output.origin, **scene.settings)
    return problem, {str(entry.on): wheres[entry.on] for entry in scene.conditions if entry.is_held}


def _make_mesh(table: dict[str, Any], comm: MPI.Comm) -> tuple[dolfinx.mesh.Mesh, FacetTags | None, dict[str, int]]:
    """Mesh, facet tags, and the tags of the facets' names."""
    arguments = {name: value for name, value in table.items() if name != "kind"}
    if table["kind"] == "gmsh":
        return meshes.from_gmsh(comm, **arguments)
    return (meshes.box if table["kind"] == "box" else meshes.annulus)(comm, **arguments), None, {}


@dataclass(frozen=True)
class _Plane:
    """Where a side of a box, or the bottom or top of a ring, is; a function of x (3, n) as `where`."""

    axis: int
    place: float
    tolerance: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return abs(x[self.axis] - self.place) < self.tolerance


@dataclass(frozen=True)
class _Circle:
    """Where the inner or outer side of a ring is; a function of x (3, n) as `where`."""

    radius: float
    tolerance: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return abs(np.hypot(x[0], x[1]) - self.radius) < self.tolerance


def _side(table: dict[str, Any], d: int, name: str) -> _Plane | _Circle:
    if table["kind"] == "box" or name in ("bottom", "top"):
        axis, end = BOX_SIDES[d][name]
        size = table["size"] if table["kind"] == "box" else [0, 0, table["height"]]
        return _Plane(axis, float(end * size[axis]), ON_SIDE * max(size))
    return _Circle(float(table["radii"][name == "outer"]), ON_SIDE * table["radii"][1])


def _conditions(entry: SideConditions, where: Where, size: Sequence[float], kind: str, initial: Any) -> list[object]:
    """The conditions of one side of a body of a size (d), into which material flows in the initial state."""
    local_axes = polar() if kind == "annulus" else None
    conditions: list[object] = []
    if entry.displacement:
        value = _Moved(entry.displacement, kind == "annulus")
        conditions.append(Displacement(where, value, sorted(entry.displacement), local_axes))
    if entry.gradient:
        conditions.append(Displacement(where, _Strained(entry.gradient), sorted({i for i, _ in entry.gradient})))
    if entry.rotation is not None:
        conditions.append(Displacement(where, _Turned(entry.rotation, tuple(entry.center)), [0, 1]))
    if entry.platen is not None:
        conditions.append(Tied(where, entry.platen, local_axes))
    if entry.pressure is not None:
        conditions.append(Pressure(where, entry.pressure))
    if entry.traction:
        conditions.append(Traction(where, _Force(tuple(entry.traction.get(i, ZERO) for i in range(len(size))))))
    if entry.periodic is not None:
        shift = np.zeros(len(size))
        shift[entry.periodic] = size[entry.periodic]
        conditions.append(Periodic(where, lambda x: x - shift))
    if entry.opening is not None:
        conditions.append(Inflow(where, initial) if entry.opening == "inflow" else Outflow(where))
    return conditions


def _tie_of_sector(angle: float) -> Periodic:
    """Ties the side of a sector that is at an angle to the one at the x axis, turned by the angle."""
    return Periodic(lambda x: abs(np.arctan2(x[1], x[0]) - angle) < ON_SIDE,
                    lambda x: np.column_stack([np.hypot(x[:, 0], x[:, 1]), 0 * x[:, 1], x[:, 2:]]), polar())


# Values of conditions. They are data and not closures, so that a checkpoint can compare what loads the body.

@dataclass(frozen=True)
class _Moved:
    """Value for Displacement from functions by component; of a ring along polar axes."""

    components: dict[int, Function]
    is_polar: bool

    def __call__(self, x: np.ndarray, t: float) -> np.ndarray:
        vectors = np.zeros_like(x)
        for component, function in self.components.items():
            vectors[:, component] = function(t)
        return np.einsum("nij,nj->ni", polar()(x), vectors) if self.is_polar else vectors


@dataclass(frozen=True)
class _Strained:
    """Value for Displacement from displacement gradients by component and axis."""

    gradient: dict[tuple[int, int], Function]

    def __call__(self, x: np.ndarray, t: float) -> np.ndarray:
        vectors = np.zeros_like(x)
        for (i, j), function in self.gradient.items():
            vectors[:, i] += function(t) * x[:, j]
        return vectors


@dataclass(frozen=True)
class _Turned:
    """Value for Displacement: a rotation about a center."""

    angle: Function
    center: tuple[float, ...]

    def __call__(self, x: np.ndarray, t: float) -> np.ndarray:
        return rotation(self.angle, self.center)(x, t)

    def motion(self, x: np.ndarray, start: float, t: float) -> np.ndarray:
        return rotation(self.angle, self.center).motion(x, start, t)


@dataclass(frozen=True)
class _Force:
    """Value for Traction from functions by component."""

    components: tuple[Function, ...]

    def __call__(self, t: float) -> list[float]:
        return [component(t) for component in self.components]


def solve(path: str | Path, out: str | Path, resumed: bool = False, overwrite: bool = False, comm: MPI.Comm = MPI.COMM_WORLD,
          progress: TextIO | None = None) -> tuple[Problem, list[Path]]:
    """Runs a scene file; what it gives is in the directory `out`.

    Parameters
    ----------
    path, out : path
    resumed : bool
        Whether to go on from the checkpoint in `out`.
    overwrite : bool
        Whether what an earlier run has left in `out` is removed; without it and `resumed` nothing may be there.
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
        Names everything that is wrong with the file at once; or what cannot be written.
    SolveError
        Where it cannot be brought further; fields and a checkpoint of the last accepted increment are written.
    InterruptedRunError
        Ctrl-C or SIGTERM came; what is written is the same.
    """
    scene, out = read_scene(path), Path(out)
    if resumed:
        on_rank_0(comm, lambda: _check_checkpoint(out))
    with locked_by_one(lambda action: on_rank_0(comm, action), out):
        problem, held = problem_of(scene, comm)
        outputs = _outputs(scene, held, out)
        checkpoint = Checkpoint(out / CHECKPOINT, outputs, **scene.output.checkpoint)
        if resumed:
            resume(checkpoint.path, problem, outputs)
        else:
            on_rank_0(comm, lambda: clear(out, overwrite, WAYS_OUT))
        try:
            run(problem, scene.run.end, scene.run.increment, smallest=scene.run.smallest, events=scene.events,
                observers=[*outputs, checkpoint], unjammed=scene.run.unjammed, progress=progress)
        except (SolveError, InterruptedRunError) as error:
            _write_all(problem, outputs, checkpoint)
            raise type(error)(f"{error}\neverything up to t = {problem.t:g} is in {out}: {_left(comm, out)}"
                              f"{'; --resume goes on from there' if problem.increments else ''}") from None
        except OSError as error:
            raise OSError(f"{error}\nthe run has come to t = {problem.t:g}; in {out} is {_left(comm, out)}; "
                          + ("there is no checkpoint to go on from" if checkpoint.written is None else
                             f"--resume goes on from the checkpoint at t = {checkpoint.written:g}")) from None
        _write_all(problem, outputs, checkpoint)
    return problem, [output.path for output in outputs if not isinstance(output, Pictures)] + [checkpoint.path]


def _check_checkpoint(out: Path) -> None:
    """FileNotFoundError if a directory has no checkpoint."""
    if not (out / CHECKPOINT).exists():
        raise FileNotFoundError(f"there is no {out / CHECKPOINT} to go on from: run it without --resume"
                                + (", but with --overwrite" if run_files(out) else ""))


def _left(comm: MPI.Comm, out: Path) -> str:
    """What a run has left in its directory, in words; collective."""
    return on_rank_0(comm, lambda: ", ".join(file.name for file in run_files(out) if file.suffix != ".png") or "nothing")


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
