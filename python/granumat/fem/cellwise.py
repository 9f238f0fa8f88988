"""Data of all ranks' cells on rank 0, in the order in which the mesh was given: the same however the cells are shared out."""

import numpy as np
from mpi4py import MPI


class CellOrder:
    """Moves arrays with one row a cell to rank 0 and back."""

    def __init__(self, mesh):
        self.comm = mesh.comm
        self._owned = mesh.topology.index_map(mesh.topology.dim).size_local
        original = np.asarray(mesh.topology.original_cell_index, np.int64)
        self._owners = self.comm.gather(original[:self._owned])            # on rank 0: of every rank's own cells
        self._users = self.comm.gather(original)                           # and with its ghosts

    def gather(self, values):
        """All cells' values (all cells, ...) on rank 0, None on the others, from those (cells, ...) of this rank's own cells."""
        values = np.ascontiguousarray(values)
        whole, received = None, None
        if self.comm.rank == 0:
            places = np.concatenate(self._owners)
            whole = np.empty((len(places), *values.shape[1:]), values.dtype)
            received = np.empty_like(whole)
        with _Row(values) as row:
            counts = self._counts(self._owners)
            self.comm.Gatherv([_bytes(values), len(values), row], None if whole is None else [_bytes(received), counts, row])
        if whole is not None:
            whole[places] = received
        return whole

    def share(self, values):
        """Values (cells, ...) of this rank's cells, ghosts last, from all cells' (all cells, ...) on rank 0."""
        shape, dtype = self.comm.bcast(None if values is None else (values.shape[1:], values.dtype))
        count = self.comm.scatter(None if self._users is None else [len(cells) for cells in self._users])
        mine, sent = np.empty((count, *shape), dtype), None
        with _Row(mine) as row:
            if self.comm.rank == 0:
                sent = [_bytes(np.ascontiguousarray(values[np.concatenate(self._users)])), self._counts(self._users), row]
            self.comm.Scatterv(sent, [_bytes(mine), count, row])
        return mine

    @staticmethod
    def _counts(cells):
        return None if cells is None else [len(part) for part in cells]


class _Row:
    """The MPI type of a row, so that counts of rows stay small however large the array."""

    def __init__(self, values):
        self._type = MPI.BYTE.Create_contiguous(values.dtype.itemsize * int(np.prod(values.shape[1:], dtype=int)))

    def __enter__(self):
        return self._type.Commit()

    def __exit__(self, *_):
        self._type.Free()


def _bytes(values):
    return values.view(np.ndarray).reshape(-1).view(np.uint8)


def on_rank_0(comm, action):
    """What `action()` returns on rank 0, on all ranks; also what it raises, so that no rank waits for another in vain."""
    result, error = None, None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as raised:
            error = raised
    result, error = comm.bcast((result, error))
    if error is not None:
        raise error
    return result
