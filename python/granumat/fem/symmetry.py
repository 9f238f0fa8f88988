"""Bodies of which a part is modelled, because a symmetry makes the rest like it, and what the whole body's results are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .. import tensors
from .conditions import Where
from .problem import Problem

SAME_PLACE = 1e-9                   # round-off of the number of copies
TENSORS = ("stress", "fabric", "direction")     # of a state


class Place(NamedTuple):
    """Where a position of the whole body is beside a copy of the modelled part, which need not be the copy that it is in.

    Attributes
    ----------
    position : array (d)
        In the part, or outside it, if the copy is moved to the part.
    copy : int
        How many times the part's angle or width the copy is away from the part.
    level : float
        Along the axis without strain; 0 if there is none.
    """

    position: np.ndarray
    copy: int
    level: float


@dataclass(frozen=True)
class Symmetry:
    """What part of a body is modelled, and how the whole body's results follow; without arguments the part is the body.

    Attributes
    ----------
    sectors : int
        Equal sectors of a ring about the z axis, of which the first, which begins at the x axis, is modelled.
    widths : (float, float), optional
        Along x, of the part that is modelled, which begins at 0, and of the body.
    across : 1 or 2, optional
        The axis of the body along which there is no strain. The part is in plane strain, with the two other axes in their order.
    thickness : float
        Of the body along that axis, from 0.
    """

    sectors: int = 1
    widths: tuple[float, float] | None = None
    across: int | None = None
    thickness: float = 1.0

    def dimension(self, d: int) -> int:
        """Dimension of the whole body if the part has d."""
        return d if self.across is None else 3

    # ---- positions and states --------------------------------------------------------------------------------------

    def places(self, position: Sequence[float]) -> list[Place]:
        """Where a position of the whole body is beside the copies of the part that can have the nearest point to it."""
        x, copies = np.array(position, float), {0}
        if self.sectors > 1:
            copy = int(np.arctan2(x[1], x[0]) // self._angle)
            copies = {near % self.sectors for near in (copy - 1, copy, copy + 1)}
        elif self.widths is not None:
            part, whole = self.widths
            copy = int(x[0] // part)
            copies = {near for near in (copy - 1, copy, copy + 1) if 0 <= near < whole / part * (1 - SAME_PLACE)} or {0}
        return [self._place(x, copy) for copy in sorted(copies)]

    def _place(self, x: np.ndarray, copy: int) -> Place:
        level = 0.0
        if self.sectors > 1:
            x = self._rotation(-copy)[:len(x), :len(x)] @ x
        elif self.widths is not None:
            x = x - copy * self.widths[0] * np.eye(len(x))[0]
        if self.across is not None:
            level = float(x[self.across])
            x = np.delete(x, self.across)
        return Place(x, copy, level)

    def position(self, x: np.ndarray, place: Place) -> np.ndarray:
        """The position in the whole body of a point of the copy of a place that is at x in the part."""
        if self.across is not None:
            x = np.insert(x, self.across, place.level)
        if self.sectors > 1:
            x = self._rotation(place.copy)[:len(x), :len(x)] @ x
        elif self.widths is not None:
            x = x + place.copy * self.widths[0] * np.eye(len(x))[0]
        return x

    def states(self, states: np.ndarray, copy: int = 0) -> np.ndarray:
        """States (n) of the part's points along the axes of the whole body; `copy` as in Place."""
        if self.across != 1 and not (self.sectors > 1 and copy):
            return states
        states = exchange_y_z(states) if self.across == 1 else states.copy()
        if self.sectors > 1:
            rotation = self._rotation(copy)
            for name in TENSORS:
                states[name] = tensors.to_voigt(rotation @ tensors.to_matrix(states[name]) @ rotation.T)
        return states

    def mean(self, columns: Mapping[str, float]) -> dict[str, float]:
        """Means of columns of points (state_columns) over the whole body from those over the part."""
        mean = dict(columns)
        if self.sectors > 1:
            for name in ("A", "sigma"):
                mean[f"{name}_xx"] = mean[f"{name}_yy"] = (mean[f"{name}_xx"] + mean[f"{name}_yy"]) / 2
                mean |= dict.fromkeys((f"{name}_xy", f"{name}_xz", f"{name}_yz"), 0.0)
        return mean

    @property
    def _angle(self) -> float:
        return 2 * np.pi / self.sectors

    def _rotation(self, copies: int) -> np.ndarray:
        """Rotation matrix (3, 3) from the first sector to the one that is so many copies away."""
        cosine, sine = np.cos(copies * self._angle), np.sin(copies * self._angle)
        return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])

    # ---- forces ----------------------------------------------------------------------------------------------------

    def reaction(self, problem: Problem, where: Where, center: Sequence[float] | None = None) -> tuple[np.ndarray, Any]:
        """Problem.reaction of the whole body; center (D), force (D) and moment are along the axes of the body, D its dimension."""
        force, moment = self._in_space(*problem.reaction(where))
        if self.sectors > 1:
            force, moment = self.sectors * force * [0, 0, 1], self.sectors * moment * [0, 0, 1]
        if self.widths is not None:
            part, whole = self.widths
            moment = whole / part * (moment + np.cross([(whole - part) / 2, 0, 0], force))
            force = whole / part * force
        d = self.dimension(problem.d)
        if center is not None:
            moment = moment - np.cross(np.append(center, np.zeros(3 - len(center))), force)
        return force[:d], moment if d == 3 else moment[2]

    def _in_space(self, force: np.ndarray, moment: Any) -> tuple[np.ndarray, np.ndarray]:
        """Force (3) and moment (3) about the origin of the part over the body's thickness."""
        if len(force) == 3:
            return force, moment
        across = 2 if self.across is None else self.across
        in_space = self.thickness * np.insert(force, across, 0.0)
        about_origin = self.thickness * moment * np.cross(*np.delete(np.eye(3), across, axis=0))
        level = 0.0 if self.across is None else self.thickness / 2
        return in_space, about_origin + np.cross(level * np.eye(3)[across], in_space)


WHOLE = Symmetry()                 # the part is the body


def exchange_y_z(states: np.ndarray) -> np.ndarray:
    """A copy of states (n), in which their y axis is called z and their z axis y."""
    exchanged = states.copy()
    for name in TENSORS:
        exchanged[name] = states[name][:, [0, 2, 1, 4, 3, 5]]
    return exchanged
