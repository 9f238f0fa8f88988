"""Quantities of interest of boundary-value problems: values, times, ranks, checkpoints, and what is refused."""

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem
from granumat.fem import scene, scene_file
from granumat.quantities import Quantity, read_values
from support import scenes
from support.scenes import faults, read_table, solved, written

pytestmark = pytest.mark.release_only
RING = scenes.RING + """
[output]
probes = { wall = [1.1, 0] }
[[region]]
name = "core"
ring = [1, 1.5]
[[region]]
name = "corner"
box = [[1, 0], [2, 1]]
[[quantity]]
name = "torque"
of = "moment of inner"
at = [0.25, 1.5]
tolerance = 0.02
[[quantity]]
name = "force"
of = "reaction x of outer"
at = "range"
[[quantity]]
name = "wall"
of = "sigma_xy at wall"
[[quantity]]
name = "height"
of = "y at wall"
[[quantity]]
name = "phi"
of = "mean phi"
[[quantity]]
name = "p"
of = "mean p of core"
at = "range"
[[quantity]]
name = "Z2"
of = "mean Z2 of corner"
"""


def test_a_scenes_quantities_are_what_the_problem_says_at_times_that_are_met(tmp_path):
    problem, tables = solved(tmp_path, RING)
    assert tables.keys() == {"reactions", "probe-wall", "quantities"}
    values = read_values(tmp_path / "out/quantities.csv", scene_file.read_scene(tmp_path / "scene.toml").quantities)
    reactions, wall = tables["reactions"], tables["probe-wall"]
    assert reactions["t"].tolist() == [0.25, 1.25, 1.5, 2.5, 3] == values["force"][0].tolist()
    assert values["torque"][0].tolist() == [0.25, 1.5]
    np.testing.assert_array_equal(values["torque"][1], reactions["inner_M"][[0, 2]])
    np.testing.assert_array_equal(values["force"][1], reactions["outer_F_x"])
    for name, column in (("wall", "sigma_xy"), ("height", "y")):
        assert values[name] == (3, wall[column][-1])
    volumes, states = problem.point_volumes(), problem.states
    start = problem.point_positions(at_start=True)
    assert values["phi"][1] == pytest.approx(volumes @ states.volume_fraction / volumes.sum(), rel=1e-13)
    core, corner = np.hypot(*start.T) < 1.5, (start >= [1, 0]).all(axis=1) & (start[:, 1] <= 1)
    assert core.sum() == len(core) / 2 and 0 < corner.sum() < len(corner) / 6
    p = -states.stress[:, :3].sum(axis=1) / 3
    assert values["p"][1][-1] == pytest.approx(volumes[core] @ p[core] / volumes[core].sum(), rel=1e-13)
    assert values["Z2"][1] == pytest.approx(volumes[corner] @ states.coordination_number[corner] / volumes[corner].sum(), rel=1e-13)


def test_a_moment_in_three_dimensions_has_an_axis(tmp_path):
    _, tables = solved(tmp_path, scenes.RING.replace("cells = [4, 12]", "cells = [4, 12, 1]\nheight = 0.2") + """
        [[condition]]
        on = ["bottom", "top"]
        displacement = { z = 0 }
        [[quantity]]
        name = "torque"
        of = "moment z of inner"
    """)
    assert tables["quantities"]["torque"].tolist() == tables["reactions"]["inner_M_z"].tolist()
    assert tables["quantities"]["torque"].all()


def test_a_run_that_goes_on_leaves_the_table_of_one_that_was_not_stopped(tmp_path):
    path = written(tmp_path, RING + "[output.checkpoint]\nevery = 2\n")
    scene.solve(path, tmp_path / "whole")
    table = (tmp_path / "whole/quantities.csv").read_text().split("\n")
    short = written(tmp_path, RING.replace("until = 3", "until = 1.5"))
    scene.solve(short, tmp_path / "cut")
    with open(tmp_path / "cut/quantities.csv", "a") as stream:
        stream.write("2.5,0,0,0")                                                      # what a killed run left behind
    scene.solve(written(tmp_path, RING), tmp_path / "cut", resumed=True)
    again = (tmp_path / "cut/quantities.csv").read_text().split("\n")
    assert again[:4] == table[:4] and len(again) == len(table) == 7
    np.testing.assert_allclose(np.loadtxt(again[1:], delimiter=","), np.loadtxt(table[1:], delimiter=","), rtol=1e-9, atol=1e-12)


def test_the_table_does_not_depend_on_the_number_of_ranks(mpirun, tmp_path):
    written(tmp_path, RING)
    script = "import sys\nfrom granumat.fem import scene\nscene.solve('scene.toml', sys.argv[1])"
    tables = []
    for ranks in (1, 3):
        mpirun(script, ranks, f"of{ranks}")
        tables.append(read_table(tmp_path / f"of{ranks}/quantities.csv"))
    for name in tables[0].dtype.names:
        np.testing.assert_allclose(tables[1][name], tables[0][name], rtol=1e-9, atol=1e-11, err_msg=name)


def test_every_fault_of_a_files_quantities_and_regions_comes_in_one_message(tmp_path):
    said = faults(tmp_path, scenes.RING + """
        [[region]]
        name = "core"
        ring = [2, 1]
        [[region]]
        name = "core"
        box = [[0, 0], [1, 0]]
        where = 3
        [[region]]
    """)
    for words in ("region 1: is wrong", "ring = [2, 1]: must be two radii", "box = [[0, 0], [1, 0]]: must be the lowest and the",
                  "unknown key 'where'", "region 3", "name is missing", "must have either box or ring", "'core' is given 2 times"):
        assert words in said, words + said
    of = {"moment of lid": "there is no side that a condition holds 'lid': there are inner, outer",
          "torque": "must be \"reaction x of SIDE",
          "reaction of inner": "must be \"reaction x of", "reaction z of inner": "the component 'z' must be one of x, y",
          "moment z of inner": "in plane strain there is one moment", "p at middle": "there is no probe 'middle': there are wall",
          "speed at wall": "the field 'speed' must be one of x, y, phi, p", "mean x": "the field 'x' must be one of phi, p",
          "mean p of shell": "there is no region 'shell': there are core"}
    tables = "".join(f"[[quantity]]\nname = \"q{number}\"\nof = '{text}'\n" for number, text in enumerate(of))
    said = faults(tmp_path, RING.split("[[region]]")[0] + "[[region]]\nname = \"core\"\nring = [1, 2]\n" + tables
                  + "[[quantity]]\nname = \"late\"\nof = \"mean p\"\nat = [0, 3.5]\n")
    for words in (*of.values(), "at 0: must be above 0, and at most until = 3", "at 3.5: must be above 0, and at most until = 3"):
        assert words in said, words + said


def test_in_python_what_does_not_fit_the_problem_is_refused_when_the_run_begins(tmp_path):
    material = Material(0.5, elastic_strain=0.01)
    bottom = {"bottom": lambda x: np.isclose(x[1], 0)}
    problem = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, [1, 1], [2, 2]), material, material.isotropic(0.6, pressure=0.01),
                          [fem.Displacement(bottom["bottom"])])
    with pytest.raises(ValueError, match=r"(?s)q: of = 'p at q': there is no probe 'q': there are none.*two of them have the same"):
        fem.Quantities(tmp_path / "q.csv", [Quantity("q", "p at q"), Quantity("q", "mean p")])
    outside = fem.Quantities(tmp_path / "q.csv", [Quantity("q", "mean p of far")], regions={"far": lambda x: x[:, 0] > 2})
    with pytest.raises(ValueError, match="the region 'far' has no integration point"):
        fem.run(problem, 1, 1, observers=[outside])
    in_space = fem.Quantities(tmp_path / "q.csv", [Quantity("q", "moment z of bottom")], bottom)
    with pytest.raises(ValueError, match="in plane strain there is one moment"):
        fem.run(problem, 1, 1, observers=[in_space])
