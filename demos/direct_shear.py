# %% [markdown]
# # Undrained cyclic shear in a rigid box
#
# A saturated packing keeps its volume. Rough platens below and above drag its grains along, side walls tilt about their feet, and
# the top goes to and fro. A packing near phi = 0.59 liquefies: its pressure falls to zero, and comes back when the shear goes on in
# one direction; a denser one keeps a finite pressure. With rough side walls the box deforms homogeneously, as a single point.
# Smooth ones, as in the usual apparatus, carry no shear stress to balance the platens': one row of cells at the ends dilates, all
# others are compacted a little, and the mean pressure falls a little more slowly.

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
PRESSURE = 0.01                        # at the start
AMPLITUDE = 0.1                        # of the shear strain
ONWARD = 0.8                           # shear strain in one direction after the cycles
LENGTH = 3                             # of the box, whose height is 1
LIQUEFIED = 0.025 * PRESSURE            # mean pressure below which the run with smooth ends stops: parts of it carry nothing
RANK = MPI.COMM_WORLD.rank
SHORT = {"cells": 2, "increments": 12, "cycles": 2}


def mean_pressure(problem):
    volumes = problem.point_volumes()
    p = problem.states.stress[:, :3].sum(axis=1) / -3
    sums = problem.comm.allreduce(np.array([volumes @ p, volumes.sum()]))
    return sums[0] / sums[1]


def box(phi, cells, rough, shear_strain):
    """The box, its side walls smooth or rough."""
    def tilt(x, t):
        return shear_strain(t) * x[:, 1:] * np.array([1.0, 0.0])
    return fem.Problem(
        fem.meshes.box(MPI.COMM_WORLD, (LENGTH, 1.0), (LENGTH * cells, cells)), SAND, SAND.isotropic(phi, pressure=PRESSURE), [
            fem.Displacement(lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 1), tilt),
            fem.Displacement(lambda x: np.isclose(x[0], 0) | np.isclose(x[0], LENGTH), tilt, components=[0, 1] if rough else [0])])


# %%
def history(phi, cells, increments, cycles, rough):
    """Cycle number, p of the box and of the point, and volume fractions in the end; pseudo-time counts cycles."""
    def shear_strain(t):
        wave = AMPLITUDE * (1 - abs((t + 0.25) % 1 - 0.5) * 4)
        return wave if t <= cycles else 4 * AMPLITUDE * (t - cycles)

    problem, rows = box(phi, cells, rough, shear_strain), []
    point, t = SAND.isotropic(phi, pressure=PRESSURE), 0.0

    def watch(problem):
        nonlocal point, t
        if rows and problem.t == t:                     # the end of one run is shown again at the start of the next
            return
        gradient = np.zeros((3, 3))
        gradient[0, 1] = shear_strain(problem.t) - shear_strain(t)
        point, t = SAND.update(point, gradient), problem.t
        rows.append((t, shear_strain(t), mean_pressure(problem), point.stress[:3].sum() / -3))

    end = cycles + rough * ONWARD / AMPLITUDE / 4
    for stop in np.arange(1, round(increments * end) + 1) / increments:
        fem.run(problem, stop, 1 / increments, observers=[watch])
        if not rough and rows[-1][2] < LIQUEFIED:
            break
    field = fields.on_rank_0(problem, "phi")
    return dict(zip(("t", "gamma", "box", "point"), np.array(rows).T)), field


# %%
def main(cells=6, increments=40, cycles=6, out=None):
    data, pictures = {}, []
    for phi in (0.59, 0.60):
        for rough in (True, False):
            found, field = history(phi, cells, increments, cycles, rough)
            pictures.append((phi, rough, found, field))
            data |= {f"{phi:.2f} {'rough' if rough else 'smooth'} {name}": value for name, value in found.items()}
            cyclic = found["t"] <= cycles
            least, last = max(found["box"][cyclic].min(), 0), found["box"][-1]
            if RANK == 0:
                print(f"phi {phi:.2f}, {'rough' if rough else 'smooth'} ends: least mean p in {found['t'][cyclic][-1]:.2f} cycles "
                      f"{least:.1e} (point {max(found['point'][cyclic].min(), 0):.1e}), p at the end {last:.5f}"
                      + ("" if rough else f", phi from {field[1].min():.4f} to {field[1].max():.4f}"))
            if rough:
                assert abs(found["box"] - found["point"]).max() < 1e-9 * PRESSURE       # liquefied, too
                assert (least < 1e-9) == (phi == 0.59) and last > 0.05 * PRESSURE
    if out and RANK == 0:
        fields.save(picture(pictures), out, "direct-shear")
    return data


def picture(pictures):
    """Pressure histories, and what the smooth ends do to the volume fraction."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    for row, phi in enumerate((0.59, 0.60)):
        axes = figure.add_subplot(2, 2, 2 * row + 1)
        for number, rough, found, field in pictures:
            if number == phi:
                axes.plot(found["t"], found["box"], label="rough ends" if rough else "smooth ends")
            if number == phi and rough:
                axes.plot(found["t"][::3], found["point"][::3], "k.", markersize=3, label="point")
            if number == phi and not rough:
                sub = figure.add_subplot(2, 2, 2 * row + 2)
                fields.draw(sub, field, "$\\phi$")
                sub.set_title(f"smooth ends after {found['t'][-1]:.2f} cycles", fontsize=9)
        axes.set(ylabel=f"mean $p\\,d/k$, $\\phi$ = {phi:.2f}")
        axes.legend(frameon=False, fontsize=8)
    axes.set_xlabel("cycles of shear strain $\\pm$0.1, then one way")
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
