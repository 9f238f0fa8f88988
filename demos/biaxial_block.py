# %%
import sys
import tomllib
from pathlib import Path

import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

PROBLEM = tomllib.loads((Path(__file__).parent / "linking/calculix/block.toml").read_text())
WIDTH, HEIGHT = PROBLEM["block"]["width"], PROBLEM["block"]["height"]
PRESSURE = PROBLEM["initial"]["pressure"]
RANK = MPI.COMM_WORLD.rank
SHORT = {"meshes": (4,), "compression": 0.02, "increments": 5}


def bottom(x):
    return np.isclose(x[1], 0)


def top(x):
    return np.isclose(x[1], HEIGHT)


def sides(x):
    return np.isclose(x[0], 0) | np.isclose(x[0], WIDTH)


def block(rows, compression, elastic_strain=0.01, rate_term=0.0, degree=1, closure="kinematic"):
    sand = Material(PROBLEM["material"]["mu"], closure, elastic_strain=elastic_strain)
    mesh = fem.meshes.box(MPI.COMM_WORLD, (WIDTH, HEIGHT), (2 * rows, rows))
    return fem.Problem(mesh, sand, sand.isotropic(PROBLEM["initial"]["phi"], pressure=PRESSURE), [
        fem.Displacement(bottom), fem.Displacement(top, lambda x, t: np.array([0.0, -t * HEIGHT])),
        fem.Pressure(sides, PRESSURE)], degree=degree, rate_term=rate_term)
