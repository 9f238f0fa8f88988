# %% [markdown]
# # The law with a length beside grains in a box without walls
#
# Half of the box of demos/dem/gradient.toml: a column of sand, periodic along the flow, from the plane in the middle, where the
# pressure is least, to the top, in grain diameters. A body force makes the pressure p (1 - a cos(2 pi z/H)); it comes as tractions
# on the rows of facets. The column is sheared forth and back as the grains are. Steady shear gives the length (demos/dem/bands.py);
# here is what the law then does on its way there and after the reversal.

# %%
import sys
from itertools import product
from pathlib import Path

import dolfinx.mesh
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import STATE, Material, fem

sys.path.insert(0, str(Path(__file__).parent / "dem"))
import bands
from collect import read
from gradient import COLLECTED
from layers import LAYERS, column
from profiles import profile

HEIGHT, PRESSURE, PHI = 31.2, 0.005, 0.60               # of the whole box, in d and k/d
START, FORTH, BACK = 3.1, 12.4, 8.1                     # slip of the whole box to steady shear, in it, and after the reversal, in d
SLIP = 0.1                                              # of an increment, in d
CREEP = 3e-4                                            # m at the top per slip, as of the grains; else it falls below round-off
SIZE = 0.5                                              # of the cells, over the length
GRADIENTS = {0.5: ("o", "-"), 0.3: ("s", "--"), 0.7: ("d", ":")}         # marker of the grains, line of the law
SHOWN = 0.5                                             # gradient of which the reversal is drawn
LAWS = {"full": (Material(0.5, closure="full", elastic_strain=0.01), 0.41),
        "kinematic": (Material(0.5, closure="kinematic", elastic_strain=0.01), 0.53),
        "mobilised, dem-2026": (Material(0.5, closure="mobilised", calibration="dem-2026"), 0.39)}
SHORT = {"laws": {"full": (LAWS["full"][0], 1.0)}, "gradients": (0.5,), "size": 0.7, "back": 1.0}


def pressure_at(z, gradient):
    return PRESSURE * (1 - gradient * np.cos(2 * np.pi * z / HEIGHT))


# %%
def shear_column(material, length, gradient, rows=62, back=BACK):
    """A table as that of grains: steps, strain, height, stress, and the slip of the layers; the lower half mirrors the upper."""
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
        fem.run(problem, until, SLIP, observers=[watch])
    return table(problem.positions[line, 1], gradient, *map(np.array, zip(*found)))


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


# %%
def main(laws=LAWS, gradients=GRADIENTS, size=SIZE, back=BACK, out=None):
    columns = {}
    for (law, (material, length)), gradient in product(laws.items(), gradients):
        rows = round(HEIGHT / 2 / (size * length))
        columns[law, gradient] = one = shear_column(material, length, gradient, rows, back)
        steady = steady_profile(one)
        band = bands.measured_band(steady)
        found = dict(zip(("deviation", "width"), bands.width(band))) | bands.of_reversal(bands.Reversal.of(one), band)
        found["length of the steady equation"], _ = bands.fit_length(steady, bands.Friction.of(material))
        print(f"{law}, l = {length}, gradient {gradient}: " + ", ".join(f"{name} {value:.3f}" for name, value in found.items()),
              flush=True)
    if out:
        fields.save(draw(columns), out, "grain-layer")
    return columns


def steady_profile(columns):
    """The profile before the reversal."""
    return profile({name: values[columns["step"] < 3] for name, values in columns.items()})


def draw(columns):
    figure = Figure(figsize=(12.5, 3.8), layout="constrained")
    steady, slips, stress = figure.subplots(1, 3)
    for gradient, (marker, _) in GRADIENTS.items():
        place = COLLECTED / f"gradient{gradient:g}"
        seeds = [bands.folded_shear(bands.measured_band(one)) for one in bands.seeds_of(place, "steady-profile").values()]
        z, shear = np.mean(seeds, axis=0)
        spread = np.std([one[1] for one in seeds], axis=0)
        steady.fill_between(z, np.maximum(shear - spread, 1e-5), shear + spread, color="0.8", linewidth=0)
        steady.plot(z, shear, marker, color="0.3", markersize=4, markerfacecolor="none", label=f"grains, a = {gradient:g}")
    place = COLLECTED / f"gradient{SHOWN:g}"
    band = bands.measured_band(read(place / "steady-profile_mean.csv"))
    for seed in bands.seeds_of(place, "reversal").values():
        plot_reversal(slips, stress, bands.Reversal.of(seed), band, color="0.6", linewidth=0.8)
    slips.plot([], color="0.6", linewidth=0.8, label="packings of grains")
    slips.legend(frameon=False, fontsize=7.5)
    for (law, gradient), one in columns.items():
        band = bands.measured_band(steady_profile(one))
        style = {"color": f"C{list(LAWS).index(law)}", "linestyle": GRADIENTS[gradient][1]}
        label = f"{law}, l = {LAWS[law][1]:g} d" if gradient == SHOWN else None
        steady.plot(*bands.folded_shear(band), **style, label=label)
        if gradient == SHOWN:
            plot_reversal(slips, stress, bands.Reversal.of(one), band, **style)
    steady.set(yscale="log", ylim=(1e-4, 0.4), xlim=(0, 12), xlabel="distance from the middle [d]",
               ylabel="shear strain per slip [1/d]", title="steady")
    steady.legend(frameon=False, fontsize=7.5)
    for axes, words in ((slips, "slip outside the band [d]"), (stress, "shear stress over that before")):
        axes.set(xlabel="slip after the reversal [d]", ylabel=words, title=f"a = {SHOWN:g}, after the reversal")
    return figure


def plot_reversal(slips, stress, reversal, band, **style):
    """Slip that is lost outside the band, and the shear stress, against slip."""
    half = bands.half_height(band)
    within = [np.diff(np.interp([-half, half], reversal.z, slip))[0] for slip in reversal.slip]
    slips.plot(reversal.path, reversal.path - within, **style)
    stress.plot(reversal.path, reversal.tau / band.tau, **style)


if __name__ == "__main__":
    main(out=fields.directory())
