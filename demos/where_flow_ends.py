# %% [markdown]
# # Where flow ends: what stays outside of meshes that go their own way
#
# Three bodies that the method cannot follow to the end, each run until it stops, with what it says then. A platen is pushed into
# a bed: the free surface folds at its corner. A bed is drawn past a wall that stands: below it the sand loses all pressure, and how
# it moves there is arbitrary. An outlet is let go, its counterpressure taken away: below some pressure there is no equilibrium, and
# how fast sand falls is a matter of inertia.

# %%
import textwrap

import fields
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
PHI, PRESSURE, LENGTH = 0.60, 0.01, 0.1
WEIGHT, SURCHARGE = 0.02, 0.001                 # in the silo: of the solid; pressure at its top
ENTERING = SAND.isotropic(PHI, pressure=PRESSURE)
UNJAMMED = 0.005                                # part of a body that is taken for the beginning of a cavity
SHORT = {"names": ("a bed is drawn past a wall that stands",)}


def at(axis, value):
    return lambda x: np.isclose(x[axis], value)


def bottom(x):
    return np.isclose(x[1], 0)


# %% Problems, and increments of pseudo-time.
def pushed():
    """A rough platen, of which half is modelled, is pushed into a bed; beside it there is a pressure."""
    def platen(x):
        return np.isclose(x[1], 1) & (x[0] < 0.5001)

    def beside(x):
        return np.isclose(x[1], 1) & (x[0] > 0.4999)
    bed = fem.meshes.box(MPI.COMM_WORLD, (2, 1), (16, 8))
    return fem.Problem(bed, SAND, ENTERING, [
        fem.Displacement(lambda x: np.isclose(x[0] * (2 - x[0]), 0), components=[0]), fem.Displacement(bottom),
        fem.Displacement(platen, lambda x, t: [0, -t]), fem.Pressure(beside, PRESSURE)], motion="boundary", length=LENGTH), 0.005


def drawn():
    """The bed of drawn_bed.py, past a wall of which the middle stands still."""
    def left_wall(x, t):
        inside = (x[:, 1] > 0.4) & (x[:, 1] < 1.6)
        return np.column_stack([0 * x[:, 0], -t * (1 - np.where(inside, np.sin(np.pi * (x[:, 1] - 0.4) / 1.2)**2, 0))])
    bed = fem.meshes.box(MPI.COMM_WORLD, (1, 2), (8, 16))
    return fem.Problem(bed, SAND, ENTERING, [
        fem.Displacement(at(0, 0), left_wall), fem.Displacement(at(0, 1), lambda x, t: [0, -t]), fem.Inflow(at(1, 2), ENTERING),
        fem.Pressure(at(1, 2), PRESSURE), fem.Displacement(bottom, lambda x, t: [0, -t]), fem.Outflow(bottom)],
        motion="fixed", length=LENGTH), 0.025


def let_go():
    """Half of a silo with a rough wall; at the outlet is at first what bears the sand, and at t = 1 nothing."""
    def outlet(x):
        return bottom(x) & (x[0] < 0.5001)

    def floor(x):
        return bottom(x) & (x[0] > 0.4999)

    def start(x):
        heights, which = np.unique(x[:, 1], return_inverse=True)
        return np.array([SAND.isotropic(PHI, pressure=SURCHARGE + PHI * WEIGHT * (2 - y)) for y in heights])[which.ravel()]
    silo = fem.meshes.box(MPI.COMM_WORLD, (1, 2), (6, 12))
    return fem.Problem(silo, SAND, start, [
        fem.Displacement(at(0, 0), components=[0]), fem.Displacement(at(0, 1)), fem.Displacement(floor),
        fem.Pressure(outlet, lambda t: (SURCHARGE + 2 * PHI * WEIGHT) * (1 - t)), fem.Outflow(outlet),
        fem.Pressure(at(1, 2), SURCHARGE), fem.Inflow(at(1, 2), SAND.isotropic(PHI, pressure=SURCHARGE))],
        motion="fixed", gravity=(0, -WEIGHT), length=LENGTH), 0.02


BODIES = {"a platen is pushed into a bed": pushed, "a bed is drawn past a wall that stands": drawn, "an outlet is let go": let_go}


# %%
def ended(name):
    """The problem where it stops, and why."""
    problem, increment = BODIES[name]()
    try:
        fem.run(problem, 2, increment, smallest=increment / 64, unjammed=UNJAMMED)
    except fem.SolveError as error:
        return problem, str(error)
    raise AssertionError(f"{name}: it goes on")


def main(names=tuple(BODIES), out=None):
    found = {name: ended(name) for name in names}
    shown = [(name, why, *(fields.on_rank_0(problem, field) for field in ("p", "unjammed")), arrows(problem))
             for name, (problem, why) in found.items()]
    if MPI.COMM_WORLD.rank == 0:
        for name, (problem, why) in found.items():
            print(f"{name}: t = {problem.t:.3f}, {why}")
        if out:
            fields.save(draw(shown), out, "where-flow-ends")
    return {"t": np.array([problem.t for problem, _ in found.values()])}


def arrows(problem):
    """Positions and rates of displacement (nodes, 2) of all nodes, on all ranks."""
    own = slice(problem.body.owned_nodes)
    parts = problem.comm.allgather(((problem.positions + problem.displacement)[own], (problem.last.u / problem.last.duration)[own]))
    return [np.concatenate(part) for part in zip(*parts)]


def draw(shown):
    figure = Figure(figsize=(4.2 * len(shown), 5), layout="constrained")
    for axes, (name, why, pressure, (corners, unjammed), (x, v)) in zip(np.atleast_1d(figure.subplots(1, len(shown))), shown):
        fields.draw(axes, pressure, "pressure $p\\,d/k$")
        axes.add_collection(PolyCollection(corners, facecolors=np.where(unjammed > 0, "0.6", "none"), edgecolors="w", lw=0.3))
        axes.quiver(*x.T, *v.T, color="r", angles="xy", width=0.004)
        axes.set_title(name[0].upper() + name[1:] + "\n" + textwrap.fill(why.split("; ")[0], 46), fontsize=8)
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
