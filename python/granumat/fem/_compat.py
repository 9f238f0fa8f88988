"""The only file that knows one DOLFINx release (0.5.2 to 0.11) from another."""

import contextlib
import logging

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

if np.issubdtype(PETSc.ScalarType, np.complexfloating):
    raise ImportError("granumat.fem needs a PETSc of real numbers, this one has complex ones")


@contextlib.contextmanager
def _quietly():
    """Without the compiler's lines that DOLFINx 0.5.2 logs when it meets an element for the first time."""
    level = logging.root.manager.disable
    logging.disable(logging.INFO)
    try:
        yield
    finally:
        logging.disable(level)


@_quietly()
def vector_space(body, degree):
    """Continuous Lagrange displacements of a degree."""
    if hasattr(fem, "functionspace"):
        return fem.functionspace(body, ("Lagrange", degree, (body.geometry.dim,)))
    return fem.VectorFunctionSpace(body, ("Lagrange", degree))


@_quietly()
def cell_space(body, size):
    """Fields of `size` numbers that are constant in each cell."""
    if hasattr(fem, "functionspace"):
        return fem.functionspace(body, ("DG", 0) if size == 1 else ("DG", 0, (size,)))
    return fem.FunctionSpace(body, ("DG", 0)) if size == 1 else fem.VectorFunctionSpace(body, ("DG", 0), dim=size)


def cell_nodes(space):
    """The nodes (cells, nodes), int32, of every cell of this rank, ghost cells last."""
    nodes = space.dofmap.list
    return np.asarray(getattr(nodes, "array", nodes), np.int32).reshape(-1, space.dofmap.dof_layout.num_dofs)


class ReferenceCell:
    """The Lagrange element of a mesh's cells, tabulated.

    Attributes
    ----------
    weights : array (points)
    values : array (points, nodes)
    gradients : array (points, d, nodes), by reference coordinates
    facets : list of (values (points, nodes), slopes (points, d - 1, nodes), weights (points)), by local facet
        slopes are derivatives along the facet's own reference coordinates.
    """

    def __init__(self, body, degree):
        cell = getattr(basix.CellType, body.topology.cell_type.name)
        element = basix.create_element(basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.gll_warped)
        product = cell in (basix.CellType.quadrilateral, basix.CellType.hexahedron)
        points, self.weights = basix.make_quadrature(cell, 2 * degree if product else max(1, 2 * degree - 2))
        table = element.tabulate(1, points)[..., 0]
        self.values = np.ascontiguousarray(table[0])
        self.gradients = np.ascontiguousarray(table[1:].transpose(1, 0, 2))
        dimension = len(basix.topology(cell)) - 1
        vertices, self.facets = basix.geometry(cell), []
        for corners in basix.topology(cell)[dimension - 1]:
            kind = {(2, 2): "interval", (3, 3): "triangle", (3, 4): "quadrilateral"}[dimension, len(corners)]
            places, weights = basix.make_quadrature(getattr(basix.CellType, kind), 2 * degree)
            origin, sides = vertices[corners[0]], vertices[corners[1:dimension]] - vertices[corners[0]]
            table = element.tabulate(1, origin + places.reshape(len(weights), -1) @ sides)[..., 0]
            self.facets.append((table[0], np.einsum("kpn,sk->psn", table[1:], sides), weights))


def mesh_of(comm, cell, cells, positions):
    """The mesh of cells (cells, vertices) and positions (vertices, d), given on rank 0; `cell` is the name of their shape."""
    d = positions.shape[1]
    if comm.rank > 0:
        cells, positions = cells[:0], positions[:0]
    if hasattr(basix, "ufl"):
        domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(d,)))
    else:
        domain = ufl.Mesh(ufl.VectorElement("Lagrange", ufl.Cell(cell), 1))
    with _quietly():
        return mesh.create_mesh(comm, cells=np.asarray(cells, np.int64), x=np.asarray(positions, float),
                                **{"domain" if not hasattr(basix, "ufl") else "e": domain})


def gmsh_mesh(comm, path):
    """The mesh of a gmsh file, its facet tags, and the tags of its facets' physical names."""
    try:
        import gmsh
    except ImportError:
        raise ImportError("meshes from gmsh files need the Python module of gmsh (Debian: python3-gmsh)") from None
    try:
        from dolfinx.io import gmshio as reader
    except ImportError:
        from dolfinx.io import gmsh as reader
    what, error = None, None
    if comm.rank == 0:
        gmsh.initialize()
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.open(str(path))
            d = gmsh.model.getDimension()
            groups = gmsh.model.getPhysicalGroups()
            if d not in (2, 3) or not any(dimension == d for dimension, _ in groups):
                error = f"{path}: must have a physical group of surfaces (plane) or volumes, the cells of the body"
            names = {gmsh.model.getPhysicalName(*group): group[1] for group in groups if group[0] == d - 1}
            what = d, {name: tag for name, tag in names.items() if name}
        except Exception as raised:                              # gmsh raises nothing more special
            error = f"{path} cannot be read by gmsh: {raised}"
    error, what = comm.bcast((error, what))
    if error is None:
        with _quietly():
            found = reader.model_to_mesh(gmsh.model, comm, 0, gdim=what[0])
    if comm.rank == 0:
        gmsh.finalize()
    if error is not None:
        raise ValueError(error)
    return found[0], found[2], what[1]
