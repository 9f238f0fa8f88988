# %% [markdown]
# # A ring shear cell in three dimensions
#
# A hollow cylinder of grains under a rough lid that carries a constant load, on a rough floor that turns; smooth walls inside and
# outside. The torque on the lid, the lid's settlement and the shear along the height, with an iterative linear solver on some
# 50 000 unknowns. Were the ring narrow, it would be the single point under constant normal load.

# %%
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, driver, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
START = SAND.isotropic(0.60, pressure=0.01)
INNER, OUTER, HEIGHT = 1.0, 1.5, 0.25
LOAD = 0.01
ITERATIVE = {"ksp_type": "gmres", "ksp_gmres_restart": 200, "ksp_rtol": 1e-6, "pc_type": "bjacobi", "sub_pc_type": "ilu"}
RANK = MPI.COMM_WORLD.rank
SHORT = {"cells": (2, 24, 2), "turn": 0.01, "increments": 4}


def floor(x):
    return np.isclose(x[2], 0)


def lid(x):
    return np.isclose(x[2], HEIGHT)


def walls(x):
    r = np.hypot(x[0], x[1])
    return (r < INNER * 1.0001) | (r > OUTER * 0.9999)


# %%
def main(cells=(10, 160, 9), turn=0.1, increments=20, solver=None):
    mesh = fem.meshes.annulus(MPI.COMM_WORLD, (INNER, OUTER), cells, height=HEIGHT)
    problem = fem.Problem(mesh, SAND, START, [
        fem.Displacement(floor, fem.rotation(lambda t: t)), fem.Displacement(lid, components=[0, 1]), fem.Tied(lid, 2),
        fem.Pressure(lid, LOAD), fem.Displacement(walls, components=[0], axes=fem.polar())],
        solver=ITERATIVE if solver is None else solver)
    return problem
