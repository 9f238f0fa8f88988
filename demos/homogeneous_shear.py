# %% [markdown]
# # Homogeneous simple shear is the single point
#
# A box of finite elements in simple shear, first at constant volume with a pause and a reversal, then under a platen that carries
# a constant load and rises as the packing dilates. Every integration point must have the state that the driver gets for one point.

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, driver, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
START = SAND.isotropic(0.60, pressure=0.003)
SHEAR, BACK = 0.4, 0.25                 # shear strain until the pause, and after it
RANK = MPI.COMM_WORLD.rank
SHORT = {"cells": 2, "increments": 8}


def box(cells, cell):
    """A box of height 1 along the last axis: mesh, where its bottom and top are, periodic sides."""
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    size = np.array([1.5, 0.8, 1.0])[[0, 2] if d == 2 else [0, 1, 2]]
    sides = [fem.Periodic(lambda x, i=i: np.isclose(x[i], size[i]), lambda x, i=i: x - size * (np.arange(d) == i))
             for i in range(d - 1)]
    mesh = fem.meshes.box(MPI.COMM_WORLD, size, [cells] * d, cell)
    return mesh, lambda x: np.isclose(x[d - 1], 0), lambda x: np.isclose(x[d - 1], 1), sides


def difference(problem, state):
    """Largest difference of any point's state to one: stress by the pressure, fabric by kappa."""
    units = {"stress": -START.stress[0], "fabric": SAND["kappa"], "coordination_number": 1.0, "volume_fraction": 1.0}
    mine = max(np.abs(problem.states[name] - state[name]).max(initial=0) / unit for name, unit in units.items())
    return problem.comm.allreduce(mine, MPI.MAX)


def pressure_and_ratio(states, d):
    """p and stress ratio (n, 2) of states in simple shear along the first and the last axis of d."""
    p = states.stress[:, :3].sum(axis=1) / -3
    return np.stack([p, states.stress[:, 3 if d == 2 else 4] / p], axis=1)


# %% [markdown]
# At constant volume the platen's motion is known, and pseudo-time counts increments: forward, one of pause, back.

# %%
def constant_volume(cells, cell, degree, increments):
    mesh, bottom, top, sides = box(cells, cell)
    axes = np.eye(3)[:mesh.geometry.dim, :mesh.geometry.dim]
    back = round(increments * BACK / SHEAR)
    direction = np.zeros((3, 3))
    direction[0, len(axes) - 1] = SHEAR / increments
    steps = [driver.deform(direction, increments, increments=increments), driver.pause(),
             driver.deform(-direction, back, increments=back)]
    point = driver.run(SAND, START, steps)
    problem = fem.Problem(mesh, SAND, START, degree=degree, conditions=[
        fem.Displacement(bottom), *sides,
        fem.Displacement(top, lambda x, t: SHEAR / increments * (min(t, increments) - max(t - increments - 1, 0)) * axes[0])])
    differences, body = [], []

    def compare(problem):
        differences.append(difference(problem, point.states[len(differences)]))
        body.append(pressure_and_ratio(problem.states[:1], len(axes))[0])

    fem.run(problem, increments + 1 + back, 1.0, observers=[compare])
    return {"point": pressure_and_ratio(point.states, len(axes)), "body": np.array(body), "difference": np.array(differences)}


# %% [markdown]
# Under a constant load the platen rises by what the solution finds. The point gets the platen's motion as the elements do, as
# L = log F of every increment, and must then carry the platen's load: that is what the driver's control "normal-load" asks for.

# %%
def constant_load(cells, cell, degree, increments):
    mesh, bottom, top, sides = box(cells, cell)
    vertical = mesh.geometry.dim - 1
    load = -START.stress[vertical]
    problem = fem.Problem(mesh, SAND, START, degree=degree, conditions=[
        fem.Displacement(bottom), *sides, fem.Tied(top, vertical), fem.Pressure(top, load),
        fem.Displacement(top, lambda x, t: SHEAR / increments * t * np.eye(vertical + 1)[0], components=range(vertical))])
    states, height, differences = [START], [1.0], []

    def compare(problem):
        if problem.last is not None:
            risen = problem.displacement[problem.nodes_at(top), vertical].max(initial=-np.inf)
            height.append(1 + problem.comm.allreduce(risen, MPI.MAX))
            stretch = np.log(height[-1] / height[-2])
            L = np.zeros((3, 3))
            L[0, vertical] = SHEAR / increments / height[-2] * stretch / np.expm1(stretch)
            L[vertical, vertical] = stretch
            states.append(SAND.update(states[-1], L))
            differences.append(max(difference(problem, states[-1]), abs(-states[-1].stress[vertical] / load - 1)))

    fem.run(problem, increments, 1.0, observers=[compare])
    return {"height": np.array(height), "difference": np.array(differences)}


# %%
def main(cells=4, increments=40, cell="quadrilateral", degree=1):
    volume = constant_volume(cells, cell, degree, increments)
    load = constant_load(cells, cell, degree, increments)
    largest = volume["difference"].max(), load["difference"].max()
    if RANK == 0:
        print(f"{cell:13} of degree {degree}: largest difference to the point {largest[0]:.0e} at constant volume, "
              f"{largest[1]:.0e} at constant load, where the platen rises by {load['height'][-1] - 1:.5f}")
    assert max(largest) < 1e-9
    return {"at_volume": volume["body"], "point": volume["point"], "height": load["height"], "difference": np.array(largest)}


def picture(data):
    """p and stress ratio at constant volume, and the platen's height at constant load."""
    figure = Figure(figsize=(10, 3), layout="constrained")
    axes = figure.subplots(1, 3)
    increments = len(data["height"]) - 1
    row = np.arange(len(data["point"]))
    gamma = SHEAR / increments * (row - np.clip(row - increments, 0, 1))            # a pause strains nothing
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
    data = main()
    if RANK == 0:
        fields.save(picture(data), "homogeneous-shear.png")
