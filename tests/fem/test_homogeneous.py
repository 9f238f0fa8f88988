"""A homogeneous deformation of a body is that of a point."""

import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem

sys.path.insert(0, str(Path(__file__).parents[2] / "demos"))
import homogeneous_shear

KINDS = [(cell, degree) for cell in ("quadrilateral", "triangle", "hexahedron", "tetrahedron") for degree in (1, 2)]


@pytest.mark.parametrize(("cell", "degree"), KINDS)
def test_simple_shear_with_pause_and_reversal_and_under_constant_load_equals_the_point(cell, degree):
    data = homogeneous_shear.main(**homogeneous_shear.SHORT, cell=cell, degree=degree)
    assert data["difference"].max() < 1e-9
    assert data["height"][-1] > 1.001


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
def test_any_affine_motion_of_the_boundary_is_that_of_every_point(elastic_strain):
    sand = Material(0.5, elastic_strain=elastic_strain)
    start = sand.isotropic(0.6, pressure=0.01)
    rate = np.array([[0.02, 0.3, 0.0], [-0.1, -0.05, 0.0], [0.0, 0.0, 0.0]])
    values, vectors = np.linalg.eig(0.1 * rate[:2, :2])

    def affine(x, t):
        F = (vectors * np.exp(t * values)) @ np.linalg.inv(vectors)
        return x @ (F.real - np.eye(2)).T

    problem = fem.Problem(fem.meshes.annulus(MPI.COMM_WORLD, (1, 2), (2, 9)), sand, start,
                          [fem.Displacement(lambda x: np.full(x.shape[1], True), affine)])
    fem.run(problem, 5, 1.0)
    state = start
    for _ in range(5):
        state = sand.update(state, 0.1 * rate)
    for name in ("stress", "fabric", "coordination_number", "volume_fraction"):
        assert np.allclose(problem.states[name], state[name], rtol=0, atol=1e-10), name


def test_a_pause_changes_nothing_and_takes_one_iteration():
    sand = Material(0.5, elastic_strain=0.01)
    problem = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (1, 1), (3, 3)), sand, sand.isotropic(0.6, pressure=0.01), [
        fem.Displacement(lambda x: np.isclose(x[1], 0)), fem.Displacement(lambda x: np.isclose(x[0], 0), components=[0]),
        fem.Displacement(lambda x: np.isclose(x[1], 1), lambda x, t: min(t, 2) * np.array([0, -0.002]))])
    fem.run(problem, 2, 1.0)
    before = problem.states.copy()
    pause = problem.solve_increment(1.0)
    assert not pause.failure and len(pause.residuals) <= 3
    assert np.allclose(pause.states.stress, before.stress, rtol=0, atol=1e-10 * abs(before.stress).max())


def test_a_body_without_stress_can_be_moved_until_it_jams():
    sand = Material(0.5, elastic_strain=0.01)
    start = sand.isotropic(0.59, coordination_number=sand["Zc"] - 0.1)
    problem = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (1, 1), (3, 3)), sand, start, [
        fem.Displacement(lambda x: np.isclose(x[1], 0)),
        fem.Displacement(lambda x: np.isclose(x[1], 1), lambda x, t: np.array([0, -t])),
        fem.Periodic(lambda x: np.isclose(x[0], 1), lambda x: x - np.array([1.0, 0.0]))])
    pressures, state = [], start
    for height in np.linspace(1, 0.98, 11)[1:]:
        fem.run(problem, 1 - height, 0.002)
        state = sand.update(state, np.diag([0, np.log(height / (height + 0.002)), 0]))
        pressures.append(-state.stress[:3].sum() / 3)
        assert np.allclose(problem.states.stress, state.stress, rtol=0, atol=1e-9)
    assert pressures[0] == 0 and pressures[-1] > 1e-3


def test_on_two_ranks_too(mpirun):
    script = f"""
import sys
sys.path.insert(0, {str(Path(homogeneous_shear.__file__).parent)!r})
from mpi4py import MPI
import homogeneous_shear
for cell, degree in {KINDS!r}:
    data = homogeneous_shear.main(**homogeneous_shear.SHORT, cell=cell, degree=degree)
    if not data["difference"].max() < 1e-9 or MPI.COMM_WORLD.size != 2:
        MPI.COMM_WORLD.Abort(1)
"""
    assert mpirun(script, 2).count("largest difference") == len(KINDS)
