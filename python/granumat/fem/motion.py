"""How a mesh moves: with the material, not at all, with the material's boundary, or as a function says; the state is convected."""

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc

from .body import Body
from .conditions import Periodic
from .convection import CELLS, SWEPT, Convection
from .errors import format_position
from .numbering import PRESCRIBED, Numbering
from .system import System

Motion = str | Callable[[np.ndarray, np.ndarray, float], np.ndarray]
KINDS = ("lagrangian", "fixed", "boundary")
MOST_SUBSTEPS = 10                  # of the convection of an increment: one that would need more is cut
SHARP = 0.1                         # a direction that a node's faces have this little of, over the most, is not normal to them
ALIGNED = 0.9                       # cosine of the angle between a wall's axis and the normal of its faces
THROUGH = 0.5                       # a face of a wall whose nodes all leave it by this part of the largest motion is passed
NOTICED = 1e-8                      # over the body's size: less is no motion through a wall


class MovingMesh:
    """A mesh that does not follow the material.

    Parameters
    ----------
    motion : str or function
        "fixed", "boundary", or a function of the nodes' positions (nodes, d), of where the material has taken them (nodes, d), and
        of the pseudo-time, that returns where they go (nodes, d).
    body : Body
    conditions : sequence
    numbering : Numbering
        Of the displacements.
    largest_fabric : float
        As in Convection.
    """

    def __init__(self, motion: Motion, body: Body, conditions: Sequence[object], numbering: Numbering,
                 largest_fabric: float) -> None:
        self._motion, self._body, self._numbering = motion, body, numbering
        self.convection = Convection(body, conditions, largest_fabric)
        self._boundary = _Boundary(body, conditions, numbering, self.convection) if motion == "boundary" else None

    def target(self, x: np.ndarray, material: np.ndarray, t: float) -> np.ndarray:
        """Where nodes at x (nodes, d), which the material has taken with it (nodes, d), go at pseudo-time t; collective.

        Raises
        ------
        ValueError
            The material would pass a wall, or a function returns another shape; the same on all ranks.
        """
        if self._motion == "fixed":
            new = x
        elif self._boundary is not None:
            new = self._boundary.follow(x, material)
        else:
            assert callable(self._motion)
            new = np.asarray(self._motion(x, material, t), float)
            if new.shape != x.shape:
                raise ValueError(f"motion returns shape {new.shape} for positions of shape {x.shape}: must be the same")
        self._check_walls(material, new)
        return new

    def fault(self, material: np.ndarray, new: np.ndarray) -> str:
        """Why the state cannot be convected from where the material has taken the nodes to where they go, or empty; collective."""
        swept = self.convection.swept(material, new)
        if swept <= MOST_SUBSTEPS * SWEPT:
            return ""
        return ("the mesh is inverted" if swept > 1 / NOTICED
                else f"the mesh would sweep {swept:.2g} of a cell, at most {MOST_SUBSTEPS * SWEPT:.2g} can be convected at once")

    def _check_walls(self, material: np.ndarray, new: np.ndarray) -> None:
        """ValueError where the material leaves the mesh through a wall; collective."""
        nodes = self.convection.boundary_nodes[~self.convection.boundary_is_open]
        vectors, size = (new - material)[nodes], NOTICED * self._body.size
        normal = abs(np.einsum("fai,fi->fa", vectors, _directions(new[nodes])))
        most = np.linalg.norm(vectors, axis=2).max(axis=1, initial=0.0)
        passed = normal.min(axis=1, initial=np.inf) > np.maximum(THROUGH * most, size)
        places = [format_position(new[nodes[face]].mean(axis=0)) for face in np.flatnonzero(passed)[:1]]
        places = [place for of_rank in self._body.comm.allgather(places) for place in of_rank]
        if places:
            raise ValueError(f"the material passes the boundary of the mesh at {places[0]}: " + (
                "it has come along a wall by the height of a cell, or folds" if self._boundary is not None else
                "give an Inflow or an Outflow there, or take motion = 'boundary', with which the mesh follows it"))


class _Boundary:
    """Nodes on the boundary follow the material's normal motion and stay tangentially; those inside follow by Laplace's equation.

    At an Inflow or Outflow the boundary stays.
    """

    def __init__(self, body: Body, conditions: Sequence[object], numbering: Numbering, convection: Convection) -> None:
        self._body, self._material, self._convection = body, numbering, convection
        d = body.d
        self._ties = Numbering(body, [condition for condition in conditions if isinstance(condition, Periodic)])
        self._shared = self._ties.labels[:, 0] // d               # one number for a node and its periodic partners
        self._sums = PETSc.Vec().create(comm=body.comm)
        self._sums.setSizes((body.owned_nodes * 2 * d * d, None))
        self._sums.setBlockSize(2 * d * d)
        self._sums.setType("standard")
        wanted = PETSc.IS().createBlock(2 * d * d, self._shared.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._at_nodes = PETSc.Vec().createSeq(len(self._shared) * 2 * d * d)
        self._to_nodes = PETSc.Scatter().create(self._sums, wanted, self._at_nodes, None)
        self._on_boundary = self._sum_of_normals(body.positions)[0].any(axis=(1, 2))

        labels = np.where(self._on_boundary[:, None], PRESCRIBED, self._ties.labels)
        self._system = System(body.comm, body.owned_nodes * d, d, labels[body.cell_nodes].reshape(body.cells, -1), labels, {})
        jacobians = np.einsum("qja,cai->cqji", body.element.gradients, body.at_cells(body.positions))
        slopes = np.linalg.solve(jacobians, body.element.gradients[None])
        laplacian = np.einsum("cq,q,cqia,cqib->cab", abs(np.linalg.det(jacobians)), body.element.weights, slopes, slopes,
                              optimize=True)
        self._system.cell_matrices[:] = np.einsum("cab,ij->caibj", laplacian, np.eye(d)).reshape(self._system.cell_matrices.shape)
        self._ties.rotate_stiffness(self._system.cell_matrices)
        self._system.assemble()

    def follow(self, x: np.ndarray, material: np.ndarray) -> np.ndarray:
        """Where nodes at x (nodes, d) go when the material has taken them with it (nodes, d)."""
        moved = self._on_boundary_motion(material - x, (x + material) / 2)
        if self._body.largest(moved) == 0:
            return x
        in_axes = self._ties.to_axes(moved)
        forces = np.einsum("crk,ck->cr", self._system.cell_matrices, self._body.at_cells(in_axes).reshape(self._body.cells, -1))
        solution = self._system.solve_again(-forces)
        assert solution is not None                              # the direct solver of a positive definite matrix
        return x + self._ties.from_axes(solution + np.where(self._on_boundary[:, None], in_axes, 0))

    def _on_boundary_motion(self, u: np.ndarray, middle: np.ndarray) -> np.ndarray:
        """Motion (nodes, d) of the nodes on the boundary, 0 inside, where the material moves by u, normals those in the middle."""
        every, closed = self._sum_of_normals(middle)
        share, directions = np.linalg.eigh(every)
        is_normal = share > SHARP * share[:, -1:]
        along = np.einsum("nij,nik,nk->nj", directions, closed, u)
        along = np.divide(along, share, out=np.zeros_like(along), where=is_normal)
        moved = np.einsum("nij,nj->ni", directions, along)
        d = self._body.d
        held = self._material.is_prescribed[:, :d]
        axis = np.einsum("nij,nj->ni", self._material.axes[:, :d, :d], held.astype(float))
        aligned = abs((axis * directions[..., -1]).sum(axis=1)) > ALIGNED
        slips = self._on_boundary & aligned & (is_normal.sum(axis=1) == 1) & (held.sum(axis=1) == 1)
        moved[slips] = (axis * (axis * u).sum(axis=1, keepdims=True))[slips]     # a wall has the normal that its condition says
        return moved

    def _sum_of_normals(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the faces at each node, their area times n n^T, summed (nodes, d, d): over all, and over those that are closed."""
        d, nodes = self._body.d, self._convection.boundary_nodes
        areas = _areas(x[nodes])
        size = np.linalg.norm(areas, axis=1)
        tensors = np.einsum("fi,fj,f->fij", areas, areas, 1 / np.maximum(size, np.finfo(float).tiny))
        both = np.stack([tensors, np.where(self._convection.boundary_is_open[:, None, None], 0, tensors)], axis=1)
        axes = self._ties.axes[nodes]
        both = np.einsum("faik,fsij,fajl->faskl", axes, both, axes, optimize=True)
        self._sums.set(0)
        self._sums.setValuesBlocked(self._shared[nodes].ravel().astype(PETSc.IntType), both.ravel(), addv=True)
        self._sums.assemble()
        self._to_nodes.scatter(self._sums, self._at_nodes)
        sums = self._at_nodes.array_r.reshape(-1, 2, d, d)
        every, closed = np.einsum("nik,nskl,njl->snij", self._ties.axes, sums, self._ties.axes, optimize=True)
        return every, closed


def _areas(x: np.ndarray) -> np.ndarray:
    """Area vectors (faces, d) of faces with their nodes at x (faces, nodes of a face, d)."""
    if x.shape[-1] == 2:
        return np.stack([x[:, 1, 1] - x[:, 0, 1], x[:, 0, 0] - x[:, 1, 0]], axis=1)
    return np.cross(x[:, 3] - x[:, 0], x[:, 2] - x[:, 1]) / 2


def _directions(x: np.ndarray) -> np.ndarray:
    """Unit normals (faces, d)."""
    areas = _areas(x)
    return areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), np.finfo(float).tiny)


def motion_faults(motion: object, cell: str, degree: object, has_openings: bool) -> list[str]:
    """What is wrong with a problem's motion on a mesh of these cells."""
    if not callable(motion) and motion not in KINDS:
        return [f"motion = {motion!r}: must be one of {', '.join(KINDS)}, or a function of (x, material, t)"]
    if motion == "lagrangian":
        return ["Inflow and Outflow are for a mesh that does not follow the material: take motion = 'fixed' or 'boundary'"
                ] if has_openings else []
    if cell not in CELLS or degree != 1:
        return [f"motion = {motion!r} on cells of the shape {cell}, degree {degree}: the state is convected on quadrilaterals and "
                "hexahedra of degree 1 only: take these, or motion = 'lagrangian'"]
    return []
