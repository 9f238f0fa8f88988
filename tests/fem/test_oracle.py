"""The element kernels against UFL forms on the moved mesh, for all elements without mean dilatation (B-bar).

Triangles and tetrahedra of degree 1 are among them: they have one integration point, whose value is the cell's mean.
"""

import basix
import dolfinx.fem.petsc
import numpy as np
import pytest
import ufl
from dolfinx import fem as forms
from mpi4py import MPI
from scipy.spatial import cKDTree

from granumat import Material, fem, tensors

KINDS = [("triangle", 1), ("tetrahedron", 1), ("triangle", 2), ("quadrilateral", 2), ("tetrahedron", 2), ("hexahedron", 2)]


class Oracle:
    """A body deformed affinely, with random stress at its points, as the kernels and as UFL see it."""

    def __init__(self, cell, degree, rng):
        d = 2 if cell in ("triangle", "quadrilateral") else 3
        sand = Material(0.5)
        self.mesh = fem.meshes.box(MPI.COMM_SELF, (1.0, 1.2, 0.8)[:d], (3, 2, 2)[:d], cell)
        self.problem = fem.Problem(self.mesh, sand, sand.isotropic(0.6, pressure=0.01), degree=degree)
        self.degree = 2 * degree if cell in ("quadrilateral", "hexahedron") else max(1, 2 * degree - 2)
        F = np.eye(d) + 0.3 * rng.uniform(-1, 1, (d, d))
        moved = self.problem.positions @ F.T
        if degree == 1:                                       # any deformation, not only an affine one
            moved += rng.uniform(-0.05, 0.05, moved.shape)
        x = self.mesh.geometry.x
        x[:, :d] = moved[cKDTree(self.problem.positions).query(x[:, :d])[1]]
        self.x = moved[self.problem.body.cell_nodes]
        self.body = self.problem.body
        self.rows, self.columns = (slice(4), [0, 1, 3, 6]) if d == 2 else (slice(6), slice(9))     # of the full tangent
        _, self.volumes, status = self.body.kinematics(self.x, np.zeros_like(self.x))
        assert not status.any()
        self.stress = rng.uniform(-1, 1, (*self.volumes.shape, 6))
        self.dx = ufl.Measure("dx", self.mesh, metadata={"quadrature_degree": self.degree, "quadrature_scheme": "default"})
        self.u, self.v = ufl.TrialFunction(self.problem.space), ufl.TestFunction(self.problem.space)

    def quadrature_function(self, values):
        """Values (cells, points, n) as a function of the quadrature element."""
        cell, n = self.mesh.topology.cell_type.name, values.shape[-1]
        if hasattr(basix, "ufl"):
            element = basix.ufl.quadrature_element(cell, value_shape=(n,), scheme="default", degree=self.degree)
            function = forms.Function(forms.functionspace(self.mesh, element))
        else:
            element = ufl.VectorElement("Quadrature", ufl.Cell(cell), degree=self.degree, quad_scheme="default", dim=n)
            function = forms.Function(forms.FunctionSpace(self.mesh, element))
        function.x.array[:] = values.ravel()
        return function

    def sigma(self, stress):
        """Stress (cells, points, 6) as a matrix in a form."""
        function, d = self.quadrature_function(stress), self.problem.d
        rows = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
        return ufl.as_matrix([[function[rows[i][j]] for j in range(d)] for i in range(d)])

    def residual(self, stress):
        """Nodal forces of a stress, by its form."""
        form = ufl.inner(self.sigma(stress), ufl.grad(self.v)) * self.dx
        return dolfinx.fem.petsc.assemble_vector(forms.form(form)).array

    def forces(self, stress):
        """Nodal forces of a stress, by the kernels."""
        cells = self.body.internal_forces(self.x, self.volumes, stress)
        total = np.zeros(self.problem.positions.size)
        np.add.at(total, self.dofs(), cells.reshape(len(cells), -1))
        return total

    def dofs(self):
        """Number (cells, n) of every displacement component of the cells."""
        d = self.problem.d
        return (self.problem.body.cell_nodes[:, :, None] * d + np.arange(d)).reshape(len(self.x), -1)

    def stiffness(self, stress, tangent):
        """The kernels' element matrices, summed over the cells."""
        dofs, size = self.dofs(), self.problem.positions.size
        matrices = np.empty((*dofs.shape, dofs.shape[1]))
        self.body.internal_stiffness(self.x, self.volumes, np.zeros((*self.volumes.shape, 3, 3)), stress,
                                     tangent[..., self.rows, self.columns], matrices)
        total = np.zeros((size, size))
        np.add.at(total, (dofs[:, :, None], dofs[:, None, :]), matrices)
        return total

    def assembled(self, form):
        matrix = dolfinx.fem.petsc.assemble_matrix(forms.form(form))
        matrix.assemble()
        every = np.arange(matrix.getSize()[0], dtype=np.int32)
        return matrix.getValues(every, every)


def difference(found, expected):
    return abs(found - expected).max() / abs(expected).max()


@pytest.mark.parametrize(("cell", "degree"), KINDS)
def test_forces_are_those_of_the_residual_form(cell, degree, rng):
    oracle = Oracle(cell, degree, rng)
    assert difference(oracle.forces(oracle.stress), oracle.residual(oracle.stress)) < 1e-13


@pytest.mark.parametrize(("cell", "degree"), KINDS)
def test_stiffness_of_linear_elasticity_is_that_of_its_form(cell, degree, rng):
    oracle = Oracle(cell, degree, rng)
    lame, shear = 1.7, 0.6
    tangent = np.zeros((*oracle.volumes.shape, 6, 9))
    tangent[..., :, :6] = lame * np.outer(tensors.IDENTITY, tensors.IDENTITY) + shear * np.diag([2, 2, 2, 1, 1, 1])
    strain = ufl.sym(ufl.grad(oracle.u))
    form = lame * ufl.div(oracle.u) * ufl.div(oracle.v) + 2 * shear * ufl.inner(strain, ufl.grad(oracle.v))
    found = oracle.stiffness(np.zeros_like(oracle.stress), tangent)
    assert difference(found, oracle.assembled(form * oracle.dx)) < 1e-13


@pytest.mark.parametrize(("cell", "degree"), KINDS)
def test_geometric_stiffness_is_that_of_the_moving_mesh(cell, degree, rng):
    oracle = Oracle(cell, degree, rng)
    by_u, by_v = ufl.grad(oracle.u), ufl.grad(oracle.v)
    form = ufl.inner(oracle.sigma(oracle.stress), ufl.tr(by_u) * by_v - by_v * by_u)          # derivatives of dV and of grad v
    found = oracle.stiffness(oracle.stress, np.zeros((*oracle.volumes.shape, 6, 9)))
    assert difference(found, oracle.assembled(form * oracle.dx)) < 1e-13


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_with_mean_dilatation_the_cells_mean_pressure_works(cell, rng):
    oracle = Oracle(cell, 1, rng)
    volumes, d = oracle.volumes[..., None], oracle.problem.d
    excess = oracle.stress[..., :d].sum(axis=-1, keepdims=True) / d
    excess = excess - (volumes * excess).sum(axis=1, keepdims=True) / volumes.sum(axis=1, keepdims=True)
    working = oracle.stress - excess * np.append(np.ones(d), np.zeros(6 - d))
    found = oracle.forces(oracle.stress)
    assert difference(found, oracle.residual(working)) < 1e-13
    assert difference(found, oracle.residual(oracle.stress)) > 0.01
