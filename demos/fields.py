"""What the demos share: output directory, fields of plane bodies, means over layers."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection

from granumat import fem


def on_rank_0(problem, name):
    """Corners (cells, 4, 2) of all quadrilaterals as they are now and one of fem.cell_fields (cells); None on other ranks."""
    dofmap = problem.space.dofmap
    nodes = np.array([dofmap.cell_dofs(cell)[[0, 1, 3, 2]] for cell in range(problem.cells)], int).reshape(-1, 4)
    parts = problem.comm.gather(((problem.positions + problem.displacement)[nodes], fem.cell_fields(problem)[name]))
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


def over_layers(problem, heights, layers, values):
    """Means (layers) of values (points) over layers of equal height, on all ranks; heights (points) are 0 to 1."""
    layer = np.minimum(heights * layers, layers - 0.5).astype(int)
    total, points = problem.comm.allreduce(np.stack([np.bincount(layer, values, layers), np.bincount(layer, minlength=layers)]))
    return total / points


def directory():
    """The directory that the command line names, results/fem if it names none."""
    return sys.argv[1] if len(sys.argv) > 1 else "results/fem"


def save(figure, out, name):
    """Writes a figure as NAME.png into the directory `out`."""
    Path(out).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(out) / f"{name}.png", dpi=80)
