"""Tables of numbers against pseudo-time, CSV: what holds parts of the boundary, and the history of a point."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from .. import driver
from ..checks import real_array
from ..files import appending
from .cellwise import on_rank_0
from .conditions import Where
from .errors import format_position
from .fields import stress_ratio
from .output import Output
from .problem import Problem
from .symmetry import WHOLE, Place, Symmetry

SAME_DISTANCE = 1e-9                # over the body's size: points whose distances differ by less are equally near
POINT_COLUMNS = (*driver.STATE_COLUMNS, "shear_strain", "volume_strain")


class Table(Output):
    """One row a record; the names of the columns are the first line."""

    def growing_files(self) -> Sequence[Path]:
        return (self.path,)

    def append_row(self, comm: MPI.Comm, row: Mapping[str, float]) -> None:
        def append() -> None:
            with appending(self.path), open(self.path, "w" if self.written is None else "a", encoding="utf-8") as stream:
                if self.written is None:
                    print(",".join(row), file=stream)
                print(",".join(f"{value:.15g}" for value in row.values()), file=stream)
        on_rank_0(comm, append)


class Reactions(Table):
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
    symmetry : Symmetry, optional
        By which the problem's body is a part of the one whose reactions are wanted.
    """

    def __init__(self, path: str | Path, parts: Mapping[str, Where], center: Sequence[float] | None = None,
                 every: int | None = None, symmetry: Symmetry = WHOLE) -> None:
        super().__init__(path, every)
        self.parts, self.center, self.symmetry = dict(parts), center, symmetry

    def write(self, problem: Problem) -> None:
        if problem.last is not None:                             # before that there is no reaction
            super().write(problem)

    def content(self) -> object:
        return {"parts": list(self.parts), "center": vector_as_json(self.center)}

    def _write(self, problem: Problem) -> None:
        assert problem.last is not None
        row: dict[str, float] = {"t": problem.t, "iterations": len(problem.last.residuals) - 1}
        for name, where in self.parts.items():
            force, moment = self.symmetry.reaction(problem, where, self.center)
            row |= {f"{name}_F_{axis}": value for axis, value in zip("xyz", force)}
            row |= {f"{name}_M": moment} if len(force) == 2 else {f"{name}_M_{axis}": m for axis, m in zip("xyz", moment)}
        self.append_row(problem.comm, row)


def vector_as_json(vector: Sequence[float] | np.ndarray | None) -> list[float] | None:
    """A vector as JSON has it."""
    return None if vector is None else [float(value) for value in vector]


def point_columns(problem: Problem, points: np.ndarray | slice, symmetry: Symmetry = WHOLE,
                  copy: int = 0) -> dict[str, np.ndarray]:
    """State and strains of this rank's points.

    Parameters
    ----------
    problem : Problem
    points : int array (n), bool array or slice
    symmetry : Symmetry, optional
    copy : int, optional
        Of the part, as in Place; its axes are turned with it.

    Returns
    -------
    dict of str to array (n)
        POINT_COLUMNS: driver.STATE_COLUMNS, of which stress_ratio is abs(sigma')/p here, then shear_strain and volume_strain
        (extension positive).
    """
    columns = driver.state_columns(problem.material, symmetry.states(problem.states[points], copy))
    return columns | {"stress_ratio": stress_ratio(problem.states["stress"][points]), "shear_strain": problem.shear_strain[points],
                      "volume_strain": problem.volume_strain[points]}


class MaterialPoint:
    """The integration point that is nearest to a position at the start; it stays in the mesh if this does not follow the material.

    Parameters
    ----------
    position : sequence (d)
        In the whole body.
    symmetry : Symmetry, optional

    Raises
    ------
    ValueError
        The position is outside the body, when it is looked for.
    """

    def __init__(self, position: Sequence[float], symmetry: Symmetry = WHOLE) -> None:
        self.position = real_array("position", position)
        self.symmetry, self.places = symmetry, symmetry.places(self.position.tolist())
        self._found: tuple[int, int, Place] | None = None

    def columns(self, problem: Problem) -> dict[str, float]:
        """Where it is now, x, y (, z), then POINT_COLUMNS; collective, the same on all ranks."""
        if self._found is None:
            self._found = _nearest(problem, self.position, self.places)
        rank, point, place = self._found
        row = None
        if problem.comm.rank == rank:
            row = dict(zip("xyz", self.symmetry.position(problem.point_positions()[point], place)))
            columns = point_columns(problem, slice(point, point + 1), self.symmetry, place.copy)
            row |= {name: values[0] for name, values in columns.items()}
        return problem.comm.bcast(row, root=rank)


def _nearest(problem: Problem, position: np.ndarray, places: Sequence[Place]) -> tuple[int, int, Place]:
    """Rank of the point, its number there, and the place beside whose copy it is nearest.

    Of equally near points it is the one whose cell comes first in the mesh as given, and of copies of a cell the first. A position
    is in the body if a cell reaches as far from one of its points; at a side that is curved it may lie outside the cells.
    """
    if any(place.position.shape != (problem.d,) for place in places) or not np.isfinite(position).all():
        raise ValueError(f"position = {position.tolist()}: must be as many finite numbers as the body has dimensions")
    found: list[tuple[int, ...]] = []
    x = problem.point_positions(at_start=True)
    points = len(x) // max(problem.cells, 1)
    cells = np.repeat(problem.mesh.topology.original_cell_index[:problem.cells], points)
    corners = np.repeat(problem.body.at_cells(problem.positions), points, axis=0)
    reach = np.linalg.norm(corners - x[:, None], axis=2).max(axis=1)
    inside = False
    for number, place in enumerate(places):
        distance = np.linalg.norm(x - place.position, axis=1)
        inside |= bool((distance <= reach).any())
        steps = np.round(distance / (SAME_DISTANCE * problem.body.size)).astype(np.int64)
        found += [(int(steps[i]), int(cells[i]), number, problem.comm.rank, int(i)) for i in np.lexsort((cells, steps))[:1]]
    if not problem.comm.allreduce(inside, MPI.LOR):
        raise ValueError(f"position = {format_position(position)}: is outside the body")
    _, _, number, rank, point = min(candidate for of_rank in problem.comm.allgather(found) for candidate in of_rank)
    return rank, point, places[number]


class Probe(Table):
    """State and strains of a material point: the integration point that is nearest to a position at the start.

    Columns are t, x, y (, z), where it is now, then POINT_COLUMNS: driver.STATE_COLUMNS, of which stress_ratio is abs(sigma')/p
    here, then shear_strain and volume_strain (extension positive).

    Parameters
    ----------
    path : path
    position : sequence (d)
    every : int, optional
        Increments from one row to the next.
    symmetry : Symmetry, optional
        By which the problem's body is a part of the one that the position is in.
    """

    def __init__(self, path: str | Path, position: Sequence[float], every: int | None = None,
                 symmetry: Symmetry = WHOLE) -> None:
        super().__init__(path, every)
        self.point = MaterialPoint(position, symmetry)

    def content(self) -> object:
        return vector_as_json(self.point.position)

    def _write(self, problem: Problem) -> None:
        self.append_row(problem.comm, {"t": problem.t} | self.point.columns(problem))
