"""The only file that knows one DOLFINx release (0.5.2 to 0.11) from another."""

import contextlib
import importlib.util
import logging
from collections.abc import Iterator
from types import ModuleType
from typing import NamedTuple, Protocol

import basix
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

if np.issubdtype(PETSc.ScalarType, np.complexfloating):
    raise ImportError("granumat.fem needs a PETSc of real numbers, this one has complex ones")


@contextlib.contextmanager
def quiet_compiler() -> Iterator[None]:
    """Suppresses the messages that the form compiler of DOLFINx 0.5.2 logs when it meets an element for the first time."""
    level = logging.root.manager.disable
    logging.disable(logging.INFO)
    try:
        yield
    finally:
        logging.disable(level)


@quiet_compiler()
def vector_space(mesh: dolfinx.mesh.Mesh, degree: int) -> fem.FunctionSpace:
    """Continuous Lagrange space of displacements."""
    if hasattr(fem, "functionspace"):
        return fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))
    return fem.VectorFunctionSpace(mesh, ("Lagrange", degree))


def cell_nodes(space: fem.FunctionSpace) -> np.ndarray:
    """Local node numbers (cells, nodes per cell), int32, of this rank's cells; ghost cells come last."""
    nodes = space.dofmap.list
    return np.asarray(getattr(nodes, "array", nodes), np.int32).reshape(-1, space.dofmap.dof_layout.num_dofs)


class FacetTags(Protocol):
    """dolfinx.mesh.MeshTags of facets, a type that not every release names: mesh facets and their numbers."""

    indices: np.ndarray
    values: np.ndarray


class FacetTable(NamedTuple):
    """Shape functions of a cell at the integration points of one of its facets.

    `values` (points, nodes); `derivatives` (points, d - 1, nodes) along the facet's own reference coordinates; `weights` (points).
    """

    values: np.ndarray
    derivatives: np.ndarray
    weights: np.ndarray


class ReferenceCell:
    """Shape functions and quadrature of the Lagrange element on the reference cell of a mesh.

    Attributes
    ----------
    weights : array (points)
        Quadrature weights.
    values : array (points, nodes)
        Shape functions at the integration points.
    gradients : array (points, d, nodes)
        Their derivatives by reference coordinates.
    vertex_values, vertex_gradients : array (points, vertices), (points, d, vertices)
        The same of the element of degree 1, whose nodes are the vertices, the first of all nodes.
    facets : list of FacetTable
        One for each local facet.
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh, degree: int) -> None:
        cell = getattr(basix.CellType, mesh.topology.cell_type.name)
        element = basix.create_element(basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.gll_warped)
        product = cell in (basix.CellType.quadrilateral, basix.CellType.hexahedron)
        points, self.weights = basix.make_quadrature(cell, 2 * degree if product else max(1, 2 * degree - 2))
        table = element.tabulate(1, points)[..., 0]
        self.values = np.ascontiguousarray(table[0])
        self.gradients = np.ascontiguousarray(table[1:].transpose(1, 0, 2))
        linear = basix.create_element(basix.ElementFamily.P, cell, 1, basix.LagrangeVariant.gll_warped)
        table = linear.tabulate(1, points)[..., 0]
        self.vertex_values = np.ascontiguousarray(table[0])
        self.vertex_gradients = np.ascontiguousarray(table[1:].transpose(1, 0, 2))
        d = len(basix.topology(cell)) - 1
        vertices = basix.geometry(cell)
        self.facets = []
        for corners in basix.topology(cell)[d - 1]:
            shape = {(2, 2): "interval", (3, 3): "triangle", (3, 4): "quadrilateral"}[d, len(corners)]
            points, weights = basix.make_quadrature(getattr(basix.CellType, shape), 2 * degree)
            origin, sides = vertices[corners[0]], vertices[corners[1:d]] - vertices[corners[0]]
            table = element.tabulate(1, origin + points.reshape(len(weights), -1) @ sides)[..., 0]
            self.facets.append(FacetTable(table[0], np.einsum("kpn,sk->psn", table[1:], sides), weights))


def create_mesh(comm: MPI.Comm, cell: str, cells: np.ndarray, positions: np.ndarray) -> dolfinx.mesh.Mesh:
    """A mesh from its vertices, which need to be given on rank 0 only.

    Parameters
    ----------
    comm : MPI communicator
    cell : str
        Name of the cells' shape.
    cells : int array (cells, vertices per cell)
    positions : array (vertices, d)
    """
    d = positions.shape[1]
    if comm.rank > 0:
        cells, positions = cells[:0], positions[:0]
    if hasattr(basix, "ufl"):
        domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(d,)))
    else:
        domain = ufl.Mesh(ufl.VectorElement("Lagrange", ufl.Cell(cell), 1))
    with quiet_compiler():
        return dolfinx.mesh.create_mesh(comm, cells=np.asarray(cells, np.int64), x=np.asarray(positions, float),
                                        **{"domain" if not hasattr(basix, "ufl") else "e": domain})


def gmsh_reader() -> ModuleType:
    """The module of DOLFINx that has model_to_mesh."""
    return importlib.import_module("dolfinx.io.gmshio" if importlib.util.find_spec("dolfinx.io.gmshio") else "dolfinx.io.gmsh")
