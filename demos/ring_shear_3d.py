# %% [markdown]
# # A ring shear cell in three dimensions
#
# A hollow cylinder of grains under a rough lid that carries a constant load, on a rough floor that turns; smooth walls inside and
# outside: 52 800 unknowns with an iterative linear solver. In a narrow ring every point would be in simple shear at constant normal
# load, with the shear strain r turn/height, and the torque is compared with that. The ring is not narrow: its outer part is sheared
# more and would settle more, but the lid is rigid. It shears nearly homogeneously, so that a length would change little.

# %%
import sys
import time

import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, driver, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
START = SAND.isotropic(0.60, pressure=0.01)
INNER, OUTER, HEIGHT = 1.0, 1.5, 0.25
LOAD = 0.01
RANK = MPI.COMM_WORLD.rank
SHORT = {"cells": (2, 24, 2), "turn": 0.012, "increments": 6}


def floor(x):
    return np.isclose(x[2], 0)


def lid(x):
    return np.isclose(x[2], HEIGHT)


def walls(x):
    r = np.hypot(x[0], x[1])
    return (r < INNER * 1.0001) | (r > OUTER * 0.9999)


# %%
def narrow_ring(turn, increments, radii=6):
    """Turns and torques of a ring of points in simple shear under constant normal load, by Gauss's rule over the radii."""
    nodes, weights = np.polynomial.legendre.leggauss(radii)
    r = (INNER + OUTER + (OUTER - INNER) * nodes) / 2
    torque = np.zeros(increments + 1)
    for radius, weight in zip(r, weights * (OUTER - INNER) / 2):
        history = driver.run(SAND, START, [driver.shear(turn * radius / HEIGHT, "normal-load", increments)])
        torque += weight * 2 * np.pi * radius**2 * -history["sigma_xz"]
    return np.linspace(0, turn, increments + 1), torque


def main(cells=(10, 160, 9), turn=0.024, increments=12, out=None):
    mesh = fem.meshes.annulus(MPI.COMM_WORLD, (INNER, OUTER), cells, height=HEIGHT)
    problem = fem.Problem(mesh, SAND, START, [
        fem.Displacement(floor, fem.rotation(lambda t: t)), fem.Displacement(lid, components=[0, 1]), fem.Tied(lid, 2),
        fem.Pressure(lid, LOAD), fem.Displacement(walls, components=[0], axes=fem.polar())])
    rows, start = [(0.0, 0.0, 0.0, 0)], time.monotonic()

    def watch(problem):
        if problem.last is None:
            return
        settled = problem.comm.allreduce(problem.displacement[problem.nodes_at(lid), 2].min(initial=np.inf), MPI.MIN)
        rows.append((problem.t, -problem.reaction(lid)[1][2], -settled, len(problem.last.residuals) - 1))

    fem.run(problem, turn, turn / increments, observers=[watch], progress=sys.stderr)
    t, torque, settlement, iterations = np.array(rows).T
    expected = narrow_ring(turn, increments)
    heights = problem.point_positions()[:, 2] / (HEIGHT - settlement[-1])
    strain = fields.over_layers(problem, heights, cells[2], problem.shear_strain)
    if RANK == 0:
        print(f"{problem.system.size} unknowns, {len(rows) - 1} increments, {iterations[1:].mean():.1f} Newton iterations each, "
              f"{time.monotonic() - start:.0f} s on {problem.comm.size} ranks")
        print(f"torque at {t[-1]:.3f} rad {torque[-1]:.5f}, of a narrow ring {expected[1][-1]:.5f}; the lid settles by "
              f"{settlement[-1]:.5f}; shear strain along the height {strain.min():.3f} to {strain.max():.3f}")
    assert abs(np.interp(t, *expected) - torque).max() < 0.05 * torque[-1]
    data = {"t": t, "torque": torque, "settlement": settlement, "shear_strain": strain, "narrow": np.interp(t, *expected)}
    if out and RANK == 0:
        fields.save(picture(data), out, "ring-shear-3d")
    return data


def picture(data):
    """Torque, settlement of the lid, and shear strain along the height."""
    figure = Figure(figsize=(10, 3), layout="constrained")
    axes = figure.subplots(1, 3)
    axes[0].plot(data["t"], data["torque"], label="ring")
    axes[0].plot(data["t"], data["narrow"], "k:", label="narrow ring: points")
    axes[0].set(xlabel="turn [rad]", ylabel="torque [k/d]")
    axes[0].legend(frameon=False)
    axes[1].plot(data["t"], data["settlement"] / HEIGHT)
    axes[1].set(xlabel="turn [rad]", ylabel="settlement of the lid over height")
    layers = len(data["shear_strain"])
    axes[2].plot(data["shear_strain"], (np.arange(layers) + 0.5) / layers, ".-")
    axes[2].set(xlabel="shear strain", ylabel="height over that of the ring", xlim=(0, 1.15 * max(data["shear_strain"])))
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
