"""From nodal displacements to the unknowns that the conditions leave: local axes, prescribed values, ties, periodic sides."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from ..checks import refuse
from .body import Body
from .conditions import Displacement, Periodic, Tied
from .errors import format_position

PRESCRIBED = -1                     # the label of a component whose value is prescribed
ABSENT = -2                         # the label that stands where no rank has the partner of a periodic node
PARTNER_DISTANCE = 1e-8             # largest distance to a periodic partner, over the body's size
ORTHONORMALITY = 1e-9               # largest error of local axes, and difference of axes that must be the same


class Numbering:
    """Which equation every displacement component belongs to.

    Parameters
    ----------
    body : Body
    conditions : sequence
        Those of other types than Displacement, Tied and Periodic are left to Loads.

    Attributes
    ----------
    labels : int array (nodes, d)
        Number of the equation among those of all ranks, or PRESCRIBED, for a node's components along its axes.
    cell_labels : int array (cells, n)
        The same for the rows of the cells' matrices, n = nodes per cell times d.
    axes : array (nodes, d, d)
        Local axes of the nodes, in columns.
    is_prescribed : bool array (nodes, d)

    Raises
    ------
    ValueError
        Names every condition that does not fit the mesh or contradicts another one; the same on all ranks.
    """

    def __init__(self, body: Body, conditions: Sequence[object]) -> None:
        count, d = body.positions.shape
        self._body, self._comm = body, body.comm
        numbers = np.asarray(body.space.dofmap.index_map.local_to_global(np.arange(count, dtype=np.int32)), np.int64)
        self.labels = numbers[:, None] * d + np.arange(d)
        self.axes = np.tile(np.eye(d), (count, 1, 1))
        self._has_own_axes = np.zeros(count, bool)
        self._values: list[tuple[np.ndarray, list[int], Any]] = []             # nodes, components, value of the Displacements
        faults: list[str] = []

        placed = [(condition, self._place(condition, f"condition {number} ({type(condition).__name__})", faults))
                  for number, condition in enumerate(conditions) if isinstance(condition, (Displacement, Tied, Periodic))]
        self._label_tied([(condition, nodes) for condition, nodes in placed if isinstance(condition, Tied)])
        self._label_prescribed([(condition, nodes) for condition, nodes in placed if isinstance(condition, Displacement)])
        for condition, nodes in placed:
            if isinstance(condition, Tied) and self._comm.allreduce(
                    bool((self.labels[nodes, condition.component] == PRESCRIBED).any()), MPI.LOR):
                faults.append(f"Tied: component {condition.component} of its displacement is given at some of its nodes")
        for condition, nodes in placed:
            if isinstance(condition, Periodic):
                self._label_periodic(nodes, condition.partner(body.positions[nodes]), faults)
        refuse("the conditions do not fit the mesh", sorted(set().union(*self._comm.allgather(faults))))

        self.cell_labels = self.labels[body.cell_nodes].reshape(body.cells, -1)
        self.is_prescribed = self.labels == PRESCRIBED
        self._rotated_cells = np.flatnonzero(self._has_own_axes[body.cell_nodes].any(axis=1))

    def _place(self, condition: Displacement | Tied | Periodic, name: str, faults: list[str]) -> np.ndarray:
        """The nodes of a condition, which get its axes if it has some."""
        nodes = self._body.nodes_at(condition.where)
        if self._comm.allreduce(len(nodes)) == 0:
            faults.append(f"{name}: there is no node where it should hold")
        if condition.axes is not None:
            self._set_axes(nodes, condition.axes, name, faults)
        return nodes

    def _set_axes(self, nodes: np.ndarray, axes: Callable, name: str, faults: list[str]) -> None:
        frames = np.asarray(axes(self._body.positions[nodes]))
        if not np.allclose(frames.transpose(0, 2, 1) @ frames, np.eye(self._body.d), atol=ORTHONORMALITY):
            faults.append(f"{name}: its axes are not orthonormal")
        before = self._has_own_axes[nodes]
        if not np.allclose(self.axes[nodes][before], frames[before], atol=ORTHONORMALITY):
            faults.append(f"{name}: some nodes have other axes by another condition")
        self.axes[nodes], self._has_own_axes[nodes] = frames, True

    def _label_tied(self, ties: list[tuple[Tied, np.ndarray]]) -> None:
        """Each tie has one equation, the smallest of its nodes' over all ranks."""
        for tie, nodes in ties:
            smallest = self.labels[nodes, tie.component].min(initial=np.iinfo(np.int64).max)
            self.labels[nodes, tie.component] = self._comm.allreduce(smallest, MPI.MIN)

    def _label_prescribed(self, displacements: list[tuple[Displacement, np.ndarray]]) -> None:
        for displacement, nodes in displacements:
            components = list(range(self._body.d) if displacement.components is None else displacement.components)
            self.labels[nodes[:, None], components] = PRESCRIBED
            self._values.append((nodes, components, displacement.value))

    def _label_periodic(self, nodes: np.ndarray, partners: np.ndarray, faults: list[str]) -> None:
        """Gives nodes the labels of the nodes at the partners' positions (n, d), whichever rank owns these."""
        partners_by_rank = self._comm.allgather(partners)
        all_partners = np.concatenate(partners_by_rank)
        found = np.full((len(all_partners), self._body.d), ABSENT, np.int64)
        owned = self._body.owned_nodes
        if owned and len(all_partners):
            distance, nearest = cKDTree(self._body.positions[:owned]).query(all_partners)
            there = distance < PARTNER_DISTANCE * self._body.size
            found[there] = self.labels[nearest[there]]
        self._comm.Allreduce(MPI.IN_PLACE, found, MPI.MAX)
        start = sum(len(part) for part in partners_by_rank[:self._comm.rank])
        labels = found[start:start + len(nodes)]
        absent = (labels == ABSENT).any(axis=1)
        if absent.any():
            faults.append(f"Periodic: there is no node at {format_position(partners[absent][0])}, a partner's position")
        if ((self.labels[nodes] == PRESCRIBED) & (labels >= 0)).any():
            faults.append("Periodic: a displacement is given on the part, but not on its partner")
        self.labels[nodes] = labels

    def prescribed(self, t: float) -> np.ndarray:
        """Prescribed total displacements (nodes, d) along the nodes' axes at pseudo-time t, 0 where the component is free."""
        values = np.zeros(self._body.positions.shape)
        for nodes, components, value in self._values:
            x = self._body.positions[nodes]
            vectors = np.broadcast_to(value(x, t) if callable(value) else value, x.shape)
            values[nodes[:, None], components] = np.einsum("nij,ni->nj", self.axes[nodes], vectors)[:, components]
        return values

    def to_axes(self, vectors: np.ndarray) -> np.ndarray:
        """Components (nodes, d) along the nodes' axes of vectors (nodes, d) along x y (z)."""
        return np.einsum("nij,ni->nj", self.axes, vectors)

    def from_axes(self, vectors: np.ndarray) -> np.ndarray:
        """Components (nodes, d) along x y (z) of vectors (nodes, d) along the nodes' axes."""
        return np.einsum("nij,nj->ni", self.axes, vectors)

    def forces_to_axes(self, forces: np.ndarray) -> np.ndarray:
        """Cells' forces (cells, nodes per cell, d) along the nodes' axes, as the rows (cells, n) of the cells' matrices."""
        rotated = self._rotated_cells
        if len(rotated):
            forces = forces.copy()
            forces[rotated] = np.einsum("caij,cai->caj", self.axes[self._body.cell_nodes[rotated]], forces[rotated])
        return forces.reshape(self._body.cells, -1)

    def rotate_stiffness(self, stiffness: np.ndarray) -> None:
        """Replaces cells' matrices (cells, n, n) along x y (z) by those along the nodes' axes."""
        rotated = self._rotated_cells
        if len(rotated):
            axes = self.axes[self._body.cell_nodes[rotated]]
            blocks = stiffness[rotated].reshape(len(rotated), -1, self._body.d, axes.shape[1], self._body.d)
            blocks = np.einsum("caik,caibj,cbjl->cakbl", axes, blocks, axes, optimize=True)
            stiffness[rotated] = blocks.reshape(len(rotated), *stiffness.shape[1:])
