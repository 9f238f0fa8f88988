"""Meshes of the standard geometries."""

import dolfinx.mesh
import numpy as np

from ..checks import refuse
from ._compat import mesh_of

CELLS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}


def box(comm, size, cells, cell=None):
    """A rectangle (2 sizes) or a block (3), one corner at 0.

    Parameters
    ----------
    comm : MPI communicator
    size : sequence of 2 or 3 floats
    cells : sequence of as many ints
        Along each side.
    cell : str, optional
        "quadrilateral" or "triangle"; "hexahedron" or "tetrahedron".
    """
    cell = check_box(size, cells, cell)
    kind = getattr(dolfinx.mesh.CellType, cell)
    create = dolfinx.mesh.create_rectangle if len(size) == 2 else dolfinx.mesh.create_box
    return create(comm, [np.zeros(len(size)), np.asarray(size, float)], list(cells), kind)


def annulus(comm, radii, cells, height=None, cell=None, grading=1.0, angle=2 * np.pi):
    """A ring about the z axis, or a part of it from the x axis on; a hollow cylinder from z = 0 where a height is given.

    Parameters
    ----------
    comm : MPI communicator
    radii : (float, float)
        Inner and outer.
    cells : (rings, sectors) or (rings, sectors, layers)
    height : float, optional
    cell : str, optional
        As in box.
    grading : float, optional
        Ratio of the outermost ring's width to the innermost's.
    angle : float, optional
        Of a part, to be tied to itself by Periodic with polar axes; the sectors are then those of the part.
    """
    cell = check_annulus(radii, cells, height, cell, grading, angle)
    rings, sectors = cells[:2]
    widths = np.geomspace(1, grading, rings)
    r = radii[0] + (radii[1] - radii[0]) * np.concatenate([[0], np.cumsum(widths) / widths.sum()])
    r[-1] = radii[1]
    rays = sectors if angle == 2 * np.pi else sectors + 1
    theta = angle * np.arange(rays) / sectors
    plane = np.stack([np.outer(r, np.cos(theta)).ravel(), np.outer(r, np.sin(theta)).ravel()], axis=1)
    i, j = np.divmod(np.arange(rings * sectors), sectors)
    corners = np.stack([i * rays + j, (i + 1) * rays + j, i * rays + (j + 1) % rays, (i + 1) * rays + (j + 1) % rays], axis=1)
    if height is not None:
        z = np.linspace(0, height, cells[2] + 1)
        plane = np.concatenate([np.hstack([plane, np.full((len(plane), 1), level)]) for level in z])
        step = (rings + 1) * rays
        corners = np.concatenate([np.hstack([corners + k * step, corners + (k + 1) * step]) for k in range(cells[2])])
    return mesh_of(comm, cell, _split(corners, cell), plane)


def _split(corners, cell):
    """Quadrilaterals into two triangles, hexahedra into six tetrahedra, all along the same diagonal."""
    if cell == "triangle":
        return corners[:, [[0, 1, 3], [0, 2, 3]]].reshape(-1, 3)
    if cell == "tetrahedron":
        ways = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]]
        return corners[:, ways].reshape(-1, 4)
    return corners


def check_annulus(radii, cells, height=None, cell=None, grading=1.0, angle=2 * np.pi):
    """The name of the cells' shape; ValueError where annulus cannot be made of its arguments."""
    sizes = (radii[0], radii[1] - radii[0], *(() if height is None else (height,)))
    return check_box(sizes[-2:] if height is None else sizes, cells, cell,
                     radii[0] > 0 and cells[1] * 2 * np.pi >= 3 * angle > 0 and angle <= 2 * np.pi and grading > 0)


def check_box(size, cells, cell=None, more=True):
    """The name of the cells' shape; ValueError where box cannot be made of its arguments."""
    faults = []
    if len(size) not in (2, 3) or not (np.asarray(size, float) > 0).all() or not more:
        faults.append(f"sizes {size!r}: must be 2 or 3 numbers above 0; of a ring also radius, grading, and "
                      "angle, at most 2 pi, and 3 sectors or more a turn")
    elif len(cells) != len(size) or not all(isinstance(count, (int, np.integer)) and count > 0 for count in cells):
        faults.append(f"cells = {cells!r}: must be {len(size)} integers above 0")
    elif cell is not None and cell not in CELLS[len(size)]:
        faults.append(f"cell = {cell!r}: must be one of {', '.join(CELLS[len(size)])}")
    refuse("the mesh cannot be made", faults)
    return cell or CELLS[len(size)][0]
