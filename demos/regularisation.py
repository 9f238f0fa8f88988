# %% [markdown]
# # What the three regularisations change
#
# The elastic strain e_r, the rate term alpha and the length l, each small and larger, on three meshes of the annular shear cell
# (one sector tied to itself): what they change in the torque, what is left of the mesh dependence, and what a width of the sheared
# zone costs in torque. The rate term's shear rate is per radian that the wall turns; as the gap is as wide as the inner radius,
# that is the mean shear rate over the gap.

# %%
from itertools import pairwise, product

import fields
import numpy as np
from annular_cell import Watch, ring, save, sheared_zone
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

MESHES = (16, 32, 64)
ELASTIC_STRAINS = (1e-3, 1e-2)
CASES = ((0.0, 0.0), (0.01, 0.0), (0.02, 0.0), (0.05, 0.0), (0.0, 0.025), (0.0, 0.05), (0.0, 0.1))         # alpha, l
TURN, BACK, INCREMENT = 0.12, 0.08, 0.002
SHORT = {"meshes": (8, 16), "elastic_strains": (1e-2,), "cases": ((0.0, 0.0), (0.05, 0.0), (0.0, 0.2)), "increment": 0.01}
COLUMNS = ("elastic_strain", "rate_term", "length", "rings", "torque", "torque_back", "pressure", "width", "iterations",
           "increments")


# %%
def attempt(elastic_strain, rate_term, length, rings, increment):
    """A row of COLUMNS (torque and pressure at the reversal, torque_back a quarter of the way back), and Watch's columns."""
    sand, part = Material(0.5, elastic_strain=elastic_strain), 1 / round(2 * np.pi * rings)
    problem, inner = ring(sand, rings, 1, TURN, part=part, rate_term=rate_term, length=length)
    watch, wide = Watch(problem, inner, rings, part), []
    fem.run(problem, TURN + BACK, increment, events=[TURN],
            observers=[watch, lambda problem: wide.append(sheared_zone(problem)) if problem.t == TURN else None])
    columns = watch.columns()
    at, back = (np.argmin(abs(columns["path"] - path)) for path in (TURN, TURN + BACK / 4))
    return dict(zip(COLUMNS, (
        elastic_strain, rate_term, length, rings, columns["torque"][at], columns["torque"][back], columns["pressure"][at], wide[0],
        columns["iterations"].mean(), len(columns["path"])))), columns


# %%
def main(meshes=MESHES, elastic_strains=ELASTIC_STRAINS, cases=CASES, increment=INCREMENT, out=None):
    rows, paths = [], {}
    for elastic_strain, case, rings in product(elastic_strains, cases, meshes):
        row, paths[elastic_strain, *case, rings] = attempt(elastic_strain, *case, rings, increment)
        rows.append(row)
        if MPI.COMM_WORLD.rank == 0:
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
    if out and MPI.COMM_WORLD.rank == 0:
        save(out, "regularisation", COLUMNS, rows, draw(rows, paths))
    for coarse, fine in pairwise(rows):                # of the two finest meshes; without alpha and l the width follows the mesh
        if (coarse["rings"], fine["rings"]) == meshes[-2:]:
            ratio = fine["width"] / coarse["width"]
            assert abs(ratio - 1) < 0.1 if fine["rate_term"] or fine["length"] else ratio < 0.6
    return rows


def draw(rows, paths):
    strains, meshes = (sorted({row[name] for row in rows}) for name in ("elastic_strain", "rings"))
    cases = list(dict.fromkeys((row["rate_term"], row["length"]) for row in rows))
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 3)
    colours, lines = dict(zip(meshes, ("#E69F00", "#009E73", "#0072B2"))), dict(zip(reversed(strains), ("-", ":")))
    for axes, shown in zip(upper, (min(cases), max(cases), max(cases, key=lambda case: case[1]))):
        for (elastic_strain, *case, rings), columns in paths.items():
            if tuple(case) == shown:
                axes.plot(columns["path"], columns["torque"], lines[elastic_strain], color=colours[rings],
                          label=f"{rings} rings, $e_r$ = {elastic_strain:g}")
        axes.set(title=in_words(*shown), xlabel="path of the inner wall [rad]", ylabel="torque per height [k/d]",
                 ylim=(-0.03, 0.038))
    upper[0].legend(frameon=False, fontsize=7.5)
    for strain, (count, case) in product(strains, enumerate(cases)):
        found = chosen(rows, strain, *case)
        for axes, name in zip(lower, ("width", "torque")):
            axes.plot(meshes, [row[name] for row in found], lines[strain] + "osv"[kind(*case)], color=f"C{count}", markersize=4,
                      label=in_words(*case) if strain == strains[-1] else None)
    for axes, label in zip(lower, ("width of the sheared zone", "torque at the reversal [k/d]")):
        axes.set(xlabel="rings of cells", ylabel=label, xscale="log", xticks=meshes, xticklabels=meshes)
        axes.minorticks_off()
    lower[0].set(yscale="log", ylim=(0.003, 0.8))
    lower[0].legend(frameon=False, fontsize=7.5, ncols=2, loc="lower left")
    for strain, which in product(strains, (1, 2)):
        finest = [chosen(rows, strain, *case)[-1] for case in cases if kind(*case) in (0, which)]
        lower[2].plot([row["width"] for row in finest], [row["torque"] for row in finest], lines[strain] + "osv"[which],
                      color=("#D55E00", "#0072B2")[which - 1], markersize=4,
                      label=("rate term", "length")[which - 1] + f", $e_r$ = {strain:g}")
    lower[2].set(xlabel=f"width of the sheared zone, {meshes[-1]} rings", ylabel="torque at the reversal [k/d]")
    lower[2].legend(frameon=False, fontsize=7.5)
    return figure


def chosen(rows, *case):
    """The rows of an elastic strain, rate term and length, by mesh."""
    return [row for row in rows if (row["elastic_strain"], row["rate_term"], row["length"]) == case]


def kind(rate_term, length):
    """0: neither, 1: a rate term, 2: a length."""
    return (rate_term > 0) + 2 * (length > 0)


def in_words(rate_term, length):
    return ("neither rate term nor length", rf"$\alpha$ = {rate_term:g}", f"$l$ = {length:g}")[kind(rate_term, length)]


if __name__ == "__main__":
    main(out=fields.directory())
