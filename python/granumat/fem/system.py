"""The linear system: element matrices and vectors into PETSc's, by coordinates, and its solution."""

import ctypes
import re
import warnings
import zlib
from pathlib import Path

import numpy as np
from petsc4py import PETSc

_petsc = ctypes.CDLL(PETSc.__file__)                   # reaches the library that petsc4py itself has loaded
_INSERT = 1
ERROR_IN_LIBRARY = 76              # PETSc's number for what MUMPS makes of some matrices that it cannot factorise
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
# The norm is that of the residual itself, from the right: matrices after a reversal or where shear localises are indefinite, and
# there preconditioned residuals fall while the residual does not. In steady shear nothing hardens: the matrix is nearly singular
# and no iteration gets there, so it gives up early.
ITERATIVE = {"mat_type": "baij", "ksp_type": "gmres", "ksp_pc_side": "right", "ksp_gmres_restart": 200, "ksp_rtol": 1e-3,
             "ksp_max_it": 400, "pc_type": "bjacobi"}               # of which each block has an incomplete factor
DIRECT_UP_TO = {2: 400_000, 3: 5_000}                  # unknowns, by dimension: the direct solver comes first
DIRECT_AT_MOST = {2: 2_000_000, 3: 100_000}            # it comes where the iterative solver fails; beyond, its memory counts


def _check(error):
    if error:
        raise PETSc.Error(error)


def _pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


class _Coordinates:
    """Values at given coordinates (int arrays, one for a vector, two for a matrix), summed where they meet; negative ones are left
    out."""

    def __init__(self, target, kind, *indices):
        self.target, self._kind = target, kind
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
        PETSc options of the solver, without prefix, and mat_type, "aij" or "baij". They are added to the defaults; those that name
        a pc_type stand alone.

    Attributes
    ----------
    matrices : array (cells, n, n)
        What `solve` takes the cells' matrices from.
    """

    def __init__(self, comm, owned, block, cell_labels, labels, options):
        self.size = comm.allreduce(owned)
        size = (owned, self.size)
        cell_labels = cell_labels.astype(PETSc.IntType)
        right = PETSc.Vec().create(comm=comm)
        right.setSizes(size)
        right.setBlockSize(block)
        right.setType("standard")
        right.setOption(PETSc.Vec.Option.IGNORE_NEGATIVE_INDICES, True)
        self._right = _Coordinates(right, "Vec", cell_labels.ravel())
        self._solution = right.duplicate()
        unused = np.flatnonzero(self._right.set(np.ones(cell_labels.size)).array_r == 0) + right.getOwnershipRange()[0]

        cells, n = cell_labels.shape
        more = _rest_of_blocks(cell_labels, unused, block)
        rows, columns = (np.empty(cells * n * n + len(more[0]), PETSc.IntType) for _ in range(2))
        rows[:cells * n * n].reshape(cells, n, n)[:] = cell_labels[:, :, None]
        columns[:cells * n * n].reshape(cells, n, n)[:] = cell_labels[:, None, :]
        rows[cells * n * n:], columns[cells * n * n:] = more
        self._values = np.zeros(len(rows))
        self._values[cells * n * n:] = (more[0] == more[1]) & np.isin(more[0], unused)
        self.matrices = self._values[:cells * n * n].reshape(cells, n, n)
        matrix = PETSc.Mat().create(comm=comm)
        matrix.setSizes((size, size))
        matrix.setBlockSize(block)
        matrix.setType("aij")
        self._matrix = _Coordinates(matrix, "Mat", rows, columns)

        wanted = PETSc.IS().createGeneral(np.maximum(labels, 0).ravel().astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._local = PETSc.Vec().createSeq(labels.size)
        self._scatter = PETSc.Scatter().create(self._solution, wanted, self._local, None)
        self._free = labels >= 0

        self._second = None
        if "pc_type" not in options:
            if self.size > DIRECT_UP_TO[block]:
                options = ITERATIVE | options
                if self.size <= DIRECT_AT_MOST[block]:
                    self._second = make_solver(comm, DIRECT)
            else:
                options = DIRECT | options
        self._type = options.get("mat_type", "aij")
        self._operator = matrix if self._type == "aij" else _alike(self._matrix.set(self._values), self._type)
        self._unused = {name: value for name, value in options.items() if name != "mat_type"}       # until the first solution
        self.solver = make_solver(comm, self._unused)
        if comm.rank == 0 and self.solver.getPC().getType() in ("lu", "cholesky"):
            _warn_of_reference_blas()

    def norm(self, forces):
        """Two-norm of the cells' forces (cells, n), summed into the equations."""
        return self._right.set(forces).norm()

    def solve(self, forces):
        """Solves K q = forces, for the element matrices in `matrices` and forces (cells, n).

        Returns
        -------
        array (nodes, d), what every displacement component gets along its axes, 0 where it is given; None where the solver fails
        """
        self.assemble()
        if not self.solve_assembled(self._right.set(forces)):
            return None
        self._scatter.scatter(self._solution, self._local)
        return np.where(self._free, self._local.array_r.reshape(self._free.shape), 0)

    def assemble(self):
        """The matrix of the elements' matrices."""
        matrix = self._matrix.set(self._values)
        if self._type != "aij":
            matrix.convert(self._type, self._operator)

    def solve_assembled(self, right):
        """Whether the first solver, or the second, solves the equations."""
        solved = self._solve(self.solver, self._operator, right)
        self._warn_of_unused()
        return solved or (self._second is not None and self._solve(self._second, self._matrix.target, right))

    def _solve(self, solver, matrix, right):
        solver.setOperators(matrix)
        try:
            solver.solve(right, self._solution)
        except PETSc.Error as error:
            if error.ierr != ERROR_IN_LIBRARY:
                raise
            return False
        return solver.getConvergedReason() > 0 and np.isfinite(self._solution.norm())

    def _warn_of_unused(self):
        used = ctypes.c_int()
        for name in self._unused:
            _check(_petsc.PetscOptionsUsed(None, f"{self.solver.getOptionsPrefix()}{name}".encode(), ctypes.byref(used)))
            if not used.value:
                warnings.warn(f"PETSc has not used the solver's option {name!r}", stacklevel=2)
        self._unused = {}


def make_solver(comm, options):
    """A linear solver with options.

    They stay in PETSc's database, which parts of the solver read when they are first needed, under a prefix that all solvers with
    the same options share: the database is small.
    """
    solver = PETSc.KSP().create(comm)
    solver.setOptionsPrefix(f"granumat_{zlib.crc32(repr(sorted(options.items())).encode()):08x}_")
    database = PETSc.Options(solver.getOptionsPrefix())
    for name, value in options.items():
        database[name] = value
    solver.setFromOptions()
    return solver


def _alike(matrix, kind):
    """A matrix of another kind with the same pattern, of whole blocks."""
    first, last = matrix.getOwnershipRange()
    block = matrix.getBlockSize()
    inside, outside = [], []
    for row in range(first, last, block):
        columns = matrix.getRow(row)[0]
        own = np.count_nonzero((columns >= first) & (columns < last))
        inside.append(own // block)
        outside.append((len(columns) - own) // block)
    alike = PETSc.Mat().create(comm=matrix.comm)
    alike.setSizes(matrix.getSizes())
    alike.setBlockSize(block)
    alike.setType(kind)
    alike.setPreallocationNNZ((np.array(inside, PETSc.IntType), np.array(outside, PETSc.IntType)))
    return alike


def _rest_of_blocks(cell_labels, unused, block):
    """Coordinates (rows, columns) that make the matrix one of whole blocks, the diagonal ones of unused equations included.

    The nodes' own blocks are whole in cells all of whose nodes have their own equations; the others' blocks are listed here.
    """
    nodes = cell_labels.reshape(len(cell_labels), -1, block)
    own = (nodes == nodes[..., :1] // block * block + np.arange(block)).all(axis=(1, 2))
    hosts = cell_labels[~own].astype(np.int64) // block
    row, column = np.broadcast_arrays(hosts[:, :, None], hosts[:, None, :])
    base = np.iinfo(np.int32).max
    pairs = (row * base + column)[(row >= 0) & (column >= 0)]
    row, column = np.divmod(np.unique(np.append(pairs, unused // block * (base + 1))), base)
    i, j = np.divmod(np.arange(block**2), block)
    return (row[:, None] * block + i).ravel(), (column[:, None] * block + j).ravel()


def _warn_of_reference_blas():
    """The direct solver spends its time in the BLAS that the system's libblas.so.3 is."""
    reference = re.search(r"/\S*/blas/libblas\.so\.3\S*", Path("/proc/self/maps").read_text(encoding="utf-8"))
    if reference:
        warnings.warn(f"the BLAS is the reference one, {reference[0]}: in large problems the direct solver takes about ten times "
                      "as long as with OpenBLAS (Debian: libopenblas0)", stacklevel=4)
