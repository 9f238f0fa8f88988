"""Random batches of points for benchmarks."""

import numpy as np

from .. import tensors
from ..core import STATE
from ..material import Material

PHI = 0.60
BATCH_SHEAR = 0.01                # largest shear strain of an increment


def random_batch(material: Material, n: int, shear: float = BATCH_SHEAR, seed: int = 0,
                 plane: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Draw points near steady shear and increments in random directions.

    Parameters
    ----------
    material : Material
    n : int
        Number of points.
    shear : float
        Largest shear strain, 2 abs(D), of an increment.
    seed : int
        Of the random numbers.
    plane : bool
        Whether all is plane strain in x and y.

    Returns
    -------
    states : array (n,) of dtype STATE
    gradient : array (n, 3, 3)
        Displacement gradients with spin and a little volume strain.
    """
    rng = np.random.default_rng(seed)
    states = np.full(n, material.steady(PHI), STATE)
    states["fabric"] *= rng.uniform(0.3, 1, n)[:, None]
    states["coordination_number"] += rng.uniform(-0.3, 0.3, n)
    gradient = rng.normal(size=(n, 3, 3))
    if plane:
        for name in ("stress", "fabric", "direction"):                    # from shear in x and z
            states[name] = states[name][:, [0, 2, 1, 4, 3, 5]]
        gradient[:, 2] = gradient[:, :, 2] = 0
    gradient -= np.trace(gradient, axis1=1, axis2=2)[:, None, None] * (np.diag([0.45, 0.45, 0]) if plane else 0.3 * np.eye(3))
    gradient *= (shear / 2 * rng.random(n) / tensors.magnitude(tensors.symmetric(gradient)))[:, None, None]
    return states, gradient
