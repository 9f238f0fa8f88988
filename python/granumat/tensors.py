"""Symmetric tensors as six components 11 22 33 12 13 23 = xx yy zz xy xz yz, as everywhere in granumat."""

import numpy as np

AXES = ("xx", "yy", "zz", "xy", "xz", "yz")
ROWS, COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
IDENTITY = np.array([1.0, 1, 1, 0, 0, 0])


def to_voigt(tensor):
    """Components (..., 6) of symmetric tensors (..., 3, 3)."""
    return np.asarray(tensor)[..., ROWS, COLUMNS]


def symmetric(tensor):
    """Components (..., 6) of the symmetric parts of tensors (..., 3, 3)."""
    tensor = np.asarray(tensor)
    return to_voigt((tensor + np.swapaxes(tensor, -1, -2)) / 2)


def to_matrix(components):
    """Symmetric tensors (..., 3, 3) of components (..., 6)."""
    components = np.asarray(components)
    tensor = np.empty(components.shape[:-1] + (3, 3), components.dtype)
    tensor[..., ROWS, COLUMNS] = components
    tensor[..., COLUMNS, ROWS] = components
    return tensor


def trace(components):
    """Trace (...) of components (..., 6)."""
    return components[..., 0] + components[..., 1] + components[..., 2]


def deviator(components):
    """Deviator (..., 6) of components (..., 6)."""
    return components - trace(components)[..., None] / 3 * IDENTITY


def contract(x, y):
    """X : Y (...) of components (..., 6)."""
    product = x * y
    return product[..., :3].sum(-1) + 2 * product[..., 3:].sum(-1)


def magnitude(components):
    """The paper's abs(T) = sqrt(T:T/2) (...) of components (..., 6)."""
    return np.sqrt(contract(components, components) / 2)
