# %% [markdown]
# # Undrained cyclic simple shear between rough rigid walls
#
# A saturated packing keeps its volume. Its box has a rough bottom and top, which drag the grains at them along, and rough rigid
# side walls that tilt about their feet. The top goes to and fro. A packing near phi = 0.59 liquefies: its pressure falls to zero,
# comes back while the shear goes on, and is lost again at every reversal; a denser one keeps a finite pressure. The single point
# has the same walls' shear strain. Loose sides instead of the tilting ones show what inhomogeneity does at the ends.

# %%
import sys
from pathlib import Path

import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, driver, fem

SAND = Material(mu=0.5, closure="kinematic", elastic_strain=0.01)
AMPLITUDE = 0.05                       # of the shear strain
LENGTH = 3.0                           # of the box, whose height is 1
PRESSURE = 0.01
RANK = MPI.COMM_WORLD.rank
SHORT = {"cells": 3, "increments": 10, "cycles": 1}


def shear_strain(t):
    """A triangular wave of period 1."""
    return AMPLITUDE * (1 - abs((t + 0.25) % 1 - 0.5) * 4)


def walls(x):
    return np.isclose(x[1], 0) | np.isclose(x[1], 1) | np.isclose(x[0], 0) | np.isclose(x[0], LENGTH)


def problem(phi, cells, rough_ends):
    """The box; its smooth ends bear on the grains but do not hold them up or down."""
    mesh = fem.meshes.box(MPI.COMM_WORLD, (LENGTH, 1.0), (3 * cells, cells))
    def tilt(x, t):
        return shear_strain(t) * x[:, 1:] * np.array([1.0, 0.0])
    where = (lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 1)), (lambda x: np.isclose(x[0], 0) | np.isclose(x[0], LENGTH))
    return fem.Problem(mesh, SAND, SAND.isotropic(phi, pressure=PRESSURE), [
        fem.Displacement(where[0], tilt), fem.Displacement(where[1], tilt, components=None if rough_ends else [0])])
