# %% [markdown]
# # What the two regularisations change
#
# The elastic strain e_r and the rate term alpha, each small and larger, on three meshes of the annular shear cell (one sector tied
# to itself): what they change in the torque and the pressure, and what is left of the mesh dependence. The rate term's shear rate
# is per radian that the wall turns; as the gap is as wide as the inner radius, that is the mean shear rate over the gap.

# %%
from itertools import product

import fields
import numpy as np
from annular_cell import Watch, ring, save, sheared_zone
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

MESHES = (8, 16, 32)
ELASTIC_STRAINS = (1e-3, 1e-2)
RATE_TERMS = (0.0, 0.01, 0.05)
TURN, BACK, INCREMENT, SECTORS = 0.12, 0.08, 0.002, 96
SHORT = {"meshes": (8, 16), "elastic_strains": (1e-2,), "rate_terms": (0.0, 0.05), "increment": 0.01}
COLUMNS = ("elastic_strain", "rate_term", "rings", "torque", "torque_back", "pressure", "width", "iterations", "reached")


# %%
def attempt(elastic_strain, rate_term, rings, increment):
    """A row of COLUMNS (torque and pressure at the reversal, torque_back a quarter of the way back), and Watch's columns."""
    sand = Material(0.5, elastic_strain=elastic_strain)
    problem, inner = ring(sand, rings, 1, TURN, part=1 / SECTORS, rate_term=rate_term)
    watch, wide = Watch(problem, inner, rings, 1 / SECTORS), []

    try:
        fem.run(problem, TURN + BACK, increment, events=[TURN],
                observers=[watch, lambda problem: wide.append(sheared_zone(problem)) if problem.t == TURN else None])
    except fem.SolveError as error:
        print(error) if problem.comm.rank == 0 else None
    columns = watch.columns()
    at, back = (np.argmin(abs(columns["path"] - path)) for path in (TURN, TURN + BACK / 4))
    return dict(zip(COLUMNS, (
        elastic_strain, rate_term, rings, columns["torque"][at], columns["torque"][back], columns["pressure"][at],
        np.append(wide, np.nan)[0], columns["iterations"].mean(), problem.t))), columns


# %%
def main(meshes=MESHES, elastic_strains=ELASTIC_STRAINS, rate_terms=RATE_TERMS, increment=INCREMENT, out=None):
    rows, paths = [], {}
    for case in product(elastic_strains, rate_terms, meshes):
        row, paths[case] = attempt(*case, increment)
        rows.append(row)
        if MPI.COMM_WORLD.rank == 0:
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
    if out and MPI.COMM_WORLD.rank == 0:
        save(out, "regularisation", COLUMNS, rows, draw(rows, paths))
    found = {(row["elastic_strain"], row["rate_term"], row["rings"]): row["width"] for row in rows}
    for elastic_strain in elastic_strains:              # only with a rate term the width does not depend on the mesh
        coarse, fine = ({alpha: found[elastic_strain, alpha, rings] for alpha in rate_terms} for rings in meshes[-2:])
        assert fine[0.0] < 0.6 * coarse[0.0]
        assert abs(fine[max(rate_terms)] / coarse[max(rate_terms)] - 1) < 0.05
    return rows


def draw(rows, paths):
    strains, alphas, meshes = (sorted({row[name] for row in rows}) for name in COLUMNS[:3])
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    upper, lower = (part.subplots(1, count) for part, count in zip(figure.subfigures(2, 1), (len(alphas), 3)))
    colours, lines = dict(zip(meshes, ("#E69F00", "#009E73", "#0072B2"))), dict(zip(reversed(strains), ("-", ":")))
    for axes, rate_term in zip(upper, alphas):
        for (elastic_strain, alpha, rings), columns in paths.items():
            if alpha == rate_term:
                axes.plot(columns["path"], columns["torque"], lines[elastic_strain], color=colours[rings],
                          label=f"{rings} rings, $e_r$ = {elastic_strain:g}")
        axes.set(title=rf"rate term $\alpha$ = {rate_term:g}", xlabel="path of the inner wall [rad]",
                 ylabel="torque per height [k/d]", ylim=(-0.03, 0.038))
    upper[0].legend(frameon=False, fontsize=7.5)
    labels = {"width": "width of the sheared zone", "torque": "torque at the reversal [k/d]",
              "pressure": "pressure, first ring, at the reversal [k/d]"}
    for axes, (name, label) in zip(lower, labels.items()):
        for rate_term, marker in zip(alphas, "osd"):
            for elastic_strain in strains:
                values = [row[name] for row in rows if (row["elastic_strain"], row["rate_term"]) == (elastic_strain, rate_term)]
                axes.plot(meshes, values, lines[elastic_strain] + marker, color=f"C{alphas.index(rate_term)}", markersize=4,
                          label=rf"$\alpha$ = {rate_term:g}, $e_r$ = {elastic_strain:g}")
        axes.set(xlabel="rings of cells", ylabel=label, xscale="log", xticks=meshes, xticklabels=meshes)
        axes.minorticks_off()
    lower[0].set(yscale="log", ylim=(0.005, 0.6))
    lower[0].legend(frameon=False, fontsize=7.5, ncols=2, loc="lower left")
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
