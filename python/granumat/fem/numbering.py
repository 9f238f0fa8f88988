"""From nodal displacements to the unknowns that the conditions leave: local axes, given values, ties, periodic sides."""

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from ..checks import refuse
from .conditions import Displacement, Periodic, Tied
from .errors import in_words

GIVEN = -1                         # the label of a component whose value is prescribed
NEAR = 1e-8                        # distance to a periodic partner, relative to the size of the body


class Numbering:
    """Which equation every displacement component belongs to.

    Attributes
    ----------
    labels : int array (nodes, d)
        Number of the equation among those of all ranks, or GIVEN; of a node's components along its axes.
    axes : array (nodes, d, d)
        Local axes of the nodes, in columns.
    turned : bool array (nodes)
        Where the axes are not x y (z).
    """

    def __init__(self, space, positions, size, locate, conditions):
        comm = space.mesh.comm
        index_map = space.dofmap.index_map
        count, d = positions.shape
        local = np.arange(count, dtype=np.int32)
        self.nodes = np.asarray(index_map.local_to_global(local), np.int64)
        self.labels = self.nodes[:, None] * d + np.arange(d)
        self.axes = np.tile(np.eye(d), (count, 1, 1))
        self.turned = np.zeros(count, bool)
        self._given = []
        self._positions = positions
        faults = []
        periodic = [condition for condition in conditions if isinstance(condition, Periodic)]
        for number, condition in enumerate(conditions):
            if not isinstance(condition, (Displacement, Tied, Periodic)):
                continue
            nodes = locate(condition.where)
            if comm.allreduce(len(nodes)) == 0:
                faults.append(f"condition {number} ({type(condition).__name__}): there is no node where it should hold")
            if condition.axes is not None:
                self._turn(nodes, condition.axes, f"condition {number} ({type(condition).__name__})", faults)
        for condition in conditions:
            if isinstance(condition, Tied):
                nodes = locate(condition.where)
                least = self.labels[nodes, condition.component].min(initial=np.iinfo(np.int64).max)
                self.labels[nodes, condition.component] = comm.allreduce(least, MPI.MIN)
        for condition in conditions:
            if isinstance(condition, Displacement):
                nodes = locate(condition.where)
                components = list(range(d) if condition.components is None else condition.components)
                self.labels[nodes[:, None], components] = GIVEN
                self._given.append((nodes, components, condition.value))
        for condition in conditions:
            if isinstance(condition, Tied) and comm.allreduce(
                    bool((self.labels[locate(condition.where), condition.component] == GIVEN).any()), MPI.LOR):
                faults.append(f"Tied: component {condition.component} of its displacement is given at some of its nodes")
        for condition in periodic:
            nodes = locate(condition.where)
            self._follow(comm, nodes, condition.partner(positions[nodes]), index_map.size_local, NEAR * size, faults)
        faults = sorted(set().union(*comm.allgather(faults)))
        refuse("the conditions do not fit the mesh", faults)

    def _turn(self, nodes, axes, name, faults):
        frames = np.asarray(axes(self._positions[nodes]))
        if not np.allclose(frames.transpose(0, 2, 1) @ frames, np.eye(self.axes.shape[1]), atol=1e-9):
            faults.append(f"{name}: its axes are not orthonormal")
        before = self.turned[nodes]
        if not np.allclose(self.axes[nodes][before], frames[before], atol=1e-9):
            faults.append(f"{name}: some nodes have other axes by another condition")
        self.axes[nodes], self.turned[nodes] = frames, True

    def _follow(self, comm, nodes, wanted, owned, near, faults):
        """The labels of the nodes at the wanted positions, wherever they are owned, become those of the nodes."""
        everywhere = comm.allgather(wanted)
        everything = np.concatenate(everywhere)
        found = np.full((len(everything), self.labels.shape[1]), -2, np.int64)
        if owned and len(everything):
            distance, partner = cKDTree(self._positions[:owned]).query(everything)
            there = distance < near
            found[there] = self.labels[partner[there]]
        comm.Allreduce(MPI.IN_PLACE, found, MPI.MAX)
        start = sum(len(part) for part in everywhere[:comm.rank])
        mine = found[start:start + len(nodes)]
        if (mine == -2).any():
            missing = wanted[(mine == -2).any(axis=1)][0]
            faults.append(f"Periodic: there is no node at {in_words(missing)}, a partner's position")
        if ((self.labels[nodes] == GIVEN) & (mine >= 0)).any():
            faults.append("Periodic: a displacement is given on the part, but not on its partner")
        self.labels[nodes] = mine

    def given(self, t):
        """Prescribed total displacements (nodes, d) along the nodes' axes at t, 0 where free."""
        values = np.zeros(self._positions.shape)
        for nodes, components, value in self._given:
            x = self._positions[nodes]
            vectors = np.broadcast_to(value(x, t) if callable(value) else value, x.shape)
            local = np.einsum("nij,ni->nj", self.axes[nodes], vectors)
            values[nodes[:, None], components] = local[:, components]
        return values

    def to_axes(self, vectors):
        """Vectors (nodes, d) along the nodes' axes."""
        return np.einsum("nij,ni->nj", self.axes, vectors)

    def from_axes(self, vectors):
        """Vectors (nodes, d) along x y (z)."""
        return np.einsum("nij,nj->ni", self.axes, vectors)
