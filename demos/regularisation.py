# %% [markdown]
# # What the two regularisations change
#
# The elastic strain e_r and the rate term alpha, each small and larger, on three meshes of the annular shear cell (one sector tied
# to itself): what they change in the torque and the pressure, and what is left of the mesh dependence. The rate term's shear rate
# is per radian that the wall turns; as the gap is as wide as the inner radius, alpha is the added viscosity in p per mean shear rate.

# %%
import csv
import sys
from itertools import product
from pathlib import Path

import numpy as np
from annular_cell import Watch, ring
from annulus import width
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

MESHES = (8, 16, 32)
ELASTIC_STRAINS = (1e-3, 1e-2)
RATE_TERMS = (0.0, 0.01, 0.05)
TURN, BACK, INCREMENT, SECTORS = 0.12, 0.08, 0.002, 96
SHORT = {"meshes": (4, 8), "elastic_strains": (1e-2,), "rate_terms": (0.0, 0.05), "increment": 0.01}
COLUMNS = ("elastic_strain", "rate_term", "rings", "torque", "torque_back", "pressure", "width", "iterations", "reached")


# %%
def attempt(elastic_strain, rate_term, rings, increment):
    """A row of COLUMNS (torque and pressure at the reversal, torque_back a quarter of the way back), and Watch's columns."""
    sand = Material(0.5, elastic_strain=elastic_strain)
    problem, inner = ring(sand, rings, 1, TURN, part=1 / SECTORS, rate_term=rate_term)
    watch, wide = Watch(problem, inner, rings, 1 / SECTORS), []

    def look(problem):
        if problem.t == TURN:
            now = (problem.positions + problem.displacement)[:, :2]
            x = now - problem.last.u[:, :2]
            angle = np.arctan2(x[:, 0] * now[:, 1] - x[:, 1] * now[:, 0], (x * now).sum(axis=1))
            nodes = np.concatenate(problem.comm.allgather(np.column_stack([np.hypot(*now.T), angle])))
            wide.append(width(nodes[np.argsort(nodes[:, 0])]))

    try:
        fem.run(problem, TURN + BACK, increment, events=[TURN], observers=[watch, look])
    except fem.SolveError as error:
        print(error) if problem.comm.rank == 0 else None
    columns = watch.columns()
    at, back = (np.argmin(abs(columns["path"] - path)) for path in (TURN, TURN + BACK / 4))
    return dict(zip(COLUMNS, (elastic_strain, rate_term, rings, columns["torque"][at], columns["torque"][back], columns["pressure"][at],
                              np.append(wide, np.nan)[0], columns["iterations"].mean(), problem.t))), columns
