# %% [markdown]
# # A split-bottom shear cell: flow in three dimensions
#
# The cell of Fenistein & van Hecke (Nature 425, 256, 2003): a ring of sand with weight on a bottom that is split. The part within
# the radius 1 turns with the inner wall, the rest stands with the outer one, and the zone that is sheared rises from the split and
# bends inwards. The mesh stays, but for its free surface, which follows the sand; the state is convected around the ring, of which
# one sector is modelled. A length keeps the zone wider than a cell. Its middle, where sand turns half as fast as the wall, is
# compared with the path of least torque between two rigid blocks (Unger, Torok, Kertesz & Wolf, Phys. Rev. Lett. 92, 214301,
# 2004), which knows neither the law nor a width.

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI
from scipy.optimize import minimize

from granumat import Material, fem

SAND = Material(mu=0.5, closure="kinematic", elastic_strain=0.01)
INNER, OUTER, SPLIT, HEIGHT = 0.4, 1.6, 1.0, 0.4
PHI, WEIGHT, SURCHARGE = 0.60, 0.05, 0.002      # of the start; of the solid; pressure on the surface
LENGTH = 0.05
SHORT = {"meshes": ((11, 4),), "turn": 0.2}
INCREMENT = 0.02


def radius(x):
    return np.hypot(x[0], x[1])


def turning(x):
    return np.isclose(radius(x), INNER) | (np.isclose(x[2], 0) & (radius(x) < SPLIT))


def standing(x):
    return np.isclose(radius(x), OUTER) | (np.isclose(x[2], 0) & (radius(x) > SPLIT))


def surface(x):
    return np.isclose(x[2], HEIGHT)


def start(x):
    """At rest under the weight, the pressure the same in all directions."""
    heights, which = np.unique(x[:, 2], return_inverse=True)
    states = [SAND.isotropic(PHI, pressure=SURCHARGE + PHI * WEIGHT * (HEIGHT - z)) for z in heights]
    return np.array(states)[which.ravel()]


# %%
def cell(rings, layers):
    """The problem on one sector of that angle, at the split as wide as a ring. The split is within a cell where rings are odd."""
    angle = (OUTER - INNER) / rings / SPLIT
    mesh = fem.meshes.annulus(MPI.COMM_WORLD, (INNER, OUTER), (rings, 1, layers), height=HEIGHT, angle=angle)
    problem = fem.Problem(mesh, SAND, start, [
        fem.Displacement(turning, fem.rotation(lambda t: t), components=[0, 1]), fem.Displacement(standing, components=[0, 1]),
        fem.Displacement(lambda x: np.isclose(x[2], 0), components=[2]), fem.Pressure(surface, SURCHARGE),
        fem.Periodic(lambda x: np.isclose(np.arctan2(x[1], x[0]), angle),
                     lambda x: np.column_stack([np.hypot(x[:, 0], x[:, 1]), 0 * x[:, 1], x[:, 2]]), fem.polar())],
        motion="boundary", gravity=(0, 0, -WEIGHT), length=LENGTH)
    return problem, angle


def turn_by(rings, layers, turn):
    """Turns and torques of the turning part of the whole ring; radii, heights, and how fast nodes turn that lie on one grid."""
    problem, angle = cell(rings, layers)
    rows = []

    def watch(problem):
        if problem.last is not None:
            rows.append((problem.t, problem.reaction(turning)[1][2] / angle * 2 * np.pi))

    fem.run(problem, turn, INCREMENT, observers=[watch])
    assert problem.increments == round(turn / INCREMENT)         # none was cut
    own = np.flatnonzero(np.isclose(problem.positions[:problem.body.owned_nodes, 1], 0))
    x = (problem.positions + problem.displacement)[own]
    found = np.concatenate(problem.comm.allgather(np.column_stack([
        problem.positions[own][:, [2, 0]], np.arctan2(x[:, 1], x[:, 0]) / INCREMENT, x[:, [0, 2]]])))
    speed, r, z = found[np.lexsort(np.round(found[:, 1::-1].T, 9))][:, 2:].T.reshape(3, layers + 1, rings + 1)
    return np.array(rows).T, r, z, speed


# %% The path of least torque.
def least_torque(points=41):
    """Heights, and radii at which rigid blocks slide on each other under the weight of the sand above, from the split upwards."""
    z = np.linspace(0, HEIGHT, points)
    pressure = SURCHARGE + PHI * WEIGHT * (HEIGHT - (z[1:] + z[:-1]) / 2)

    def torque(r):
        r = np.concatenate([[SPLIT], r])
        return (pressure * ((r[1:] + r[:-1]) / 2)**2 * np.hypot(np.diff(r), np.diff(z))).sum()
    return z, np.concatenate([[SPLIT], minimize(torque, np.full(points - 1, SPLIT)).x])


# %%
def main(meshes=((15, 5), (27, 9)), turn=2.0, out=None):
    z, path = least_torque()
    runs, middles = {}, {}
    for rings, layers in meshes:
        runs[rings] = found = turn_by(rings, layers, turn)
        middles[rings] = np.array([np.interp(-0.5, -speed, r) for r, speed in zip(found[1], found[3])])
    if MPI.COMM_WORLD.rank == 0:
        for rings, ((_, torque), *_) in runs.items():
            print(f"{rings} rings: torque {torque[-1]:.5f}, middle of the zone at the surface at r = {middles[rings][-1]:.3f}, on "
                  f"the path of least torque {path[-1]:.3f}")
        if out:
            fields.save(draw(runs, middles, z, path), out, "split-bottom")
    assert all(path[-1] - 0.12 < middle[-1] < path[-1] for middle in middles.values())         # it begins far in
    rings = meshes[-1][0]
    return {"torque": runs[rings][0][1], "speed": runs[rings][3], "middle": middles[rings]}


def draw(runs, middles, z, path):
    figure = Figure(figsize=(10, 6), layout="constrained")
    section, surface_speed, turning_moment = figure.subplot_mosaic("aa;bc", height_ratios=(1.1, 1)).values()
    rings, (_, r, height, speed) = list(runs.items())[-1]
    levels = section.contourf(r, height, speed, np.linspace(0, 1, 11), cmap="viridis")
    figure.colorbar(levels, ax=section, label="speed over that of a rigid turn", shrink=0.9)
    section.plot(middles[rings], height[:, 0], "k.-", label="half as fast as the wall")
    section.plot(path, z, "r--", label="path of least torque")
    section.set(xlabel="radius", ylabel="height", aspect="equal")
    section.legend(loc="lower right")
    for rings, ((turned, torque), r, _, speed) in runs.items():
        surface_speed.plot(r[-1], speed[-1], ".-", label=f"{rings} rings")
        turning_moment.plot(turned, torque)
    surface_speed.set(xlabel="radius", ylabel="speed at the surface")
    surface_speed.legend(frameon=False)
    turning_moment.set(xlabel="turn [rad]", ylabel="torque [k/d]", ylim=(0, None))
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
