"""What holds a body: displacements, ties, periodic sides, pressures and tractions on parts of its boundary.

Every condition acts on a part of the boundary, `where`: a function of positions x (3, n) that returns n truth values, as DOLFINx
has it, or the numbers of facet tags (Problem's facet_tags).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Where = Callable | int | Sequence[int]


@dataclass(frozen=True)
class Displacement:
    """Components of the displacement are given.

    Attributes
    ----------
    where : function or tags
    value : number, sequence, or function of (x (n, d), t), optional
        Total displacement since the start, along x y (z) also where axes turns them: all of its components, of which those
        named are used. A function returns (n, d) or what broadcasts to it; see rotation.
    components : sequence of int, optional
        Which components, counted from 0, all if not given; those of the local axes where there are.
    axes : function of x (n, d), optional
        Local axes (n, d, d), in columns; see polar.
    """

    where: Where
    value: object = 0.0
    components: Sequence[int] | None = None
    axes: Callable | None = None


@dataclass(frozen=True)
class Tied:
    """A component of the displacement is the same on the whole part: a rigid platen, or, along polar axes, a ring that stays round.

    The load on it comes from a Pressure or a Traction on the same part.
    """

    where: Where
    component: int
    axes: Callable | None = None


@dataclass(frozen=True)
class Periodic:
    """The part moves as its partner does.

    Attributes
    ----------
    where : function or tags
    partner : function of x (n, d)
        Positions on the partner side (n, d), where there must be nodes.
    axes : function of x (n, d), optional
        The part's displacement along these axes is the partner's along x y (z): a sector's rotation, see polar.
    """

    where: Where
    partner: Callable
    axes: Callable | None = None


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
    value: object


@dataclass(frozen=True)
class Traction:
    """A force per area of the boundary as it is at the start, which follows no rotation.

    Attributes
    ----------
    where : function or tags
    value : sequence (d) or function of t
        In units of stress, k/d (k_Hz).
    """

    where: Where
    value: object


def polar(center=(0.0, 0.0)):
    """Local axes for Displacement, Tied and Periodic: radial, circumferential (, z) about a center in the plane x y."""
    def axes(x):
        away = x[:, :2] - np.asarray(center, float)
        radial = away / np.linalg.norm(away, axis=1, keepdims=True)
        frames = np.zeros((len(x), x.shape[1], x.shape[1]))
        frames[:, :2, 0] = radial
        frames[:, 0, 1], frames[:, 1, 1] = -radial[:, 1], radial[:, 0]
        if x.shape[1] == 3:
            frames[:, 2, 2] = 1
        return frames
    return axes


def rotation(angle, center=(0.0, 0.0)):
    """Value for Displacement: a rigid rotation in the plane x y by angle(t), in radians, about a center."""
    def value(x, t):
        away = x[:, :2] - np.asarray(center, float)
        cosine, sine = np.cos(angle(t)), np.sin(angle(t))
        moved = np.zeros_like(x)
        moved[:, 0] = (cosine - 1) * away[:, 0] - sine * away[:, 1]
        moved[:, 1] = sine * away[:, 0] + (cosine - 1) * away[:, 1]
        return moved
    return value
