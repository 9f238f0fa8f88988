"""Fields, tables and pictures on disk agree with the problem that wrote them."""

import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, driver, fem, tensors
from granumat.fem.cellwise import VertexMesh
from granumat.fem.fields import FIELDS, RECORDED, TENSORS
from support.scenes import read_table
from support.xdmf import records

MATERIAL = Material(0.5, elastic_strain=1e-2)
SHEAR = np.array([[0.02, 0.1, 0], [0, -0.03, 0.05], [0, 0, 0.01]])
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def homogeneous(cell="quadrilateral", degree=1, gradient=SHEAR, origin=False):
    """A body that is moved by t times a constant gradient."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    mesh = fem.meshes.box(MPI.COMM_WORLD, [1.0, 2, 1.5][:d], [3, 2, 2][:d], cell)
    everywhere = fem.Displacement(lambda x: np.full(x.shape[1], True), lambda x, t: t * x @ gradient[:d, :d].T)
    return fem.Problem(mesh, MATERIAL, MATERIAL.isotropic(0.6, pressure=0.01), [everywhere], degree=degree, origin=origin)


def volume_of_cells(shape, corners):
    """Areas or volumes of cells in VTK's order of corners (cells, corners, 3)."""
    def simplices(kind):
        return sum(abs(np.linalg.det(corners[:, part[1:]] - corners[:, part[:1]]))[:, None] for part in kind) / 6
    if shape == "Quadrilateral":
        return np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])[:, 2:] / 2
    if shape == "Triangle":
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2:] / 2
    if shape == "Tetrahedron":
        return simplices([[0, 1, 2, 3]])
    return simplices([[0, 1, 3, 4], [1, 2, 3, 6], [1, 4, 5, 6], [3, 4, 6, 7], [1, 3, 4, 6]])


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_fields_hold_the_mesh_at_the_start_the_displacements_and_the_cells_state(tmp_path, cell, degree):
    problem = homogeneous(cell, degree)
    fem.run(problem, 0.2, 0.05, observers=[fem.Fields(tmp_path / "a.xdmf", every=3, times=[0.2])])
    times, shapes, arrays = zip(*records(tmp_path / "a.xdmf"))
    np.testing.assert_allclose(times, [0, 0.15, 0.2], rtol=1e-14)
    assert set(shapes) == {cell.capitalize()}
    last, d = arrays[-1], problem.d
    places = last["Geometry"]
    assert len(places) == np.prod([4, 3, 3][:d])                                  # every vertex once
    volumes = volume_of_cells(shapes[0], places[last["Topology"]])
    np.testing.assert_allclose(abs(volumes).sum(), 2 if d == 2 else 3, rtol=1e-14)
    np.testing.assert_allclose(last["displacement"][:, :d], 0.2 * places[:, :d] @ SHEAR[:d, :d].T, atol=1e-14)
    assert not arrays[0]["displacement"].any() and (last["displacement"][:, d:] == 0).all()
    expected = driver.state_columns(MATERIAL, problem.states[:1])
    for name in ("p", "Z2", "phi", "eta_t", "dilatancy"):
        np.testing.assert_allclose(last[name], expected[name][0], rtol=1e-9, err_msg=name)
    stress, fabric = problem.states.stress[0], tensors.to_matrix(problem.states.fabric[0])
    np.testing.assert_allclose(last["stress_ratio"], tensors.magnitude(tensors.deviator(stress)) / expected["p"][0], rtol=1e-9)
    np.testing.assert_allclose(last["A"], tensors.magnitude(problem.states.fabric[0]), rtol=1e-9)
    np.testing.assert_allclose(last["A_direction"] @ fabric, np.linalg.eigvalsh(fabric)[-1] * last["A_direction"], atol=1e-12)
    np.testing.assert_allclose(last["shear_strain"], problem.shear_strain[0], rtol=1e-9)


def test_the_page_names_every_field_and_those_that_are_recorded(tmp_path):
    page = (Path(__file__).parents[2] / "docs/results.md").read_text().split("## Fields of a body\n")[1]
    rows = re.findall(r"^\| `(\w+)` \| (\d) \| (yes|no) \|", page, re.M)
    assert [name for name, _, _ in rows] == list(FIELDS)
    assert [name for name, _, recorded in rows if recorded == "yes"] == list(RECORDED)
    fields = fem.cell_fields(homogeneous(origin=True))
    assert {name: str(values[0].size) for name, values in fields.items()} == {name: numbers for name, numbers, _ in rows}
    fem.run(homogeneous(), 0.05, 0.05, observers=[fem.Fields(tmp_path / "a.xdmf")])
    _, _, arrays = next(records(tmp_path / "a.xdmf"))
    assert set(arrays) == {"displacement", "Topology", "Geometry", *RECORDED}


@pytest.mark.parametrize("cell", CELLS)
def test_tensors_are_those_of_the_points_and_strain_is_that_of_the_stretch(tmp_path, cell):
    problem = homogeneous(cell)
    fem.run(problem, 1, 0.25, observers=[fem.Fields(tmp_path / "a.xdmf", times=[1], fields=["stress", "strain", "sigma_xy"])])
    d = problem.d
    deformation = np.eye(3)
    deformation[:d, :d] += SHEAR[:d, :d]
    stretch, axes = np.linalg.eigh(deformation @ deformation.T)
    strain = axes @ np.diag(np.log(stretch) / 2) @ axes.T
    expected = {"strain": tensors.to_voigt(strain), "stress": -problem.states.stress[0], "fabric": problem.states.fabric[0]}
    fields = fem.cell_fields(problem, ["strain", "stress", "fabric", "volume_strain", "q", "coordination_number"])
    for name, values in expected.items():
        np.testing.assert_allclose(fields[name], np.tile(values, (problem.cells, 1)), atol=1e-13, err_msg=name)
        components = fem.cell_fields(problem, [f"{TENSORS[name]}_{axis}" for axis in tensors.AXES])
        assert (np.column_stack(list(components.values())) == fields[name]).all()
    np.testing.assert_allclose(fields["volume_strain"], np.trace(strain), rtol=1e-10)
    np.testing.assert_allclose(fields["q"], driver.state_columns(MATERIAL, problem.states[:1])["q"][0], rtol=1e-9)
    np.testing.assert_allclose(fields["coordination_number"], problem.states.coordination_number[0], rtol=1e-12)
    _, _, arrays = list(records(tmp_path / "a.xdmf"))[-1]
    xdmf = {"stress": [0, 3, 4, 1, 5, 2], "strain": [0, 3, 4, 1, 5, 2]}
    assert set(arrays) == {"displacement", "Topology", "Geometry", "sigma_xy", *xdmf}
    for name, order in xdmf.items():
        np.testing.assert_allclose(arrays[name], fields[name][:1, order].repeat(len(arrays[name]), 0), atol=1e-13)
    assert 'Name="stress" AttributeType="Tensor6"' in (tmp_path / "a.xdmf").read_text()


def test_unknown_fields_are_refused_all_at_once(tmp_path):
    for refused in (lambda: fem.Fields(tmp_path / "a.xdmf", fields=["speed", "p", "heat"]),
                    lambda: fem.cell_fields(homogeneous(), ["speed", "p", "heat"])):
        with pytest.raises(ValueError, match=r"(?s)no field 'speed': must be one of p, q, .*, origin_z\n.*no field 'heat'"):
            refused()


def test_fields_of_a_long_run_go_on_in_further_files(tmp_path, monkeypatch):
    fem.run(homogeneous(), 0.4, 0.05, observers=[fem.Fields(tmp_path / "b.xdmf")])
    monkeypatch.setattr(fem.Fields, "LARGEST_FILE", 2000)                  # bytes: two records
    fields = fem.Fields(tmp_path / "a.xdmf")
    fem.run(homogeneous(), 0.35, 0.05, observers=[fields, fem.Checkpoint(tmp_path / "a.npz", [fields], every=6)])
    assert sorted(path.name for path in tmp_path.glob("a*.bin")) == ["a.1.bin", "a.2.bin", "a.3.bin", "a.4.bin", "a.bin"]
    problem, fields = homogeneous(), fem.Fields(tmp_path / "a.xdmf")
    fem.resume(tmp_path / "a.npz", problem, [fields])                 # at 0.3, before the last of the files
    fem.run(problem, 0.4, 0.05, observers=[fields])
    for (t, _, arrays), (t_whole, _, expected) in zip(records(tmp_path / "a.xdmf"), records(tmp_path / "b.xdmf"), strict=True):
        assert t == t_whole and all(np.array_equal(arrays[name], expected[name]) for name in expected)


def test_cell_fields_are_means_by_volume():
    problem = homogeneous()
    problem.states.coordination_number = np.arange(len(problem.states))
    means = problem.states.coordination_number.reshape(problem.cells, -1).mean(axis=1)
    np.testing.assert_allclose(fem.cell_fields(problem)["Z2"], means, rtol=1e-14)
    assert (fem.cell_fields(problem)["A_direction"] == 0).all()                   # no fabric, no direction
    problem.displacement = problem.positions.prod(axis=1, keepdims=True) * [0.2, 0]                      # points of unequal volumes
    uneven = fem.cell_fields(problem)["Z2"]
    volumes = problem.point_volumes().reshape(problem.cells, -1)
    z2 = problem.states.coordination_number.reshape(volumes.shape)
    np.testing.assert_allclose(uneven, (z2 * volumes).sum(axis=1) / volumes.sum(axis=1), rtol=1e-14)
    assert abs(uneven - means).max() > 1e-3


def test_dilatancy_is_0_without_shear():
    problem = homogeneous("hexahedron", gradient=np.eye(3))
    fem.run(problem, 0.01, 0.01)
    assert (fem.cell_fields(problem)["dilatancy"] == 0).all()


def test_rows_are_in_the_tables_as_soon_as_their_increment_is_accepted(tmp_path):
    problem, seen = homogeneous(), []
    part = {"right": lambda x: np.isclose(x[0], 1)}
    tables = [fem.Reactions(tmp_path / "r.csv", part, center=[1, 1]), fem.Probe(tmp_path / "p.csv", [0.3, 0.4])]

    def watch(problem):
        if problem.last is not None:
            row = read_table(tmp_path / "r.csv")[-1]
            force, moment = problem.reaction(part["right"], [1, 1])
            assert [row["right_F_x"], row["right_F_y"], row["right_M"]] == pytest.approx([*force, moment], rel=1e-14)
            assert row["iterations"] == len(problem.last.residuals) - 1
            seen.append(row["t"])
        place = read_table(tmp_path / "p.csv")[-1]
        start = problem.point_positions(at_start=True)
        nearest = start[np.linalg.norm(start - [0.3, 0.4], axis=1).argmin()]
        assert [place["x"], place["y"]] == pytest.approx(nearest + problem.t * SHEAR[:2, :2] @ nearest, abs=1e-14)
        assert place["p"] == pytest.approx(-problem.states.stress[0, :3].mean(), rel=1e-9)
    fem.run(problem, 0.2, 0.05, observers=[*tables, watch])
    assert seen == pytest.approx([0.05, 0.1, 0.15, 0.2])


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.release_only
def test_pictures_show_the_surface(tmp_path, cell):
    problem = homogeneous(cell)
    polygons, cells = VertexMesh(problem.body).polygons()
    expected = {"quadrilateral": 6, "triangle": 12, "hexahedron": 2 * (6 + 6 + 4), "tetrahedron": 4 * (6 + 6 + 4)}[cell]
    assert len(polygons) == expected and cells.max() < problem.cells
    fem.Pictures(tmp_path, "phi").write(problem)
    assert (tmp_path / "phi-000000.png").read_bytes()[:4] == b"\x89PNG"


def test_a_picture_of_an_unknown_field_is_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no field 'stress': must be one of p, q, stress_ratio"):
        fem.Pictures(tmp_path, "stress")


SCRIPT = """
import sys
import numpy as np
from mpi4py import MPI
from granumat import Material, fem
material = Material(0.5, elastic_strain=1e-2)
def wall(radius): return lambda x: np.isclose(np.hypot(x[0], x[1]), radius)
problem = fem.Problem(fem.meshes.annulus(MPI.COMM_WORLD, (1, 2), (3, 12)), material, material.isotropic(0.6, pressure=0.01),
                      [fem.Displacement(wall(1), fem.rotation(lambda t: 0.002 * t)), fem.Displacement(wall(2))])
name = sys.argv[1]
fem.run(problem, 2, 1.0, observers=[fem.Fields(name + ".xdmf"), fem.Probe(name + ".csv", [1.5, 0.0])])
"""


def test_files_do_not_depend_on_the_number_of_ranks(mpirun, tmp_path):
    for ranks in (1, 3):
        mpirun(SCRIPT, ranks, f"of{ranks}")
    one, three = (list(records(tmp_path / f"of{ranks}.xdmf")) for ranks in (1, 3))
    assert len(one) == 3
    for (t, shape, arrays), (t3, shape3, arrays3) in zip(one, three):
        assert (t, shape) == (t3, shape3)
        assert (arrays["Topology"] == arrays3["Topology"]).all()
        for name, values in arrays.items():
            np.testing.assert_allclose(arrays3[name], values, rtol=1e-9, atol=1e-11, err_msg=name)
    tables = [np.genfromtxt(tmp_path / f"of{ranks}.csv", delimiter=",", skip_header=1) for ranks in (1, 3)]
    np.testing.assert_allclose(*tables, rtol=1e-9, atol=1e-11)
