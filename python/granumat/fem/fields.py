"""Fields: what a body's cells and vertices have, and their record for ParaView."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from .. import tensors
from ..checks import refuse
from ..files import appending
from ..history import column_name
from .cellwise import SHAPES, VertexMesh, on_rank_0
from .output import Output
from .problem import Problem

FIELDS = {
    "p": "pressure $p\\,d/k$", "q": "deviator $q\\,d/k$", "stress_ratio": "stress ratio $|\\sigma'|/p$",
    "Z2": "coordination number $Z_2$", "phi": "volume fraction $\\phi$", "A": "fabric $|A|$",
    "A_direction": "direction of most contacts",
    "shear_strain": "accumulated shear strain", "volume_strain": "volume strain (extension positive)",
    "dilatancy": "dilatancy tr $D/|S|$", "eta_t": "transverse modulus $\\eta_t$",
    "nonlocal_strain": "nonlocal strain $m$", "R": "local over nonlocal strain $R = |D|/m$",
    "unjammed": "unjammed part of the volume",
    "origin": "origin $X$",
    "stress": "stress $\\sigma\\,d/k$", "strain": "logarithmic strain $e$", "fabric": "fabric $A$",
}
TENSORS = {"stress": "sigma", "strain": "e", "fabric": "A"}         # names of the components' columns in histories begin so
COMPONENTS = {f"{symbol}_{axis}": (name, i) for name, symbol in TENSORS.items() for i, axis in enumerate(tensors.AXES)}
COMPONENTS |= {f"origin_{axis}": ("origin", i) for i, axis in enumerate("xyz")}
SCALAR_FIELDS = [*(name for name in FIELDS if name not in ("A_direction", "origin", *TENSORS)), *COMPONENTS]
OF_LENGTH = ("nonlocal_strain", "R")
# If nothing else is asked for:
RECORDED = tuple(name for name in FIELDS if name not in ("q", "unjammed", "origin", *TENSORS, *OF_LENGTH))
XDMF_ORDER = [0, 3, 4, 1, 5, 2]     # xx xy xz yy yz zz
ROUND_OFF = 1e-9                    # a component of a unit vector below, or a shear over a volume strain, counts as 0


def check_fields(names: Sequence[str], allowed: Sequence[str], faults: list[str]) -> None:
    """Appends a fault for each name that is neither among the allowed fields nor another word for one of them."""
    faults += [f"there is no field {name!r}: must be one of {', '.join(allowed)}" for name in names
               if not isinstance(name, str) or column_name(name) not in allowed]


def field_label(name: str) -> str:
    """Words for the axis of a field, one of FIELDS or COMPONENTS."""
    name = column_name(name)
    if name not in COMPONENTS:
        return FIELDS[name]
    words, symbol = FIELDS[COMPONENTS[name][0]].split("$")[:2]
    letter, _, unit = symbol.partition("\\,")
    return f"{words}${letter}_{{{name.split('_')[1]}}}{unit and chr(92) + ',' + unit}$"


def cell_fields(problem: Problem, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """The means over this rank's own cells, weighted by volume.

    Parameters
    ----------
    problem : Problem
    names : sequence of str, optional
        From FIELDS, COMPONENTS ("sigma_xx" ... "sigma_yz", "e_xx" ..., "A_xx" ..., "origin_x" ...) and history.WORDS; all FIELDS
        that there are if not given.

    Returns
    -------
    dict of str to array
        (cells,); A_direction and origin (cells, 3); stress, strain, fabric (cells, 6). Stresses and p are compression positive,
        strains extension positive. strain is the logarithmic strain since the start, ln(F F^T)/2, along x y z. q is sqrt(3 J2). A
        is abs(A) of the mean fabric and A_direction the unit eigenvector of its largest eigenvalue, of which the first component
        that is not 0 is positive; it is 0 where there is no fabric. dilatancy is that of the last increment, 0 where it had no
        shear. nonlocal_strain is m of the last increment, abs(D) without a length, and R the mean abs(D) over it, 1 where it is 0.
        unjammed is the part of the cell's volume where p = 0. origin is where the material was at the start or has flowed in, its
        z component 0 in the plane, if the problem keeps it. Where the mesh does not follow the material, there is no strain since
        the start.

    Raises
    ------
    ValueError
        Names every field that does not exist.
    """
    faults: list[str] = []
    lacking = {"strain": "the strain since the start is not known where the mesh does not follow the material"
               } if problem.moving_mesh is not None else {}
    if problem.origin is None:
        lacking["origin"] = "where the material has come from is not kept: give Problem(..., origin=True)"
    if names is None:
        names = [name for name in FIELDS if name not in lacking]
    check_fields(names, (*FIELDS, *COMPONENTS), faults)
    faults += [f"{name}: {lacking[_field_of(name)]}" for name in names if isinstance(name, str) and _field_of(name) in lacking]
    refuse("the fields cannot be given", faults)
    states, volumes = problem.states, problem.point_volumes().reshape(problem.cells, -1)
    weights = volumes / volumes.sum(axis=1, keepdims=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.einsum("cq,cq...->c...", weights, np.asarray(values).reshape(*weights.shape, *values.shape[1:]))

    stress, fabric = mean(states["stress"]), mean(states["fabric"])
    strain = np.zeros((problem.cells, 6))
    if problem.last is not None:
        strain = mean(tensors.symmetric(problem.last.gradients))
    volume_strain, shear = tensors.trace(strain), tensors.magnitude(tensors.deviator(strain))
    dilatancy = np.divide(volume_strain, shear, out=np.zeros_like(shear), where=shear > ROUND_OFF * abs(volume_strain))
    local, m = _strains_of_last(problem)
    local, m = mean(local), mean(m)
    R = np.divide(local, m, out=np.ones_like(m), where=m > 0)
    direction = np.linalg.eigh(tensors.to_matrix(fabric))[1][..., -1]
    first = np.take_along_axis(direction, (abs(direction) > ROUND_OFF).argmax(axis=1)[:, None], axis=1)
    direction = np.where(tensors.magnitude(fabric)[:, None] > 0, direction * np.sign(first), 0.0)
    fields = {"p": -tensors.trace(stress) / 3, "q": np.sqrt(3) * tensors.magnitude(tensors.deviator(stress)),
              "stress_ratio": stress_ratio(stress), "Z2": mean(states["coordination_number"]),
              "phi": mean(states["volume_fraction"]), "A": tensors.magnitude(fabric), "A_direction": direction,
              "shear_strain": mean(problem.shear_strain), "volume_strain": mean(problem.volume_strain), "dilatancy": dilatancy,
              "nonlocal_strain": m, "R": R, "eta_t": mean(problem.material.transverse_modulus(states)),
              "unjammed": mean((tensors.trace(states["stress"]) >= 0).astype(float)), "stress": -stress, "fabric": fabric}
    if "strain" in map(_field_of, names):
        fields["strain"] = mean(point_strains(problem))
    if problem.origin is not None:
        fields["origin"] = _in_space(mean(problem.origin))
    columns = [column_name(name) for name in names]
    return {given: fields[COMPONENTS[name][0]][:, COMPONENTS[name][1]] if name in COMPONENTS else fields[name]
            for given, name in zip(names, columns)}


def _field_of(name: str) -> str:
    """The one of FIELDS that a name or a component's name belongs to."""
    name = column_name(name)
    return COMPONENTS[name][0] if name in COMPONENTS else name


def _strains_of_last(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """abs(D) and m (points) of the last increment; without a length both are abs(D)."""
    if problem.last is None:
        return np.zeros(len(problem.states)), np.zeros(len(problem.states))
    strain = tensors.magnitude(tensors.symmetric(problem.last.gradients))
    return strain, strain if problem.nonlocal_field is None else problem.nonlocal_field.at_points(problem.last.m)


def point_strains(problem: Problem) -> np.ndarray:
    """Logarithmic strains since the start, ln(F F^T)/2 (points, 6), of this rank's points, along x y z."""
    body = problem.body

    def jacobians(nodal: np.ndarray) -> np.ndarray:
        return np.einsum("cai,qja->cqij", body.at_cells(nodal), body.element.gradients)
    deformation = jacobians(problem.positions + problem.displacement) @ np.linalg.inv(jacobians(problem.positions))
    stretch, axes = np.linalg.eigh(deformation @ np.swapaxes(deformation, -1, -2))
    strain = np.zeros((*stretch.shape[:2], 3, 3))
    strain[..., :problem.d, :problem.d] = (axes * np.log(stretch)[..., None, :] / 2) @ np.swapaxes(axes, -1, -2)
    return tensors.to_voigt(strain).reshape(-1, 6)


def stress_ratio(stress: np.ndarray) -> np.ndarray:
    """abs(sigma')/p (...) of stresses (..., 6), tension positive; 0 where p is not positive."""
    p, shear = -tensors.trace(stress) / 3, tensors.magnitude(tensors.deviator(stress))
    return np.divide(shear, p, out=np.zeros_like(p), where=p > 0)


class Fields(Output):
    """Fields of the cells and displacements of the vertices, as an XDMF time series over the mesh at the start.

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
    fields : sequence of str, optional
        As in cell_fields; RECORDED if not given, OF_LENGTH where the problem has a length, and origin where it keeps that. Where
        the mesh does not follow the material, unjammed too. Tensors have XDMF's order of components, xx xy xz yy yz zz.

    Raises
    ------
    ValueError
        Names every field that does not exist.
    """

    HEAD = '<?xml version="1.0"?>\n<Xdmf Version="3.0">\n<Domain>\n<Grid GridType="Collection" CollectionType="Temporal">\n'
    FOOT = "</Grid>\n</Domain>\n</Xdmf>\n"
    LARGEST_FILE = 2**32            # bytes of a file of numbers: two of ParaView's three XDMF readers count them in 32 bits

    def __init__(self, path: str | Path, every: int | None = None, times: Sequence[float] = (),
                 fields: Sequence[str] | None = None) -> None:
        super().__init__(path, every, times)
        faults: list[str] = []
        check_fields(fields or (), (*FIELDS, *COMPONENTS), faults)
        refuse("the fields cannot be written", faults)
        self.fields = None if fields is None else tuple(fields)
        self._mesh: VertexMesh | None = None
        self._number_files = 1

    @property
    def numbers(self) -> list[Path]:
        """The files of numbers; those that a run has begun so far are known on rank 0."""
        return [self.path.with_suffix(f".{i}.bin" if i else ".bin") for i in range(self._number_files)]

    def growing_files(self) -> Sequence[Path]:
        return [self.path, *self.numbers]

    def restore(self, bookmark: dict[str, Any], comm: MPI.Comm) -> None:
        self._number_files = max(1, len(bookmark["sizes"]) - 1)
        super().restore(bookmark, comm)

    def _write(self, problem: Problem) -> None:
        if self._mesh is None:
            self._mesh = VertexMesh(problem.body)
        mesh = self._mesh
        displacement = mesh.gather(problem.displacement)
        names = self.fields
        if names is None:
            names = RECORDED if problem.nonlocal_field is None else RECORDED + OF_LENGTH
            names = names if problem.origin is None else (*names, "origin")
        if problem.moving_mesh is not None and "unjammed" not in names:
            names = (*names, "unjammed")
        fields = {name: mesh.order.gather(values) for name, values in cell_fields(problem, names).items()}
        on_rank_0(problem.comm, lambda: self._append(problem.t, mesh, displacement, fields))

    def _append(self, t: float, mesh: VertexMesh, displacement: np.ndarray, fields: dict[str, np.ndarray]) -> None:
        """Appends a record: numbers to the last file of numbers, its description to the XDMF file."""
        cells = mesh.cells[:, SHAPES[mesh.shape].around].astype("<i4")
        positions = _in_space(mesh.positions)
        arrays = {"displacement": _in_space(displacement)}
        for name, values in fields.items():
            arrays[name] = np.ascontiguousarray(values[:, XDMF_ORDER] if name in TENSORS else values, "<f8")
        new = self.written is None
        start = 0 if new else self.numbers[-1].stat().st_size
        if start and start + sum(values.nbytes for values in arrays.values()) > self.LARGEST_FILE:
            self._number_files, start = self._number_files + 1, 0
        with appending(self.numbers[-1]), open(self.numbers[-1], "ab" if start else "wb") as stream:
            if new:
                stream.write(cells.tobytes() + positions.tobytes())
            start = stream.tell()
            stream.writelines(values.tobytes() for values in arrays.values())
        first, last = self.numbers[0], self.numbers[-1]
        record = [f'<Grid>\n<Time Value="{t!r}"/>\n<Topology TopologyType="{mesh.shape.capitalize()}" '
                  f'NumberOfElements="{len(cells)}">{_data_item(cells, first, 0)}</Topology>\n<Geometry GeometryType="XYZ">'
                  f"{_data_item(positions, first, cells.nbytes)}</Geometry>\n"]
        for name, values in arrays.items():
            kind = {(): "Scalar", (3,): "Vector", (6,): "Tensor6"}[values.shape[1:]]
            center = "Node" if name == "displacement" else "Cell"
            record.append(f'<Attribute Name="{name}" AttributeType="{kind}" Center="{center}">{_data_item(values, last, start)}'
                          "</Attribute>\n")
            start += values.nbytes
        try:
            with appending(self.path), open(self.path, "wb" if new else "rb+") as stream:
                if new:
                    stream.write(self.HEAD.encode())
                else:
                    stream.seek(-len(self.FOOT), os.SEEK_END)
                stream.write(("".join(record) + "</Grid>\n" + self.FOOT).encode())
        except OSError:
            if not new:
                self._restore_foot()
            raise

    def _truncate(self, sizes: Sequence[int]) -> None:
        super()._truncate(sizes)
        self._restore_foot()                                     # where it stood, the next record had been written

    def _restore_foot(self) -> None:
        with open(self.path, "rb+") as stream:
            stream.seek(-len(self.FOOT), os.SEEK_END)
            stream.write(self.FOOT.encode())


def _data_item(values: np.ndarray, file: Path, start: int) -> str:
    """XDMF's words for an array that begins at a byte of a file."""
    kind = "Int" if values.dtype.kind == "i" else "Float"
    return (f'<DataItem Dimensions="{" ".join(map(str, values.shape))}" NumberType="{kind}" Precision="{values.itemsize}" '
            f'Format="Binary" Endian="Little" Seek="{start}">{file.name}</DataItem>')


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) of vectors (n, d), with a z component of 0 in the plane."""
    return np.hstack([vectors, np.zeros((len(vectors), 3 - vectors.shape[1]))]).astype("<f8")
