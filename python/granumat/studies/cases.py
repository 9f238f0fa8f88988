"""Cases for `granumat chart`: batches of points under sequences of increments that are hard for integration methods.

Every function takes the number of points and returns a Case; points differ in their start and in the size of their strains.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import driver, tensors
from ..core import STATE
from ..material import Material

SEED = 2011
HISTORIES = 64              # different histories of shear at constant pressure; more points repeat them


class Case(NamedTuple):
    """What is integrated."""

    title: str
    states: np.ndarray              # (n,) of dtype STATE, at the start
    gradients: np.ndarray           # (steps, n, 3, 3), displacement gradient of each increment
    definition: dict[str, Any]      # arguments of Material


def _random(points: int) -> tuple[np.random.Generator, np.ndarray]:
    """A random generator, and factors (n,) of the points' strains."""
    rng = np.random.default_rng(SEED)
    return rng, rng.uniform(0.5, 1, points)


def _shear(strains: ArrayLike, sizes: np.ndarray) -> np.ndarray:
    """Displacement gradients of simple shear du_x/dz, (steps, n, 3, 3), of strains (steps,) times the points' factors (n,)."""
    gradients = np.zeros((np.size(strains), len(sizes), 3, 3))
    gradients[:, :, 0, 2] = np.multiply.outer(strains, sizes)
    return gradients


def _dilated(gradients: np.ndarray, volume_strains: np.ndarray) -> np.ndarray:
    """Gradients with isotropic strains added, of which the volume strains are (steps, n)."""
    return gradients + (volume_strains / 3)[..., None, None] * np.eye(3)


def _isotropic(phi: np.ndarray, z2: ArrayLike) -> np.ndarray:
    """States (n,) of isotropic packings."""
    states = np.zeros(len(phi), STATE)
    states["volume_fraction"], states["coordination_number"] = phi, z2
    return states


def _reversed_shear(title: str, points: int, strains: ArrayLike, phi: tuple[float, float] = (0.59, 0.62),
                    **definition: Any) -> Case:
    """Simple shear from the steady state of forward shear, at volume fractions between the two of phi."""
    rng, sizes = _random(points)
    states = Material(**definition).steady(rng.uniform(*phi, points))
    return Case(title, states, _shear(strains, sizes), definition)


def start_up(points: int) -> Case:
    """Steady shear from an isotropic packing."""
    rng, sizes = _random(points)
    material = Material()
    states = _isotropic(rng.uniform(0.59, 0.62, points), material["Zc"] + rng.uniform(0.3, 1, points))
    return Case("steady shear from an isotropic start, increments of 0.02", states, _shear([0.02] * 25, sizes), {})


def reversal(points: int) -> Case:
    """Reversal of steady shear."""
    return _reversed_shear("reversal of steady shear, increments of 0.01", points, [-0.01] * 20)


CYCLES = np.array([1] * 4 + [-1] * 8 + [1] * 8 + [-1] * 8) * 0.0025     # shear strain between -0.01 and 0.01


def cycles_volume(points: int) -> Case:
    """Cyclic shear at constant volume."""
    return _reversed_shear("cycles of amplitude 0.01 at constant volume, increments of 0.0025", points, -CYCLES)


def cycles_pressure(points: int) -> Case:
    """Cyclic shear with the volume strains that constant pressure needs, found by the driver."""
    rng, sizes = _random(points)
    material = Material()
    histories = min(points, HISTORIES)
    sizes, phi = np.resize(sizes[:histories], points), np.resize(rng.uniform(0.595, 0.62, histories), points)
    states, gradients = material.steady(phi), _shear(-CYCLES, sizes)
    volume_strains = np.empty((len(CYCLES), histories))
    for i in range(histories):
        steps = [driver.shear(strain, "pressure", 1) for strain in gradients[:, i, 0, 2].tolist()]
        volume_strains[:, i] = -np.diff(np.log(driver.run(material, states[i], steps)["phi"]))
    volume_strains = np.resize(np.tile(volume_strains, -(-points // histories)), (len(CYCLES), points))
    return Case("cycles of amplitude 0.01 on a path of constant pressure, increments of 0.0025", states,
                _dilated(gradients, volume_strains), {})


def _directions(rng: np.random.Generator, shape: tuple[int, ...], sign: int) -> np.ndarray:
    """Random traceless symmetric (sign 1) or skew (sign -1) tensors of magnitude 1, (*shape, 3, 3)."""
    x = rng.normal(size=(*shape, 3, 3))
    x = x + sign * np.swapaxes(x, -1, -2)
    x -= np.trace(x, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    return x / np.sqrt((x * x).sum((-1, -2)) / 2)[..., None, None]


def _random_states(rng: np.random.Generator, material: Material, points: int) -> np.ndarray:
    """States (n,) with fabrics in random directions."""
    states = _isotropic(rng.uniform(0.60, 0.62, points), material["Zc"] + rng.uniform(0.5, 1, points))
    fabric = material["kappa"] * rng.random(points)[:, None] * tensors.to_voigt(_directions(rng, (points,), 1))
    states["fabric"] = fabric
    return states


def random_spin(points: int) -> Case:
    """Strains and spins in random directions in 3D: nothing commutes."""
    rng, sizes = _random(points)
    states, shape = _random_states(rng, Material(), points), (10, points)
    strain = 0.01 * sizes[:, None, None] * _directions(rng, shape, 1)                  # |D|: half the shear strain
    spin = 0.2 * rng.random((*shape, 1, 1)) * _directions(rng, shape, -1)
    return Case("random directions in 3D, increments of 0.02 with spins up to 0.2", states,
                _dilated(strain + spin, rng.uniform(-0.001, 0.001, shape)), {})


def quarter_turn(points: int) -> Case:
    """Strains with rotations by 90 degrees within each increment."""
    rng, sizes = _random(points)
    states, shape = _random_states(rng, Material(), points), (4, points)
    strain = 0.01 * sizes[:, None, None] * _directions(rng, shape, 1)
    return Case("turned by 90 degrees in each increment of 0.02", states, strain + np.pi / 2 * _directions(rng, shape, -1), {})


def through_phic(points: int) -> Case:
    """Volume fractions that cross phic, where (4.9) has an infinite slope."""
    rng, sizes = _random(points)
    states = Material().steady(rng.uniform(0.5885, 0.591, points))
    volume_strains = np.multiply.outer([0.002] * 10 + [-0.002] * 10, sizes)
    return Case("volume fraction through phic and back, increments of 0.01", states,
                _dilated(_shear([0.01] * 20, sizes), volume_strains), {})


def unjamming(points: int) -> Case:
    """Z2 that falls below Zc and rises again."""
    return _reversed_shear("unjamming and jamming at constant volume, increments of 0.02", points, [-0.02] * 20, (0.5875, 0.5895))


def stiff(points: int) -> Case:
    """A deviatoric stress that relaxes within a small part of an increment."""
    return _reversed_shear("reversal with e_r = 1e-4, increments of 0.01", points, [-0.01] * 10, elastic_strain=1e-4)


def tiny(points: int) -> Case:
    """Increments so small that round-off could dominate."""
    return _reversed_shear("reversal, increments of 1e-6", points, [-1e-6] * 20)


def huge(points: int) -> Case:
    """Increments that reach steady states."""
    return _reversed_shear("reversals, increments of 1", points, [-1.0, 1, -1, 1])


CASES: dict[str, Callable[[int], Case]] = {
    "start-up": start_up, "reversal": reversal, "cycles-volume": cycles_volume, "cycles-pressure": cycles_pressure,
    "random-spin": random_spin, "quarter-turn": quarter_turn, "through-phic": through_phic, "unjamming": unjamming,
    "stiff": stiff, "tiny": tiny, "huge": huge}
