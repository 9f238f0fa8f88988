"""What holds and loads a body: displacements, ties, periodic sides, pressures and tractions on parts of its boundary; given m.

Every condition acts on a part of the boundary, `where`: a function of positions x (3, n) that returns n truth values, as DOLFINx
has it, or a number or several of the facet tags that the Problem was given.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Where = Callable | int | Sequence[int]
Axes = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Displacement:
    """Components of the displacement are prescribed.

    Attributes
    ----------
    where : function or tags
    value : number, sequence, or function of (x (n, d), t), optional
        Total displacement since the start, all of its components along x y (z), also where there are local axes. A function
        returns (n, d) or what broadcasts to it; see rotation. Where the mesh does not follow the material, x is where the mesh is
        now, and what the value grows by in an increment is the motion of the material that is there.
    components : sequence of int, optional
        Which components are prescribed, counted from 0, along the local axes if there are some; all if not given.
    axes : function of x (n, d), optional
        Local axes (n, d, d), in columns; see polar.
    """

    where: Where
    value: float | Sequence[float] | Callable[[np.ndarray, float], np.ndarray] = 0.0
    components: Sequence[int] | None = None
    axes: Axes | None = None


@dataclass(frozen=True)
class Tied:
    """A component of the displacement is the same on the whole part: a rigid platen, or, along polar axes, a ring that stays round.

    The load on it comes from a Pressure or a Traction on the same part.

    Attributes
    ----------
    where : function or tags
    component : int
        Counted from 0, along the local axes if there are some.
    axes : function of x (n, d), optional
        Local axes (n, d, d), in columns; see polar.
    """

    where: Where
    component: int
    axes: Axes | None = None


@dataclass(frozen=True)
class Periodic:
    """The part has the displacement of its partner.

    Attributes
    ----------
    where : function or tags
    partner : function of x (n, d)
        Positions (n, d) of the nodes on the partner side at the start.
    axes : function of x (n, d), optional
        Local axes (n, d, d), in columns, along which the part has the components that the partner has along x y (z): the other
        side of a sector of a ring, see polar.
    """

    where: Where
    partner: Callable[[np.ndarray], np.ndarray]
    axes: Axes | None = None


@dataclass(frozen=True)
class Pressure:
    """A pressure pushes along the inward normal of the moving boundary.

    Attributes
    ----------
    where : function or tags
    value : number or function of t
        In units of stress, k/d (k_Hz).
    """

    where: Where
    value: float | Callable[[float], float]


@dataclass(frozen=True)
class Traction:
    """A force per area of the boundary at the start, whose direction does not follow the boundary.

    Attributes
    ----------
    where : function or tags
    value : sequence (d) or function of t
        In units of stress, k/d (k_Hz).
    """

    where: Where
    value: Sequence[float] | Callable[[float], Sequence[float]]


@dataclass(frozen=True)
class NonlocalStrain:
    """The nonlocal strain m of a problem with a length is given; elsewhere on the boundary n . grad m = 0.

    Attributes
    ----------
    where : function or tags
    value : number or function of t
        m per unit of pseudo-time, at least 0, at the end of the increment.
    """

    where: Where
    value: float | Callable[[float], float]


@dataclass(frozen=True)
class Inflow:
    """Material enters here, in a given state, where the mesh does not follow it; how it moves another condition says.

    Attributes
    ----------
    where : function or tags
    state : record of dtype STATE, or function of x (n, d)
        A function returns records (n).
    """

    where: Where
    state: np.void | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Outflow:
    """Material leaves here, where the mesh does not follow it; how it moves, or what forces it bears, another condition says.

    Attributes
    ----------
    where : function or tags
    """

    where: Where


def polar(center: Sequence[float] = (0.0, 0.0)) -> Axes:
    """Local axes for Displacement, Tied and Periodic: radial, circumferential (, z) about a center in the plane x y."""
    def axes(x: np.ndarray) -> np.ndarray:
        away = x[:, :2] - np.asarray(center, float)
        radial = away / np.linalg.norm(away, axis=1, keepdims=True)
        frames = np.zeros((len(x), x.shape[1], x.shape[1]))
        frames[:, :2, 0] = radial
        frames[:, 0, 1], frames[:, 1, 1] = -radial[:, 1], radial[:, 0]
        if x.shape[1] == 3:
            frames[:, 2, 2] = 1
        return frames
    return axes


@dataclass(frozen=True)
class Rotation:
    """Value for Displacement: what `rotation` returns."""

    angle: Callable[[float], float]
    center: Sequence[float]

    def __call__(self, x: np.ndarray, t: float) -> np.ndarray:
        return self._by(self.angle(t), x)

    def motion(self, x: np.ndarray, start: float, t: float) -> np.ndarray:
        """Displacement from `start` to t of what is at x then."""
        return self._by(self.angle(t) - self.angle(start), x)

    def _by(self, angle: float, x: np.ndarray) -> np.ndarray:
        away = x[:, :2] - np.asarray(self.center, float)
        cosine, sine = np.cos(angle), np.sin(angle)
        displacement = np.zeros_like(x)
        displacement[:, 0] = (cosine - 1) * away[:, 0] - sine * away[:, 1]
        displacement[:, 1] = sine * away[:, 0] + (cosine - 1) * away[:, 1]
        return displacement


def rotation(angle: Callable[[float], float], center: Sequence[float] = (0.0, 0.0)) -> Rotation:
    """Value for Displacement: a rigid rotation in the plane x y by angle(t), in radians, about a center."""
    return Rotation(angle, center)
