"""The linear solvers, their options, and the bench that measures them."""

import warnings

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from granumat import Material, fem
from granumat.fem import system
from granumat.studies import bench_fem

NEVER = {2: 0, 3: 0}


def block(size, solver=None):
    """A box between a rough floor and a lid that is tied, pressure around."""
    d = len(size)
    material = Material(0.5, elastic_strain=1e-2)

    def on(*planes):
        return lambda x: np.any([np.isclose(x[axis], end) for axis, end in planes], axis=0)

    floor, lid = on((d - 1, 0)), on((d - 1, 1))
    sides = on(*((axis, end) for axis in range(d - 1) for end in (0, 1)))
    return fem.Problem(
        fem.meshes.box(MPI.COMM_WORLD, (1,) * d, size), material, material.isotropic(0.6, pressure=0.02),
        [fem.Displacement(floor), fem.Displacement(lid, lambda x, t: np.eye(d)[0] * 0.005 * t, components=range(d - 1)),
         fem.Tied(lid, d - 1), fem.Pressure(lid, 0.02), fem.Pressure(sides, 0.02)], solver=solver)


def solved(problem):
    trial = problem.solve_increment(1.0)
    assert not trial.failure
    return trial.u


@pytest.mark.parametrize("size", [(6, 6), (4, 4, 4)])
def test_the_iterative_solver_gives_the_answer_of_the_direct_one(size, monkeypatch):
    direct = block(size)
    assert direct.system.solver.getPC().getType() == "lu"
    expected = solved(direct)
    monkeypatch.setattr(system, "DIRECT_FIRST_UP_TO", NEVER)
    monkeypatch.setattr(system, "DIRECT_FALLBACK_UP_TO", NEVER)                       # no fallback
    iterative = block(size)
    assert abs(solved(iterative) - expected).max() < 1e-8 * abs(expected).max()
    solver = iterative.system.solver
    assert solver.getPC().getType() == "bjacobi" and solver.getIterationNumber() > 1
    assert solver.getNormType() == PETSc.KSP.NormType.UNPRECONDITIONED             # of the residual itself


@pytest.mark.parametrize("kind", ["aij", "baij"])
def test_the_matrix_is_the_sum_of_the_cells_matrices_and_1_where_there_is_no_unknown(kind):
    solver = {"mat_type": kind, "pc_type": "lu"}
    for problem in (block((3, 3, 3), solver), bench_fem.shear_cell(MPI.COMM_WORLD, 3, solver=solver)):
        equations = problem.system
        equations.cell_matrices[:] = np.random.default_rng(0).normal(size=equations.cell_matrices.shape)
        expected = np.zeros((equations.size, equations.size))
        labels = problem.numbering.cell_labels
        row, column = np.broadcast_arrays(labels[:, :, None], labels[:, None, :])
        there = (row >= 0) & (column >= 0)
        np.add.at(expected, (row[there], column[there]), equations.cell_matrices[there])
        unused = np.setdiff1d(np.arange(equations.size), labels)
        assert len(unused) > 0
        expected[unused, unused] = 1
        for _ in range(2):                                                             # the second one is not added to the first
            equations.assemble()
        matrix = equations.matrix
        assert matrix.getType() == f"seq{kind}"
        assert abs(matrix.convert("dense").getDenseArray() - expected).max() < 1e-13


def test_the_direct_solver_helps_where_the_iterative_one_fails(monkeypatch):
    expected = solved(block((4, 4, 4)))
    monkeypatch.setattr(system, "DIRECT_FIRST_UP_TO", NEVER)
    assert abs(solved(block((4, 4, 4), {"ksp_max_it": 2})) - expected).max() < 1e-8 * abs(expected).max()
    monkeypatch.setattr(system, "DIRECT_FALLBACK_UP_TO", NEVER)
    assert "linear solver" in block((4, 4, 4), {"ksp_max_it": 2}).solve_increment(1.0).failure


def test_two_ranks_iterate_to_the_answer_of_one(mpirun):
    script = """
import numpy as np
from mpi4py import MPI
from granumat.fem import system
from granumat.studies import bench_fem
system.DIRECT_FIRST_UP_TO = {3: 0}
problem = bench_fem.shear_cell(MPI.COMM_WORLD, 4)
for _ in range(2):
    trial = problem.solve_increment(1.0)
    assert not trial.failure and problem.system.solver.getConvergedReason() == 2
    problem.accept(trial)
force, moment = problem.reaction(lambda x: np.isclose(x[2], 0))
if problem.comm.rank == 0:
    print(*force, *moment)
"""
    one, two = (np.array(mpirun(script, ranks).split(), float) for ranks in (1, 2))
    assert abs(one - two).max() < 1e-8 * abs(one).max()


def test_options_reach_the_solver_and_its_parts():
    problem = block((3, 3), {"pc_type": "bjacobi", "sub_pc_type": "lu", "ksp_type": "fgmres", "ksp_rtol": 1e-9, "mat_type": "baij"})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solved(problem)
    solver = problem.system.solver
    assert solver.getType() == "fgmres" and solver.getTolerances()[0] == 1e-9
    assert solver.getIterationNumber() == 1                                        # one block, with a full factor by sub_pc_type


def test_a_wrong_value_is_an_error_and_a_wrong_name_a_warning():
    with pytest.raises(ValueError, match=r"PETSc refuses the options .*Unable to find requested KSP type no-such-solver"):
        block((2, 2), {"ksp_type": "no-such-solver"})
    with pytest.raises(ValueError, match="mat_type = 'no-such-matrix': must be one of aij, baij"):
        block((2, 2), {"mat_type": "no-such-matrix"})
    with pytest.raises(ValueError, match=r"PETSc cannot solve with the options that were given: .*no-such-package"):
        solved(block((2, 2), {"pc_factor_mat_solver_type": "no-such-package"}))
    with pytest.warns(UserWarning, match="'ksp_rtoll'"):
        solved(block((2, 2), {"ksp_rtoll": 1e-9}))


def test_the_bench_counts_all_time_and_no_part_is_negative():
    found = bench_fem.measure(3)
    assert found["unknowns"] == 3 * 4**3 and found["newton"] >= bench_fem.INCREMENTS
    assert min(found[phase] for phase in bench_fem.PHASES) > 0
    assert abs(sum(found[phase] for phase in bench_fem.PHASES) - found["iteration"]) < 1e-9


def test_problems_in_one_process_do_not_fill_the_options_of_petsc():
    block((2, 2))
    before = PETSc.Options().getAll()
    block((2, 2))
    assert PETSc.Options().getAll() == before
