"""Fields of plane bodies in the pictures of the demos."""

import numpy as np
from matplotlib.collections import PolyCollection


def on_rank_0(problem, values):
    """Corners (cells, 3 or 4, 2) of all cells as they are now and means (cells) of values (points); None on other ranks."""
    x = problem.mesh.geometry.x
    corners = _vertices(problem)
    weights = problem.point_volumes().reshape(problem.cells, -1)
    means = (values.reshape(weights.shape) * weights).sum(axis=1) / weights.sum(axis=1)
    parts = problem.comm.gather((corners, means))
    return None if parts is None else tuple(np.concatenate(part) for part in zip(*parts))


def _vertices(problem):
    nodes = problem.positions + problem.displacement
    corners = nodes[problem._nodes]
    order = {3: [0, 1, 2], 4: [0, 1, 3, 2]}[corners.shape[1]]
    return corners[:, order]


def draw(axes, field, label, **options):
    """A field of on_rank_0 in colours, with a colour bar."""
    corners, values = field
    patches = PolyCollection(corners, array=values, edgecolors="face", linewidths=0.2, **options)
    axes.add_collection(patches)
    axes.autoscale()
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.figure.colorbar(patches, ax=axes, label=label, shrink=0.8)
