# %% [markdown]
# # A shear layer with weight under a loaded platen
#
# A periodic layer on a rough bed carries a rough platen of constant load, which drags it sideways. The shear stress tau is the same
# at every height, but weight raises the normal stress with depth s, N = N_0 (1 + s/L): the layer yields below the platen and rests
# further down. With neither rate term nor length all shear ends in the row of elements at the platen, however thin.
#
# The rate term spreads it to a depth that no longer depends on the mesh. With tau = mu N + alpha p D/2 (D the shear rate, mu and
# r = p/N those of steady shear) and D = 0 at a depth h, the platen's speed V gives h:
# V = (2 mu/(alpha r)) ((L + h) log(1 + h/L) - h).
#
# So does a length l, and nothing depends on the speed. Steady flow at a constant R = abs(D)/m, with m the nonlocal strain, has one
# ratio of stresses mu(R); l^2 m'' = m (1 - R(tau/N)), with m' = 0 at platen and bed, has a positive solution for one tau only.

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI
from scipy.linalg import eigh_tridiagonal
from scipy.optimize import brentq

from granumat import STATE, Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
PHI = 0.60
LOAD = 0.005                           # pressure of the platen
RANK = MPI.COMM_WORLD.rank
WEIGHT = 0.01                          # of the solid, per volume of solid, in k/d per height of the layer
CASES = {"neither": (0.0, 0.0), "rate term": (0.05, 0.0), "length": (0.0, 0.1)}     # alpha, l; the platen moves at a speed of 1
DEPTH = LOAD / (PHI * WEIGHT)          # L, in which the weight adds the load once more
SHORT = {"rows": (6,), "drag": 0.15, "increments": 12}


def resting(x):
    """Initial states: isotropic, at the pressure of the load and of the weight above; the bed is at 0, the platen at 1."""
    pressures = LOAD + PHI * WEIGHT * (1 - x[:, 1])
    return np.array([SAND.isotropic(PHI, pressure=pressure) for pressure in pressures.tolist()], STATE)


def platen(x):
    return np.isclose(x[1], 1)


def with_rate_term(alpha):
    """Steady state: shear force per area over the load, and the rate of shear as a function of depth."""
    sigma = -SAND.steady(PHI).stress
    mu, r = -sigma[4] / sigma[2], sigma[:3].sum() / 3 / sigma[2]
    h = brentq(lambda h: 2 * mu / (alpha * r) * ((DEPTH + h) * np.log1p(h / DEPTH) - h) - 1, 0, 1)
    return mu * (1 + h / DEPTH), lambda s: np.maximum(2 * mu / (alpha * r) * ((DEPTH + h) / (DEPTH + s) - 1), 0)


def ratios(R, clock=10.0, steps=100):
    """Shear stress over normal stress (n) in steady shear of the law at constant R (n)."""
    states, gradients, m = np.full(len(R), SAND.isotropic(PHI, pressure=LOAD)), np.zeros((len(R), 3, 3)), clock / steps
    gradients[:, 0, 1] = 2 * m * R                                  # abs(D) is half the shear
    for _ in range(steps):
        states = SAND.update(states, gradients, nonlocal_strain=np.full(len(R), m))
    return states["stress"][:, 3] / states["stress"][:, 1]


def with_length(length, cells=1000):
    """The same with a length: the tau for which m (1 - R) - l^2 m'' has the least eigenvalue 0, by finite volumes."""
    R, h = np.linspace(0, 2, 101), 1 / cells
    mu, s = abs(ratios(R)), (np.arange(cells) + 0.5) * h
    flux = np.full(cells + 1, (length / h)**2)
    flux[[0, -1]] = 0

    def least(ratio):
        at = np.interp(ratio / (1 + s / DEPTH), mu, R)
        value, m = eigh_tridiagonal(1 - at + flux[1:] + flux[:-1], -flux[1:-1], select="i", select_range=(0, 0))
        return value[0], at * abs(m[:, 0])

    ratio = brentq(lambda ratio: least(ratio)[0], mu[50], mu[-1])
    rates = least(ratio)[1]
    return ratio, lambda depth: np.interp(depth, s, rates / rates.mean())


# %%
def drag_layer(rows, rate_term, length, drag, increments):
    """Displacement of the platen and the force on it over the load, and the rate of shear of every row in the last increment."""
    width = 2 / rows
    problem = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (width, 1.0), (2, rows)), SAND, resting, [
        fem.Displacement(lambda x: np.isclose(x[1], 0)), fem.Displacement(platen, lambda x, t: np.array([t, 0.0]), components=[0]),
        fem.Tied(platen, 1), fem.Pressure(platen, LOAD),
        fem.Periodic(lambda x: np.isclose(x[0], width), lambda x: x - np.array([width, 0.0]))],
        gravity=(0.0, -WEIGHT), rate_term=rate_term, length=length)
    force = []

    def watch(problem):
        if problem.last is not None:
            force.append((problem.t, problem.reaction(platen)[0][0] / (LOAD * width)))

    fem.run(problem, drag, drag / increments, observers=[watch])
    shear = fields.over_layers(problem, problem.point_positions()[:, 1], rows, problem.last.gradients[:, 0, 1])
    return np.array(force), shear / (force[-1][0] - force[-2][0])


def main(rows=(8, 16, 32), drag=2.0, increments=200, out=None):
    data = {}
    for name, case in CASES.items():
        for count in rows:
            force, rates = drag_layer(count, *case, drag, increments)
            data |= {f"{name} {count} force": force, f"{name} {count} rates": rates}
            if RANK == 0:
                print(f"{name:9}, {count:2} rows: force over load {force[-1, 1]:.4f}, largest rate of shear {rates.max():.2f}")
    steady = {"rate term": with_rate_term(CASES["rate term"][0]), "length": with_length(CASES["length"][1])}
    if drag >= 1:
        compare(data, steady, rows)
    if out and RANK == 0:
        fields.save(picture(data, steady, rows), out, "platen-gravity")
    return data


def compare(data, steady, rows):
    """Without either all shear is in one row; with them force and rates are those of the steady solutions."""
    for count in rows:
        assert data[f"neither {count} rates"].max() > 0.98 * count
        for name, (ratio, rates) in steady.items():
            off = data[f"{name} {count} force"][-1, 1] / ratio - 1
            expected = rates(1 - (np.arange(20 * count) + 0.5) / (20 * count)).reshape(count, 20).mean(axis=1)
            scatter = np.sqrt(((data[f"{name} {count} rates"] - expected)**2).mean())
            if RANK == 0:
                print(f"{name:9}, {count:2} rows: force off the steady {ratio:.4f} by {off:+.2%}, rates by {scatter:.3f} rms")
            assert abs(off) < 0.03 * (8 / count)**2 + 0.005 and scatter < 1.5 * (8 / count)**2 + 0.1


def picture(data, steady, rows):
    """Rate of shear along the height, and the force on the platen."""
    figure = Figure(figsize=(12, 3.2), layout="constrained")
    panels, heights = figure.subplots(1, 4), np.linspace(0, 1, 201)
    for axes, (name, (alpha, length)), line in zip(panels, CASES.items(), ("--", "-", "-.")):
        for color, count in enumerate(rows):
            axes.stairs(data[f"{name} {count} rates"], np.linspace(0, 1, count + 1), orientation="horizontal", baseline=None,
                        color=f"C{color}", label=f"{count} rows")
            panels[3].plot(*data[f"{name} {count} force"].T, line, color=f"C{color}", label=name if count == rows[-1] else None)
        if name in steady:
            axes.plot(steady[name][1](1 - heights), heights, "k:", label="steady theory")
            panels[3].axhline(steady[name][0], color="k", linestyle=":", linewidth=0.8)
        title = f"$\\alpha$ = {alpha:g}" if alpha else f"$l$ = {length:g}" if length else "neither rate term nor length"
        axes.set(title=title, xlabel="rate of shear", ylabel="height")
        axes.legend(frameon=False, fontsize=7, loc="lower right")
    panels[3].set(xlabel="path of the platen over height", ylabel="shear force over load")
    panels[3].legend(frameon=False, fontsize=7, loc="lower right")
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
