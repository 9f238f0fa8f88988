# %% [markdown]
# # Where it fails: the annulus over closures, elastic strains and increments, with and without a length
#
# One sector of the annular shear cell, tied to itself, is turned and turned back with every closure, elastic strain e_r and
# increment, without a length and with one. Recorded are how far the increment had to be cut, where the run stopped and why, and the
# least transverse modulus eta_t of the points, which is negative where ellipticity is lost (`granumat wellposed`).
# `docs/where-it-fails.md` discusses the map.

# %%
import warnings
from itertools import product

import fields
import numpy as np
from annular_cell import PRESSURE, Watch, ring, save
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

CLOSURES = ("basic", "n2", "full", "kinematic", "critical")
ELASTIC_STRAINS = (1e-2, 1e-3, 1e-4, 0.0)
INCREMENTS = (0.008, 0.002, 0.0005)             # radians; 16 times as much shear in the first of 16 rings, once it has localised
LENGTHS = (0.0, 0.05, 0.1)                      # 16 rings are 1.25 and 0.62 of the lengths wide
RINGS, PART, TURN, BACK = 16, 1 / 48, 0.12, 0.08
SMALLEST = 1 / 256                              # of an increment: it is not cut to less
SHORT = {"closures": ("full", "basic"), "elastic_strains": (1e-2, 0.0), "increments": (0.008,), "lengths": (0.0, 0.1)}
COLUMNS = ("length", "closure", "elastic_strain", "increment", "reached", "cut_to", "iterations", "torque", "eta_t", "why")


# %%
def attempt(length, closure, elastic_strain, increment, mu=0.5):
    """A row of COLUMNS, and (path, least eta_t of all points) after every increment."""
    sand = Material(mu, closure=closure, elastic_strain=elastic_strain)
    start = sand.isotropic(0.60) if closure == "critical" else sand.isotropic(0.60, pressure=PRESSURE)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "a length does not suit")         # what it does to such closures is to be seen
        problem, inner = ring(sand, RINGS, 1, TURN, part=PART, start=start, length=length)
    watch, moduli = Watch(problem, inner, RINGS, PART), []

    def least(problem):
        mine = sand.transverse_modulus(problem.states).min(initial=np.inf)
        moduli.append((problem.t, problem.comm.allreduce(mine, MPI.MIN)))

    why = ""
    try:
        fem.run(problem, TURN + BACK, increment, smallest=SMALLEST * increment, events=[TURN], observers=[watch, least])
    except fem.SolveError as error:
        why = str(error)
    columns = watch.columns()
    moduli = np.array(moduli)
    steps = np.diff(moduli[:, 0])[:-1]                          # without the last one, which `until` may have shortened
    return dict(zip(COLUMNS, (
        length, closure, elastic_strain, increment, problem.t, min([1.0, *steps / increment]) if not why else 0.0,
        np.mean(columns.get("iterations", 0.0)), np.append(0.0, columns.get("torque", []))[-1], moduli[:, 1].min(), why))), moduli


# %%
def main(closures=CLOSURES, elastic_strains=ELASTIC_STRAINS, increments=INCREMENTS, lengths=LENGTHS, out=None):
    found = []
    for case in product(lengths, closures, elastic_strains, increments):
        found.append(attempt(*case))
        print(in_words(found[-1][0]), flush=True) if MPI.COMM_WORLD.rank == 0 else None
    rows = [row for row, _ in found]
    moduli = {}                     # by length and closure, preferring e_r = 0.01, then small increments
    for row, path in sorted(found, key=lambda pair: (pair[0]["elastic_strain"] == 0.01, -pair[0]["increment"])):
        moduli[row["length"], row["closure"]] = path
    if out and MPI.COMM_WORLD.rank == 0:
        save(out, "where_it_fails", COLUMNS, rows, draw(rows, moduli))
    for row in rows:                # full and kinematic never give up at e_r = 0.01, with a length at no e_r above 0
        if row["closure"] in ("full", "kinematic") and row["elastic_strain"] > (0 if row["length"] else 0.001):
            assert not row["why"] and (row["length"] or row["cut_to"] > 0.999)
    return rows


def in_words(row):
    outcome = f"stops at {row['reached']:.4f}" if row["why"] else f"goes through, cut to {row['cut_to']:.3g}"
    return (f"l {row['length']:<4g} {row['closure']:9} e_r {row['elastic_strain']:<6g} increment {row['increment']:<6g} "
            f"{outcome:28} {row['iterations']:.2f} iterations, torque {row['torque']:+.4f}, least eta_t {row['eta_t']:+.3f}")


def draw(rows, moduli):
    lengths, closures, strains, increments = (list(dict.fromkeys(row[name] for row in rows)) for name in COLUMNS[:4])
    figure = Figure(figsize=(12, 2.2 + 3 * len(lengths)), layout="constrained")
    *upper, lower = figure.subfigures(len(lengths) + 1, 1, height_ratios=[3] * len(lengths) + [2])
    for part, length in zip(upper, lengths):
        for axes, closure in zip(part.subplots(1, len(closures), squeeze=False)[0], closures):
            for row in (row for row in rows if (row["length"], row["closure"]) == (length, closure)):
                draw_outcome(axes, row, increments.index(row["increment"]), strains.index(row["elastic_strain"]))
            axes.set(title=closure, xlabel="increment [rad]", xticks=np.arange(len(increments)) + 0.5, xticklabels=increments,
                     yticks=np.arange(len(strains)) + 0.5, yticklabels=strains, xlim=(0, len(increments)), ylim=(len(strains), 0))
            axes.tick_params(length=0)
        part.axes[0].set_ylabel(f"$l$ = {length:g}: elastic strain $e_r$")
    axes, styles = lower.subplots(), dict(zip(lengths, ("-", "--", ":")))
    for (length, closure), path in moduli.items():
        axes.plot(path[:, 0] - TURN, path[:, 1], styles[length], color=f"C{closures.index(closure)}",
                  label=None if length else closure)
    axes.axhline(0, color="0.6", linewidth=0.8)
    axes.set(xlabel="path of the inner wall from its reversal on [rad]; full, dashed, dotted: the lengths",
             ylabel=r"least $\eta_t$ of all points", xlim=(-TURN, BACK))
    axes.legend(frameon=False, ncols=len(closures))
    return figure


def draw_outcome(axes, row, x, y):
    """A field of the map: how a row's run ended."""
    if not row["why"]:
        colour, text = ("#9fd3b6" if row["cut_to"] > 0.99 else "#f0e08a"), f"{row['iterations']:.1f}"
        text += "" if row["cut_to"] > 0.99 else f"\ncut {row['cut_to']:.2g}"
    else:
        colour, text = ("#e8a58e" if row["reached"] < TURN - 1e-9 else "#e6b8d3"), f"stops\n{row['reached'] - TURN:+.3f}"
    axes.fill([x, x + 1, x + 1, x], [y, y, y + 1, y + 1], color=colour, edgecolor="white")
    axes.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=7.5)


if __name__ == "__main__":
    main(out=fields.directory())
