"""Scenes of which a part is modelled have the results of the whole: a sector, a layer, plane strain."""

import re

import pytest

from support import scenes
from support.scenes import faults, replaced, solved

pytestmark = pytest.mark.release_only

RING = replaced(scenes.RING, {"[10, 0.02]": "[2, 0.01], [10, -0.03]", "until = 3": "until = 4"}) + """
[problem]
tolerances = { force = 1e-12, correction = 1e-8 }
[[region]]
name = "core"
ring = [1, 1.5]
[[quantity]]
name = "torque"
of = "moment of inner"
[[quantity]]
name = "force"
of = "reaction x of inner"
[[quantity]]
name = "ratio"
of = "sigma_xy at left"
[[quantity]]
name = "normal"
of = "mean sigma_xx of core"
[[quantity]]
name = "fabric"
of = "mean A_xy of core"
[[quantity]]
name = "Z2"
of = "mean Z2"
[output]
probes = { left = [-1.2, -0.4], axis = [1.5, 0] }
center = [0.5, 0.3]
"""

BOX = replaced(scenes.BOX, {"[4, 2]": "[6, 3]", "[3.5, 0.02]": "[2, 0.02]", "until = 6": "until = 4",
                           "[[0, 0.007], [10, 0.008]]": "0.007"}) + """
[problem]
tolerances = { force = 1e-12, correction = 1e-8 }
gravity = [0, -0.001]
[[region]]
name = "below"
box = [[0.2, 0], [0.6, 0.2]]
[[quantity]]
name = "moment"
of = "moment of top"
[[quantity]]
name = "force"
of = "reaction x of top"
[[quantity]]
name = "middle"
of = "sigma_xy at middle"
[[quantity]]
name = "fabric"
of = "mean A_xy of below"
[[quantity]]
name = "phi"
of = "mean phi"
[output]
probes = { middle = [0.5, 0.25], right = [1, 0.4] }
center = [0.1, 0.2]
"""


SMALL = 1e-4                        # a hundredth of the pressures


def columns(directory, text):
    """The problem of a scene, and every column of every table that it leaves, but for the number of iterations."""
    problem, tables = solved(directory, text)
    return problem, {f"{stem} {name}": table[name] for stem, table in tables.items() for name in table.dtype.names
                     if name != "iterations"}


def largest_difference(whole, part):
    """Of all columns, relative to a column's largest value, or to SMALL."""
    assert whole.keys() == part.keys()
    return max(abs(part[name] - values).max() / max(abs(values).max(), SMALL) for name, values in whole.items())


def without(whole, pattern):
    """The columns whose names do not match: what the part does not have."""
    return {name: values for name, values in whole.items() if not re.search(pattern, name)}


IN_SPACE = {"cells = [4, 12]": "cells = [4, 12, 1]\nheight = 0.2", "moment of": "moment z of", "[-1.2, -0.4]": "[-1.2, -0.4, 0.1]",
            "[1.5, 0]": "[1.5, 0, 0.2]", "[0.5, 0.3]": "[0.5, 0.3, 0.1]",
            "[run]": "[[condition]]\non = [\"bottom\", \"top\"]\ndisplacement = { z = 0 }\n[run]"}
BOX_IN_SPACE = {"size = [1, 0.5]\ncells = [6, 3]": "size = [1, 0.4, 0.5]\ncells = [4, 2, 3]", "gravity = [0, ": "gravity = [0, 0, ",
                "x = 0, y = 0": "x = 0, y = 0, z = 0", "[10, -0.02]]": "[10, -0.02]], y = 0",
                "platen = \"y\"": "platen = \"z\"", "[[0.2, 0], [0.6, 0.2]]": "[[0.2, 0, 0], [0.6, 0.4, 0.2]]", "_xy": "_xz",
                "moment of": "moment y of", "[0.5, 0.25]": "[0.6, 0.2, 0.25]", "[1, 0.4]": "[1, 0.3, 0.4]",
                "[0.1, 0.2]": "[0.1, 0.1, 0.2]", "[run]": "[[condition]]\non = [\"front\", \"back\"]\nperiodic = true\n[run]"}


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron"])
def test_a_sector_is_the_ring(tmp_path, cell):
    text = replaced(RING, IN_SPACE) if cell == "hexahedron" else RING
    text = text.replace('kind = "annulus"', f'kind = "annulus"\ncell = "{cell}"')
    _, whole = columns(tmp_path / "whole", text)
    problem, part = columns(tmp_path / "part", text.replace("kind", "sector = true\nkind", 1))
    assert problem.cells in (4, 8)
    assert abs(whole["quantities torque"][-1]) > 5e-4 and abs(whole["quantities ratio"][-1]) > 1e-4
    assert largest_difference(whole, part) < 1e-10


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_a_layer_is_the_box(tmp_path, cell):
    text = replaced(BOX, BOX_IN_SPACE) if cell == "hexahedron" else BOX
    _, whole = columns(tmp_path / "whole", text)
    problem, part = columns(tmp_path / "part", text.replace("kind", "layer = true\nkind", 1))
    assert problem.cells in (6, 12)
    assert largest_difference(whole, part) < 1e-10


@pytest.mark.parametrize("across", ["periodic = true", "displacement = { y = 0 }"])
def test_plane_strain_is_the_box(tmp_path, across):
    text = replaced(BOX, BOX_IN_SPACE).replace("[\"front\", \"back\"]\nperiodic = true", f"[\"front\", \"back\"]\n{across}")
    _, whole = columns(tmp_path / "whole", text)
    problem, part = columns(tmp_path / "part", text.replace("kind", "plane = true\nlayer = true\nkind", 1))
    assert problem.d == 2 and problem.cells == 6
    assert (part["probe-middle y"] == 0.2).all()                     # as the file has it, while a point in space is beside it
    assert largest_difference(without(whole, "front|back|probe.* y"), without(part, "probe.* y")) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("initial", ['state = "K0"\nphi = 0.60\npressure = 0.007\nK0 = 0.8', 'state = "steady"\nphi = 0.60'])
def test_an_initial_state_has_the_axes_of_the_whole_box(tmp_path, initial):
    text = replaced(BOX, BOX_IN_SPACE).replace('state = "isotropic"\nphi = 0.60\npressure = 0.007', initial)
    if "steady" in initial:
        text = text.replace("gravity = [0, 0, -0.001]\n", "").replace("pressure = 0.007\n", "")
    _, whole = columns(tmp_path / "whole", text)
    _, part = columns(tmp_path / "part", text.replace("kind", "plane = true\nkind", 1))
    assert largest_difference(without(whole, "front|back|probe.* y"), without(part, "probe.* y")) < 1e-5


@pytest.mark.parametrize(("degree", "difference"), [(1, 1e-2), (2, 1e-4)])
def test_plane_strain_is_the_hollow_cylinder(tmp_path, degree, difference):
    text = replaced(RING, IN_SPACE).replace("[problem]", f"[problem]\ndegree = {degree}")
    _, whole = columns(tmp_path / "whole", text.replace("kind", "sector = true\nkind", 1))
    problem, part = columns(tmp_path / "part", text.replace("kind", "plane = true\nsector = true\nkind", 1))
    assert problem.d == 2 and problem.cells == 4
    kept = "bottom|top|probe" if degree == 1 else "bottom|top|probe.* z"               # of degree 1, B-bar averages along z too
    assert largest_difference(without(whole, kept), without(part, kept)) < difference


def test_what_contradicts_a_reduction_is_refused_at_once(tmp_path):
    def refused(text, keys, *pairs):
        return faults(tmp_path, replaced(text, dict(pairs)).replace("kind", f"{keys}\nkind", 1))

    given = 'state = "given"\nphi = 0.60\nZ2 = 5.5\nfabric = [0.01, -0.01, 0, 0.01, 0, 0.02]'
    isotropic = 'state = "isotropic"\nphi = 0.60\npressure = '
    in_space = replaced(BOX, BOX_IN_SPACE)
    found = {
        "plane = true: the scene is one of the plane already": refused(BOX, "plane = true"),
        "layer = 3: must be true or false": refused(BOX, "layer = 3"),
        "unknown key 'sector'": refused(BOX, "sector = true"),
        "front and back must have displacement = { y = 0 } and nothing else, or be periodic": refused(
            in_space, "plane = true", ('["front", "back"]', '["bottom", "top"]')),
        "top must not move and not be loaded along y": refused(in_space, "plane = true", ("], y = 0", "], y = [[0, 0], [1, 1]]")),
        "rotation of top in the plane x y is none": refused(in_space, "plane = true", (
            "displacement = { x = [[0, 0], [2, 0.02], [10, -0.02]], y = 0 }", "rotation = 0")),
        "gravity must have no component along y": refused(in_space, "plane = true", ("[0, 0, -0.001]", "[0, 1, 0]")),
        "no shear with y": refused(in_space, "plane = true", (isotropic + "0.007", given)),
        "there is no reaction of front in the plane": refused(
            in_space, "plane = true", ("periodic = true\n[run]", "displacement = { y = 0 }\n[run]"), ("x of top", "y of front")),
        "bottom and top must have displacement = { z = 0 } and nothing else": refused(
            replaced(RING, IN_SPACE), "plane = true", ("{ z = 0 }", "{ z = [[0, 0], [1, 1]] }")),
        "rotation of inner must be about [0, 0]": refused(RING, "sector = true", ("rotation", "center = [1, 0]\nrotation")),
        "gravity must be along the axis": refused(RING, "sector = true", ("[problem]", "[problem]\ngravity = [0, -1]")),
        "the same in all directions": refused(RING, "sector = true", (isotropic + "0.01", given)),
        "region 'core' must be a ring": refused(RING, "sector = true", ("ring = [1, 1.5]", "box = [[0, 0], [1, 1]]")),
        "left and right must be periodic, and nothing else": refused(BOX, "layer = true", ("periodic = true", "pressure = 0.01")),
        "at least 2 columns": refused(BOX, "layer = true", ("[6, 3]", "[1, 3]")),
        "no grading along x": refused(BOX, "grading = [2, 1]\nlayer = true"),
        "rotation of top is not uniform": refused(BOX, "layer = true", (
            "displacement = { x = [[0, 0], [2, 0.02], [10, -0.02]] }", "rotation = 0")),
        "gradient of top along x is not uniform": refused(BOX, "layer = true", ("displacement = { x = [[0, 0], [2,", (
            "gradient = { yx = 0 }\ndisplacement = { x = [[0, 0], [2,"))),
        "gradient of top must have nothing to do with y": refused(
            in_space, "plane = true", ("platen", "gradient = { zy = 0 }\nplaten")),
        "region 'below' must be a box": refused(BOX, "layer = true", ("box = [[0.2, 0], [0.6, 0.2]]", "ring = [0, 1]")),
    }
    for words, said in found.items():
        assert words in said, said
    several = refused(BOX, "grading = [2, 1]\nlayer = true", ("periodic = true", "periodic = false"), ("until = 4", "until = -1"))
    assert "no grading along x" in several and "until = -1" in several
