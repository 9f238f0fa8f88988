# %% [markdown]
# # Errors of the packing in whole rings
#
# The annular shear cell of annulus.py, whole, starts with random errors in phi, different in every cell, and is turned and turned
# back. Around each ring of cells p and the shear rate then scatter. Where short waves grow without bound they scatter the more the
# finer the mesh is. On one rank.

# %%
from itertools import product

import fields
import numpy as np
from annular_cell import PRESSURE, ring, save, uneven
from matplotlib.figure import Figure

from granumat import Material, fem

SAND = Material(0.5, elastic_strain=0.01)
ERRORS = 1e-6                                       # of phi, at most
MESHES = ((8, 32), (16, 64))                        # rings, cells of each
LENGTHS = (0.0, 0.05, 0.1)
TURN, BACK, INCREMENT = 0.12, 0.08, 0.004
SHORT = {"meshes": ((8, 16), (16, 32)), "lengths": (0.0, 0.1), "increment": 0.02}
HALVES = ("loading", "back")
COLUMNS = ("length", "rings", "path", "p", "shear_rate")


# %%
def attempt(length, shape, increment):
    """Rows of COLUMNS: standard deviations around the ring of cells where they are largest, over means, and over that of phi."""
    start = uneven(SAND.isotropic(0.60, pressure=PRESSURE), np.prod(shape), ERRORS)
    problem, _ = ring(SAND, *shape, TURN, start=start, length=length)
    middle = problem.body.at_cells(problem.positions).mean(axis=1)
    by_ring = np.argsort(np.round(np.hypot(*middle.T), 6), kind="stable").reshape(shape)
    phi = fem.cell_fields(problem, ["phi"])["phi"]
    errors, rows = phi.std() / phi.mean(), []

    def scatter(values):
        return (values[by_ring].std(axis=1) / values[by_ring].mean(axis=1)).max() / errors

    def watch(problem):
        if problem.last is not None:
            found = fem.cell_fields(problem, ["p", "nonlocal_strain", "R"])
            rows.append(dict(zip(COLUMNS, (length, shape[0], problem.t, scatter(found["p"]),
                                           scatter(found["nonlocal_strain"] * found["R"])))))

    fem.run(problem, TURN + BACK, increment, events=[TURN], observers=[watch])
    assert len(rows) == round((TURN + BACK) / increment)                # none was cut
    return rows


# %%
def main(meshes=MESHES, lengths=LENGTHS, increment=INCREMENT, out=None):
    runs = {case: attempt(*case, increment) for case in product(lengths, meshes)}
    largest = {}
    for (length, (rings, cells)), rows in runs.items():
        for half in HALVES:
            part = [row for row in rows if (row["path"] > TURN) == (half == "back")]
            largest[length, rings, half] = {name: max(row[name] for row in part) for name in COLUMNS[3:]}
            print(f"length {length:g}, {rings} x {cells} cells, {half}: " +
                  ", ".join(f"{name} {value:.3g}" for name, value in largest[length, rings, half].items()), flush=True)
    if out:
        save(out, "noisy-rings", COLUMNS, [row for rows in runs.values() for row in rows], draw(runs))
    for length, half in product(lengths, HALVES):
        coarse, fine = (largest[length, rings, half] for rings, _ in meshes)
        if length:                                  # bounded, and not growing with refinement
            assert fine["p"] < 4 and fine["shear_rate"] < coarse["shear_rate"] < 12
        elif half == "loading":
            assert fine["shear_rate"] > 2 * coarse["shear_rate"]
    return largest


def draw(runs):
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    lengths, rings = ({case[0]: None for case in runs}, {case[1][0]: None for case in runs})
    lines = dict(zip(rings, ("--", "-")))
    for axes, name, label in zip(figure.subplots(1, 2), COLUMNS[3:], ("p", "the shear rate")):
        for (length, (n, cells)), rows in runs.items():
            path, values = np.transpose([(row["path"], row[name]) for row in rows])
            axes.plot(path, values, lines[n], color=f"C{list(lengths).index(length)}",
                      label=f"$l$ = {length:g}, {n} x {cells} cells")
        axes.axvline(TURN, color="0.7", linewidth=0.8, zorder=0)
        axes.set(xlabel="path of the inner wall [rad]", ylabel=f"scatter of {label} over that of phi")
    axes.set_yscale("log")
    axes.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
