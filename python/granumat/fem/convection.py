"""Convection of what integration points have to where the points of another mesh, of the same cells, are."""

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI

from .. import core, tensors
from .body import ABSENT, Body
from .conditions import Inflow, Outflow, Periodic

CELLS = ("quadrilateral", "hexahedron")
SWEPT = 0.15                        # largest part of a cell's volume that a substep sweeps
TENSOR_COLUMNS = 18                 # stress, fabric, direction: the first numbers of a state
GAUSS = np.array([0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)])
LINEAR_AT_GAUSS = np.stack([1 - GAUSS, GAUSS], axis=1)             # an edge's two shape functions at its points


class Convection:
    """A discontinuous Galerkin step of second order, whose coefficients are what the integration points have.

    Cells are quadrilaterals or hexahedra of degree 1. Beyond the body's own cells there are copies of their neighbours: cells of
    other ranks, those beyond a periodic side, turned as it is, and cells that have what flows in. Elsewhere the body ends in a
    wall, or in an outflow, through which what a cell has leaves it.

    Parameters
    ----------
    body : Body
    conditions : sequence
        Of which those of type Periodic, Inflow and Outflow matter here.
    largest_fabric : float
        abs(A) never exceeds it, unless it has before.

    Attributes
    ----------
    boundary_nodes : int array (faces, nodes of a face)
        Nodes of the own cells' faces where the body ends.
    boundary_is_open : bool array (faces)
        Whether these belong to an Inflow or Outflow.
    """

    def __init__(self, body: Body, conditions: Sequence[object], largest_fabric: float) -> None:
        self._body, self._comm = body, body.comm
        self._fabric_limit = 2 * largest_fabric**2                 # of A : A
        self._point_at = body.element.values.argmax(axis=0)        # the point that is nearest to a node of its cell
        self._node_at = np.argsort(self._point_at)
        shape = body.cells, 2 * body.d
        self._neighbour, self._wall = np.zeros(shape, np.int32), np.ones(shape, np.int32)
        self._opposite = np.zeros((*shape, 2**body.d, 2), np.int32)
        self._connect(conditions)

    # ---- which cells are neighbours ----------------------------------------------------------------------------------

    def _connect(self, conditions: Sequence[object]) -> None:
        """Fills the tables of neighbours, and notes whose copies are needed."""
        body, d = self._body, self._body.d
        nodes = body.cell_nodes[:, face_nodes(d)].reshape(body.cells * 2 * d, -1)    # of all faces, cell by cell
        faces = body.global_numbers[nodes]
        _, inverse, count = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
        is_inside = (count == 2)[inverse.ravel()]
        inside = np.flatnonzero(is_inside)
        pairs = inside[np.argsort(inverse.ravel()[inside], kind="stable")].reshape(-1, 2)
        for here, there in (pairs.T, pairs[:, ::-1].T):
            self._join(here, faces[here], there // (2 * d), there % (2 * d), faces[there])
        self._join_copies(np.flatnonzero(~is_inside), nodes, faces, conditions)

    def _join(self, here: np.ndarray, numbers: np.ndarray, cells: np.ndarray, sides: np.ndarray, others: np.ndarray) -> None:
        """Notes the cells beyond faces, and which of their points lie opposite.

        Parameters
        ----------
        here : int array (n)
            Faces of own cells.
        numbers : int array (n, nodes of a face)
            Their nodes, as those beyond call them.
        cells, sides : int array (n)
            The cells beyond, own ones or copies, and their faces.
        others : int array (n, nodes of a face)
            The nodes of those faces, in another order.
        """
        d = self._body.d
        local = face_nodes(d)
        cell, side = np.divmod(here, 2 * d)
        self._neighbour[cell, side], self._wall[cell, side] = cells + 1, 0
        own = np.take_along_axis(local[side], np.argsort(numbers, axis=1), axis=1)
        near = np.take_along_axis(local[sides], np.argsort(others, axis=1), axis=1)
        far = near ^ (1 << sides // 2)[:, None]
        self._opposite[cell[:, None], side[:, None], own] = np.stack([near, far], axis=-1) + 1

    def _join_copies(self, single: np.ndarray, nodes: np.ndarray, faces: np.ndarray, conditions: Sequence[object]) -> None:
        """Joins faces that one own cell has to copies: of other ranks' cells, of cells beyond periodic sides, of what flows in."""
        body, comm, d = self._body, self._comm, self._body.d
        beyond, turns = faces[single].copy(), np.tile(np.eye(3), (len(single), 1, 1))
        shifts, is_periodic = np.zeros((len(single), 3)), np.zeros(len(single), bool)
        for condition in conditions:
            if isinstance(condition, Periodic):
                at = body.nodes_at(condition.where)
                partner = np.full(len(body.positions), ABSENT, np.int64)
                x = body.positions[at]
                partner[at] = body.owned_values_at(np.asarray(condition.partner(x), float), body.global_numbers)
                found = (partner[nodes[single]] != ABSENT).all(axis=1)
                beyond[found], is_periodic[found] = partner[nodes[single][found]], True
                x = body.positions[nodes[single][found, 0]]
                if condition.axes is not None:
                    turns[found, :d, :d] = condition.axes(x)
                partners = np.asarray(condition.partner(x), float)
                shifts[found, :d] = x - _applied(turns[found, :d, :d], partners)
        counts = comm.allgather(len(single))
        start = sum(counts[:comm.rank])
        owner = np.repeat(np.arange(comm.size), counts)
        numbers, mapped, turned, shifted, periodic, places = (
            np.concatenate(comm.allgather(part)) for part in (faces[single], beyond, turns, shifts, is_periodic, single))
        pairs = _pairs(numbers, mapped, periodic)
        mine = [(here, there) for here, there in pairs if owner[here] == comm.rank]
        self._sent = [[places[here] // (2 * d) for here, there in sorted(pairs, key=lambda pair: pair[1])
                       if owner[here] == comm.rank and owner[there] == rank] for rank in range(comm.size)]
        mine.sort(key=lambda pair: (owner[pair[1]], pair[0]))
        here, there = np.array(mine, np.int64).reshape(-1, 2).T
        self._received = np.bincount(owner[there], minlength=comm.size)
        copies = body.cells + np.arange(len(here))
        backward = periodic[there] & ~periodic[here]
        seen = np.where(periodic[here][:, None], mapped[here], numbers[here])
        others = np.where(backward[:, None], mapped[there], numbers[there])
        self._join(single[here - start], seen, copies, places[there] % (2 * d), others)
        self._turns = np.where(backward[:, None, None], turned[there].transpose(0, 2, 1), turned[here])
        self._is_turned = (self._turns != np.eye(3)).any(axis=(1, 2))
        self._shifts = np.where(backward[:, None], -_applied(self._turns, shifted[there]), shifted[here])

        self._inflows: list[tuple[Inflow, np.ndarray, np.ndarray, np.ndarray]] = []      # with copies, faces, and nodes of these
        alone = np.setdiff1d(np.arange(len(single)), here - start)
        next_copy = body.cells + len(copies)
        for condition in conditions:
            if isinstance(condition, (Inflow, Outflow)):
                at = np.isin(nodes[single[alone]], body.nodes_at(condition.where)).all(axis=1)
                found = single[alone[at]]
                cell, side = np.divmod(found, 2 * d)
                self._wall[cell, side] = 0
                if isinstance(condition, Inflow):
                    entries = next_copy + np.arange(len(found))
                    next_copy += len(found)
                    self._join(found, faces[found], entries, side, faces[found])
                    self._inflows.append((condition, entries, side, nodes[found]))
        self._all_cells = next_copy
        self.boundary_nodes = nodes[single[alone]]
        self.boundary_is_open = self._wall[np.divmod(single[alone], 2 * d)] == 0

    # ---- the step ------------------------------------------------------------------------------------------------------

    def swept(self, start: np.ndarray, end: np.ndarray) -> float:
        """The largest part of a cell's volume that is swept between positions (nodes, d) of the nodes; collective.

        A number without bounds where a cell is inverted.
        """
        return self._swept_of(self._body.at_cells(start), self._body.at_cells(end))

    def _swept_of(self, start: np.ndarray, end: np.ndarray) -> float:
        """The same between positions (cells, nodes per cell, d) of the cells' nodes."""
        return self._comm.allreduce(core.swept_volumes(start, end).max(initial=0.0), MPI.MAX)

    def convect(self, values: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """What the points have once the nodes have gone from start to end while the material stayed; collective.

        Parameters
        ----------
        values : array (points, columns)
            The 20 numbers of a state, then up to four scalars.
        start, end : array (nodes, d)

        Returns
        -------
        array (points, columns)
        """
        return self._convected(values, self._entering(start), self._turn_tensors, start, end)

    def convect_positions(self, positions: np.ndarray, volume_fraction: np.ndarray, start: np.ndarray,
                          end: np.ndarray) -> np.ndarray:
        """As convect, of positions that the material has had; what flows in has that of the inflow, where it has passed it.

        Beyond periodic sides the positions are those beyond. Where there is a stress of a state there is a position here, so that
        the limiter takes it as a whole, in any axes alike.

        Parameters
        ----------
        positions : array (points, d)
        volume_fraction : array (points)
            Before.
        start, end : array (nodes, d)

        Returns
        -------
        array (points, d)
        """
        entering = [_with_positions(at, states["volume_fraction"])
                    for at, states in zip(self._inflow_points(end), self._entering(start))]
        values = core.numbers(_with_positions(positions, volume_fraction))
        return self._convected(values, entering, self._move_positions, start, end)[:, :self._body.d].copy()

    def _convected(self, values: np.ndarray, entering: Sequence[np.ndarray], cross: Callable[[np.ndarray], None],
                   start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """What the points have of values (points, columns), as convect.

        Parameters
        ----------
        values : array (points, columns)
        entering : sequence of arrays (faces, points) of dtype STATE
            What flows in at each inflow.
        cross : function of values (copies, points, columns)
            Makes of what cells have what their copies have.
        start, end : array (nodes, d)
        """
        cells, points = self._body.cells, 2**self._body.d
        here, first, second = np.zeros((3, self._all_cells, points, core.CONVECTED_NUMBERS))    # before a substep, its stages
        here[:cells, :, :values.shape[1]] = values.reshape(cells, points, -1)[:, self._point_at]
        ranges = np.empty((cells, core.CONVECTION_RANGES))
        for stage in (here, first, second):
            self._fill_inflows(stage, entering)
        at_start, at_end = self._body.at_cells(start), self._body.at_cells(end)
        steps = max(1, int(np.ceil(self._swept_of(at_start, at_end) / SWEPT)))
        for step in range(steps):
            x, x_new = (at_start + part / steps * (at_end - at_start) for part in (step, step + 1))
            self._fill_copies(here, cross)
            core.convection_ranges(x, self._neighbour, here, ranges)
            given = x, x_new, self._neighbour, self._opposite, self._wall, ranges, here
            core.convection_stage(0.0, self._fabric_limit, *given, here, first[:cells])
            self._fill_copies(first, cross)
            core.convection_stage(0.5, self._fabric_limit, *given, first, second[:cells])
            here, second = second, here
        return here[:cells, self._node_at, :values.shape[1]].reshape(values.shape)

    def _inflow_points(self, x: np.ndarray) -> list[np.ndarray]:
        """Positions (faces, points, d) of the points of each inflow's faces, the nodes at x."""
        to_points = np.eye(1)
        for _ in range(self._body.d - 1):
            to_points = np.kron(to_points, LINEAR_AT_GAUSS)
        return [to_points @ x[nodes] for *_, nodes in self._inflows]

    def _entering(self, x: np.ndarray) -> list[np.ndarray]:
        """States (faces, points) that flow in at these points."""
        entering = []
        for (inflow, *_), at in zip(self._inflows, self._inflow_points(x)):
            states = inflow.state(at.reshape(-1, self._body.d)) if callable(inflow.state) else np.full(at.shape[:2], inflow.state)
            entering.append(np.ascontiguousarray(states).reshape(at.shape[:2]))
        return entering

    def _fill_inflows(self, values: np.ndarray, entering: Sequence[np.ndarray]) -> None:
        """Gives the copies beyond inflows the states (faces, points) that flow in at the points of their faces."""
        for (_, copies, sides, _), states in zip(self._inflows, entering):
            numbers = core.numbers(states).reshape(*states.shape, core.STATE_NUMBERS)
            near = face_nodes(self._body.d)[sides]
            for place in (near, near ^ (1 << sides // 2)[:, None]):
                values[copies[:, None], place, :core.STATE_NUMBERS] = numbers

    def _fill_copies(self, values: np.ndarray, cross: Callable[[np.ndarray], None]) -> None:
        """Gives the copies what the cells have that they are copies of, as it is across periodic sides."""
        cells, row = self._body.cells, values[0].size
        count = int(self._received.sum())
        sent = np.ascontiguousarray(values[np.concatenate(self._sent).astype(int)])
        received = np.empty((count, *values.shape[1:]))
        self._comm.Alltoallv([sent, [len(part) * row for part in self._sent]], [received, (self._received * row).tolist()])
        cross(received)
        values[cells:cells + count] = received

    def _turn_tensors(self, received: np.ndarray) -> None:
        """Turns tensors of the copies (copies, points, columns) as the periodic sides are."""
        turned = self._is_turned
        if turned.any():
            turns, some = self._turns[turned][:, None, None], received[turned]
            shape = some[..., :TENSOR_COLUMNS].shape
            matrices = tensors.to_matrix(some[..., :TENSOR_COLUMNS].reshape(*shape[:2], -1, 6))
            some[..., :TENSOR_COLUMNS] = tensors.to_voigt(turns @ matrices @ np.swapaxes(turns, -1, -2)).reshape(shape)
            received[turned] = some

    def _move_positions(self, received: np.ndarray) -> None:
        """Turns and shifts positions of the copies (copies, points, columns) as the periodic sides are."""
        received[..., :3] = _applied(self._turns[:, None], received[..., :3]) + self._shifts[:, None]


def face_nodes(d: int) -> np.ndarray:
    """Local nodes (2 d, 2^(d - 1)) of the faces of a quadrilateral or hexahedron: face 2 k + s is where coordinate k is s."""
    nodes = np.arange(2**d)
    return np.array([nodes[nodes >> k & 1 == s] for k in range(d) for s in (0, 1)])


def _with_positions(positions: np.ndarray, volume_fraction: np.ndarray) -> np.ndarray:
    """States (...) that have positions (..., d) where others have the first components of their stresses."""
    states = np.zeros(volume_fraction.shape, core.STATE)
    states["volume_fraction"], states["stress"][..., :positions.shape[-1]] = volume_fraction, positions
    return states


def _applied(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., n), turned by matrices (..., n, n)."""
    return (turns @ vectors[..., None])[..., 0]


def _pairs(numbers: np.ndarray, mapped: np.ndarray, periodic: np.ndarray) -> list[tuple[int, int]]:
    """Which of the faces (n, nodes) of all ranks lie opposite each other, both ways.

    `mapped` are their nodes as the faces beyond call them.
    """
    by_nodes: dict[tuple[int, ...], list[int]] = {}
    for face, own in enumerate(np.sort(numbers, axis=1).tolist()):
        by_nodes.setdefault(tuple(own), []).append(face)
    pairs = []
    for face, beyond in enumerate(np.sort(mapped, axis=1).tolist()):
        for other in by_nodes.get(tuple(beyond), ()):
            if other != face:
                pairs.append((face, other))
                if periodic[face]:
                    pairs.append((other, face))
    return sorted(set(pairs))
