"""Symmetric tensors by their six Voigt components in the order 11 22 33 12 13 23 = xx yy zz xy xz yz, as everywhere in granumat.

Shear components are tensor components, not twice them.
"""

import numpy as np
from numpy.typing import ArrayLike

AXES = ("xx", "yy", "zz", "xy", "xz", "yz")
ROWS, COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])         # of each component in the matrix
IDENTITY = np.array([1.0, 1, 1, 0, 0, 0])


def to_voigt(tensor: ArrayLike) -> np.ndarray:
    """Voigt components (..., 6) of symmetric tensors (..., 3, 3)."""
    return np.asarray(tensor)[..., ROWS, COLUMNS]


def symmetric(tensor: ArrayLike) -> np.ndarray:
    """Voigt components (..., 6) of the symmetric parts of tensors (..., 3, 3)."""
    tensor = np.asarray(tensor)
    return to_voigt((tensor + np.swapaxes(tensor, -1, -2)) / 2)


def to_matrix(components: ArrayLike) -> np.ndarray:
    """Symmetric tensors (..., 3, 3) from their Voigt components (..., 6)."""
    components = np.asarray(components)
    tensor = np.empty(components.shape[:-1] + (3, 3), components.dtype)
    tensor[..., ROWS, COLUMNS] = components
    tensor[..., COLUMNS, ROWS] = components
    return tensor


def trace(components: np.ndarray) -> np.ndarray:
    """Traces (...) of tensors (..., 6)."""
    return components[..., 0] + components[..., 1] + components[..., 2]


def deviator(components: np.ndarray) -> np.ndarray:
    """Deviators (..., 6) of tensors (..., 6): T - tr(T) I/3."""
    return components - trace(components)[..., None] / 3 * IDENTITY


def contract(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Double contractions X:Y (...) of tensors (..., 6)."""
    product = x * y
    return product[..., :3].sum(-1) + 2 * product[..., 3:].sum(-1)


def magnitude(components: np.ndarray) -> np.ndarray:
    """Magnitudes (...) of tensors (..., 6) as the paper measures them, abs(T) = sqrt(T:T/2)."""
    return np.sqrt(contract(components, components) / 2)
