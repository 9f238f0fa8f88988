"""Cases for `granumat chart`: batches of points under sequences of strain increments, chosen to hurt integration methods.

Every function takes the number of points and returns a Case; points differ in their start and in the size of their strain.
"""

from typing import NamedTuple

import numpy as np

from .. import driver, tensors
from ..core import STATE
from ..material import Material

SEED = 2011
HISTORIES = 64              # of shear at constant pressure; more points repeat them


class Case(NamedTuple):
    """What is integrated: from states (n,) through gradients (steps, n, 3, 3), with the arguments of the material."""

    title: str
    states: np.ndarray
    gradients: np.ndarray
    definition: dict


def _random(points):
    rng = np.random.default_rng(SEED)
    return rng, rng.uniform(0.5, 1, points)                # and the sizes of the points' strains


def _shear(strains, sizes):
    """Gradients of simple shear du_x/dz, (steps, n, 3, 3)."""
    gradients = np.zeros((len(strains), len(sizes), 3, 3))
    gradients[:, :, 0, 2] = np.multiply.outer(strains, sizes)
    return gradients


def _dilated(gradients, volume_strains):
    """Gradients with equal strains along the axes that make the volume strains (steps, n)."""
    return gradients + (volume_strains / 3)[..., None, None] * np.eye(3)


def _isotropic(material, phi, z2):
    states = np.zeros(len(phi), STATE)
    states["volume_fraction"], states["coordination_number"] = phi, z2
    return states


def _steady(material, phi):
    """Steady simple shear, du_x/dz > 0."""
    return material.update(_isotropic(material, phi, material["Zc"]), _shear([material.steady_strain], np.ones(len(phi)))[0])


def _reversed_shear(title, points, strains, phi=(0.59, 0.62), **definition):
    """Simple shear from the steady state of forward shear."""
    rng, sizes = _random(points)
    states = _steady(Material(**definition), rng.uniform(*phi, points))
    return Case(title, states, _shear(strains, sizes), definition)


def start_up(points):
    rng, sizes = _random(points)
    material = Material()
    states = _isotropic(material, rng.uniform(0.59, 0.62, points), material["Zc"] + rng.uniform(0.3, 1, points))
    return Case("steady shear from an isotropic start, increments of 0.02", states, _shear([0.02] * 25, sizes), {})


def reversal(points):
    return _reversed_shear("reversal of steady shear, increments of 0.01", points, [-0.01] * 20)


CYCLES = np.array([1] * 4 + [-1] * 8 + [1] * 8 + [-1] * 8) * 0.0025     # shear strain between -0.01 and 0.01


def cycles_volume(points):
    return _reversed_shear("cycles of amplitude 0.01 at constant volume, increments of 0.0025", points, -CYCLES)


def cycles_pressure(points):
    rng, sizes = _random(points)
    material = Material()
    cut = min(points, HISTORIES)
    sizes, phi = np.resize(sizes[:cut], points), np.resize(rng.uniform(0.595, 0.62, cut), points)
    states, gradients = _steady(material, phi), _shear(-CYCLES, sizes)
    volume_strains = np.empty((len(CYCLES), cut))
    for i in range(cut):
        steps = [driver.shear(strain, "pressure", 1) for strain in gradients[:, i, 0, 2].tolist()]
        volume_strains[:, i] = -np.diff(np.log(driver.run(material, states[i], steps)["phi"]))
    volume_strains = np.resize(np.tile(volume_strains, -(-points // cut)), (len(CYCLES), points))
    return Case("cycles of amplitude 0.01 on a path of constant pressure, increments of 0.0025", states,
                 _dilated(gradients, volume_strains), {})


def _directions(rng, shape, sign):
    """Random traceless symmetric (sign 1) or skew (-1) tensors of modulus 1, (*shape, 3, 3)."""
    x = rng.normal(size=(*shape, 3, 3))
    x = x + sign * np.swapaxes(x, -1, -2)
    x -= np.trace(x, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    return x / np.sqrt((x * x).sum((-1, -2)) / 2)[..., None, None]


def _random_states(rng, material, points):
    states = _isotropic(material, rng.uniform(0.60, 0.62, points), material["Zc"] + rng.uniform(0.5, 1, points))
    fabric = material["kappa"] * rng.random(points)[:, None] * tensors.to_voigt(_directions(rng, (points,), 1))
    states["fabric"] = fabric
    return states


def random_spin(points):
    rng, sizes = _random(points)
    states, shape = _random_states(rng, Material(), points), (10, points)
    strain = 0.01 * sizes[:, None, None] * _directions(rng, shape, 1)                  # |D|: half the shear strain
    spin = 0.2 * rng.random((*shape, 1, 1)) * _directions(rng, shape, -1)
    return Case("random directions in 3D, increments of 0.02 with spins up to 0.2", states,
                 _dilated(strain + spin, rng.uniform(-0.001, 0.001, shape)), {})


def quarter_turn(points):
    rng, sizes = _random(points)
    states, shape = _random_states(rng, Material(), points), (4, points)
    strain = 0.01 * sizes[:, None, None] * _directions(rng, shape, 1)
    return Case("turned by 90 degrees in each increment of 0.02", states, strain + np.pi / 2 * _directions(rng, shape, -1), {})


def through_phic(points):
    rng, sizes = _random(points)
    states = _steady(Material(), rng.uniform(0.5885, 0.591, points))
    volume_strains = np.multiply.outer([0.002] * 10 + [-0.002] * 10, sizes)
    return Case("volume fraction through phic and back, increments of 0.01", states,
                 _dilated(_shear([0.01] * 20, sizes), volume_strains), {})


def unjamming(points):
    return _reversed_shear("unjamming and jamming at constant volume, increments of 0.02", points, [-0.02] * 20, (0.5875, 0.5895))


def stiff(points):
    return _reversed_shear("reversal with e_r = 1e-4, increments of 0.01", points, [-0.01] * 10, elastic_strain=1e-4)


def tiny(points):
    return _reversed_shear("reversal, increments of 1e-6", points, [-1e-6] * 20)


def huge(points):
    return _reversed_shear("reversals, increments of 1", points, [-1.0, 1, -1, 1])


CASES = {"start-up": start_up, "reversal": reversal, "cycles-volume": cycles_volume, "cycles-pressure": cycles_pressure,
          "random-spin": random_spin, "quarter-turn": quarter_turn, "through-phic": through_phic, "unjamming": unjamming,
          "stiff": stiff, "tiny": tiny, "huge": huge}
