"""From nodal displacements to the unknowns that the conditions leave: local axes, prescribed values, ties, periodic sides."""

from collections import ChainMap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from ..checks import attempt, real_array, refuse
from .body import ABSENT, Body
from .cellwise import together
from .conditions import Displacement, NonlocalStrain, Periodic, Tied
from .errors import format_position

PRESCRIBED = -1                     # the label of a component whose value is prescribed
MOTIONS = {2: ("translation along x", "translation along y", "rotation"),
           3: (*(f"translation along {axis}" for axis in "xyz"), *(f"rotation about {axis}" for axis in "xyz"))}
FREE = 1e-12                        # over the largest: what hinders a motion less than this is round-off
SHARE = 0.3                         # of a motion in a free combination of motions that makes it worth naming; one has 1/sqrt(6)
ORTHONORMALITY = 1e-9               # largest error of local axes, and difference of axes that must be the same


class Numbering:
    """Which equation every unknown of a node belongs to: a displacement component, or with a length the nonlocal strain m.

    Parameters
    ----------
    body : Body
    conditions : sequence
        Of those of other types than Displacement, Tied, Periodic and NonlocalStrain, which are left to Loads, only the place is
        checked.
    has_length : bool
        Whether there is an unknown m beside the d displacement components, the last one of a node. It has an axis of its own, and
        periodic nodes share it.

    Attributes
    ----------
    labels : int array (nodes, unknowns)
        Number of the equation among those of all ranks, or PRESCRIBED, for a node's components along its axes; there are d unknowns
        a node, or with a length d + 1.
    cell_labels : int array (cells, n)
        The same for the rows of the cells' matrices, n = nodes per cell times unknowns.
    axes : array (nodes, unknowns, unknowns)
        Local axes of the nodes, in columns.
    is_prescribed : bool array (nodes, unknowns)

    Raises
    ------
    ValueError
        Names every condition that does not fit the mesh or contradicts another one; the same on all ranks.
    """

    def __init__(self, body: Body, conditions: Sequence[object], has_length: bool = False) -> None:
        count, unknowns = len(body.positions), body.d + has_length
        self._body, self._comm = body, body.comm
        self.labels = body.global_numbers[:, None] * unknowns + np.arange(unknowns)
        self._own_labels = self.labels.copy()
        self.axes = np.tile(np.eye(unknowns), (count, 1, 1))
        self._has_own_axes = np.zeros(count, bool)
        self._values: list[tuple[np.ndarray, list[int], Displacement]] = []    # with their nodes and components
        self._nonlocal_values: list[tuple[np.ndarray, NonlocalStrain]] = []
        self._placed_axes: list[tuple[np.ndarray, Callable]] = []              # of places, which a moving mesh has elsewhere
        faults: list[str] = []

        placed = [(condition, self._place(condition, f"condition {number} ({type(condition).__name__})", faults))
                  for number, condition in enumerate(conditions)]
        self._label_tied([(condition, nodes) for condition, nodes in placed if isinstance(condition, Tied)])
        self._label_prescribed([(condition, nodes) for condition, nodes in placed if isinstance(condition, Displacement)])
        for condition, nodes in placed:
            if isinstance(condition, NonlocalStrain):
                self.labels[nodes, -1] = PRESCRIBED
                self._nonlocal_values.append((nodes, condition))
        for condition, nodes in placed:
            if isinstance(condition, Tied) and self._comm.allreduce(
                    bool((self.labels[nodes, condition.component] == PRESCRIBED).any()), MPI.LOR):
                faults.append(f"Tied: component {condition.component} of its displacement is given at some of its nodes")
        for condition, nodes in placed:
            if isinstance(condition, Periodic):
                self._label_periodic(nodes, self._partners(condition, nodes), faults)
        refuse("the conditions do not fit the mesh", sorted(set().union(*self._comm.allgather(faults))))

        self.cell_labels = self.labels[body.cell_nodes].reshape(body.cells, -1)
        self.is_prescribed = self.labels == PRESCRIBED
        self._rotated_cells = np.flatnonzero(self._has_own_axes[body.cell_nodes].any(axis=1))

    def _place(self, condition: Any, name: str, faults: list[str]) -> np.ndarray:
        """The nodes of a condition, which get its axes if it has some."""
        nodes = attempt(faults, f"{name}: ", self._body.nodes_at, condition.where)
        if nodes is None:
            return np.empty(0, np.int32)
        if self._comm.allreduce(len(nodes)) == 0:
            faults.append(f"{name}: there is no node where it should hold")
        if getattr(condition, "axes", None) is not None:
            self._set_axes(nodes, condition.axes, name, faults)
            if not isinstance(condition, Periodic):              # whose axes are those of one side in the other's
                self._placed_axes.append((nodes, condition.axes))
        return nodes

    def _set_axes(self, nodes: np.ndarray, axes: Callable, name: str, faults: list[str]) -> None:
        frames, d = np.asarray(axes(self._body.positions[nodes])), self._body.d
        if frames.shape != (len(nodes), d, d):
            faults.append(f"{name}: its axes are of shape {frames.shape} for {len(nodes)} nodes: must be {(len(nodes), d, d)}")
            return
        if not np.allclose(frames.transpose(0, 2, 1) @ frames, np.eye(d), atol=ORTHONORMALITY):
            faults.append(f"{name}: its axes are not orthonormal")
        before = self._has_own_axes[nodes]
        if not np.allclose(self.axes[nodes, :d, :d][before], frames[before], atol=ORTHONORMALITY):
            faults.append(f"{name}: some nodes have other axes by another condition")
        self.axes[nodes, :d, :d], self._has_own_axes[nodes] = frames, True

    def _label_tied(self, ties: list[tuple[Tied, np.ndarray]]) -> None:
        """Each tie has one equation, the smallest of its nodes' over all ranks."""
        for tie, nodes in ties:
            smallest = self.labels[nodes, tie.component].min(initial=np.iinfo(np.int64).max)
            self.labels[nodes, tie.component] = self._comm.allreduce(smallest, MPI.MIN)

    def _label_prescribed(self, displacements: list[tuple[Displacement, np.ndarray]]) -> None:
        for displacement, nodes in displacements:
            components = list(range(self._body.d) if displacement.components is None else displacement.components)
            self.labels[nodes[:, None], components] = PRESCRIBED
            self._values.append((nodes, components, displacement))

    def _partners(self, condition: Periodic, nodes: np.ndarray) -> np.ndarray:
        """Positions (n, d) of the partners of nodes."""
        x = self._body.positions[nodes]
        partners = np.asarray(condition.partner(x), float)
        if partners.shape != x.shape:
            raise ValueError(f"a Periodic condition's partner returns shape {partners.shape} for x of shape {x.shape}: must be the "
                             "same")
        return partners

    def _label_periodic(self, nodes: np.ndarray, partners: np.ndarray, faults: list[str]) -> None:
        """Gives nodes the labels of the nodes at the partners' positions (n, d), whichever rank owns these."""
        labels = self._body.owned_values_at(partners, self.labels)
        absent = (labels == ABSENT).any(axis=1)
        if absent.any():
            faults.append(f"Periodic: there is no node at {format_position(partners[absent][0])}, a partner's position")
        if ((self.labels[nodes] == PRESCRIBED) & (labels >= 0)).any():
            faults.append("Periodic: a displacement is given on the part, but not on its partner")
        self.labels[nodes] = labels

    def prescribed(self, t: float, duration: float = 0.0) -> np.ndarray:
        """Prescribed total displacements (nodes, unknowns) along the nodes' axes at pseudo-time t, 0 where the component is free.

        The last unknown is m of an increment of this duration that ends at t, if there is a length.

        Raises
        ------
        ValueError
            They are not finite, or not of the right shape, on one of the ranks; the same on all of them.
        """
        def values() -> np.ndarray:
            values, d = np.zeros(self.labels.shape), self._body.d
            for nodes, components, displacement in self._values:
                vectors = _vectors(displacement.value, self._body.positions[nodes], t)
                values[nodes[:, None], components] = np.einsum("nij,ni->nj", self.axes[nodes, :d, :d], vectors)[:, components]
            for nodes, condition in self._nonlocal_values:
                values[nodes, -1] = duration * _rate(condition.value, t)
            return values
        return together(self._comm, values)

    def prescribed_motion(self, start: float, t: float, x: np.ndarray) -> np.ndarray:
        """Prescribed motions (nodes, unknowns) along the nodes' axes, between two pseudo-times, of the material at x (nodes, d).

        It is what a value grows by at this place; a value that has a method `motion` of (x, start, t) says it itself.

        Raises
        ------
        ValueError
            As `prescribed`.
        """
        def values() -> np.ndarray:
            values, d = np.zeros(self.labels.shape), self._body.d
            for nodes, components, displacement in self._values:
                value = displacement.value
                if hasattr(value, "motion"):
                    vectors = _vectors(value.motion(x[nodes], start, t), x[nodes], t)
                else:
                    vectors = _vectors(value, x[nodes], t) - (_vectors(value, x[nodes], start) if start > 0 else 0)
                values[nodes[:, None], components] = np.einsum("nij,ni->nj", self.axes[nodes, :d, :d], vectors)[:, components]
            for nodes, condition in self._nonlocal_values:
                values[nodes, -1] = (t - start) * _rate(condition.value, t)
            return values
        return together(self._comm, values)

    @property
    def has_placed_axes(self) -> np.ndarray:
        """Which nodes (nodes) have axes of the place where they are, bool."""
        has = np.zeros(len(self.axes), bool)
        for nodes, _ in self._placed_axes:
            has[nodes] = True
        return has

    def move_axes(self, x: np.ndarray) -> None:
        """Gives nodes that are at x (nodes, d) now the axes of that place."""
        for nodes, axes in self._placed_axes:
            self.axes[nodes, :self._body.d, :self._body.d] = axes(x[nodes])

    def free_motions(self) -> list[str]:
        """Rigid motions, in words, that neither prescribed displacements, ties nor periodic sides hinder; collective."""
        d = self._body.d
        motions = np.einsum("nij,nim->njm", self.axes[:, :d, :d], _rigid_motions(self._body.positions / self._body.size))
        labels, own_labels = self.labels[:, :d], self._own_labels[:, :d]
        tied = labels != own_labels                              # prescribed, or with the equation of another component
        wanted = set().union(*self._comm.allgather(set(labels[tied].tolist())))
        owned = own_labels[:self._body.owned_nodes]
        sought = np.isin(owned, list(wanted))
        mine = dict(zip(owned[sought].tolist(), motions[:self._body.owned_nodes][sought]))
        by_label = dict(ChainMap({PRESCRIBED: np.zeros(motions.shape[2])}, *self._comm.allgather(mine)))
        same = np.array([by_label[label] for label in labels[tied].tolist()])
        differences = motions[tied] - same.reshape(-1, motions.shape[2])
        hindrance, combinations = np.linalg.eigh(self._comm.allreduce(differences.T @ differences))
        free = combinations[:, hindrance <= FREE * max(1.0, hindrance[-1])]
        return [name for name, shares in zip(MOTIONS[self._body.d], free) if np.linalg.norm(shares) > SHARE]

    def to_axes(self, vectors: np.ndarray) -> np.ndarray:
        """Components (nodes, unknowns) along the nodes' axes of vectors (nodes, unknowns) along x y (z)."""
        return np.einsum("nij,ni->nj", self.axes, vectors)

    def from_axes(self, vectors: np.ndarray) -> np.ndarray:
        """Components (nodes, unknowns) along x y (z) of vectors (nodes, unknowns) along the nodes' axes."""
        return np.einsum("nij,nj->ni", self.axes, vectors)

    def forces_to_axes(self, forces: np.ndarray) -> np.ndarray:
        """Cells' forces (cells, nodes per cell, unknowns) along the nodes' axes, as the rows (cells, n) of the cells' matrices."""
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
            unknowns = self.labels.shape[1]
            blocks = stiffness[rotated].reshape(len(rotated), -1, unknowns, axes.shape[1], unknowns)
            blocks = np.einsum("caik,caibj,cbjl->cakbl", axes, blocks, axes, optimize=True)
            stiffness[rotated] = blocks.reshape(len(rotated), *stiffness.shape[1:])


def _rigid_motions(x: np.ndarray) -> np.ndarray:
    """Displacements (nodes, d, m) of nodes at x (nodes, d) in the small motions MOTIONS of a rigid body."""
    count, d = x.shape
    motions = np.zeros((count, d, len(MOTIONS[d])))
    motions[:, range(d), range(d)] = 1
    for number, (i, j) in enumerate([(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)], d):
        motions[:, i, number], motions[:, j, number] = -x[:, j], x[:, i]
    return motions


def _rate(value: Any, t: float) -> float:
    """The m per unit of pseudo-time that a value of NonlocalStrain gives; ValueError where it is none."""
    rate = real_array("a NonlocalStrain's value", value(t) if callable(value) else value)
    if rate.shape != () or not 0 <= rate < np.inf:
        raise ValueError(f"a NonlocalStrain's value at t = {t:g} is {rate.tolist()}: must be a finite number, at least 0")
    return float(rate)


def _vectors(value: Any, x: np.ndarray, t: float) -> np.ndarray:
    """The displacements (n, d) that a value of Displacement gives nodes at x (n, d); ValueError where they are none."""
    vectors = real_array("a Displacement's value", value(x, t) if callable(value) else value)
    try:
        vectors = np.broadcast_to(vectors, x.shape)
    except ValueError:
        raise ValueError(f"a Displacement's value is of shape {vectors.shape} for x of shape {x.shape}: must be the same, or one "
                         "vector or number for all") from None
    finite = np.isfinite(vectors).all(axis=1)
    if not finite.all():
        raise ValueError(f"a Displacement's value is not finite at t = {t:g} at {format_position(x[~finite][0])}")
    return vectors
