"""Bodies with a length: the nonlocal strain m beside the displacements."""

import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem

DEMOS = Path(__file__).parents[2] / "demos"
sys.path.insert(0, str(DEMOS))
import annular_cell  # noqa: E402
import homogeneous_shear  # noqa: E402

SAND = Material(0.5, elastic_strain=0.01)
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def smooth(x, size, phase):
    """A field that differs from place to place."""
    waves = np.array([[3.0, 2, 1], [1, 3, 2], [2, 1, 3]])[:x.shape[1], :x.shape[1]]
    return size * np.sin(x @ waves + phase + np.arange(x.shape[1]))


def body(cell, **more):
    size = (1, 1) if cell in CELLS[:2] else (1, 1, 1)
    return fem.Problem(
        fem.meshes.box(MPI.COMM_WORLD, size, (3, 3) if len(size) == 2 else (2, 2, 2), cell), SAND,
        SAND.isotropic(0.6, pressure=0.05),
        [fem.Displacement(lambda x: np.isclose(x[0], 0), axes=fem.polar((-0.5, 0.1)), components=[0]),
         fem.Pressure(lambda x: np.isclose(x[0], 1), 0.3)], **more)


@pytest.mark.parametrize("rate_term", [0.0, 0.05])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_stiffness_is_the_derivative_of_forces_and_of_the_equations_of_m(cell, degree, rate_term):
    problem = body(cell, degree=degree, rate_term=rate_term, length=0.3)
    problem.displacement = smooth(problem.positions, 0.02, 0.3)
    x = problem.positions

    def unknowns(phase):
        return np.column_stack([smooth(x, 2e-3, phase), 3e-3 + smooth(x, 1e-3, phase + 1)[:, 0]])

    first, _ = problem.evaluate(unknowns(0.0), 1.0)
    assert not first.failure
    problem.accept(first)
    at, v = unknowns(1.0), np.column_stack([smooth(x, 1.0, 2.0), smooth(x, 1.0, 3.0)[:, 0]])
    trial, _ = problem.evaluate(at, 0.5)
    assert not trial.failure
    vertices = problem.body.cell_nodes[:, :problem.body.element.vertex_values.shape[1]]
    v[np.setdiff1d(np.arange(len(x)), vertices), -1] = 0                   # m lives on the vertices
    scale = problem.nonlocal_field.scale(trial.m, problem.states["stress"])
    stiffness = problem.stiffness(trial)
    direction = problem.body.at_cells(problem.numbering.to_axes(v)).reshape(problem.cells, -1)
    found = np.einsum("crk,ck->cr", stiffness, direction)

    def rows(step):
        trial, _ = problem.evaluate(at + step * v, 0.5)
        assert not trial.failure
        return problem.numbering.forces_to_axes(np.concatenate([trial.forces, scale * trial.nonlocal_residuals[..., None]], axis=2))

    h, weights = 2e-6, {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}          # of 8th order
    expected = sum(w * (rows(k * h) - rows(-k * h)) for k, w in weights.items()) / h
    of_m = np.arange(found.shape[1]) % v.shape[1] == problem.d
    for chosen in (of_m, ~of_m):
        assert abs(found - expected)[:, chosen].max() < 1e-7 * abs(expected[:, chosen]).max()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_homogeneous_shear_equals_the_point_with_any_length(cell, degree):
    tolerances = fem.Tolerances(force=1e-10)
    for length, loaded in ((0.1, False), (3.0, True)):
        problem, platen = homogeneous_shear.box(2, cell, degree, 8, loaded, length=length, tolerances=tolerances)
        found = homogeneous_shear.compare(problem, platen, 8 if loaded else 11)
        assert found["difference"].max() < 1e-10
        m = problem.nonlocal_field.at_points(problem.last.m)
        assert np.ptp(problem.comm.allreduce(m)) < 1e-9 * m.max()


@pytest.mark.parametrize("cell", CELLS)
def test_the_nonlocal_strain_of_a_given_strain_is_of_second_order(cell):
    flat, length = cell in CELLS[:2], 0.3
    d = 2 if flat else 3

    def error(n):
        mesh = fem.meshes.box(MPI.COMM_WORLD, (1,) * d, (n,) * d, cell)
        problem = fem.Problem(mesh, SAND, SAND.isotropic(0.6, pressure=0.01), [], length=length)
        exact = [2 + 0.3 * np.cos(np.pi * x).prod(axis=1) for x in (problem.positions, problem.point_positions())]
        gradients = np.zeros((len(exact[1]), 3, 3))
        gradients[:, 0, 1] = 2 * (exact[1] + length**2 * d * np.pi**2 * (exact[1] - 2))    # abs(D) is half the shear
        found = problem.nonlocal_field.solve(problem.displacement, gradients, np.zeros(len(problem.positions)))
        return np.sqrt(((found - exact[0])**2).mean())

    coarse, fine = (error(n) for n in ((8, 16) if flat else (4, 8)))
    assert fine < 0.01 and coarse / fine > 3.4


def steady_at(R):
    """The state of plane steady shear in x and y at constant abs(D)/m = R, and its rate of shear."""
    state, gradient = SAND.isotropic(0.6, pressure=0.01), np.zeros((3, 3))
    gradient[0, 1] = 0.02
    for _ in range(2000):
        state = SAND.update(state, gradient, nonlocal_strain=0.01 / R)
    return state


def creep(R, cells, height=2.0, length=0.2):
    """m over the height of a layer whose ratio of stresses is the steady one at R, where m = 1e-5 is given at the bottom."""
    state = steady_at(R)
    mesh = fem.meshes.box(MPI.COMM_WORLD, (0.5, height), (2, cells))

    def on(axis, end):
        return lambda x: np.isclose(x[axis], end)

    problem = fem.Problem(mesh, SAND, state, [
        fem.Displacement(on(1, 0)), fem.NonlocalStrain(on(1, 0), 1e-5), fem.Traction(on(1, height), state.stress[[3, 1]]),
        fem.Periodic(on(0, 0.5), lambda x: x - np.array([0.5, 0]))], length=length)
    fem.run(problem, 1.0, 1.0)
    order = np.argsort(problem.positions[:, 1])
    return problem, problem.positions[order, 1], problem.last.m[order]


def test_below_yield_m_decays_over_the_length_over_the_root_of_1_minus_R():
    R, length, errors = 0.5, 0.2, []
    decay = length / np.sqrt(1 - R)
    for cells in (30, 60):                                                  # a third, a sixth of the length
        problem, y, m = creep(R, cells)
        slope = np.polyfit(y[y < 1], np.arccosh(m[y < 1] / m[-1]), 1)[0]
        errors.append(-1 / slope / decay - 1)
        strain = np.concatenate(problem.comm.allgather(fem.cell_fields(problem, ["R"])["R"]))
        assert strain == pytest.approx(R, rel=1e-5)
    assert abs(errors[0]) < 0.005 and errors[0] / errors[1] > 3.5
