"""What a run leaves on disk: fields for ParaView, reactions and probes as tables, pictures. All are observers for `run`.

Rank 0 writes. Everything written is in the files at once, so that a run that is killed loses nothing of it.
"""

import os
from pathlib import Path

import numpy as np
from mpi4py import MPI

from .. import driver, tensors
from .cellwise import CellOrder, on_rank_0

FIELDS = {
    "p": "pressure $p\\,d/k$", "stress_ratio": "stress ratio $|\\sigma'|/p$", "Z2": "coordination number $Z_2$",
    "phi": "volume fraction $\\phi$", "A": "fabric $|A|$", "A_direction": "direction of most contacts",
    "shear_strain": "accumulated shear strain", "dilatancy": "dilatancy tr $D/|S|$", "eta_t": "transverse modulus $\\eta_t$",
}
# Per shape of the cells: XDMF's name, its order of the vertices, and the facets of a cell, each around.
SHAPES = {
    "triangle": ("Triangle", [0, 1, 2], None),
    "quadrilateral": ("Quadrilateral", [0, 1, 3, 2], None),
    "tetrahedron": ("Tetrahedron", [0, 1, 2, 3], [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]),
    "hexahedron": ("Hexahedron", [0, 1, 3, 2, 4, 5, 7, 6],
                   [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]),
}
NEAR = 1e-9                         # of the body's size, or of 1: what differs by less is the same


def cell_fields(problem):
    """The means over this rank's own cells, weighted by volume: a dict of FIELDS to arrays (cells,); A_direction (cells, 3).

    p is compression positive; A and A_direction are abs(A) and the unit eigenvector of the largest eigenvalue of the mean fabric,
    its first component above 0, 0 where there is no fabric; dilatancy is that of the last
    increment, 0 where it had no shear.
    """
    states, volumes = problem.states, problem.point_volumes().reshape(problem.cells, -1)
    share = volumes / volumes.sum(axis=1, keepdims=True)

    def mean(values):
        return np.einsum("cq,cq...->c...", share, np.asarray(values).reshape(*share.shape, *values.shape[1:]))

    stress, fabric = mean(states.stress), mean(states.fabric)
    change = np.zeros((problem.cells, 6))
    if problem.last is not None:
        change = mean(tensors.symmetric(problem.last.gradients))
    distortion = tensors.magnitude(tensors.deviator(change))
    dilatancy = np.divide(tensors.trace(change), distortion, out=np.zeros_like(distortion),
                          where=distortion > NEAR * abs(tensors.trace(change)))
    direction = np.linalg.eigh(tensors.to_matrix(fabric))[1][..., -1]
    first = np.take_along_axis(direction, (abs(direction) > NEAR).argmax(axis=1)[:, None], axis=1)
    direction = np.where(tensors.magnitude(fabric)[:, None] > 0, direction * np.sign(first), 0.0)
    return {"p": -tensors.trace(stress) / 3, "stress_ratio": stress_ratio(stress), "Z2": mean(states.coordination_number),
            "phi": mean(states.volume_fraction), "A": tensors.magnitude(fabric), "A_direction": direction,
            "shear_strain": mean(problem.shear_strain), "dilatancy": dilatancy,
            "eta_t": mean(problem.material.transverse_modulus(states))}


def stress_ratio(stress):
    """abs(sigma')/p (...) of stresses (..., 6), tension positive; 0 where p is not positive."""
    p, shear = -tensors.trace(stress) / 3, tensors.magnitude(tensors.deviator(stress))
    return np.divide(shear, p, out=np.zeros_like(p), where=p > 0)


class Output:
    """An observer with files that grow: every so many increments and at given times; after each increment if nothing is said.

    Attributes
    ----------
    path : Path
    written : float or None
        Pseudo-time of what was written last.
    """

    growing = ()                    # the files whose ends are cut off when an earlier checkpoint is resumed

    def __init__(self, path, every=None, times=()):
        self.path, self.times, self.written = Path(path), frozenset(times), None
        self.every = every if every or times else 1

    def __call__(self, problem):
        if (self.every is not None and problem.increments % self.every == 0) or problem.t in self.times:
            self.write(problem)

    def write(self, problem):
        """Writes the problem as it is, once."""
        if self.written is None or problem.t > self.written:
            self._write(problem)
            self.written = problem.t

    def position(self):
        """What brings the files back to where they are now; on rank 0, after everything is safely on disk."""
        sizes = []
        for path in self.growing if self.written is not None else ():
            with open(path, "rb+") as file:
                os.fsync(file.fileno())
                sizes.append(file.seek(0, os.SEEK_END))
        return {"written": self.written, "sizes": sizes}

    def restore(self, position, comm):
        """Cuts off what was written after a position."""
        self.written = position["written"]
        if self.written is not None:
            on_rank_0(comm, lambda: self._cut(position["sizes"]))

    def _cut(self, sizes):
        for path, size in zip(self.growing, sizes):
            if not path.exists() or path.stat().st_size < size:
                raise ValueError(f"{path} cannot be continued: it is missing or shorter than at the checkpoint")
            os.truncate(path, size)


class Fields(Output):
    """FIELDS of the cells and displacements of the vertices, as an XDMF time series over the mesh at the start.

    The numbers lie beside it in a file of the same name that ends in .bin, those of a long run in further ones, .1.bin, .2.bin ...
    In ParaView: "Warp by vector" by the displacement.

    Parameters
    ----------
    path : path
        Ends in .xdmf.
    every : int, optional
        Increments from one record to the next.
    times : sequence of float, optional
        Pseudo-times at which there are records too; make them `events` of the run.
    """

    HEAD = '<?xml version="1.0"?>\n<Xdmf Version="3.0">\n<Domain>\n<Grid GridType="Collection" CollectionType="Temporal">\n'
    FOOT = "</Grid>\n</Domain>\n</Xdmf>\n"
    LARGEST = 2**32                 # bytes of a file of numbers: two of ParaView's three XDMF readers count them in 32 bits

    def __init__(self, path, every=None, times=()):
        super().__init__(path, every, times)
        self._surface, self._files = None, 1

    @property
    def numbers(self):
        """The files of numbers, all that there are so far on rank 0."""
        return [self.path.with_suffix(f".{i}.bin" if i else ".bin") for i in range(self._files)]

    @property
    def growing(self):
        return [self.path, *self.numbers]

    def restore(self, position, comm):
        self._files = max(1, len(position["sizes"]) - 1)
        super().restore(position, comm)

    def _write(self, problem):
        if self._surface is None:
            self._surface = _Vertices(problem)
        vertices = self._surface
        moved = vertices.gather(problem.displacement)
        fields = {name: vertices.order.gather(values) for name, values in cell_fields(problem).items()}
        on_rank_0(problem.comm, lambda: self._append(problem.t, vertices, moved, fields))

    def _append(self, t, vertices, moved, fields):
        cells = vertices.cells[:, SHAPES[vertices.shape][1]].astype("<i4")
        arrays = {"displacement": _in_space(moved)} | {name: np.asarray(values, "<f8") for name, values in fields.items()}
        new = self.written is None
        start = 0 if new else self.numbers[-1].stat().st_size
        if start and start + sum(values.nbytes for values in arrays.values()) > self.LARGEST:
            self._files, start = self._files + 1, 0
        with open(self.numbers[-1], "ab" if start else "wb") as file:
            if new:
                file.write(cells.tobytes() + _in_space(vertices.positions).tobytes())
            start = file.tell()
            file.writelines(values.tobytes() for values in arrays.values())
        words = [f'<Grid>\n<Time Value="{t!r}"/>\n<Topology TopologyType="{SHAPES[vertices.shape][0]}" '
                 f'NumberOfElements="{len(cells)}">{self._item(cells, 0, 0)}</Topology>\n<Geometry GeometryType="XYZ">'
                 f"{self._item(_in_space(vertices.positions), 0, cells.nbytes)}</Geometry>\n"]
        for name, values in arrays.items():
            kind, place = "Vector" if values.ndim == 2 else "Scalar", "Node" if name == "displacement" else "Cell"
            words.append(f'<Attribute Name="{name}" AttributeType="{kind}" Center="{place}">{self._item(values, -1, start)}'
                         "</Attribute>\n")
            start += values.nbytes
        with open(self.path, "wb" if new else "rb+") as file:
            if new:
                file.write(self.HEAD.encode())
            else:
                file.seek(-len(self.FOOT), os.SEEK_END)
            file.write(("".join(words) + "</Grid>\n" + self.FOOT).encode())

    def _item(self, values, number, seek):
        kind = "Int" if values.dtype.kind == "i" else "Float"
        return (f'<DataItem Dimensions="{" ".join(map(str, values.shape))}" NumberType="{kind}" Precision="{values.itemsize}" '
                f'Format="Binary" Endian="Little" Seek="{seek}">{self.numbers[number].name}</DataItem>')

    def _cut(self, sizes):
        super()._cut(sizes)
        with open(self.path, "rb+") as file:                     # the last record had been followed by others
            file.seek(-len(self.FOOT), os.SEEK_END)
            file.write(self.FOOT.encode())


class _Vertices:
    """The vertices of all cells on rank 0, numbered as the cells meet them, so that the numbers do not depend on the ranks."""

    def __init__(self, problem):
        self.shape, self.order = problem.mesh.topology.cell_type.name, CellOrder(problem.mesh)
        self._nodes = problem._nodes[:, :len(SHAPES[self.shape][1])]
        numbers = self.order.gather(np.asarray(problem.space.dofmap.index_map.local_to_global(self._nodes.ravel()),
                                               np.int64).reshape(self._nodes.shape))
        if numbers is not None:
            _, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
            met = np.argsort(first)
            self._first, place = first[met], np.argsort(met)
            self.cells = place[inverse].reshape(numbers.shape)
        self.positions = self.gather(problem.positions)

    def gather(self, nodal):
        """Values (vertices, d) on rank 0 from those (nodes, d) of this rank, None on the others."""
        whole = self.order.gather(nodal[self._nodes])
        return None if whole is None else whole.reshape(-1, whole.shape[-1])[self._first]

    def facets(self):
        """Polygons to be drawn: their vertices, and the cell of each. In three dimensions those of the surface."""
        _, around, facets = SHAPES[self.shape]
        if facets is None:
            return self.cells[:, around], np.arange(len(self.cells))
        polygons = self.cells[:, facets].reshape(-1, len(facets[0]))
        _, first, count = np.unique(np.sort(polygons, axis=1), axis=0, return_index=True, return_counts=True)
        alone = np.sort(first[count == 1])
        return polygons[alone], alone // len(facets)


def _in_space(values):
    """Vectors (n, d) in three dimensions."""
    return np.hstack([values, np.zeros((len(values), 3 - values.shape[1]))]).astype("<f8")


class _Table(Output):
    """A table of numbers, CSV."""

    def __init__(self, path, every=None):
        super().__init__(path, every)
        self.growing = (self.path,)

    def _append(self, comm, row):
        def append():
            with open(self.path, "w" if self.written is None else "a", encoding="utf-8") as file:
                if self.written is None:
                    print(",".join(row), file=file)
                print(",".join(f"{value:.15g}" for value in row.values()), file=file)
        on_rank_0(comm, append)


class Reactions(_Table):
    """Force and moment that hold parts of the boundary (Problem.reaction), after every increment; also Newton's iterations.

    Parameters
    ----------
    path : path
    parts : dict of str to where
        Columns are called after them: inner_F_x, inner_F_y, inner_M.
    center : sequence, optional
        Of the moments.
    every : int, optional
        Increments from one row to the next.
    """

    def __init__(self, path, parts, center=None, every=None):
        super().__init__(path, every)
        self.parts, self.center = dict(parts), center

    def _write(self, problem):
        row = {"t": problem.t, "iterations": len(problem.last.residuals) - 1}
        for name, where in self.parts.items():
            force, moment = problem.reaction(where, self.center)
            row |= {f"{name}_F_{axis}": value for axis, value in zip("xyz", force)}
            row |= {f"{name}_M": moment} if problem.d == 2 else {f"{name}_M_{axis}": m for axis, m in zip("xyz", moment)}
        self._append(problem.comm, row)

    def write(self, problem):
        if problem.last is not None:                             # before that there is no reaction
            super().write(problem)


class Probe(_Table):
    """State and strains of a material point: the integration point that is nearest to a position at the start.

    Columns are t, x, y (, z), where it is now, then driver.STATE_COLUMNS, of which stress_ratio is abs(sigma')/p here, then
    shear_strain and volume_strain (extension positive).

    Parameters
    ----------
    path : path
    position : sequence (d)
    every : int, optional
        Increments from one row to the next.
    """

    def __init__(self, path, position, every=None):
        super().__init__(path, every)
        self.position_at_start, self._place = np.asarray(position, float), None

    def _write(self, problem):
        if self._place is None:
            self._place = self._find(problem)
        rank, point = self._place
        row = None
        if problem.comm.rank == rank:
            row = {"t": problem.t} | dict(zip("xyz", problem.point_positions()[point]))
            columns = driver.state_columns(problem.material, problem.states[point:point + 1])
            row |= {name: values[0] for name, values in columns.items()}
            row |= {"stress_ratio": stress_ratio(problem.states.stress[point]), "shear_strain": problem.shear_strain[point],
                    "volume_strain": problem.volume_strain[point]}
        self._append(problem.comm, problem.comm.bcast(row, root=rank))

    def _find(self, problem):
        """Rank and number of the point; among equals that of the cell given first."""
        distance = np.linalg.norm(problem.point_positions(at_start=True) - self.position_at_start, axis=1)
        size = problem.comm.allreduce(np.abs(problem.positions).max(initial=0.0), MPI.MAX)
        steps = np.round(distance / (NEAR * size)).astype(np.int64)
        cells = np.repeat(problem.mesh.topology.original_cell_index[:problem.cells], len(steps) // max(problem.cells, 1))
        nearest = np.lexsort((cells, steps))[:1]
        found = problem.comm.allgather([(int(steps[i]), int(cells[i]), problem.comm.rank, int(i)) for i in nearest])
        return min(candidate for candidates in found for candidate in candidates)[2:]


class Pictures(Output):
    """A field on the deformed mesh (in three dimensions on its surface) as PNG, one a record, FIELD-INCREMENT.png.

    Parameters
    ----------
    directory : path
    field : str
        One of FIELDS but A_direction.
    every, times
        As in Fields.
    """

    def __init__(self, directory, field="p", every=None, times=()):
        super().__init__(Path(directory) / field, every, times)
        if field not in FIELDS or field == "A_direction":
            raise ValueError(f"field = {field!r}: must be one of {', '.join(name for name in FIELDS if name != 'A_direction')}")
        self.field, self._surface = field, None

    def _write(self, problem):
        if self._surface is None:
            self._surface = _Vertices(problem)
        vertices = self._surface
        positions = vertices.gather(problem.positions + problem.displacement)
        values = vertices.order.gather(cell_fields(problem)[self.field])

        def draw():
            polygons, cells = vertices.facets()
            hertzian = problem.material.contact == "hertzian"
            label = FIELDS[self.field].replace("\\,d/k", "/k_{Hz}" if hertzian else "\\,d/k")
            figure = field_figure(positions[polygons], values[cells], label, f"t = {problem.t:.6g}")
            figure.savefig(f"{self.path}-{problem.increments:06d}.png", dpi=130)
        on_rank_0(problem.comm, draw)


def field_figure(polygons, values, label, title=""):
    """Polygons (n, corners, d) in the colours of their values (n).

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.collections import PolyCollection  # here, as few ranks and runs draw
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    solid = polygons.shape[-1] == 3
    low, high = polygons.min(axis=(0, 1)), polygons.max(axis=(0, 1))
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.add_subplot(projection="3d" if solid else None)
    collection = (Poly3DCollection if solid else PolyCollection)(polygons, cmap="viridis", linewidths=0, antialiaseds=False)
    collection.set_array(values)
    if solid:
        axes.add_collection3d(collection)
        axes.set_box_aspect(high - low)
        axes.locator_params(axis="z", nbins=3)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), zlabel="z")
    else:
        axes.add_collection(collection)
        axes.autoscale_view()
        axes.set_aspect("equal")
    axes.set(xlabel="x", ylabel="y", title=title)
    figure.colorbar(collection, ax=axes, label=label, shrink=0.8)
    return figure
