"""A body on a mesh: elements, parts of the boundary, kinematics, internal forces and stiffness."""

from collections.abc import Callable, Iterator
from typing import Any

import dolfinx.mesh
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial import cKDTree

from .. import core
from ._compat import FacetTable, FacetTags, ReferenceCell, cell_nodes, vector_space
from .conditions import Where

WHERE_WORDS = "it must be a function of positions x (3, n), x[0] all x coordinates, that returns n truth values, or facet tags"
ABSENT = -2                         # stands where no rank has a node
SAME_PLACE = 1e-8                   # over the body's size: a node as close as that to a position is there
ELEMENT_FAILURES = ("", "the mesh is inverted", "the increment rotates or strains a cell too much")     # by the core's status


class Body:
    """The nodes, cells and integration points of a mesh, and the element operations on them.

    Everything is of this rank. Arrays over cells and points hold the cells that the rank owns, points cell by cell; arrays over
    nodes hold the owned nodes first and the ghosts last. Elements of degree 1 take the volume change as the mean of the cell
    (B-bar); the nodes move with the material (updated Lagrangian), so that element operations take the present positions.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Cells of dimension 2 in the plane or 3 in space.
    degree : 1 or 2
        Of the displacements.
    facet_tags : dolfinx.mesh.MeshTags, optional
        What numbers mean where a part of the boundary is asked for.

    Attributes
    ----------
    comm : MPI communicator
    d : int
        Dimension, 2 or 3.
    space : dolfinx.fem.FunctionSpace
        Displacements.
    element : ReferenceCell
    cells : int
        How many this rank owns.
    cell_nodes : int array (cells, nodes per cell)
        Local node numbers.
    cell_nodes_with_ghosts : int array
        The same, followed by those of the ghost cells.
    owned_nodes : int
    global_numbers : int array (nodes)
        Numbers of the nodes among those of all ranks.
    positions : array (nodes, d)
        At the start.
    size : float
        Largest coordinate of a node over all ranks, the length that tolerances of positions refer to.
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh, degree: int, facet_tags: FacetTags | None = None) -> None:
        self.mesh, self.comm, self.d, self.degree = mesh, mesh.comm, mesh.geometry.dim, degree
        self._facet_tags = facet_tags
        self._mean_dilatation = int(degree == 1)
        self.space = vector_space(mesh, degree)
        self.element = ReferenceCell(mesh, degree)
        self.cells = mesh.topology.index_map(self.d).size_local
        self.cell_nodes_with_ghosts = cell_nodes(self.space)
        self.cell_nodes = self.cell_nodes_with_ghosts[:self.cells]
        self.owned_nodes = self.space.dofmap.index_map.size_local
        nodes = np.arange(self.owned_nodes + self.space.dofmap.index_map.num_ghosts, dtype=np.int32)
        self.global_numbers = np.asarray(self.space.dofmap.index_map.local_to_global(nodes), np.int64)
        self.positions = np.ascontiguousarray(self.space.tabulate_dof_coordinates()[:, :self.d])
        self.size = self.largest(self.positions)

    def largest(self, values: np.ndarray) -> float:
        """Largest absolute value of an array over all ranks, 0 if it is empty on all of them."""
        return self.comm.allreduce(np.abs(values).max(initial=0.0), MPI.MAX)

    # ---- parts of the boundary -------------------------------------------------------------------------------------

    def nodes_at(self, where: Where) -> np.ndarray:
        """Local numbers of this rank's nodes, ghosts included, on a part of the boundary; collective."""
        return np.asarray(fem.locate_dofs_topological(self.space, self.d - 1, self._facets_at(where)), np.int32)

    def owned_values_at(self, positions: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Of integers (nodes, ...) of the nodes those (n, ...) at positions (n, d) at the start, whichever rank owns these nodes.

        ABSENT where there is no node; collective.
        """
        by_rank = self.comm.allgather(positions)
        everywhere = np.concatenate(by_rank)
        found = np.full((len(everywhere), *values.shape[1:]), ABSENT, np.int64)
        if self.owned_nodes and len(everywhere):
            distance, nearest = cKDTree(self.positions[:self.owned_nodes]).query(everywhere)
            there = distance < SAME_PLACE * self.size
            found[there] = values[nearest[there]]
        self.comm.Allreduce(MPI.IN_PLACE, found, MPI.MAX)
        start = sum(len(part) for part in by_rank[:self.comm.rank])
        return found[start:start + len(positions)]

    def cell_facets_at(self, where: Where) -> np.ndarray:
        """Pairs (n, 2), int32, of an owned cell and its local facet on a part of the boundary."""
        topology = self.mesh.topology
        topology.create_connectivity(self.d - 1, self.d)
        topology.create_connectivity(self.d, self.d - 1)
        to_cell, to_facet = topology.connectivity(self.d - 1, self.d), topology.connectivity(self.d, self.d - 1)
        pairs = [(to_cell.links(facet)[0], facet) for facet in self._facets_at(where)]
        pairs = [(cell, np.flatnonzero(to_facet.links(cell) == facet)[0]) for cell, facet in pairs if cell < self.cells]
        return np.array(pairs, np.int32).reshape(-1, 2)

    def facet_groups(self, cell_facets: np.ndarray) -> Iterator[tuple[np.ndarray, FacetTable]]:
        """Groups pairs of cell_facets_at by local facet: cells (n), each once, and the table of that facet."""
        for local, table in enumerate(self.element.facets):
            cells = cell_facets[cell_facets[:, 1] == local, 0]
            if len(cells):
                yield cells, table

    def _facets_at(self, where: Where) -> np.ndarray:
        """Mesh facets on a part of the boundary."""
        self.mesh.topology.create_connectivity(self.d - 1, self.d)
        if callable(where):
            return dolfinx.mesh.locate_entities_boundary(self.mesh, self.d - 1, lambda x: _truth_values(where, x))
        if self._facet_tags is None:
            raise ValueError(f"a condition's where is {where!r}, but the problem was given no facet_tags")
        return np.unique(self._facet_tags.indices[np.isin(self._facet_tags.values, where)])

    # ---- elements --------------------------------------------------------------------------------------------------

    def at_cells(self, nodal: np.ndarray) -> np.ndarray:
        """Values (cells, nodes per cell, ...) of the cells' nodes from those (nodes, ...) of all nodes."""
        return nodal[self.cell_nodes]

    def point_positions(self, x: np.ndarray) -> np.ndarray:
        """Positions (points, d) of the integration points where the cells' nodes are at x (cells, nodes per cell, d)."""
        return np.einsum("qa,cai->cqi", self.element.values, x).reshape(-1, self.d)

    def kinematics(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacement gradient increments of the points as the material takes them.

        Parameters
        ----------
        x, u : array (cells, nodes per cell, d)
            Positions of the cells' nodes before the increment, and their displacements in it.

        Returns
        -------
        gradients : array (cells, points per cell, 3, 3)
        volumes : array (cells, points per cell)
            After the increment; areas in plane strain.
        status : int array (cells)
            0, or the position of the reason in ELEMENT_FAILURES.
        """
        return core.element_gradients(self._mean_dilatation, self.element.gradients, self.element.weights, x, u)

    def internal_forces(self, x: np.ndarray, volumes: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """Nodal forces (cells, nodes per cell, d) of stresses (cells, points per cell, 6) where the cells' nodes are at x."""
        return core.element_forces(self._mean_dilatation, self.element.gradients, x, volumes, stress)

    def internal_stiffness(self, x: np.ndarray, volumes: np.ndarray, gradients: np.ndarray, stress: np.ndarray,
                           tangent: np.ndarray, stiffness: np.ndarray) -> None:
        """Writes the derivatives of the internal forces by the increment's displacements into stiffness (cells, n, n).

        Parameters
        ----------
        x : array (cells, nodes per cell, d)
            Positions after the increment.
        volumes : array (cells, points per cell)
        gradients : array (cells, points per cell, 3, 3)
            Of the increment, by positions before it.
        stress : array (cells, points per cell, 6)
        tangent : array (cells, points per cell, 6, 9), or (cells, points per cell, 4, 4) in plane strain
            d stress / d (strain, spin) of the increment.
        stiffness : array (cells, n, n)
            n = nodes per cell times their unknowns, of which the first d are displacements; the others are left alone.
        """
        core.element_stiffness(self._mean_dilatation, self.element.gradients, x, volumes, gradients, stress, tangent, stiffness)

    def helmholtz(self, x: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Matrices of m - length^2 div grad m, for m of degree 1, and volumes.

        Parameters
        ----------
        x : array (cells, nodes per cell, d)
            Where the cells' nodes are.
        length : float

        Returns
        -------
        matrices : array (cells, vertices per cell, vertices per cell)
        volumes : array (cells, points per cell)
        """
        element = self.element
        return core.element_helmholtz(element.gradients, element.vertex_values, element.vertex_gradients, element.weights, x,
                                      length)

    def coupling(self, x: np.ndarray, volumes: np.ndarray, old_volumes: np.ndarray, gradients: np.ndarray, by_nonlocal: np.ndarray,
                 matrices: np.ndarray, scale: float, stiffness: np.ndarray) -> None:
        """Writes the derivatives that have to do with m into stiffness (cells, n, n), n = nodes per cell times d + 1.

        They are those of the internal forces by m, and `scale` times those of what the equations of m lack: matrices m less the
        integrals of abs(D) over old_volumes.

        Parameters
        ----------
        x, volumes, gradients
            As in internal_stiffness.
        old_volumes, matrices
            Of `helmholtz` at the start of the increment.
        by_nonlocal : array (cells, points per cell, 6), or (cells, points per cell, 4) in plane strain
            d stress / d m.
        scale : float
        """
        core.element_coupling(self._mean_dilatation, self.element.gradients, self.element.vertex_values, x, volumes, old_volumes,
                              gradients, by_nonlocal, matrices, scale, stiffness)


def _truth_values(where: Callable[[np.ndarray], Any], x: np.ndarray) -> np.ndarray:
    """What a `where` says of positions x (3, n); ValueError if it is no truth value for each."""
    try:
        found = np.asarray(where(x))
    except IndexError as error:
        raise ValueError(f"where cannot be evaluated, {error}: {WHERE_WORDS}") from None
    if found.dtype != bool or found.shape != x.shape[1:]:
        raise ValueError(f"where returns shape {found.shape} of dtype {found.dtype} for x of shape {x.shape}: {WHERE_WORDS}")
    return found
