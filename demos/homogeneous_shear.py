# %% [markdown]
# # Homogeneous simple shear is the single point
#
# A box of finite elements in simple shear, first at constant volume with a pause and a reversal, then under a platen that carries
# a constant load and rises as the packing dilates. Every integration point must have the state of a single point that
# is strained as the platen moves, by log F of every increment. Under the load that point must also carry the load, as with the
# driver's control "normal-load".

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI
from scipy.linalg import logm

from granumat import Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
START = SAND.isotropic(0.60, pressure=0.003)
LOAD = -START.stress[0]
SHEAR, BACK = 0.4, 0.25                 # shear strain until the pause, and after it
UNITS = {"stress": LOAD, "fabric": SAND["kappa"], "coordination_number": 1.0, "volume_fraction": 1.0}
RANK = MPI.COMM_WORLD.rank
SHORT = {"cells": 2, "increments": 8}


def box(cells, cell, degree, increments, loaded, **more):
    """A box of height 1 along its last axis, with periodic sides, and where its platen is.

    Pseudo-time counts increments: the platen goes forward, pauses for one and goes back; without a load it keeps its height.
    `more` are arguments of Problem.
    """
    size = np.array([1.5, 1.0] if cell in ("quadrilateral", "triangle") else [1.5, 0.8, 1.0])
    axes, up = np.eye(len(size)), len(size) - 1

    def bottom(x):
        return np.isclose(x[up], 0)

    def platen(x):
        return np.isclose(x[up], 1)

    def drag(x, t):
        return SHEAR / increments * (min(t, increments) - max(t - increments - 1, 0)) * axes[0]

    conditions = [fem.Displacement(bottom)]
    conditions += [fem.Periodic(lambda x, i=i: np.isclose(x[i], size[i]), lambda x, i=i: x - size[i] * axes[i]) for i in range(up)]
    if loaded:
        conditions += [fem.Displacement(platen, drag, range(up)), fem.Tied(platen, up), fem.Pressure(platen, LOAD)]
    else:
        conditions += [fem.Displacement(platen, drag)]
    mesh = fem.meshes.box(MPI.COMM_WORLD, size, [cells] * len(size), cell)
    return fem.Problem(mesh, SAND, START, conditions, degree=degree, **more), platen


# %%
def pressure_and_ratio(state, d):
    """p and stress ratio in simple shear along the first and the last axis of d."""
    p = state.stress[:3].sum() / -3
    return p, state.stress[d + 1] / p


def compare(problem, platen, increments):
    """Runs a problem and the single point. Each array has a row for the start and one for every increment:

    p and stress ratio of the point and of one in the body; the height of the platen; the point's normal stress over LOAD; the
    largest difference of any state in the body to the point's.
    """
    up, start = problem.d - 1, np.eye(problem.d)[-1]                # of the platen
    point, place, rows = START, start, []

    def watch(problem):
        nonlocal point, place
        moved = np.concatenate(problem.comm.allgather(problem.displacement[problem.nodes_at(platen)]))[0]
        F = np.eye(3)
        F[:problem.d, up] += (start + moved - place) / place[up]
        point, place = SAND.update(point, logm(F)), start + moved
        difference = max(np.abs(problem.states[name] - point[name]).max(initial=0) / unit for name, unit in UNITS.items())
        rows.append((pressure_and_ratio(point, problem.d), pressure_and_ratio(problem.states[0], problem.d), place[up],
                     -point.stress[up] / LOAD, problem.comm.allreduce(difference, MPI.MAX)))

    fem.run(problem, increments, 1.0, observers=[watch])
    return dict(zip(("point", "body", "height", "load", "difference"), map(np.array, zip(*rows))))


# %%
def main(cells=4, increments=40, cell="quadrilateral", degree=1, out=None):
    volume = compare(*box(cells, cell, degree, increments, False), increments + 1 + round(increments * BACK / SHEAR))
    load = compare(*box(cells, cell, degree, increments, True), increments)
    difference = np.array([volume["difference"].max(), load["difference"].max(), abs(load["load"] - 1).max()])
    if RANK == 0:
        print(f"{cell:13} of degree {degree}: largest difference to the point {difference[0]:.0e} at constant volume, "
              f"{difference[1:].max():.0e} at constant load, where the platen rises by {load['height'][-1] - 1:.5f}")
    assert difference.max() < 1e-9
    data = {"at_volume": volume["body"], "point": volume["point"], "height": load["height"], "difference": difference}
    if out and RANK == 0:
        fields.save(picture(data), out, "homogeneous-shear")
    return data


def picture(data):
    """p and stress ratio at constant volume, and the platen's height at constant load."""
    figure = Figure(figsize=(10, 3), layout="constrained")
    axes = figure.subplots(1, 3)
    increments = len(data["height"]) - 1
    row = np.arange(len(data["point"]))
    gamma = SHEAR / increments * (row - np.clip(row - increments, 0, 1))            # no shear in the pause
    for i, label in enumerate(("pressure $p\\,d/k$", "stress ratio")):
        axes[i].plot(gamma, data["point"][:, i], label="point")
        axes[i].plot(gamma, data["at_volume"][:, i], "k.", markersize=4, label="finite elements")
        axes[i].set(xlabel="accumulated shear strain, constant volume", ylabel=label)
    axes[0].legend(frameon=False)
    axes[2].plot(SHEAR / increments * np.arange(increments + 1), data["height"])
    axes[2].set(xlabel="shear strain, constant load", ylabel="height of the platen")
    return figure


if __name__ == "__main__":
    for cell in ("triangle", "hexahedron", "tetrahedron"):
        main(**SHORT, cell=cell, degree=2)
    main(out=fields.directory())
