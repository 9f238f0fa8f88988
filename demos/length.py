# %% [markdown]
# # What a length changes
#
# The annular shear cell of annulus.py (one sector tied to itself) on three meshes, with no length and with three: torque and width
# of the sheared zone settle where the cells are smaller than the length, and both grow with it. Cells are about as long around the
# inner wall as across it.

# %%
from itertools import product

import fields
import numpy as np
from annular_cell import Watch, ring, save, sheared_zone
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

SAND = Material(0.5, elastic_strain=0.01)
MESHES = (16, 32, 64)
LENGTHS = (0.0, 0.05, 0.1, 0.2)
TURN, BACK, INCREMENT = 0.12, 0.08, 0.002
SHORT = {"meshes": (8, 16), "lengths": (0.0, 0.2), "increment": 0.01}
COLUMNS = ("length", "rings", "torque", "torque_end", "width", "iterations", "increments")


# %%
def attempt(length, rings, increment):
    """A row of COLUMNS (torque and width at the reversal), and Watch's columns."""
    part = 1 / round(2 * np.pi * rings)
    problem, inner = ring(SAND, rings, 1, TURN, part=part, length=length)
    watch, wide = Watch(problem, inner, rings, part), []
    fem.run(problem, TURN + BACK, increment, events=[TURN],
            observers=[watch, lambda problem: wide.append(sheared_zone(problem)) if problem.t == TURN else None])
    columns = watch.columns()
    torque = columns["torque"]
    return dict(zip(COLUMNS, (length, rings, torque[np.argmin(abs(columns["path"] - TURN))], torque[-1], wide[0],
                              columns["iterations"].mean(), len(torque)))), columns


# %%
def main(meshes=MESHES, lengths=LENGTHS, increment=INCREMENT, out=None):
    rows, paths = [], {}
    for case in product(lengths, meshes):
        row, paths[case] = attempt(*case, increment)
        rows.append(row)
        if MPI.COMM_WORLD.rank == 0:
            print("  ".join(f"{name} {value:.5g}" for name, value in row.items()), flush=True)
    if out and MPI.COMM_WORLD.rank == 0:
        save(out, "length", COLUMNS, rows, draw(rows, paths))
    found = {(row["length"], row["rings"]): row for row in rows}
    for length in lengths:                              # only with a length torque and width do not depend on the mesh
        coarse, fine = (found[length, rings] for rings in meshes[-2:])
        if length == 0:
            assert fine["width"] < 0.6 * coarse["width"]
        else:
            assert abs(fine["width"] / coarse["width"] - 1) < 0.06 and abs(fine["torque"] / coarse["torque"] - 1) < 0.02
        assert fine["increments"] == round((TURN + BACK) / increment)              # none was cut
    return rows


def draw(rows, paths):
    lengths, meshes = (sorted({row[name] for row in rows}) for name in COLUMNS[:2])
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    panels = figure.subplots(1, 3)
    lines = dict(zip(meshes, (":", "--", "-")))
    for (length, rings), columns in paths.items():
        panels[0].plot(columns["path"], columns["torque"], lines[rings], color=f"C{lengths.index(length)}",
                       label=f"$l$ = {length:g}" if rings == meshes[-1] else None)
    panels[0].set(xlabel="path of the inner wall [rad]", ylabel="torque per height [k/d]")
    panels[0].legend(frameon=False)
    for axes, name, label in zip(panels[1:], ("torque", "width"), ("torque at the reversal [k/d]", "width of the sheared zone")):
        for length in lengths:
            axes.plot(meshes, [row[name] for row in rows if row["length"] == length], "o-", label=f"$l$ = {length:g}")
        axes.set(xlabel="rings of cells", ylabel=label, xscale="log", xticks=meshes, xticklabels=meshes)
        axes.minorticks_off()
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
