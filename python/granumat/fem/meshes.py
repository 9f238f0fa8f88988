"""Meshes of the standard geometries and of gmsh files."""

import math
from collections.abc import Sequence, Sized
from pathlib import Path
from typing import Any

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from ..checks import LARGEST_COUNT, is_finite_number, is_positive_integer, refuse
from ._compat import FacetTags, create_mesh, gmsh_reader, quiet_compiler

CELL_SHAPES = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}

GMSH_CELLS = {2: (2, 9, 3, 10), 3: (4, 11, 5, 12)}             # gmsh's numbers of these shapes, of first and second order


def box(comm: MPI.Comm, size: Sequence[float], cells: Sequence[int], cell: str | None = None,
        grading: Sequence[float] | None = None) -> dolfinx.mesh.Mesh:
    """A rectangle (2 sizes) or a block (3), one corner at 0.

    Parameters
    ----------
    comm : MPI communicator
    size : sequence of 2 or 3 floats
    cells : sequence of as many ints
        Along each side.
    cell : str, optional
        "quadrilateral" or "triangle"; "hexahedron" or "tetrahedron".
    grading : sequence of as many floats, optional
        Along each side, ratio of the last cell's width to the first's, which is at 0; widths form a geometric series.

    Raises
    ------
    ValueError
        The mesh cannot be made of the arguments.
    """
    cell = check_box(size, cells, cell, grading)
    cell_type = getattr(dolfinx.mesh.CellType, cell)
    create = dolfinx.mesh.create_rectangle if len(size) == 2 else dolfinx.mesh.create_box
    mesh = create(comm, [np.zeros(len(size)), np.asarray(size, float)], list(cells), cell_type)
    for axis, ratio in enumerate(grading or ()):
        if ratio != 1:
            x = mesh.geometry.x
            x[:, axis] = _graded(size[axis], cells[axis], ratio)[np.rint(x[:, axis] / size[axis] * cells[axis]).astype(int)]
    return mesh


def _graded(length: float, cells: int, grading: float) -> np.ndarray:
    """Ends (cells + 1) of cells from 0 to a length, the widths a geometric series whose last is `grading` times the first."""
    widths = np.geomspace(1, grading, cells)
    ends = length * np.concatenate([[0], np.cumsum(widths) / widths.sum()])
    ends[-1] = length
    return ends


def annulus(comm: MPI.Comm, radii: Sequence[float], cells: Sequence[int], height: float | None = None, cell: str | None = None,
            grading: float = 1.0, angle: float = 2 * np.pi) -> dolfinx.mesh.Mesh:
    """A ring about the z axis, or a sector of it that begins at the x axis; with a height a hollow cylinder on z = 0.

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
        Of a sector, whose two sides Periodic with polar axes ties together; `cells` are then those of the sector.

    Raises
    ------
    ValueError
        The mesh cannot be made of the arguments.
    """
    cell = check_annulus(radii, cells, height, cell, grading, angle)
    rings, sectors = cells[:2]
    r = radii[0] + _graded(radii[1] - radii[0], rings, grading)
    r[-1] = radii[1]                                             # without round-off
    rays = sectors if angle == 2 * np.pi else sectors + 1
    theta = angle * np.arange(rays) / sectors
    positions = np.stack([np.outer(r, np.cos(theta)).ravel(), np.outer(r, np.sin(theta)).ravel()], axis=1)
    i, j = np.divmod(np.arange(rings * sectors), sectors)
    corners = np.stack([i * rays + j, (i + 1) * rays + j, i * rays + (j + 1) % rays, (i + 1) * rays + (j + 1) % rays], axis=1)
    if height is not None:
        levels = np.linspace(0, height, cells[2] + 1)
        positions = np.concatenate([np.hstack([positions, np.full((len(positions), 1), z)]) for z in levels])
        step = (rings + 1) * rays
        corners = np.concatenate([np.hstack([corners + k * step, corners + (k + 1) * step]) for k in range(cells[2])])
    return create_mesh(comm, cell, _split(corners, cell), positions)


def from_gmsh(comm: MPI.Comm, file: str | Path) -> tuple[dolfinx.mesh.Mesh, FacetTags, dict[str, int]]:
    """The mesh of a gmsh file.

    Returns
    -------
    mesh : dolfinx.mesh.Mesh
    facet_tags : dolfinx.mesh.MeshTags
    names : dict
        The tags of the facets' physical names.

    Raises
    ------
    ImportError
        The Python module of gmsh is missing.
    ValueError
        gmsh cannot read the file, or it names no cells, or such that the solver has no elements for; the same on all ranks.
    """
    try:
        import gmsh
    except ImportError:
        raise ImportError("meshes from gmsh files need the Python module of gmsh (Debian: python3-gmsh)") from None
    found, fault = None, None
    if comm.rank == 0:
        gmsh.initialize()
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.open(str(file))
            d = gmsh.model.getDimension()
            groups = gmsh.model.getPhysicalGroups()
            fault = _gmsh_fault(gmsh.model, d, groups)
            names = {gmsh.model.getPhysicalName(*group): group[1] for group in groups if group[0] == d - 1}
            found = d, {name: tag for name, tag in names.items() if name}
        except Exception as error:                               # gmsh raises nothing more special
            fault = f"cannot be read by gmsh: {error}"
    fault, found = comm.bcast((fault, found))
    if fault is None:
        with quiet_compiler():
            mesh_and_tags = gmsh_reader().model_to_mesh(gmsh.model, comm, 0, gdim=found[0])
    if comm.rank == 0:
        gmsh.finalize()
    if fault is not None:
        raise ValueError(f"{file}: {fault}")
    return mesh_and_tags[0], mesh_and_tags[2], found[1]


def _gmsh_fault(model: Any, d: int, groups: Sequence[tuple[int, int]]) -> str | None:
    """What a gmsh model with physical groups lacks to be a body in d dimensions; None if it lacks nothing."""
    entities = [entity for group in groups if group[0] == d for entity in model.getEntitiesForPhysicalGroup(*group)]
    if d not in (2, 3) or not entities:
        return "must have a physical group of surfaces (plane) or volumes, the cells of the body"
    if len(set(entities)) < len(entities):
        return "has cells that belong to several physical groups: must be to one"
    kinds = {kind for entity in entities for kind in model.mesh.getElementTypes(d, entity)}
    names = sorted(model.mesh.getElementProperties(kind)[0] for kind in kinds)
    if not kinds:
        return "has no cells: it must be meshed before it is saved"
    if len(kinds) > 1 or not kinds <= set(GMSH_CELLS[d]):
        return f"has cells of the kinds {', '.join(names)}: must be of one kind, {' or '.join(CELL_SHAPES[d])}"
    if d == 2 and np.ptp(model.mesh.getNodes()[1].reshape(-1, 3)[:, 2]) > 0:
        return "lies in another plane than x y: must be flat, with one z"
    return None


def _split(corners: np.ndarray, cell: str) -> np.ndarray:
    """Quadrilaterals into two triangles, hexahedra into six tetrahedra, all along the same diagonal."""
    if cell == "triangle":
        return corners[:, [[0, 1, 3], [0, 2, 3]]].reshape(-1, 3)
    if cell == "tetrahedron":
        parts = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]]
        return corners[:, parts].reshape(-1, 4)
    return corners


def check_annulus(radii: Sequence[float], cells: Sequence[int], height: float | None = None, cell: str | None = None,
                  grading: float = 1.0, angle: float = 2 * np.pi) -> str:
    """The name of the cells' shape; ValueError where annulus cannot be made of its arguments."""
    d = 2 if height is None else 3
    faults = _cell_faults(cells, cell, d)
    if not _are_positive(radii, 2) or not radii[0] < radii[1]:
        faults.append(f"radii = {radii!r}: must be 2 numbers above 0, the smaller first")
    if height is not None and not _are_positive([height], 1):
        faults.append(f"height = {height!r}: must be a number above 0")
    if not _are_positive([grading], 1):
        faults.append(f"grading = {grading!r}: must be a number above 0")
    if not is_finite_number(angle) or not 0 < angle <= 2 * np.pi:
        faults.append(f"angle = {angle!r}: must be above 0 and at most 2 pi")
    elif not faults and cells[1] * 2 * np.pi < 3 * angle:
        faults.append(f"cells = {cells!r}: must be 3 sectors or more a turn")
    refuse("the mesh cannot be made", faults)
    return cell or CELL_SHAPES[d][0]


def check_box(size: Sequence[float], cells: Sequence[int], cell: str | None = None,
              grading: Sequence[float] | None = None) -> str:
    """The name of the cells' shape; ValueError where box cannot be made of its arguments."""
    d = len(size) if isinstance(size, Sized) else 0
    if d not in CELL_SHAPES:
        raise ValueError(f"the mesh cannot be made:\n  size = {size!r}: must be 2 or 3 numbers above 0")
    faults = _cell_faults(cells, cell, d)
    if not _are_positive(size, d):
        faults.append(f"size = {size!r}: must be {d} numbers above 0")
    if grading is not None and not _are_positive(grading, d):
        faults.append(f"grading = {grading!r}: must be {d} numbers above 0")
    refuse("the mesh cannot be made", faults)
    return cell or CELL_SHAPES[d][0]


def _are_positive(values: object, count: int) -> bool:
    """Whether values are a sequence of so many finite numbers above 0."""
    return (isinstance(values, (Sequence, np.ndarray)) and len(values) == count
            and all(is_finite_number(value) and value > 0 for value in values))


def _cell_faults(cells: Sequence[int], cell: str | None, d: int) -> list[str]:
    """What is wrong with the numbers of cells along the axes of a mesh in d dimensions, and with their shape."""
    faults = []
    if not isinstance(cells, Sized) or len(cells) != d or not all(map(is_positive_integer, cells)):
        faults.append(f"cells = {cells!r}: must be {d} integers above 0")
    elif math.prod(cells) > LARGEST_COUNT:
        faults.append(f"cells = {cells!r}: must be {LARGEST_COUNT} together at most")
    if cell is not None and cell not in CELL_SHAPES[d]:
        faults.append(f"cell = {cell!r}: must be one of {', '.join(CELL_SHAPES[d])}")
    return faults
