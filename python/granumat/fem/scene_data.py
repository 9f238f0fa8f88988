"""What a scene file says, as data: conditions, regions, the run, the output; not yet on a mesh."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..material import Material
from ..quantities import Quantity

# By dimension: the axis across each side of a box, and 0 or 1 where the coordinate along it is 0 or the box's size.
BOX_SIDES = {2: {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)},
             3: {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}}


@dataclass(frozen=True)
class Function:
    """A piecewise linear function of pseudo-time; constant before its first time and after its last."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, t: float) -> float:
        return float(np.interp(t, self.times, self.values))

    def up_to(self, t: float) -> list[tuple[float, float]]:
        """The rows (time, value) before a time, and the value then: what of the function has been until then."""
        return [(time, value) for time, value in zip(self.times, self.values) if 0 < time < t] + [(t, self(t))]


@dataclass(frozen=True)
class Resting:
    """An initial state at rest under gravity; its surface is the top of the mesh. Arguments of scene.resting.

    Attributes
    ----------
    volume_fraction : float
    weight : float
        Of the solid per volume of the solid, in units of stress per length.
    pressure : float
        Vertical stress at the surface.
    k0 : float
        Horizontal over vertical stress.
    """

    volume_fraction: float
    weight: float
    pressure: float
    k0: float


@dataclass(frozen=True)
class SideConditions:
    """What holds and loads one side of the body.

    Attributes
    ----------
    on : str or int
        Name of the side, or of a gmsh file's facets, or their number there.
    displacement : dict of int to Function
        By component: x y z of a box, radial circumferential z of an annulus.
    gradient : dict of (int, int) to Function
        Displacement gradients: component i of the displacement is the sum of gradient[i, j] times the position along j.
    rotation : Function or None
        Angle in radians.
    center : sequence of 2 floats
        Of the rotation.
    platen : int or None
        The displacement component that is the same on the whole side.
    pressure : Function or None
        In units of stress.
    traction : dict of int to Function
        By component, in units of stress.
    periodic : int or None
        The axis across the side, if it has the displacement of the opposite side.
    opening : "inflow", "outflow" or None
        Whether material enters in the initial state, or leaves, where the mesh does not follow it.
    """

    on: str | int
    displacement: dict[int, Function]
    gradient: dict[tuple[int, int], Function]
    rotation: Function | None
    center: Sequence[float]
    platen: int | None
    pressure: Function | None
    traction: dict[int, Function]
    periodic: int | None
    opening: str | None

    @property
    def is_held(self) -> bool:
        """Whether displacements are prescribed or tied, so that there is a reaction."""
        return bool(self.displacement or self.gradient) or self.rotation is not None or self.platen is not None

    @property
    def functions(self) -> list[Function]:
        """All functions of pseudo-time."""
        functions = [*self.displacement.values(), *self.gradient.values(), *self.traction.values()]
        return functions + [function for function in (self.rotation, self.pressure) if function is not None]


@dataclass(frozen=True)
class RunControl:
    """Arguments of control.run: end, infinite if that is a steady state, largest increment and smallest one; unjammed."""

    until: float
    increment: Function
    smallest: float | None
    unjammed: float | None

    @property
    def end(self) -> float | str:
        """The end as control.run has it."""
        return "steady" if self.until == np.inf else self.until


@dataclass(frozen=True)
class OutputRequest:
    """What is to be written.

    Attributes
    ----------
    every : int or None
        Increments from one record of fields and pictures to the next.
    times : tuple of float
        Pseudo-times of further records.
    fields : list of str or None
        Fields of the cells in fields.xdmf; those of Fields if None.
    pictures : list of str
        Fields to be drawn.
    probes : dict of str to list of float
        Positions of points at the start, by name.
    center : list of float or None
        Of the moments of reactions.
    checkpoint : dict
        Arguments of Checkpoint: every, seconds.
    """

    every: int | None
    times: tuple[float, ...]
    fields: list[str] | None
    pictures: list[str]
    probes: dict[str, list[float]]
    center: list[float] | None
    checkpoint: dict[str, Any]

    @property
    def origin(self) -> bool:
        """Whether it has to be kept where the material has come from, since a field shows it."""
        return any(name.startswith("origin") for name in (*(self.fields or ()), *self.pictures))


@dataclass(frozen=True)
class Region:
    """A part of the body, by positions at the start.

    Attributes
    ----------
    name : str
    box : (sequence (d), sequence (d)) or None
        The lowest and the highest position of a box along the axes,
    ring : (float, float) or None
        or the radii of a ring about the z axis.
    """

    name: str
    box: tuple[Sequence[float], Sequence[float]] | None
    ring: tuple[float, float] | None

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Which of the positions x (n, d) are in the region, bool (n)."""
        if self.box is not None:
            lowest, highest = self.box
            return ((x >= lowest) & (x <= highest)).all(axis=1)
        assert self.ring is not None
        radius = np.hypot(x[:, 0], x[:, 1])
        return (radius >= self.ring[0]) & (radius <= self.ring[1])


@dataclass(frozen=True)
class Scene:
    """What a scene file says, not yet on a mesh.

    Attributes
    ----------
    path : Path
        Of the file.
    material : Material
    initial : record of dtype STATE, or Resting
    mesh : dict
        Its kind, and arguments of meshes.box, meshes.annulus or meshes.from_gmsh.
    settings : dict
        Further arguments of Problem.
    conditions : list of SideConditions
    run : RunControl
    output : OutputRequest
    regions : list of Region
    quantities : list of Quantity
        Their `of` is as fem.quantities has it.
    """

    path: Path
    material: Material
    initial: np.void | Resting
    mesh: dict[str, Any]
    settings: dict[str, Any]
    conditions: list[SideConditions]
    run: RunControl
    output: OutputRequest
    regions: list[Region]
    quantities: list[Quantity]

    @property
    def events(self) -> list[float]:
        """Pseudo-times that the run meets exactly: kinks of the functions, times of the output and of the quantities."""
        kinks = {t for condition in self.conditions for function in condition.functions for t in function.times}
        wanted = {t for quantity in self.quantities for t in quantity.times}
        return sorted(t for t in kinks | wanted | set(self.output.times) if 0 < t < self.run.until)
