"""Checkpoints: everything that makes the continuation of a run the same, on any number of ranks."""

import json
import os
import time
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..checks import refuse
from ..core import STATE
from ..files import naming, replacing
from .cellwise import CellOrder, on_rank_0
from .conditions import NonlocalStrain, Pressure, Traction
from .errors import format_position
from .output import Output
from .problem import Problem
from .scene_data import Function
from .trial import Snapshot, Trial

POSITION_TOLERANCE = 1e-12          # over the body's size: nodes within this are where they were
DISPLACEMENT_TOLERANCE = 1e-10      # over the body's size: prescribed displacements within this are as they were
DESCRIPTION = ("fingerprint", "numbers", "residual", "residuals", "outputs")
NO_ORIGIN = "the run until then has not kept the origin of the material: leave it out, or begin anew"
COMPARED_DIGITS = 12                # of the values of functions, which round-off may change


class Checkpoint:
    """An observer that keeps the latest state of a run in one file; put it behind the outputs it names.

    The file is replaced only by a complete one. Cells are in the order in which the mesh was given, so that the number of ranks
    does not matter.

    Parameters
    ----------
    path : path
        Ends in .npz.
    outputs : sequence of Output
        Those that `resume` shall continue.
    every : int, optional
        Increments from one checkpoint to the next.
    seconds : float, optional
        Or when so much time has passed.

    Attributes
    ----------
    written : float or None
        Pseudo-time of the latest checkpoint.
    """

    def __init__(self, path: str | Path, outputs: Sequence[Output] = (), every: int | None = None,
                 seconds: float | None = None) -> None:
        self.path, self.outputs, self.every, self.seconds = Path(path), tuple(outputs), every, seconds
        self.written: float | None = None
        self._last_clock = time.monotonic()
        self._order: CellOrder | None = None

    def __call__(self, problem: Problem) -> None:
        late = self.seconds is not None and time.monotonic() - self._last_clock >= self.seconds
        if problem.comm.bcast(late) or (self.every is not None and problem.increments % self.every == 0):
            self.write(problem)

    def write(self, problem: Problem) -> None:
        """Writes the problem as it is, if an increment was accepted and it has not been written already; collective."""
        if problem.last is None or problem.t == self.written:
            return
        if self._order is None:
            self._order = CellOrder(problem.mesh)
        arrays = {name: self._order.gather(values) for name, values in _cell_arrays(problem, problem.last).items()}
        description = {"fingerprint": _fingerprint(problem, problem.t), "numbers": _numbers(problem, problem.last),
                       "residual": problem.last.residual, "residuals": problem.last.residuals}

        def replace_file() -> None:
            description["outputs"] = {output.path.name: output.bookmark() for output in self.outputs}
            with replacing(self.path) as partial, open(partial, "wb") as stream:
                _save(stream, arrays | {"description": np.array(json.dumps(description, default=float))})
                stream.flush()
                os.fsync(stream.fileno())
            directory = os.open(self.path.parent, os.O_RDONLY)
            with naming(self.path):
                os.fsync(directory)                              # so that the new name is on disk as well
            os.close(directory)
        on_rank_0(problem.comm, replace_file)
        self.written, self._last_clock = problem.t, time.monotonic()


def _save(stream: BinaryIO, arrays: dict[str, np.ndarray]) -> None:
    """Writes arrays as numpy.savez does, which leaves its archive open where a write fails."""
    with zipfile.ZipFile(stream, "w") as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asarray(values), allow_pickle=False)


def _numbers(problem: Problem, last: Trial) -> dict[str, float | None]:
    return {"t": problem.t, "increments": problem.increments, "next_increment": problem.next_increment,
            "last_duration": last.duration, "is_ahead": problem.is_ahead}


def _cell_arrays(problem: Problem, last: Trial) -> dict[str, np.ndarray]:
    """What a checkpoint keeps of this rank's own cells, one row a cell: values at their nodes and at their points."""
    at_cells, points = problem.body.at_cells, last.volumes.shape
    return {"places": at_cells(problem.positions), "displacement": at_cells(problem.displacement), "u": at_cells(last.u),
            "states": problem.states.reshape(points), "shear_strain": problem.shear_strain.reshape(points),
            "volume_strain": problem.volume_strain.reshape(points), "gradients": last.gradients.reshape(*points, 3, 3),
            "volumes": last.volumes, "stress": last.stress, "forces": last.forces,
            **({"m": at_cells(last.m)} if problem.length > 0 else {}),
            **({"origin": problem.origin.reshape(*points, problem.d)} if problem.origin is not None else {})}


def _fingerprint(problem: Problem, t: float) -> dict[str, Any]:
    """What must be the same in the problem that is resumed at pseudo-time t; the same on all ranks."""
    material = {f"material's {name}": value for name, value in problem.material.definition.items()}
    return {**material, "degree": problem.degree, "rate_term": problem.rate_term, "length": problem.length,
            "motion": _comparable(problem.motion, t), "dimension": problem.d,
            "shape of the cells": problem.mesh.topology.cell_type.name, "number of cells": problem.comm.allreduce(problem.cells),
            "gravity": _comparable(problem.gravity, t), "initial state": _comparable(problem.initial, t),
            **{f"condition {number} ({type(condition).__name__}), {name}": _comparable(_load(condition, value, t), t)
               for number, condition in enumerate(problem.conditions) for name, value in vars(condition).items()}}


def _load(condition: object, value: Any, t: float) -> Any:
    """An attribute of a condition; of a load that is a function of Python its value at a time."""
    is_load = isinstance(condition, (NonlocalStrain, Pressure, Traction)) and value is condition.value
    return value(t) if is_load and callable(value) and not is_dataclass(value) else value


def _comparable(value: Any, t: float) -> Any:
    """A number, sequence, state or function of a scene file as JSON has it, up to a time; other functions cannot be compared."""
    if isinstance(value, Function):
        return [[float(f"{number:.{COMPARED_DIGITS}g}") for number in row] for row in value.up_to(t)]
    if is_dataclass(value):
        return {name: _comparable(item, t) for name, item in vars(value).items()}
    if isinstance(value, dict):
        return {str(name): _comparable(item, t) for name, item in value.items()}
    if isinstance(value, tuple) and any(map(is_dataclass, value)):
        return [_comparable(item, t) for item in value]
    if callable(value):
        return "a function"
    value = np.asarray(value)
    return {name: value[name].tolist() for name in value.dtype.names} if value.dtype.names else value.tolist()


def resume(path: str | Path, problem: Problem, outputs: Sequence[Output] = ()) -> None:
    """Brings a problem, set up as at the start of a run, to where the run's checkpoint was, and its outputs too.

    What has loaded the body until then must be the same, what loads it later need not. Of functions given in Python
    only the values at the checkpoint are compared. Outputs go on in their files, of which what was written after
    the checkpoint is cut off.

    Parameters
    ----------
    path : path
    problem : Problem
    outputs : sequence of Output

    Raises
    ------
    ValueError
        Names every difference where the checkpoint belongs to another problem.
    OSError
        Where there is no checkpoint.
    """
    order, comm = CellOrder(problem.mesh), problem.comm
    positions = order.gather(problem.body.at_cells(problem.positions))
    arrays: dict[str, np.ndarray] = {}                           # of all cells, on rank 0

    def read() -> dict[str, Any]:
        description, content = _read(path)
        arrays.update(content)
        return description

    description = on_rank_0(comm, read)
    fingerprint = _fingerprint(problem, description["numbers"]["t"])
    shapes = _shapes(problem)
    on_rank_0(comm, lambda: _compare(path, description["fingerprint"], fingerprint, arrays, shapes, positions, problem.body.size))
    problem.restore(_snapshot(problem, description, {name: order.scatter(arrays.get(name)) for name in shapes}))
    difference, place = problem.lag_of_prescribed()
    if difference > DISPLACEMENT_TOLERANCE * problem.body.size:
        raise ValueError(f"{path} belongs to another problem:\n  displacements that conditions prescribe at t = {problem.t:g} are "
                         f"up to {difference:.3g} away from those in the checkpoint, at {format_position(place)}")
    for output in outputs:
        bookmark = description["outputs"].get(output.path.name)
        if bookmark is not None:
            output.restore(bookmark, comm)


def _read(path: str | Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Description and arrays of a checkpoint file; ValueError where it is none."""
    with open(path, "rb") as stream:
        try:
            with np.load(stream, allow_pickle=False) as file:
                arrays = dict(file)
            description = json.loads(str(arrays.pop("description")))
            lacking = [key for key in DESCRIPTION if key not in description]
        except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} is not a checkpoint: {error}") from None
    if lacking:
        raise ValueError(f"{path} is not a checkpoint: its description lacks {', '.join(lacking)}")
    return description, arrays


def _shapes(problem: Problem) -> dict[str, tuple[int, ...]]:
    """The shapes of what a checkpoint keeps of a cell, as _cell_arrays."""
    nodes, points = (problem.body.cell_nodes.shape[1], problem.d), (len(problem.body.element.weights),)
    return {"places": nodes, "displacement": nodes, "u": nodes, "states": points, "shear_strain": points, "volume_strain": points,
            "gradients": (*points, 3, 3), "volumes": points, "stress": (*points, 6), "forces": nodes,
            **({"m": nodes[:1]} if problem.length > 0 else {}),
            **({"origin": (*points, problem.d)} if problem.origin is not None else {})}


def _compare(path: str | Path, saved: dict[str, Any], fingerprint: dict[str, Any], arrays: dict[str, np.ndarray],
             shapes: dict[str, tuple[int, ...]], positions: np.ndarray, size: float) -> None:
    """ValueError that names every difference between a checkpoint and a problem; on rank 0."""
    faults = [f"{name}: {saved.get(name)!r} in the checkpoint, {fingerprint.get(name)!r} here"
              for name in sorted(saved | fingerprint) if saved.get(name) != fingerprint.get(name)]
    if not faults:
        faults += [NO_ORIGIN if name == "origin" else f"it lacks the array {name!r}" for name in shapes if name not in arrays]
        for name, shape in shapes.items():
            expected = (len(positions), *shape), STATE if name == "states" else np.dtype(float)
            if name in arrays and (arrays[name].shape, arrays[name].dtype) != expected:
                faults.append(f"its array {name!r} is of shape {arrays[name].shape} and dtype {arrays[name].dtype}")
    if not faults:
        distance = abs(arrays["places"] - positions).max()
        if not distance <= POSITION_TOLERANCE * size:
            faults.append(f"positions of the nodes: up to {distance:.3g} apart")
    refuse(f"{path} belongs to another problem, or is damaged", faults)


def _snapshot(problem: Problem, description: dict[str, Any], cell_arrays: dict[str, np.ndarray]) -> Snapshot:
    """The snapshot that a description and arrays of this rank's cells, ghosts last, are of."""
    def at_nodes(name: str) -> np.ndarray:
        nodal = np.zeros((len(problem.positions), *cell_arrays[name].shape[2:]))
        nodal[problem.body.cell_nodes_with_ghosts] = cell_arrays[name]
        return nodal

    def at_own_cells(name: str) -> np.ndarray:
        return cell_arrays[name][:problem.cells]

    def at_points(name: str) -> np.ndarray:
        values = at_own_cells(name)
        return values.reshape(-1, *values.shape[2:])

    numbers, states = description["numbers"], at_points("states").view(np.recarray)
    m = at_nodes("m") if problem.length > 0 else np.empty(0)
    last = Trial(numbers["t"], numbers["last_duration"], at_nodes("u"), m, states, at_points("gradients"), at_own_cells("volumes"),
                 at_own_cells("stress"), at_own_cells("forces"), residual=description["residual"],
                 residuals=tuple(description["residuals"]))
    return Snapshot(numbers["t"], numbers["increments"], numbers["next_increment"], at_nodes("displacement"), states,
                    at_points("shear_strain"), at_points("volume_strain"),
                    None if problem.origin is None else at_points("origin"), last, numbers["is_ahead"])
