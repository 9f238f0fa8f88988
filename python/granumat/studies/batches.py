"""Random batches of points for benchmarks."""

import numpy as np

from .. import tensors
from ..core import STATE

PHI = 0.60
BATCH_SHEAR = 0.01                # largest shear strain of an increment


def random_batch(material, n, shear=BATCH_SHEAR, seed=0):
    """States (n,) near steady shear and displacement gradients (n, 3, 3) in random directions with spin."""
    rng = np.random.default_rng(seed)
    states = np.full(n, material.steady(PHI), STATE)
    states["fabric"] *= rng.uniform(0.3, 1, n)[:, None]
    states["coordination_number"] += rng.uniform(-0.3, 0.3, n)
    gradient = rng.normal(size=(n, 3, 3))
    gradient -= np.trace(gradient, axis1=1, axis2=2)[:, None, None] * np.eye(3) * 0.3
    strain = tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2)
    gradient *= (shear / 2 * rng.random(n) / tensors.magnitude(strain))[:, None, None]
    return states, gradient
