"""Pictures of the demos, and fields of plane bodies in them."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection


def on_rank_0(problem, values):
    """Corners (cells, 3 or 4, 2) of all cells as they are now and means (cells) of values (points); None on other ranks."""
    corners = (problem.positions + problem.displacement)[problem._nodes]
    around = {3: [0, 1, 2], 4: [0, 1, 3, 2]}[corners.shape[1]]
    weights = problem.point_volumes().reshape(problem.cells, -1)
    means = (values.reshape(weights.shape) * weights).sum(axis=1) / weights.sum(axis=1)
    parts = problem.comm.gather((corners[:, around], means))
    return None if parts is None else tuple(np.concatenate(part) for part in zip(*parts))


def draw(axes, field, label):
    """A field of on_rank_0 in colours, with a colour bar."""
    corners, values = field
    patches = PolyCollection(corners, array=values, edgecolors="face", linewidths=0.2)
    axes.add_collection(patches)
    axes.autoscale()
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.figure.colorbar(patches, ax=axes, label=label, shrink=0.8)


def save(figure, name):
    """Into the directory that the command line names, results/fem if it names none."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "results/fem")
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / name, dpi=80)
