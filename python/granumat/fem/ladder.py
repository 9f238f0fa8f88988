"""Runs scenes for a ladder of models: their quantities, their time, and what tells why one differs from another."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from .. import tensors
from ..coarsen import Content
from ..errors import GranumatError, InterruptedRunError
from ..quantities import QUANTITIES_FILE, read_table
from ..runs import SHORT_SECONDS, Result, split_stress
from ..toml import write_content
from .cellwise import on_rank_0
from .checkpoint import Checkpoint, resume
from .control import run
from .problem import Problem
from .scene import problem_of, quantities_of
from .scene_data import Scene
from .scene_file import read_scene
from .tables import Table

T = TypeVar("T")

REPETITIONS = 5                     # of a short run at most, whose setting up takes longer than the run
CHECKPOINT_SECONDS = 60.0           # between two checkpoints of a run
MONITOR = "monitor.csv"


class SceneRunner:
    """Runs scene files, on all ranks.

    Parameters
    ----------
    file : path
        The file that is to be made coarser.
    comm : MPI communicator

    Attributes
    ----------
    quantities : list of Quantity
        Of the file.
    kinks : tuple of float
        Pseudo-times at which what is prescribed changes its direction, the start included.
    """

    def __init__(self, file: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> None:
        scene = read_scene(file)
        self.comm, self.quantities = comm, list(scene.quantities)
        kinks = {t for condition in scene.conditions for function in condition.functions for t in function.times}
        self.kinks = tuple(sorted({0.0} | {t for t in kinks if 0 < t < scene.run.until}))

    def on_one(self, function: Callable[[], T]) -> T:
        """What a function returns on rank 0, on all of them."""
        return on_rank_0(self.comm, function)

    def run(self, content: Content, directory: Path) -> Result:
        """Runs a scene, or goes on from its checkpoint; short ones several times."""
        noise = content.get("ladder", {}).get("noise", 0.0)
        file = directory / "scene.toml"
        self.on_one(lambda: write_content(file, {name: table for name, table in content.items() if name != "ladder"}))
        try:
            scene = read_scene(file)
            problem, held = self._problem(scene, noise)
        except ValueError as error:
            return Result({}, 0.0, {}, failure=str(error))
        monitor = Monitor(directory / MONITOR)
        outputs = [monitor, quantities_of(scene, held, directory / QUANTITIES_FILE)]
        checkpoint = Checkpoint(directory / "checkpoint.npz", outputs, seconds=CHECKPOINT_SECONDS)
        if self.on_one(checkpoint.path.exists):
            resume(checkpoint.path, problem, outputs)
        try:
            failure = _failure(scene, problem, [*outputs, checkpoint])
        except InterruptedRunError:
            checkpoint.write(problem)
            raise
        seconds = [monitor.seconds]
        while not failure and len(seconds) < REPETITIONS and self.comm.bcast(sum(seconds) < SHORT_SECONDS):
            again = Monitor(None)
            _failure(scene, self._problem(scene, noise)[0], [again])
            seconds.append(again.seconds)
        return self.on_one(lambda: self._result(directory, float(np.median(seconds)), failure))

    def _problem(self, scene: Scene, noise: float) -> tuple[Problem, dict[str, Any]]:
        problem, held = problem_of(scene, self.comm)
        if noise:
            cells = problem.mesh.topology.original_cell_index[:problem.cells]
            factors = 1 + noise * np.random.default_rng(0).standard_normal(self.comm.allreduce(problem.cells))[cells]
            problem.states["volume_fraction"] *= np.repeat(factors, len(problem.states) // max(problem.cells, 1))
        return problem, held

    def _result(self, directory: Path, seconds: float, failure: str) -> Result:
        if not (directory / MONITOR).exists() or not (directory / QUANTITIES_FILE).exists():
            return Result({}, seconds, {}, failure=failure)
        monitor, table = read_table(directory / MONITOR), read_table(directory / QUANTITIES_FILE)
        ends = np.searchsorted(monitor["t"], [*self.kinks[1:], monitor["t"][-1]])
        share = float(monitor["share"][np.minimum(ends, len(monitor["t"]) - 1)].min())
        signature = {name: monitor[name] for name in ("t", "strain", "p", "shear", "normal")}
        return Result(table, seconds, signature, share, bool((monitor["eta_t"] < 0).any()), failure)


def _failure(scene: Scene, problem: Problem, observers: list[Any]) -> str:
    """Runs a problem to its end; why it did not come to it, empty if it did."""
    try:
        run(problem, scene.run.end, scene.run.increment, smallest=scene.run.smallest, events=scene.events, observers=observers,
            unjammed=scene.run.unjammed)
    except InterruptedRunError:
        raise
    except GranumatError as error:
        return str(error)
    return ""


class Monitor(Table):
    """An observer that measures the time of a run, and writes what tells why one run differs from another.

    Columns are t, the accumulated shear strain, the pressure and the deviatoric stress along and across the straining, all as means
    over the body that are weighted by the shear of the increment, the share of the body that does half of the shear, and the
    smallest transverse modulus. Put it first: its own time is left out.

    Parameters
    ----------
    path : path or None
        None: only the time is measured.

    Attributes
    ----------
    seconds : float
        Since the first call: the process's time on one rank, otherwise the time that has passed.
    """

    def __init__(self, path: str | Path | None) -> None:
        super().__init__(path or "")
        self._is_written = path is not None
        self.seconds, self._strain = 0.0, 0.0
        self._start: float | None = None

    def __call__(self, problem: Problem) -> None:
        clock = time.process_time if problem.comm.size == 1 else time.perf_counter
        if self._start is not None:
            self.seconds += problem.comm.bcast(clock() - self._start)
        if self._is_written and problem.last is not None:
            super().__call__(problem)
        self._start = clock()

    def bookmark(self) -> dict[str, Any]:
        """How far the file is written, the time and the strain."""
        return super().bookmark() | {"seconds": self.seconds, "strain": self._strain}

    def restore(self, bookmark: dict[str, Any], comm: MPI.Comm) -> None:
        """Goes on from a bookmark."""
        super().restore(bookmark, comm)
        self.seconds, self._strain = bookmark["seconds"], bookmark["strain"]

    def _write(self, problem: Problem) -> None:
        assert problem.last is not None
        volumes = problem.point_volumes()
        increment = 2 * tensors.magnitude(tensors.deviator(tensors.symmetric(problem.last.gradients)))
        shear, normal = split_stress(problem.states["stress"], problem.states["direction"])
        p = -tensors.trace(problem.states["stress"]) / 3
        weights = volumes * np.maximum(increment, np.finfo(float).tiny)
        total, *sums = problem.comm.allreduce(np.array([weights @ values for values in (
            np.ones_like(p), increment, p, shear, normal)])).tolist()
        strain, *means = (value / total for value in sums)
        self._strain += strain
        least = problem.comm.allreduce(float(problem.material.transverse_modulus(problem.states).min(initial=np.inf)), MPI.MIN)
        self.append_row(problem.comm, {"t": problem.t, "strain": self._strain, **dict(zip(("p", "shear", "normal"), means)),
                                       "share": share_of_shear(problem.comm, increment, volumes), "eta_t": least})


def share_of_shear(comm: MPI.Comm, shear: np.ndarray, volumes: np.ndarray) -> float:
    """The smallest share of a body that does half of its shear: 0.5 where it is uniform, less where it localises.

    Parameters
    ----------
    comm : MPI communicator
    shear, volumes : array (points)
        Of this rank's integration points.
    """
    shear, volumes = (np.concatenate(comm.allgather(values)) for values in (shear, volumes))
    order = np.argsort(-shear)
    done = np.concatenate([[0.0], np.cumsum((shear * volumes)[order])])
    taken = np.concatenate([[0.0], np.cumsum(volumes[order])])
    return float(np.interp(done[-1] / 2, done, taken) / taken[-1])
