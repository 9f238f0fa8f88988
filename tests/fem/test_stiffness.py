"""The element stiffness is the derivative of the element forces."""

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from granumat import Material, fem


def body(cell):
    kind = getattr(mesh.CellType, cell)
    if cell in ("triangle", "quadrilateral"):
        return mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [1, 1]], [3, 3], kind)
    return mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [1, 1, 1]], [2, 2, 2], kind)


def smooth(x, size, phase):
    """A displacement field that rotates and strains every cell differently."""
    waves = np.array([[3.0, 2, 1], [1, 3, 2], [2, 1, 3]])[:x.shape[1], :x.shape[1]]
    return size * np.sin(x @ waves + phase + np.arange(x.shape[1]))


@pytest.mark.parametrize("rate_term", [0.0, 0.05])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_stiffness_is_the_derivative_of_the_forces(cell, degree, rate_term):
    material = Material(0.5, elastic_strain=1e-2)
    problem = fem.Problem(
        body(cell), material, material.isotropic(0.6, pressure=0.05), degree=degree, rate_term=rate_term,
        conditions=[fem.Displacement(lambda x: np.isclose(x[0], 0), axes=fem.polar((-0.5, 0.1)), components=[0]),
                    fem.Pressure(lambda x: np.isclose(x[0], 1), 0.3)])
    problem.displacement = smooth(problem.positions, 0.02, 0.3)                # cells of different shapes
    first, _ = problem.evaluate(smooth(problem.positions, 2e-3, 0.0), 1.0)
    assert not first.failure
    problem.accept(first)
    u, v = smooth(problem.positions, 2e-3, 1.0), smooth(problem.positions, 1.0, 2.0)
    trial, _ = problem.evaluate(u, 0.5)
    assert not trial.failure
    n = trial.forces.shape[1] * trial.forces.shape[2]
    direction = problem.body.at_cells(problem.numbering.to_axes(v)).reshape(-1, n)
    found = np.einsum("crk,ck->cr", problem.stiffness(trial), direction)

    def forces(step):
        return problem.numbering.forces_to_axes(problem.evaluate(u + step * v, 0.5)[0].forces)

    h, weights = 2e-6, {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}          # of 8th order
    expected = sum(w * (forces(k * h) - forces(-k * h)) for k, w in weights.items()) / h
    assert abs(found - expected).max() < 1e-8 * abs(expected).max()
