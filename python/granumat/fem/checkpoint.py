"""Checkpoints: everything that makes the continuation of a run the same, on any number of ranks."""

import json
import os
import time
import zipfile
from pathlib import Path

import numpy as np

from ..checks import refuse
from .cellwise import CellOrder, on_rank_0
from .problem import Trial

NEAR = 1e-12                        # of the body's size: nodes closer than this are where they were
NUMBERS = ("t", "increments", "next_increment", "_last_duration")


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
    """

    def __init__(self, path, outputs=(), every=None, seconds=None):
        self.path, self.outputs, self.every, self.seconds = Path(path), tuple(outputs), every, seconds
        self._written, self._since, self._order = None, time.monotonic(), None

    def __call__(self, problem):
        late = self.seconds is not None and time.monotonic() - self._since >= self.seconds
        if problem.comm.bcast(late) or (self.every is not None and problem.increments % self.every == 0):
            self.write(problem)

    def write(self, problem):
        """Writes the problem as it is."""
        if problem.last is None or problem.t == self._written:
            return
        self._order = self._order or CellOrder(problem.mesh)
        arrays = {name: self._order.gather(values) for name, values in _arrays(problem).items()}
        description = {
            "fingerprint": _fingerprint(problem), "numbers": {name: getattr(problem, name) for name in NUMBERS},
            "residual": problem.last.residual, "residuals": problem.last.residuals}

        def replace():
            description["outputs"] = {output.path.name: output.position() for output in self.outputs}
            partial = self.path.with_name(self.path.name + ".part")
            with open(partial, "wb") as file:
                np.savez(file, description=json.dumps(description, default=float), **arrays)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(self.path)
            directory = os.open(self.path.parent, os.O_RDONLY)
            os.fsync(directory)                                  # so that the new name is on disk as well
            os.close(directory)
        on_rank_0(problem.comm, replace)
        self._written, self._since = problem.t, time.monotonic()


def _arrays(problem):
    """What a checkpoint keeps of this rank's own cells, one row a cell."""
    nodes, last, rows = problem._nodes, problem.last, (problem.cells, -1)
    return {"places": problem.positions[nodes], "displacement": problem.displacement[nodes], "u": last.u[nodes],
            "states": problem.states.reshape(rows), "shear_strain": problem.shear_strain.reshape(rows),
            "volume_strain": problem.volume_strain.reshape(rows), "gradients": last.gradients.reshape(*last.volumes.shape, 3, 3),
            "volumes": last.volumes, "stress": last.stress, "forces": last.forces}


def _fingerprint(problem):
    """What must be the same in the problem that is resumed; the same on all ranks."""
    material = {f"material's {name}": value for name, value in problem.material.definition.items()}
    return {**material, "degree": problem.degree, "rate_term": problem.rate_term, "dimension": problem.d,
            "shape of the cells": problem.mesh.topology.cell_type.name, "number of cells": problem.comm.allreduce(problem.cells),
            "gravity": _comparable(problem.gravity), "initial state": _comparable(problem.initial),
            **{f"condition {number}": {"kind": type(condition).__name__} | {
                name: _comparable(value) for name, value in vars(condition).items()}
               for number, condition in enumerate(problem.conditions)}}


def _comparable(value):
    """A number, sequence or state as JSON has it; functions cannot be compared."""
    if callable(value):
        return "a function"
    value = np.asarray(value)
    return {name: value[name].tolist() for name in value.dtype.names} if value.dtype.names else value.tolist()


def resume(path, problem, outputs=()):
    """Brings a problem, set up as at the start of a run, to where the run's checkpoint was, and its outputs too.

    Outputs go on in their files, of which what was written after the checkpoint is cut off.

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
    fingerprint = _fingerprint(problem)
    places = order.gather(problem.positions[problem._nodes])
    arrays = {}

    def read():
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays.update(file)
            description, there = json.loads(str(arrays.pop("description"))), arrays.pop("places")
        except (zipfile.BadZipFile, KeyError, ValueError, EOFError) as error:
            raise ValueError(f"{path} is not a checkpoint: {error}") from None
        before = description["fingerprint"]
        faults = [f"{name}: {before.get(name)!r} in the checkpoint, {fingerprint.get(name)!r} here"
                  for name in sorted(before | fingerprint) if before.get(name) != fingerprint.get(name)]
        if there.shape == places.shape and abs(there - places).max() > NEAR * problem._size:
            faults.append(f"positions of the nodes: up to {abs(there - places).max():.3g} apart")
        refuse(f"{path} belongs to another problem", faults)
        return description, list(arrays)

    description, names = on_rank_0(comm, read)
    found = {name: order.share(arrays.get(name)) for name in names}

    def nodal(values):
        nodes = np.zeros_like(problem.positions)
        nodes[problem._all_nodes] = values
        return nodes

    def of_points(name):
        values = found[name][:problem.cells]
        return values.reshape(-1, *values.shape[2:])

    for name, value in description["numbers"].items():
        setattr(problem, name, value)
    problem.displacement = nodal(found["displacement"])
    problem.states = of_points("states").view(np.recarray)
    problem.shear_strain, problem.volume_strain = of_points("shear_strain"), of_points("volume_strain")
    problem.last = Trial(
        problem.t, nodal(found["u"]), problem.states, of_points("gradients"),
        **{name: found[name][:problem.cells] for name in ("volumes", "stress", "forces")},
        residual=description["residual"], residuals=description["residuals"])
    for output in outputs:
        position = description["outputs"].get(output.path.name)
        if position is not None:
            output.restore(position, comm)
