"""The linear system: element matrices and vectors into PETSc's, by coordinates, and its solution."""

import ctypes
import re
import warnings
from pathlib import Path

import numpy as np
from petsc4py import PETSc

_petsc = ctypes.CDLL(PETSc.__file__)                   # reaches the library that petsc4py itself has loaded
_INSERT = 1
DIRECT_UP_TO = {2: 400_000, 3: 15_000}                 # unknowns: from where the iterative solver is faster, by dimension


def _check(error):
    if error:
        raise PETSc.Error(error)


def _pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


class _Coordinates:
    """Values at given coordinates, summed where they meet; negative coordinates are left out."""

    def __init__(self, target, kind, *indices):
        self.target, self._kind = target, kind
        indices = [np.array(index, PETSc.IntType).ravel() for index in indices]
        self._size = indices[0].size
        preallocate = getattr(_petsc, f"{kind}SetPreallocationCOO")
        _check(preallocate(ctypes.c_void_p(target.handle), ctypes.c_int64(self._size), *map(_pointer, indices)))

    def set(self, values):
        values = np.ascontiguousarray(values, PETSc.ScalarType)
        if values.size != self._size:
            raise ValueError(f"{values.size} values for {self._size} coordinates")
        _check(getattr(_petsc, f"{self._kind}SetValuesCOO")(ctypes.c_void_p(self.target.handle), _pointer(values), _INSERT))
        return self.target


class System:
    """K q = r for the unknowns of a Numbering; equations that no unknown needs are q = 0.

    Parameters
    ----------
    comm : MPI communicator
    owned : int
        Equations of this rank.
    block : int
        Components of a node.
    cell_labels : int array (cells, n)
        Equation of every row of the cells' matrices, negative where there is none.
    labels : int array (nodes, d)
        As in Numbering.
    options : dict
        PETSc options of the solver, without prefix; they take precedence over the defaults.
    """

    def __init__(self, comm, owned, block, cell_labels, labels, options):
        self.size = comm.allreduce(owned)
        size = (owned, self.size)
        right = PETSc.Vec().create(comm=comm)
        right.setSizes(size)
        right.setBlockSize(block)
        right.setType("standard")
        right.setOption(PETSc.Vec.Option.IGNORE_NEGATIVE_INDICES, True)
        self._right = _Coordinates(right, "Vec", cell_labels)
        self._solution = right.duplicate()
        used = self._right.set(np.ones(cell_labels.size)).array_r > 0
        unused = np.flatnonzero(~used) + right.getOwnershipRange()[0]
        matrix = PETSc.Mat().create(comm=comm)
        matrix.setSizes((size, size))
        matrix.setBlockSize(block)
        matrix.setType("aij")
        n = cell_labels.shape[1]
        rows = np.where(cell_labels[:, None, :] < 0, -1, cell_labels[:, :, None])
        columns = np.where(rows < 0, -1, np.broadcast_to(cell_labels[:, None, :], (len(cell_labels), n, n)))
        self._matrix = _Coordinates(matrix, "Mat", np.append(rows, unused), np.append(columns, unused))
        self._units = np.ones(unused.size)

        wanted = PETSc.IS().createGeneral(np.maximum(labels, 0).ravel().astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._local = PETSc.Vec().createSeq(labels.size)
        self._scatter = PETSc.Scatter().create(self._solution, wanted, self._local, None)
        self._free = labels >= 0

        self.solver = PETSc.KSP().create(comm)
        self.solver.setOperators(matrix)
        prefix = f"granumat_{id(self)}_"
        self.solver.setOptionsPrefix(prefix)
        database = PETSc.Options(prefix)
        for name, value in (default_options(self.size, block, comm.size) | options).items():
            database[name] = value
        self.solver.setFromOptions()
        for name in database.getAll():
            database.delValue(name)
        if comm.rank == 0 and self.solver.getPC().getType() in ("lu", "cholesky"):
            _warn_of_reference_blas()

    def norm(self, forces):
        """Two-norm of the cells' forces (cells, n), summed into the equations."""
        return self._right.set(forces).norm()

    def solve(self, stiffness, forces):
        """Solves K q = forces for element matrices (cells, n, n) and forces (cells, n).

        Returns
        -------
        array (nodes, d), what every displacement component gets along its axes, 0 where it is given; None where the solver fails
        """
        right = self._right.set(forces)
        self._matrix.set(np.append(stiffness, self._units))
        self.solver.solve(right, self._solution)
        if self.solver.getConvergedReason() < 0 or not np.isfinite(self._solution.norm()):
            return None
        self._scatter.scatter(self._solution, self._local)
        return np.where(self._free, self._local.array_r.reshape(self._free.shape), 0)


def _warn_of_reference_blas():
    """The direct solver spends its time in the BLAS that the system's libblas.so.3 is."""
    reference = re.search(r"/\S*/blas/libblas\.so\.3\S*", Path("/proc/self/maps").read_text(encoding="utf-8"))
    if reference:
        warnings.warn(f"the BLAS is the reference one, {reference[0]}: in large problems the direct solver takes about ten times "
                      "as long as with OpenBLAS (Debian: libopenblas0)", stacklevel=4)


def default_options(unknowns, dimension, ranks):
    """A direct solver as long as it is the faster one, then a Krylov solver for unsymmetric matrices."""
    if unknowns <= DIRECT_UP_TO[dimension]:
        return {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    return {"ksp_type": "gmres", "ksp_gmres_restart": 200, "ksp_rtol": 1e-6, "ksp_max_it": 1000, "pc_type": "bjacobi",
            "sub_pc_type": "ilu"}
