# %% [markdown]
# # The law with a length beside grains in a box without walls
#
# Half of the box of demos/dem/gradient.toml: a column of sand, periodic along the flow, from the plane in the middle, where the
# pressure is least, to the top, in grain diameters. A body force makes the pressure p (1 - a cos(2 pi z/H)); it comes as tractions
# on the rows of facets. The top is sheared by 6 diameters and back. The steady profile gives the length (demos/dem/bands.py); here
# is what the law then does after the reversal.

# %%
import sys
from pathlib import Path

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from granumat import STATE, fem

sys.path.insert(0, str(Path(__file__).parent / "dem"))
from layers import LAYERS, column  # noqa: E402

HEIGHT, PRESSURE, PHI = 31.2, 0.005, 0.60               # of the whole box, in d and k/d
START, FORTH, BACK = 3.1, 12.4, 8.1                     # slip of the whole box to steady shear, in it, and after the reversal, in d
SLIP = 0.05                                             # of an increment, in d
CREEP = 1e-6                                            # m at the top per slip: it would fall below round-off there


def pressure_at(z, gradient):
    return PRESSURE * (1 - gradient * np.cos(2 * np.pi * z / HEIGHT))


# %%
def shear_column(material, length, gradient, rows=62, back=BACK):
    """A table as that of grains: steps, strain, height, stress, and the slip of the layers, of which the lower half mirrors the other."""
    half, width = HEIGHT / 2, HEIGHT / 2 / rows
    mesh = fem.meshes.box(MPI.COMM_SELF, (width, half), (1, rows))
    heights = np.arange(1, rows) * width
    facets = [dolfinx.mesh.locate_entities(mesh, 1, lambda x, z=z: np.isclose(x[1], z)) for z in heights]
    tags = dolfinx.mesh.meshtags(mesh, 1, np.concatenate(facets), np.arange(1, rows, dtype=np.int32))
    jumps = pressure_at(heights + width / 2, gradient) - pressure_at(heights - width / 2, gradient)
    turn = START + FORTH

    def resting(x):
        return np.array([material.isotropic(PHI, pressure=p) for p in pressure_at(x[:, 1], gradient).tolist()], STATE)

    def middle(x):
        return np.isclose(x[1], 0)

    def top(x):
        return np.isclose(x[1], half)

    problem = fem.Problem(mesh, material, resting, [
        fem.Displacement(middle, components=[0]), fem.Tied(middle, 1), fem.Pressure(middle, pressure_at(width / 2, gradient)),
        fem.NonlocalStrain(top, CREEP), fem.Displacement(top, lambda x, t: np.array([min(t, 2 * turn - t) / 2, 0.0])),
        *(fem.Traction(tag, (0.0, jump)) for tag, jump in enumerate(jumps.tolist(), 1)),
        fem.Periodic(lambda x: np.isclose(x[0], width), lambda x: x - np.array([width, 0.0]))], length=length, facet_tags=tags)
    line = problem.nodes_at(lambda x: np.isclose(x[0], 0))
    line = line[np.argsort(problem.positions[line, 1])]
    found = []

    def watch(problem):
        if problem.last:
            found.append((problem.t, problem.reaction(top)[0][0] / width, *problem.displacement[line].T))

    for until in (START, turn, turn + back):
        go_on(problem, until, watch)
    return table(problem.positions[line, 1], gradient, *map(np.array, zip(*found)))


def go_on(problem, until, watch):
    """Run; where the guess from the last increment leads nowhere, as after the reversal, go on as from rest."""
    while problem.t < until:
        try:
            fem.run(problem, until, SLIP, observers=[watch])
        except fem.SolveError:
            if problem.last is None:
                raise
            problem.last = problem.next_increment = None


def table(z, gradient, t, tau, u_x, u_z):
    """The table from what was found after each increment: (increments), displacements (increments, nodes) at heights z."""
    height = 2 * (z[-1] - u_z[:, 0])
    path = np.minimum(t, 2 * (START + FORTH) - t)
    middles = (np.arange(LAYERS) + 0.5) / LAYERS - 0.5
    positions = (z + u_z - u_z[:, :1]) / height[:, None]
    moved = np.array([np.sign(middles) * np.interp(abs(middles), *line) for line in zip(positions, u_x)])
    slip, pressures = np.diff(moved, axis=0, prepend=0), pressure_at(middles * HEIGHT, gradient)
    columns = {"step": 1 + (t > START + 1e-9) + (t > START + FORTH + 1e-9), "gamma": np.cumsum(np.diff(path, prepend=0) / height),
               "height": height, "sigma_xz": -tau}
    return columns | {column("slip", layer): slip[:, layer] for layer in range(LAYERS)} | {
        column("sigma_zz", layer): np.full(len(t), pressures[layer]) for layer in range(LAYERS)} | {
        column("sigma_xz", layer): -tau for layer in range(LAYERS)}
