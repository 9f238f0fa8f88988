"""The linear system: the cells' matrices and forces summed into PETSc's, and its solution."""

import ctypes
import re
import signal
import threading
import warnings
import zlib
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..checks import refuse

# Python ignores SIGPIPE; PETSc, once loaded, aborts MPI at it. Where mpirun was killed, ranks of Open MPI 5 abort, and say so to
# the broken pipe of mpirun: PETSc's abort within that abort would wait for ever, and keep the lock of the run's directory.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)

_petsc = ctypes.CDLL(PETSc.__file__)                   # reaches the library that petsc4py itself has loaded
_Int = np.ctypeslib.as_ctypes_type(PETSc.IntType)
ERROR_IN_LIBRARY = 76                                  # PETSc's code of the error that MUMPS raises at some singular matrices

MATRIX_TYPES = ("aij", "baij")
DIRECT = {"mat_type": "baij", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
# Right preconditioning, so that GMRES controls the norm of the residual itself: after a reversal and where shear localises the
# matrix is indefinite, and the preconditioned residual falls while the residual does not. In steady shear nothing hardens, the
# matrix is nearly singular and GMRES does not converge at all: it stops after 400 iterations, and the fallback solves.
ITERATIVE = {"mat_type": "baij", "ksp_type": "gmres", "ksp_pc_side": "right", "ksp_gmres_restart": 200, "ksp_rtol": 1e-3,
             "ksp_max_it": 400, "pc_type": "bjacobi"}  # PETSc's default for each block is ILU(0)
DIRECT_FIRST_UP_TO = {2: 400_000, 3: 5_000}            # unknowns, by dimension: up to here the direct solver is the first
DIRECT_FALLBACK_UP_TO = {2: 2_000_000, 3: 100_000}     # up to here it replaces an iterative one that fails; more takes much memory
# With a length the matrix stays well-conditioned in steady shear too, and ILU(0) needs some 30 iterations. Where cells are sheared
# out of shape it can fail; ILU(1) then does not, at four times the memory.
ITERATIVE_WITH_LENGTH = (ITERATIVE | {"ksp_max_it": 100}, ITERATIVE | {"sub_pc_factor_levels": 1})


def _check(error: int) -> None:
    if error:
        raise PETSc.Error(error)


class System:
    """K q = r for the unknowns of a Numbering; equations that no unknown uses are q = 0.

    Parameters
    ----------
    comm : MPI communicator
    owned : int
        Equations of this rank.
    d : int
        Dimension of the body, on which the default solvers depend.
    cell_labels : int array (cells, n)
        Equation of every row of the cells' matrices, negative where there is none.
    labels : int array (nodes, unknowns)
        Equation of every unknown of the nodes, negative where there is none: d displacement components, with a length one more.
    options : mapping
        PETSc options of the solver, without prefix, and mat_type, "aij" or "baij". They are added to the defaults; with a pc_type
        among them, they replace the defaults.

    Attributes
    ----------
    size : int
        Equations of all ranks.
    cell_matrices : array (cells, n, n)
        `assemble` sums these.
    matrix : petsc4py.PETSc.Mat
        Their sum.
    solver : petsc4py.PETSc.KSP
        The one that is tried first.
    """

    def __init__(self, comm: MPI.Comm, owned: int, d: int, cell_labels: np.ndarray, labels: np.ndarray,
                 options: Mapping[str, object]) -> None:
        self.size, block_size = comm.allreduce(owned), labels.shape[1]
        self._has_length = block_size > d
        self._cell_labels = np.ascontiguousarray(cell_labels, PETSc.IntType)
        cells, n = self._cell_labels.shape
        self.cell_matrices = np.empty((cells, n, n))
        self._right = PETSc.Vec().create(comm=comm)
        self._right.setSizes((owned, self.size))
        self._right.setBlockSize(block_size)
        self._right.setType("standard")
        self._right.setOption(PETSc.Vec.Option.IGNORE_NEGATIVE_INDICES, True)
        self._solution = self._right.duplicate()
        used = self._sum(np.ones(self._cell_labels.shape)).array_r > 0
        self._unused = (np.flatnonzero(~used) + self._right.getOwnershipRange()[0]).astype(PETSc.IntType)

        wanted = PETSc.IS().createGeneral(np.maximum(labels, 0).ravel().astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._at_nodes = PETSc.Vec().createSeq(labels.size)
        self._to_nodes = PETSc.Scatter().create(self._solution, wanted, self._at_nodes, None)
        self._free = labels >= 0

        fallbacks: list[Mapping[str, object]] = []
        if "pc_type" not in options:
            first, *fallbacks = default_solvers(d, self.size, self._has_length)
            options = {**first, **options}
        # made when they are first needed: PETSc complains at the end of options that no solver has read
        self._fallbacks = [cache(partial(make_solver, comm, fallback)) for fallback in fallbacks]
        self.matrix = PETSc.Mat().create(comm=comm)
        self.matrix.setSizes(((owned, self.size), (owned, self.size)))
        self.matrix.setBlockSize(block_size)
        if options.get("mat_type", "aij") not in MATRIX_TYPES:
            raise ValueError(f"solver: mat_type = {options['mat_type']!r}: must be one of {', '.join(MATRIX_TYPES)}")
        self.matrix.setType(options.get("mat_type", "aij"))
        self._preallocate(comm, block_size)
        self.solver = make_solver(comm, options)
        self._unchecked_options = set(options) - {"mat_type"}                      # until the first solution has used them
        if comm.rank == 0 and self.solver.getPC().getType() in ("lu", "cholesky"):
            warn_of_reference_blas()

    def _preallocate(self, comm: MPI.Comm, block_size: int) -> None:
        """Preallocates the matrix: blocks of every two nodes of a cell, and the diagonal blocks.

        Cells are sorted into runs of two kinds. Where every node has its own equations or none, `assemble` inserts whole blocks,
        elsewhere (ties, periodic nodes, single components prescribed) single numbers.
        """
        labels = self._cell_labels.reshape(len(self._cell_labels), -1, block_size)
        blocks = labels // block_size
        own = (labels == blocks[..., :1] * block_size + np.arange(block_size)).all(axis=2) | (labels < 0).all(axis=2)
        self._cell_blocks = np.ascontiguousarray(blocks[..., 0])
        whole = own.all(axis=1)
        runs = np.split(np.arange(len(whole)), np.flatnonzero(np.diff(whole)) + 1)
        self._runs = [(slice(run[0], run[-1] + 1), whole[run[0]]) for run in runs if len(run)]

        # A pair of block row and block column is one number, row * block_rows + column; each goes to the rank that owns the row.
        first, last = (end // block_size for end in self._right.getOwnershipRange())
        block_rows = self.size // block_size
        pairs = [np.arange(first, last) * (block_rows + 1)]
        for nodes in (self._cell_blocks[whole], self._cell_labels[~whole] // block_size):
            row, column = np.broadcast_arrays(nodes[:, :, None].astype(np.int64), nodes[:, None, :])
            pairs.append((row * block_rows + column)[(row >= 0) & (column >= 0)])
        sent = np.unique(np.concatenate(pairs))
        ends = np.searchsorted(sent, np.array(comm.allgather(last)) * block_rows)
        row, column = np.divmod(np.unique(np.concatenate(comm.alltoall(np.split(sent, ends[:-1])))), block_rows)
        diagonal = (first <= column) & (column < last)
        counts = [np.bincount(row[chosen] - first, minlength=last - first).astype(PETSc.IntType)
                  for chosen in (diagonal, ~diagonal)]
        _check(_petsc.MatXAIJSetPreallocation(ctypes.c_void_p(self.matrix.handle), _Int(block_size),
                                              *(ctypes.c_void_p(count.ctypes.data) for count in counts), None, None))

    def _sum(self, forces: np.ndarray) -> PETSc.Vec:
        """The cells' forces (cells, n), summed into the equations."""
        self._right.set(0)
        self._right.setValues(self._cell_labels.ravel(), forces.ravel(), addv=True)
        self._right.assemble()
        return self._right

    def norm(self, forces: np.ndarray) -> float:
        """Two-norm of the cells' forces (cells, n), summed into the equations; collective."""
        return self._sum(forces).norm()

    def solve(self, forces: np.ndarray) -> np.ndarray | None:
        """Solves K q = r for the sums of `cell_matrices` and of the cells' forces (cells, n); collective.

        Returns
        -------
        array (nodes, unknowns) or None
            q of every unknown along its node's axes, 0 where it is prescribed. None if no solver solves the equations.
        """
        self.assemble()
        return self.solve_again(forces)

    def solve_again(self, forces: np.ndarray) -> np.ndarray | None:
        """As `solve`, with the matrix as it is assembled."""
        if not self.solve_assembled(self._sum(forces)):
            return None
        self._to_nodes.scatter(self._solution, self._at_nodes)
        return np.where(self._free, self._at_nodes.array_r.reshape(self._free.shape), 0)

    def assemble(self) -> None:
        """Sums `cell_matrices` into `matrix`."""
        self.matrix.zeroEntries()
        for cells, whole in self._runs:
            if whole:
                add, rows = self.matrix.setValuesBlockedRCV, self._cell_blocks
            else:
                add, rows = self.matrix.setValuesRCV, self._cell_labels
            add(rows[cells], rows[cells], self.cell_matrices[cells], addv=True)
        ones = np.arange(len(self._unused) + 1, dtype=PETSc.IntType), self._unused, np.ones(len(self._unused))
        self.matrix.setValuesIJV(*ones, addv=True, rowmap=self._unused)
        self.matrix.assemble()

    def solve_assembled(self, right: PETSc.Vec) -> bool:
        """Whether the solver, or one that it falls back on, solves the assembled equations."""
        solved = self._solve(self.solver, right)
        self._warn_of_unused_options()
        for make_fallback in self._fallbacks:
            if solved:
                break
            fallback = make_fallback()
            solved = self._solve(fallback, right)
            if self._has_length and fallback.getPC().getType() == "lu":            # rarely needed, and far larger than the matrix
                fallback.reset()
        return solved

    def _solve(self, solver: PETSc.KSP, right: PETSc.Vec) -> bool:
        solver.setOperators(self.matrix)
        try:
            solver.solve(right, self._solution)
        except PETSc.Error as error:
            if error.ierr != ERROR_IN_LIBRARY:
                raise ValueError(f"solver: PETSc cannot solve with the options that were given: {_last_line(error)}") from None
            return False
        return bool(solver.getConvergedReason() > 0 and np.isfinite(self._solution.norm()))

    def _warn_of_unused_options(self) -> None:
        used = ctypes.c_int()
        for name in sorted(self._unchecked_options):
            _check(_petsc.PetscOptionsUsed(None, f"{self.solver.getOptionsPrefix()}{name}".encode(), ctypes.byref(used)))
            if not used.value:
                warnings.warn(f"PETSc has not used the solver's option {name!r}", stacklevel=2)
        self._unchecked_options = set()


def default_solvers(d: int, size: int, has_length: bool) -> list[Mapping[str, object]]:
    """PETSc options of the solvers that are tried one after the other, for so many unknowns in d dimensions."""
    if size <= DIRECT_FIRST_UP_TO[d]:
        return [DIRECT]
    iterative = ITERATIVE_WITH_LENGTH if has_length else (ITERATIVE,)
    return [*iterative, *([DIRECT] if size <= DIRECT_FALLBACK_UP_TO[d] else [])]


def make_solver(comm: MPI.Comm, options: Mapping[str, object]) -> PETSc.KSP:
    """A linear solver with PETSc options; mat_type is left to the matrix.

    The options stay in PETSc's database, as parts of the solver read them when they are first needed. All solvers with the same
    options share one prefix, so that the database does not grow with the number of problems.
    """
    solver = PETSc.KSP().create(comm)
    solver.setOptionsPrefix(f"granumat_{zlib.crc32(repr(sorted(options.items())).encode()):08x}_")
    database = PETSc.Options(solver.getOptionsPrefix())
    refuse("the options of the solver cannot be used", [
        f"{name} = {value!r}: must be a text, a number, true or false" for name, value in options.items()
        if not isinstance(name, str) or not isinstance(value, (str, int, float))])
    for name, value in options.items():
        if name != "mat_type":
            database[name] = value
    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        raise ValueError(f"solver: PETSc refuses the options {dict(options)}: {_last_line(error)}") from None
    return solver


def _last_line(error: PETSc.Error) -> str:
    """What of PETSc's message says why, without the calls that have led there."""
    return str(error).splitlines()[-1].removeprefix("[0] ")


def warn_of_reference_blas() -> None:
    """Warns if the system's BLAS, in which the direct solver spends its time, is the unoptimised reference one."""
    reference = re.search(r"/\S*/blas/libblas\.so\.3\S*", Path("/proc/self/maps").read_text(encoding="utf-8"))
    if reference:
        warnings.warn(f"the BLAS is the reference one, {reference[0]}: in large problems the direct solver takes about ten times "
                      "as long as with OpenBLAS (Debian: libopenblas0)", stacklevel=4)
