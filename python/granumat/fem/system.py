"""The linear system: element matrices and vectors into PETSc's, and its solution."""

import ctypes
import re
import warnings
import zlib
from pathlib import Path

import numpy as np
from petsc4py import PETSc

_petsc = ctypes.CDLL(PETSc.__file__)                   # reaches the library that petsc4py itself has loaded
_Int = np.ctypeslib.as_ctypes_type(PETSc.IntType)
ERROR_IN_LIBRARY = 76              # PETSc's number for what MUMPS makes of some matrices that it cannot factorise
DIRECT = {"mat_type": "baij", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
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
        self._labels = np.ascontiguousarray(cell_labels, PETSc.IntType)
        cells, n = self._labels.shape
        self.matrices = np.empty((cells, n, n))
        self._right = PETSc.Vec().create(comm=comm)
        self._right.setSizes((owned, self.size))
        self._right.setBlockSize(block)
        self._right.setType("standard")
        self._right.setOption(PETSc.Vec.Option.IGNORE_NEGATIVE_INDICES, True)
        self._solution = self._right.duplicate()
        used = self._sum(np.ones(self._labels.shape)).array_r > 0
        self._unused = (np.flatnonzero(~used) + self._right.getOwnershipRange()[0]).astype(PETSc.IntType)

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
        self._matrix = PETSc.Mat().create(comm=comm)
        self._matrix.setSizes(((owned, self.size), (owned, self.size)))
        self._matrix.setBlockSize(block)
        self._matrix.setType(options.get("mat_type", "aij"))
        self._make_pattern(comm, block)
        self.solver = make_solver(comm, options)
        self._ignored = set(options) - {"mat_type"}                                # until the first solution
        if comm.rank == 0 and self.solver.getPC().getType() in ("lu", "cholesky"):
            _warn_of_reference_blas()

    def _make_pattern(self, comm, block):
        """Room for the blocks of nodes that meet in a cell, and for the diagonal ones.

        The matrices of cells all of whose nodes have their own equations, or none, go in by blocks, the others by single numbers.
        """
        parts = self._labels.reshape(len(self._labels), -1, block)
        hosts = parts // block
        own = (parts == hosts[..., :1] * block + np.arange(block)).all(axis=2) | (parts < 0).all(axis=2)
        self._nodes = np.ascontiguousarray(hosts[..., 0])
        whole = own.all(axis=1)
        runs = np.split(np.arange(len(whole)), np.flatnonzero(np.diff(whole)) + 1)
        self._runs = [(slice(run[0], run[-1] + 1), whole[run[0]]) for run in runs if len(run)]

        first, last = (end // block for end in self._right.getOwnershipRange())
        base = self.size // block
        keys = [np.arange(first, last) * (base + 1)]
        for nodes in (self._nodes[whole], self._labels[~whole] // block):
            row, column = np.broadcast_arrays(nodes[:, :, None].astype(np.int64), nodes[:, None, :])
            keys.append((row * base + column)[(row >= 0) & (column >= 0)])
        keys = np.unique(np.concatenate(keys))
        ends = np.searchsorted(keys, np.array(comm.allgather(last)) * base)
        row, column = np.divmod(np.unique(np.concatenate(comm.alltoall(np.split(keys, ends[:-1])))), base)
        inside = (first <= column) & (column < last)
        counts = [np.bincount(row[chosen] - first, minlength=last - first).astype(PETSc.IntType) for chosen in (inside, ~inside)]
        _check(_petsc.MatXAIJSetPreallocation(ctypes.c_void_p(self._matrix.handle), _Int(block),
                                              *(ctypes.c_void_p(count.ctypes.data) for count in counts), None, None))

    def _sum(self, forces):
        """The cells' forces (cells, n), summed into the equations."""
        self._right.set(0)
        self._right.setValues(self._labels.ravel(), forces.ravel(), addv=True)
        self._right.assemble()
        return self._right

    def norm(self, forces):
        """Two-norm of the cells' forces (cells, n), summed into the equations."""
        return self._sum(forces).norm()

    def solve(self, forces):
        """Solves K q = forces, for the element matrices in `matrices` and forces (cells, n).

        Returns
        -------
        array (nodes, d), what every displacement component gets along its axes, 0 where it is given; None where the solver fails
        """
        self.assemble()
        if not self.solve_assembled(self._sum(forces)):
            return None
        self._scatter.scatter(self._solution, self._local)
        return np.where(self._free, self._local.array_r.reshape(self._free.shape), 0)

    def assemble(self):
        """The matrix of the elements' matrices."""
        self._matrix.zeroEntries()
        for cells, whole in self._runs:
            add, rows = (self._matrix.setValuesBlockedRCV, self._nodes) if whole else (self._matrix.setValuesRCV, self._labels)
            add(rows[cells], rows[cells], self.matrices[cells], addv=True)
        ones = np.arange(len(self._unused) + 1, dtype=PETSc.IntType), self._unused, np.ones(len(self._unused))
        self._matrix.setValuesIJV(*ones, addv=True, rowmap=self._unused)
        self._matrix.assemble()

    def solve_assembled(self, right):
        """Whether the first solver, or the second, solves the equations."""
        solved = self._solve(self.solver, right)
        self._warn_of_ignored()
        return solved or (self._second is not None and self._solve(self._second, right))

    def _solve(self, solver, right):
        solver.setOperators(self._matrix)
        try:
            solver.solve(right, self._solution)
        except PETSc.Error as error:
            if error.ierr != ERROR_IN_LIBRARY:
                raise
            return False
        return solver.getConvergedReason() > 0 and np.isfinite(self._solution.norm())

    def _warn_of_ignored(self):
        used = ctypes.c_int()
        for name in sorted(self._ignored):
            _check(_petsc.PetscOptionsUsed(None, f"{self.solver.getOptionsPrefix()}{name}".encode(), ctypes.byref(used)))
            if not used.value:
                warnings.warn(f"PETSc has not used the solver's option {name!r}", stacklevel=2)
        self._ignored = set()


def make_solver(comm, options):
    """A linear solver with options, without mat_type, which is the matrix's.

    They stay in PETSc's database, which parts of the solver read when they are first needed, under a prefix that all solvers with
    the same options share: the database is small.
    """
    solver = PETSc.KSP().create(comm)
    solver.setOptionsPrefix(f"granumat_{zlib.crc32(repr(sorted(options.items())).encode()):08x}_")
    database = PETSc.Options(solver.getOptionsPrefix())
    for name, value in options.items():
        if name != "mat_type":
            database[name] = value
    solver.setFromOptions()
    return solver


def _warn_of_reference_blas():
    """The direct solver spends its time in the BLAS that the system's libblas.so.3 is."""
    reference = re.search(r"/\S*/blas/libblas\.so\.3\S*", Path("/proc/self/maps").read_text(encoding="utf-8"))
    if reference:
        warnings.warn(f"the BLAS is the reference one, {reference[0]}: in large problems the direct solver takes about ten times "
                      "as long as with OpenBLAS (Debian: libopenblas0)", stacklevel=4)
