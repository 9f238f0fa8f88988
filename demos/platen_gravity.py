# %% [markdown]
# # A shear layer with weight under a loaded platen
#
# A periodic layer on a rough bed carries a rough platen of constant load, which drags it sideways. The shear stress is the same at
# every height, but weight raises the pressure with depth: the layer yields below the platen and rests further down. The law has
# no length scale: all shear ends in the row of elements at the platen, however thin. The rate term spreads it to a depth that no
# longer depends on the mesh. With tau = m N + alpha p D/2 (D the shear rate, N the normal stress at depth s, N = N_0 (1 + s/l),
# m and r = p/N those of steady shear) and D = 0 at a depth h, the platen's speed V gives h:
# V = (2 m/(alpha r)) ((l + h) log(1 + h/l) - h).

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI
from scipy.optimize import brentq

from granumat import STATE, Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
PHI = 0.60
LOAD = 0.005                           # pressure of the platen
RANK = MPI.COMM_WORLD.rank
WEIGHT = 0.01                          # of the solid, per volume of solid, in k/d per height of the layer
ALPHA = 0.05                           # rate term; the platen moves at a speed of 1
SHORT = {"rows": (6,), "drag": 0.2, "increments": 20}


def resting(x):
    """Initial states: isotropic, at the pressure of the load and of the weight above; the bed is at 0, the platen at 1."""
    pressures = LOAD + PHI * WEIGHT * (1 - x[:, 1])
    return np.array([SAND.isotropic(PHI, pressure=pressure) for pressure in pressures.tolist()], STATE)


def platen(x):
    return np.isclose(x[1], 1)


def theory():
    """Depth of the shear and shear force per area over the load, in the steady state with the rate term."""
    sigma = -SAND.steady(PHI).stress
    m, r = -sigma[4] / sigma[2], sigma[:3].sum() / 3 / sigma[2]
    length = LOAD / (PHI * WEIGHT)
    depth = brentq(lambda h: 2 * m / (ALPHA * r) * ((length + h) * np.log1p(h / length) - h) - 1, 0, 1)
    return depth, m * (1 + depth / length), lambda s: np.maximum(2 * m / (ALPHA * r) * ((length + depth) / (length + s) - 1), 0)


# %%
def drag_layer(rows, rate_term, drag, increments):
    """Displacement of the platen and the force on it over the load, and the rate of shear of every row in the last increment."""
    width = 2 / rows
    problem = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (width, 1.0), (2, rows)), SAND, resting, [
        fem.Displacement(lambda x: np.isclose(x[1], 0)), fem.Displacement(platen, lambda x, t: np.array([t, 0.0]), components=[0]),
        fem.Tied(platen, 1), fem.Pressure(platen, LOAD),
        fem.Periodic(lambda x: np.isclose(x[0], width), lambda x: x - np.array([width, 0.0]))],
        gravity=(0.0, -WEIGHT), rate_term=rate_term)
    force = []

    def watch(problem):
        if problem.last is not None:
            force.append((problem.t, problem.reaction(platen)[0][0] / (LOAD * width)))

    fem.run(problem, drag, drag / increments, observers=[watch])
    shear = fields.over_layers(problem, problem.point_positions()[:, 1], rows, problem.last.gradients[:, 0, 1])
    return np.array(force), shear / (force[-1][0] - force[-2][0])


def sheared_depth(rates):
    """How far down the rate of shear is above 2 % of its largest."""
    return np.count_nonzero(rates > 0.02 * rates.max()) / len(rates)


def main(rows=(8, 16, 32), drag=1.0, increments=100, out=None):
    data = {}
    for rate_term in (0.0, ALPHA):
        for count in rows:
            force, rates = drag_layer(count, rate_term, drag, increments)
            data |= {f"{rate_term} {count} force": force, f"{rate_term} {count} rates": rates}
            if RANK == 0:
                print(f"alpha {rate_term:4}, {count:2} rows: sheared depth {sheared_depth(rates):.3f}, "
                      f"force over load {force[-1, 1]:.4f}, largest rate of shear {rates.max():.2f}")
    if drag >= 1:
        depth, ratio, _ = theory()
        if RANK == 0:
            print(f"steady theory with alpha: depth {depth:.3f}, force over load {ratio:.4f}")
        for count in rows:
            assert sheared_depth(data[f"0.0 {count} rates"]) == 1 / count
            assert abs(sheared_depth(data[f"{ALPHA} {count} rates"]) - depth) < 1 / count + 0.03
            assert abs(data[f"{ALPHA} {count} force"][-1, 1] / ratio - 1) < 0.005
    if out and RANK == 0:
        fields.save(picture(data, rows), out, "platen-gravity")
    return data


def picture(data, rows):
    """Rate of shear along the height without and with the rate term, and the force on the platen."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    panels = figure.subplots(1, 3)
    for panel, rate_term, line, more in zip(panels, (0.0, ALPHA), ("--", "-"), ("", ", rate term")):
        for color, count in enumerate(rows):
            style = {"linestyle": line, "color": f"C{color}", "label": f"{count} rows{more}"}
            panel.stairs(data[f"{rate_term} {count} rates"], np.linspace(0, 1, count + 1), orientation="horizontal",
                         baseline=None, **style)
            panels[2].plot(*data[f"{rate_term} {count} force"].T, **style)
    heights = np.linspace(0, 1, 201)
    panels[1].plot(theory()[2](1 - heights), heights, "k:", label="steady theory")
    panels[0].set(xlabel="rate of shear, no rate term", ylabel="height")
    panels[1].set(xlabel=f"rate of shear, $\\alpha$ = {ALPHA}", ylabel="height")
    panels[2].set(xlabel="displacement of the platen over height", ylabel="shear force over load")
    for panel in panels:
        panel.legend(frameon=False, fontsize=7, loc="lower right")
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
