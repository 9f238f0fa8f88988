"""Tables of numbers against pseudo-time, CSV: what holds parts of the boundary, and the history of a point."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from .. import driver
from .cellwise import on_rank_0
from .conditions import Where
from .fields import stress_ratio
from .output import Output
from .problem import Problem

SAME_DISTANCE = 1e-9                # over the body's size: points whose distances differ by less are equally near


class _Table(Output):
    """One row a record; the names of the columns are the first line."""

    def growing_files(self) -> Sequence[Path]:
        return (self.path,)

    def _append(self, comm: MPI.Comm, row: Mapping[str, float]) -> None:
        def append() -> None:
            with open(self.path, "w" if self.written is None else "a", encoding="utf-8") as stream:
                if self.written is None:
                    print(",".join(row), file=stream)
                print(",".join(f"{value:.15g}" for value in row.values()), file=stream)
        on_rank_0(comm, append)


class Reactions(_Table):
    """Force and moment that hold parts of the boundary (Problem.reaction), after every increment; also Newton's iterations.

    Parameters
    ----------
    path : path
    parts : dict of str to where
        Columns are called after them: inner_F_x, inner_F_y, inner_M.
    center : sequence, optional
        Of the moments.
    every : int, optional
        Increments from one row to the next.
    """

    def __init__(self, path: str | Path, parts: Mapping[str, Where], center: Sequence[float] | None = None,
                 every: int | None = None) -> None:
        super().__init__(path, every)
        self.parts, self.center = dict(parts), center

    def write(self, problem: Problem) -> None:
        if problem.last is not None:                             # before that there is no reaction
            super().write(problem)

    def _write(self, problem: Problem) -> None:
        assert problem.last is not None
        row: dict[str, float] = {"t": problem.t, "iterations": len(problem.last.residuals) - 1}
        for name, where in self.parts.items():
            force, moment = problem.reaction(where, self.center)
            row |= {f"{name}_F_{axis}": value for axis, value in zip("xyz", force)}
            row |= {f"{name}_M": moment} if problem.d == 2 else {f"{name}_M_{axis}": m for axis, m in zip("xyz", moment)}
        self._append(problem.comm, row)


class Probe(_Table):
    """State and strains of a material point: the integration point that is nearest to a position at the start.

    Columns are t, x, y (, z), where it is now, then driver.STATE_COLUMNS, of which stress_ratio is abs(sigma')/p here, then
    shear_strain and volume_strain (extension positive).

    Parameters
    ----------
    path : path
    position : sequence (d)
    every : int, optional
        Increments from one row to the next.
    """

    def __init__(self, path: str | Path, position: Sequence[float], every: int | None = None) -> None:
        super().__init__(path, every)
        self.position = np.asarray(position, float)
        self._point: tuple[int, int] | None = None

    def _write(self, problem: Problem) -> None:
        if self._point is None:
            self._point = self._nearest(problem)
        rank, point = self._point
        row = None
        if problem.comm.rank == rank:
            row = {"t": problem.t} | dict(zip("xyz", problem.point_positions()[point]))
            columns = driver.state_columns(problem.material, problem.states[point:point + 1])
            row |= {name: values[0] for name, values in columns.items()}
            row |= {"stress_ratio": stress_ratio(problem.states["stress"][point]), "shear_strain": problem.shear_strain[point],
                    "volume_strain": problem.volume_strain[point]}
        self._append(problem.comm, problem.comm.bcast(row, root=rank))

    def _nearest(self, problem: Problem) -> tuple[int, int]:
        """Rank of the point, and its number there; of equally near points the one whose cell comes first in the mesh as given."""
        distance = np.linalg.norm(problem.point_positions(at_start=True) - self.position, axis=1)
        steps = np.round(distance / (SAME_DISTANCE * problem.body.size)).astype(np.int64)
        cells = np.repeat(problem.mesh.topology.original_cell_index[:problem.cells], len(steps) // max(problem.cells, 1))
        first = np.lexsort((cells, steps))[:1]
        found = problem.comm.allgather([(int(steps[i]), int(cells[i]), problem.comm.rank, int(i)) for i in first])
        return min(candidate for of_rank in found for candidate in of_rank)[2:]
