"""Random states and increments, and states in another frame."""

import numpy as np

from granumat import STATE, tensors
from granumat.material import CLOSURES, TURNING
from support.reference import random_increments

CLOSURES_AND_STRAINS = [(closure, elastic_strain) for closure in CLOSURES for elastic_strain in (0.0, 0.01)
                        if elastic_strain > 0 or closure not in TURNING]


def random_states(rng, material, n, shear, **sampling):
    """States (n,) with random fabrics, and displacement gradients (n, 3, 3); `sampling` as in random_increments."""
    fabric, z2, phi, gradient = random_increments(rng, n, material["mu"], shear, **sampling)
    states = np.zeros(n, STATE)
    states["fabric"], states["coordination_number"], states["volume_fraction"] = tensors.to_voigt(fabric), z2, phi
    states["stress"] = -1e-3 * tensors.IDENTITY + 0.01 * states["fabric"]
    return states, gradient


def random_rotations(rng, n):
    """Rotation matrices (n, 3, 3), evenly distributed."""
    q, r = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q = q * np.sign(np.einsum("nii->ni", r))[:, None, :]
    return q * np.linalg.det(q)[:, None, None]


def rotated(q, states):
    """States (n,) rotated by q (n, 3, 3)."""
    new = states.copy()
    for name in ("stress", "fabric", "direction"):
        new[name] = tensors.to_voigt(q @ tensors.to_matrix(states[name]) @ np.swapaxes(q, 1, 2))
    return new
