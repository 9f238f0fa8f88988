"""Scene files: what they may say, what is refused, and that a file does what the same Python does."""

import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem, tensors
from granumat.fem import scene, scene_file, system
from granumat.toml import read_toml, write_content
from support import scenes
from support.ranks import ENVIRONMENT, on_ranks
from support.scenes import BOX, faults, replaced, solved, written

pytestmark = pytest.mark.release_only
ROOT = Path(__file__).parents[2]


def test_the_file_does_what_the_same_python_does(tmp_path):
    found, tables = solved(tmp_path, BOX)
    material = Material(0.5, elastic_strain=0.01)
    bottom, top, right = (lambda x: np.isclose(x[1], 0)), (lambda x: np.isclose(x[1], 0.5)), (lambda x: np.isclose(x[0], 1))
    problem = fem.Problem(
        fem.meshes.box(MPI.COMM_WORLD, [1, 0.5], [4, 2]), material, material.isotropic(0.6, pressure=0.007),
        [fem.Displacement(bottom), fem.Displacement(top, lambda x, t: [np.interp(t, [0, 3.5, 10], [0, 0.02, -0.02]), 0], [0]),
         fem.Tied(top, 1), fem.Pressure(top, lambda t: 0.007 + 0.0001 * t), fem.Periodic(right, lambda x: x - [1, 0])])
    fem.run(problem, 6, 1.0, events=[3.5])
    np.testing.assert_allclose(found.displacement, problem.displacement, atol=1e-13)
    table = tables["reactions"]
    assert table["t"].tolist() == [1, 2, 3, 3.5, 4.5, 5.5, 6]                       # the kink is met
    np.testing.assert_allclose(table["bottom_F_y"], 0.007 + 0.0001 * table["t"], rtol=1e-8)
    np.testing.assert_allclose(table["top_F_x"], -table["bottom_F_x"], rtol=1e-8)


RING = scenes.RING + """
[output]
every = 2
pictures = ["p"]
probes = { wall = [1.1, 0] }
"""


def test_the_ring_turns_and_stays_round(tmp_path):
    problem, _ = solved(tmp_path, RING)
    radius = np.hypot(*problem.positions.T)
    now = problem.positions + problem.displacement
    inner, outer = np.isclose(radius, 1), np.isclose(radius, 2)
    np.testing.assert_allclose(np.hypot(*now[inner].T), 1, atol=1e-13)
    turn = np.arctan2(*np.flip(now[inner].T, axis=0)) - np.arctan2(*np.flip(problem.positions[inner].T, axis=0))
    np.testing.assert_allclose(np.mod(turn + 1, 2 * np.pi) - 1, 0.006, atol=1e-13)
    assert np.ptp(np.hypot(*now[outer].T)) < 1e-13 and abs(np.hypot(*now[outer].T) - 2).max() > 1e-6
    assert sorted(path.name for path in (tmp_path / "out").glob("*.png")) == [f"p-00000{i}.png" for i in (0, 2, 3)]


def test_a_block_with_pressure_and_gravity_rests(tmp_path):
    problem, tables = solved(tmp_path, """
        [material]
        elastic_strain = 0.01
        [mesh]
        kind = "box"
        size = [1, 1, 2]
        cells = [2, 2, 4]
        [initial]
        state = "K0"
        phi = 0.60
        pressure = 0.01
        K0 = 0.8
        [problem]
        gravity = [0, 0, -0.003]
        [[condition]]
        on = ["left", "right"]
        displacement = { x = 0 }
        [[condition]]
        on = ["front", "back"]
        displacement = { y = 0 }
        [[condition]]
        on = "bottom"
        displacement = { z = 0 }
        [[condition]]
        on = "top"
        pressure = 0.01
        [run]
        until = 1
        increment = 1
    """)
    assert abs(problem.displacement).max() < 1e-12
    table = tables["reactions"]
    assert table["bottom_F_z"] == pytest.approx(0.01 + 0.6 * 0.003 * 2, rel=1e-9)
    depth = 2 - problem.point_positions()[:, 2]
    vertical = 0.01 + 0.6 * 0.003 * depth
    np.testing.assert_allclose(-problem.states.stress[:, 2], vertical, rtol=1e-6)
    np.testing.assert_allclose(table["left_F_x"], (0.8 * vertical).mean() * 2, rtol=1e-6)
    p = -tensors.trace(Material(0.5).evaluate(problem.states)[0]) / 3
    np.testing.assert_allclose(p, vertical * 2.6 / 3, rtol=1e-6)                     # Z2 is that of the pressure at each depth


def test_at_rest_the_pressure_at_each_depth_holds_in_the_critical_closure_and_phi_follows():
    material = Material(0.5, "critical", elastic_strain=0.01)
    depth = np.linspace(0, 2, 201)
    states = scene.resting(material, 0.60, 0.003, 2.0, 0.01, 0.8)(np.stack([0 * depth, 0 * depth, 2 - depth], 1))
    vertical, p = -states.stress[:, 2], -tensors.trace(states.stress) / 3
    np.testing.assert_allclose(p, vertical * 2.6 / 3, rtol=1e-14)
    np.testing.assert_allclose(-tensors.trace(material.evaluate(states)[0]) / 3, p, rtol=1e-12)
    weight = 0.003 * (states.volume_fraction[1:] + states.volume_fraction[:-1]) / 2
    np.testing.assert_allclose(vertical, 0.01 + np.append(0, np.cumsum(weight * 0.01)), rtol=1e-7)


def test_steady_shear_is_steady_along_x(tmp_path):
    problem, _ = solved(tmp_path, replaced(BOX, {
        'state = "isotropic"\nphi = 0.60\npressure = 0.007': 'state = "steady"\nphi = 0.60',
        'platen = "y"\npressure = [[0, 0.007], [10, 0.008]]': "",
        "x = [[0, 0], [3.5, 0.02], [10, -0.02]]": "x = [[0, 0], [10, 0.05]], y = 0",
        "[4, 2]": "[4, 1]"}))                                                 # with several rows any one may take all of the shear
    start = Material(0.5, elastic_strain=0.01).steady(0.60)
    for name in ("fabric", "stress"):
        in_plane = start[name][[0, 2, 1, 4, 3, 5]]
        np.testing.assert_allclose(problem.states[name], np.tile(in_plane, (len(problem.states), 1)), atol=1e-9)


def test_every_fault_of_a_file_comes_in_one_message(tmp_path):
    said = faults(tmp_path, """
        tolerence = 3
        [material]
        mu = 1.5
        [mesh]
        kind = "box"
        size = [1, 0.5]
        cells = [4, -2]
        [initial]
        state = "K0"
        phi = 60
        [problem]
        degree = 3
        gravity = [0, "down"]
        [[condition]]
        on = "lid"
        displacement = { x = 1, q = 0 }
        [[condition]]
        displacement = { x = [[0, 0], [0, 1]] }
        rotation = 0.1
        [[condition]]
        on = ["left", "top"]
        periodic = true
        [[condition]]
        on = "left"
        [[condition]]
        on = "left"
        platen = "normal"
        center = [0]
        [run]
        until = -1
        [output]
        every = 0
        times = ["end"]
        pictures = ["stress"]
        probes = { "a/b" = [0, 0] }
        checkpoint = 3
        fields = ["p", "speed"]
        colours = 3
    """)
    for words in (
            "'tolerence'", "mu = 1.5", "cells = [4, -2]: must be 2 integers above 0", "[initial]", "phi = 60",
            "pressure is missing", "degree = 3", "gravity = [0, 'down']",
            "'lid' is no side: must be one of left, right, bottom, top", "must be a table with some of x, y",
            "condition 2", "on is missing", "increasing times", "rotation = 0.1: must be 0 at t = 0",
            "periodic = true stands alone", "condition 4: is wrong:\n    says nothing", "platen = 'normal'",
            "center belongs to rotation", "until = -1", "increment is missing", "every = 0", "times = ['end']",
            "pictures: there is no field 'stress'", "fields: there is no field 'speed'",
            "probes: their names", "checkpoint = 3", "unknown key 'colours'"):
        assert words in said, words + "\n" + said
    assert "size" not in faults(tmp_path, '[mesh]\nkind = "sphere"\n') and "must be one of box, annulus, gmsh" in faults(
        tmp_path, '[mesh]\nkind = "sphere"\n')
    assert "must be one of steady, isotropic, given, K0" in faults(tmp_path, "[initial]")
    assert "not a TOML file" in faults(tmp_path, "[mesh")


@pytest.mark.parametrize("path", sorted((ROOT / "demos/scenes").glob("*.toml")), ids=lambda path: path.stem)
def test_two_increments_of_the_scenes_of_the_demos_run_on_coarse_meshes(tmp_path, path):
    content = read_toml(path)
    end = content["run"]["until"] = 2 * content["run"]["increment"]
    content["mesh"]["cells"] = [max(count // 3, 2) for count in content["mesh"]["cells"]]
    for quantity in content.get("quantity", []):
        quantity["at"] = "end"
    content["output"].pop("times", None)
    write_content(tmp_path / "scene.toml", content)
    problem, _ = scene.solve(tmp_path / "scene.toml", tmp_path / "out")
    assert problem.t == end and problem.increments == 2


def test_sides_that_move_by_a_displacement_gradient_deform_the_body_by_it(tmp_path):
    text = re.sub(r"\[\[condition\]\].*\[run\]", """[[condition]]
        on = ["left", "right", "top", "bottom"]
        gradient = { xx = [[0, 0], [3.5, 0.001]], xy = [[0, 0], [6, 0.02]], yx = [[0, 0], [6, 0.01]] }
        displacement = { y = 0 }
        [run]""", BOX, flags=re.S)
    said = faults(tmp_path, text)
    assert "condition 1: is wrong:\n    y is given by both displacement and gradient" in said
    problem, _ = solved(tmp_path, text.replace("displacement = { y = 0 }", ""))
    np.testing.assert_allclose(problem.displacement, problem.positions @ [[0.001, 0.01], [0.02, 0]], atol=1e-9)
    assert "must be a table with some of xx, xy, yx, yy" in faults(tmp_path, text.replace("xx =", "q ="))
    assert "gradient and rotation cannot be given together" in faults(
        tmp_path, text.replace("displacement = { y = 0 }", "rotation = 0"))
    assert "gradient: not on a ring" in faults(tmp_path, RING.replace("platen = \"radial\"", "gradient = { xy = 0 }"))


def granumat(cwd, *arguments, ranks=1):
    return subprocess.run(on_ranks(ranks, "-m", "granumat", *arguments), cwd=cwd, capture_output=True, text=True, env=ENVIRONMENT)


@pytest.mark.slow
def test_the_command_stops_with_words_and_goes_on_from_there(tmp_path):
    text = RING.replace("[10, 0.02]", "[2, 0.004], [2.1, 3]").replace("increment = 1", "increment = 1\nsmallest = 0.05")
    written(tmp_path, text)
    done = granumat(tmp_path, "solve", "scene.toml", "--out", "out", "--resume", ranks=2)
    assert done.returncode == 2 and done.stderr.count("there is no out/checkpoint.npz to go on from") == 1
    assert not (tmp_path / "out").exists()
    done = granumat(tmp_path, "solve", "scene.toml", "--out", "out", ranks=2)
    assert done.returncode == 1 and done.stderr.count("granumat: the increment from t = 2 cannot be solved") == 1
    assert "everything up to t = 2 is in out: checkpoint.npz, fields.bin, fields.xdmf, probe-wall.csv, reactions.csv" in done.stderr
    assert "Traceback" not in done.stderr
    table = (tmp_path / "out/reactions.csv").read_text()
    assert table.count("\n") == 3
    written(tmp_path, RING.replace("[10, 0.02]", "[2, 0.004], [4, 0]"))
    done = granumat(tmp_path, "solve", "scene.toml", "--out", "out", "--resume")
    assert done.returncode == 0 and "t = 3 after" in done.stdout
    assert (tmp_path / "out/reactions.csv").read_text().startswith(table)
    written(tmp_path, RING.replace("elastic_strain = 0.01", "elastic_strain = 0.02"))
    done = granumat(tmp_path, "solve", "scene.toml", "--out", "out", "--resume", ranks=2)
    assert done.returncode == 2 and done.stderr.count("material's elastic_strain: 0.01 in the checkpoint, 0.02 here") == 1


GEO = """
Rectangle(1) = {0, 0, 0, 1, 0.5};
Physical Surface("sand") = {1};
Physical Curve("floor") = {1};
Physical Curve("lid", 7) = {3};
Physical Curve("sides") = {2, 4};
Mesh.CharacteristicLengthMax = 0.25;
"""


def test_a_gmsh_file_is_held_by_its_physical_names_and_numbers(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    (tmp_path / "box.geo").write_text('SetFactory("OpenCASCADE");' + GEO)
    gmsh.open(str(tmp_path / "box.geo"))
    gmsh.model.mesh.generate(2)
    gmsh.write(str(tmp_path / "box.msh"))
    gmsh.finalize()
    text = replaced(BOX, {'kind = "box"\nsize = [1, 0.5]\ncells = [4, 2]': 'kind = "gmsh"\nfile = "box.msh"',
                          'on = ["left", "right"]\nperiodic = true': 'on = "sides"\npressure = 0.007',
                          'on = "bottom"': 'on = "floor"', 'on = "top"': "on = 7"})
    problem, _ = solved(tmp_path, text)
    lid = np.isclose(problem.positions[:, 1], 0.5)
    np.testing.assert_allclose(problem.displacement[lid, 0], np.interp(6, [3.5, 10], [0.02, -0.02]), atol=1e-14)
    assert (problem.displacement[np.isclose(problem.positions[:, 1], 0)] == 0).all()
    with pytest.raises(ValueError, match="there are no facets 'cellar': the file names floor, lid, sides"):
        solved(tmp_path, text.replace('"floor"', '"cellar"'))


def test_without_gmsh_a_gmsh_file_is_refused_with_the_packages_name(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    (tmp_path / "box.msh").write_text("")
    text = re.sub(r"\[\[condition\]\].*?\[run", "[run", BOX, flags=re.S)
    text = text.replace('kind = "box"\nsize = [1, 0.5]\ncells = [4, 2]', 'kind = "gmsh"\nfile = "box.msh"')
    with pytest.raises(ImportError, match="python3-gmsh"):
        solved(tmp_path, text)


def test_the_reference_blas_is_warned_of_with_the_better_package(monkeypatch):
    maps = "7f00-7f01 r-xp 0 08:01 3 /usr/lib/x86_64-linux-gnu/{}/libblas.so.3.11.0\n"
    for place, told in (("blas", True), ("openblas-pthread", False)):
        monkeypatch.setattr(system.Path, "read_text", lambda self, place=place, **_: maps.format(place))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            system.warn_of_reference_blas()
        assert [("libopenblas0" in str(warning.message)) for warning in caught] == [True] * told


def test_an_error_of_one_rank_ends_the_others_that_wait_for_it(mpirun):
    script = """
from granumat import cli
from granumat.fem import scene
def solve(*_, **__):
    if scene.MPI.COMM_WORLD.rank == 1:
        raise ValueError("only here")
    scene.MPI.COMM_WORLD.Barrier()
scene.solve, cli.PATIENCE = solve, 0.5
raise SystemExit(cli.main(["solve", "scene.toml", "--out", "out"]))
"""
    with pytest.raises(AssertionError, match=r"(?s)Traceback.*ValueError: only here"):
        mpirun(script, 2)


# ---- keys that make a model cheaper ----------------------------------------------------------------------------------

def test_newtons_tolerances_are_those_of_the_file(tmp_path):
    loose = "tolerances = { force = 1e-4, correction = 1e-2 }"
    tight, tables = solved(tmp_path, BOX)
    problem, loose_tables = solved(tmp_path / "loose", BOX + f"[problem]\n{loose}\n")
    assert tight.tolerances == fem.Tolerances() and problem.tolerances == fem.Tolerances(1e-4, 1e-2, 15)
    reactions, near = tables["reactions"][-1], loose_tables["reactions"][-1]
    assert near["iterations"] < reactions["iterations"]
    assert 0 < abs(near["top_F_x"] / reactions["top_F_x"] - 1) < 1e-3
    said = faults(tmp_path, BOX + "[problem]\ntolerances = { force = 2, iterations = 0, displacement = 1 }")
    for words in ("force = 2: must be a number in (0, 1)", "iterations = 0", "unknown key 'displacement'"):
        assert words in said, said


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_a_graded_box_has_widths_in_a_geometric_series(cell):
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    size, cells, grading = [1.0, 2.0, 0.5][:d], [4, 3, 2][:d], [8.0, 1.0, 0.25][:d]
    mesh = fem.meshes.box(MPI.COMM_WORLD, size, cells, cell, grading)
    for axis in range(d):
        widths = np.diff(np.unique(mesh.geometry.x[:, axis].round(12)))
        np.testing.assert_allclose(widths, size[axis] * np.geomspace(1, grading[axis], cells[axis])
                                   / np.geomspace(1, grading[axis], cells[axis]).sum(), rtol=1e-9)
    problem = fem.Problem(mesh, Material(0.5), Material(0.5).isotropic(0.6, pressure=0.01))
    assert problem.comm.allreduce(problem.point_volumes().sum()) == pytest.approx(np.prod(size), rel=1e-12)


def test_grading_is_given_by_a_list_or_by_axes(tmp_path):
    for given in ("[1, 4]", "{ y = 4 }"):
        mesh = scene_file.read_scene(written(tmp_path, BOX.replace("cells = [4, 2]", f"cells = [4, 2]\ngrading = {given}"))).mesh
        assert mesh["grading"] == [1, 4]
    problem, _ = scene.solve(tmp_path / "scene.toml", tmp_path / "out")
    assert np.unique(problem.positions[:, 1].round(12)).tolist() == [0, 0.1, 0.5]
    for given in ("4", "[1, 2, 3]", "[1, 0]", "{ z = 2 }", "{}"):
        assert "must be 2 numbers above 0" in faults(tmp_path, BOX.replace("cells = [4, 2]", f"cells = [4, 2]\ngrading = {given}"))
