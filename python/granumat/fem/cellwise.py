"""Data of all ranks' cells on rank 0, in the order in which the mesh was given: the same on any number of ranks."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from .body import Body

T = TypeVar("T")
OnRank0 = Any                       # an array on rank 0, None on the others


class CellOrder:
    """Moves arrays with one row a cell to rank 0 and back; all methods are collective."""

    def __init__(self, mesh: dolfinx.mesh.Mesh) -> None:
        self._comm = mesh.comm
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        original = np.asarray(mesh.topology.original_cell_index, np.int64)
        self._owned_cells = self._comm.gather(original[:owned])            # on rank 0: the numbers of every rank's cells,
        self._cells_with_ghosts = self._comm.gather(original)              # without and with ghost cells

    def gather(self, values: np.ndarray) -> OnRank0:
        """All cells' values (all cells, ...) on rank 0, None on the others, from those (cells, ...) of this rank's own cells."""
        values = np.ascontiguousarray(values)
        everything, received = None, None
        if self._comm.rank == 0:
            numbers = np.concatenate(self._owned_cells)
            everything = np.empty((len(numbers), *values.shape[1:]), values.dtype)
            received = np.empty_like(everything)
        with _Row(values) as row:
            counts = _lengths(self._owned_cells)
            self._comm.Gatherv([_bytes(values), len(values), row], None if received is None else [_bytes(received), counts, row])
        if everything is not None:
            everything[numbers] = received
        return everything

    def scatter(self, values: OnRank0) -> np.ndarray:
        """Values (cells, ...) of this rank's cells, ghosts last, from all cells' (all cells, ...) on rank 0."""
        shape, dtype = self._comm.bcast(None if values is None else (values.shape[1:], values.dtype))
        count = self._comm.scatter(_lengths(self._cells_with_ghosts))
        received, sent = np.empty((count, *shape), dtype), None
        with _Row(received) as row:
            if values is not None:
                rows = np.ascontiguousarray(values[np.concatenate(self._cells_with_ghosts)])
                sent = [_bytes(rows), _lengths(self._cells_with_ghosts), row]
            self._comm.Scatterv(sent, [_bytes(received), count, row])
        return received


def _lengths(parts: list[np.ndarray] | None) -> list[int] | None:
    return None if parts is None else [len(part) for part in parts]


class _Row:
    """The MPI type of an array's row: MPI counts in 32 bits, and rows are fewer than bytes."""

    def __init__(self, values: np.ndarray) -> None:
        self._type = MPI.BYTE.Create_contiguous(values.dtype.itemsize * int(np.prod(values.shape[1:], dtype=int)))

    def __enter__(self) -> MPI.Datatype:
        return self._type.Commit()

    def __exit__(self, *_: object) -> None:
        self._type.Free()


def _bytes(values: np.ndarray) -> np.ndarray:
    return values.view(np.ndarray).reshape(-1).view(np.uint8)


def on_rank_0(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What `action()` returns on rank 0, on all ranks; an exception there is raised on all, so that none waits for ever."""
    result: Any = None
    error = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as raised:
            error = raised
    result, error = comm.bcast((result, error))
    if error is not None:
        raise error
    return result


def together(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What `action()` returns on each rank; a ValueError or TypeError on one of them is raised on all."""
    result: Any = None
    error = None
    try:
        result = action()
    except (ValueError, TypeError) as raised:
        error = raised
    errors = [of_rank for of_rank in comm.allgather(error) if of_rank is not None]
    if errors:
        raise errors[0]
    return result


class Shape(NamedTuple):
    """`around`: a cell's vertices in VTK's order; `facets`: the vertices of its facets, each in order around, in space only."""

    around: list[int]
    facets: list[list[int]]


SHAPES = {
    "triangle": Shape([0, 1, 2], []),
    "quadrilateral": Shape([0, 1, 3, 2], []),
    "tetrahedron": Shape([0, 1, 2, 3], [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]),
    "hexahedron": Shape([0, 1, 3, 2, 4, 5, 7, 6],
                        [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]),
}


class VertexMesh:
    """The vertices and cells of the whole mesh on rank 0.

    Vertices are numbered in the order in which the cells of CellOrder come upon them, so that the numbers are the same on any
    number of ranks. Methods are collective.

    Attributes
    ----------
    shape : str
        Name of the cells' shape.
    order : CellOrder
    cells : int array (all cells, vertices per cell)
        On rank 0 only.
    positions : array (vertices, d) or None
        At the start; None on other ranks than 0.
    """

    def __init__(self, body: Body) -> None:
        self.shape, self.order = body.mesh.topology.cell_type.name, CellOrder(body.mesh)
        self._cell_vertices = body.cell_nodes[:, :len(SHAPES[self.shape].around)]
        global_numbers = body.space.dofmap.index_map.local_to_global(self._cell_vertices.ravel())
        nodes = self.order.gather(np.asarray(global_numbers, np.int64).reshape(self._cell_vertices.shape))
        if nodes is not None:
            _, first, inverse = np.unique(nodes, return_index=True, return_inverse=True)
            by_first = np.argsort(first)
            self._first, number = first[by_first], np.argsort(by_first)
            self.cells = number[inverse].reshape(nodes.shape)
        self.positions = self.gather(body.positions)

    def gather(self, nodal: np.ndarray) -> OnRank0:
        """Values (vertices, d) on rank 0 from those (nodes, d) of this rank, None on the others."""
        of_cells = self.order.gather(nodal[self._cell_vertices])
        return None if of_cells is None else of_cells.reshape(-1, of_cells.shape[-1])[self._first]

    def polygons(self) -> tuple[np.ndarray, np.ndarray]:
        """On rank 0: vertices (n, corners) and cells (n) of the cells, or in three dimensions of the facets on the surface."""
        around, facets = SHAPES[self.shape]
        if not facets:
            return self.cells[:, around], np.arange(len(self.cells))
        polygons = self.cells[:, facets].reshape(-1, len(facets[0]))
        _, first, count = np.unique(np.sort(polygons, axis=1), axis=0, return_index=True, return_counts=True)
        on_surface = np.sort(first[count == 1])
        return polygons[on_surface], on_surface // len(facets)
