"""Malformed scene files: each is refused in words that name its fault, before anything is computed."""

import pytest

from granumat.fem import scene
from support.scenes import BOX, RING, replaced, written

pytestmark = pytest.mark.release_only

HUGE = 12345678901234567890
GMSH = replaced(BOX, {'kind = "box"\nsize = [1, 0.5]\ncells = [4, 2]': 'kind = "gmsh"\nfile = "body.msh"'})
SHEAR = "displacement = { x = [[0, 0], [3.5, 0.02], [10, -0.02]] }"


def box(old, new):
    return replaced(BOX, {old: new})


def ring(old, new):
    return replaced(RING, {old: new})


def output(text):
    return f"{BOX}[output]\n{text}\n"


def problem(text):
    return f"{BOX}[problem]\n{text}\n"


def condition(text):
    return f"{BOX}[[condition]]\n{text}\n"


def quantity(text):
    return f'{BOX}[[quantity]]\nname = "a"\n{text}\n'


# Text of a scene file, and what is said of it.
SCENES = [
    # mesh
    (box("[mesh]\n", "[mesh]\nkin = 1\n"), "unknown key 'kin'"), (box('kind = "box"', 'kind = "bax"'), "kind = 'bax'"),
    (box('kind = "box"', "kind = 1"), "kind = 1"), (box('kind = "box"', 'kind = ["box"]'), "kind = ['box']"),
    (box("size = [1, 0.5]\n", ""), "size is missing"), (box("[1, 0.5]", "[1, -0.5]"), "size = [1, -0.5]"),
    (box("[1, 0.5]", "[1, nan]"), "size = [1, nan]"), (box("[1, 0.5]", "1"), "size = 1"),
    (box("[1, 0.5]", '["1", 2]'), "size = ['1', 2]"), (box("[1, 0.5]", "[1, 1e400]"), "size = [1, inf]"),
    (box("[4, 2]", "[4]"), "cells = [4]"), (box("[4, 2]", "[0, 2]"), "cells = [0, 2]"),
    (box("[4, 2]", "[4.5, 2]"), "cells = [4.5, 2]"),
    (box("[4, 2]", f"[{HUGE}, 2]"), f"cells = [{HUGE}, 2]"), (box("[4, 2]", "[4, 2, 2]"), "cells = [4, 2, 2]"),
    (box("[4, 2]", "[100000, 100000]"), "must be 2147483647 together at most"),
    (box("[4, 2]", '[4, 2]\ncell = "hexahedron"'), "cell = 'hexahedron'"), (box("[4, 2]", "[4, 2]\ncell = 3"), "cell = 3"),
    (box("[4, 2]", "[4, 2]\ngrading = [1]"), "grading = [1]"), (box("[4, 2]", "[4, 2]\ngrading = 0"), "grading = 0"),
    (box("[4, 2]", "[4, 2]\ngrading = { z = 2 }"), "grading = {'z': 2}"), (box("[4, 2]", "[4, 2]\nlayer = 1"), "layer = 1"),
    (ring("[1, 2]", "[2, 1]"), "radii = [2, 1]"), (ring("[1, 2]", "[0, 1]"), "radii = [0, 1]"),
    (ring("[1, 2]", "[1]"), "radii = [1]"),
    (ring("[4, 12]", "[4, 2]"), "must be 3 sectors or more"), (ring("[4, 12]", "[4, 12]\nheight = -1"), "height = -1"),
    (ring("[4, 12]", "[4, 12]\nheight = 1"), "must be 3 integers"), (GMSH, "there is no such file"),
    (replaced(GMSH, {'"body.msh"': "1"}), "file = 1"), (replaced(GMSH, {'file = "body.msh"': ""}), "file is missing"),
    # initial state
    (box('state = "isotropic"', 'state = "K0"'), "needs a gravity"), (box("phi = 0.60", "phi = 2"), "phi = 2"),
    (box('state = "isotropic"', 'state = ["K0"]'), "state = ['K0']"), (box("phi = 0.60\n", ""), "phi is missing"),
    (ring('state = "isotropic"\nphi = 0.60\npressure = 0.01', 'state = "steady"\nphi = 0.6'), "of a box only"),
    (box("pressure = 0.007\n[[condition]]\non = \"bottom\"", "[[condition]]\non = \"bottom\""), "give either pressure"),
    # problem
    (problem("degree = 3"), "degree = 3"), (problem('degree = "1"'), "degree = '1'"), (problem("degree = [1]"), "degree = [1]"),
    (problem("gravity = 1"), "gravity = 1"), (problem("gravity = [0, 0, -1]"), "must be 2 finite numbers"),
    (problem("gravity = [0, nan]"), "gravity = [0, nan]"), (problem("rate_term = -1"), "rate_term = -1"),
    (problem('solver = "lu"'), "solver: must be a table"), (problem('solver = { pc_type = "foo" }'), "find requested PC type foo"),
    (problem('solver = { ksp_type = "foo" }'), "find requested KSP type foo"),
    (problem('solver = { mat_type = "foo" }'), "mat_type = 'foo': must be one of aij, baij"),
    (problem("solver = { ksp_max_it = [1] }"), "ksp_max_it = [1]: must be a text, a number"),
    (problem("tolerances = 1"), "tolerances: must be a table"), (problem("tolerances = { force = 0 }"), "force = 0"),
    (problem(f"tolerances = {{ iterations = {HUGE} }}"), f"iterations = {HUGE}"),
    (problem("tolerance = 1"), "unknown key 'tolerance'"),
    # conditions
    (condition('on = "botom"\npressure = 1'), "'botom' is no side"), (condition("pressure = 1"), "on is missing"),
    (condition('on = "left"'), "says nothing"), (condition("on = []\npressure = 1"), "on = []"),
    (condition("on = 1\npressure = 1"), "on = 1"),
    (condition('on = "left"\npresure = 1'), "unknown key 'presure'"), (condition('on = "left"\npressure = "a"'), "pressure = 'a'"),
    (condition('on = "left"\npressure = nan'), "pressure = nan"), (condition('on = "left"\npressure = []'), "pressure = []"),
    (condition('on = "left"\npressure = [[0, 1], [0, 2]]'), "with increasing times"),
    (condition('on = "left"\npressure = [[1, 2, 3]]'), "pressure = [[1, 2, 3]]"),
    (condition('on = "left"\ntraction = 1'), "traction = 1"),
    (condition('on = "left"\ntraction = { z = 1 }'), "traction = {'z': 1}"), (box(SHEAR, "displacement = 1"), "displacement = 1"),
    (box(SHEAR, "displacement = { x = 0.1 }"), "must be 0 at t = 0"), (box(SHEAR, "displacement = { q = 0 }"), "'q'"),
    (box(SHEAR, "displacement = {}"), "displacement = {}"), (box(SHEAR, "displacement = { x = [[0, 0], [1, nan]] }"), "nan"),
    (box('platen = "y"', 'platen = "z"'), "platen = 'z'"), (box('platen = "y"', "platen = 1"), "platen = 1"),
    (box("periodic = true", "periodic = false"), "periodic = true stands alone"),
    (box('on = ["left", "right"]', 'on = ["left", "top"]'), "periodic = true stands alone"),
    (box('on = ["left", "right"]', 'on = "left"'), "periodic = true stands alone"),
    (ring("rotation = [[0, 0], [10, 0.02]]", "rotation = 1"), "must be 0 at t = 0"),
    (ring("rotation = [[0, 0], [10, 0.02]]", "rotation = 0\ncenter = [0]"), "center = [0]"),
    (ring('platen = "radial"', 'center = [0, 0]'), "center belongs to rotation"), (ring("circumferential", "x"), "'x'"),
    (ring('platen = "radial"', "traction = { radial = 1 }"), "on a ring only pressure"),
    # run
    (box("until = 6\n", ""), "until is missing"), (box("until = 6", "until = 0"), "until = 0"),
    (box("until = 6", "until = inf"), "until = inf"),
    (box("increment = 1", "increment = 0"), "increment = 0"), (box("increment = 1", "increment = -1"), "increment = -1"),
    (box("increment = 1", "increment = 1e-300"), "increment = 1e-300: is lost beside until = 6"),
    (box("increment = 1", 'increment = "1"'), "increment = '1'"),
    (box("increment = 1", "increment = [[0, 1], [1, 0]]"), "must be above 0"),
    (box("increment = 1", "increment = 1\nsmallest = 2"), "smallest = 2"),
    (box("increment = 1", "increment = 1\nsmallest = 1e-300"), "smallest = 1e-300: must be"),
    (BOX + "steps = 5\n", "unknown key 'steps'"),
    # output
    (output("every = 0"), "every = 0"), (output(f"every = {HUGE}"), f"every = {HUGE}"), (output("times = 1"), "times = 1"),
    (output("times = [-1]"), "times = [-1]"), (output('pictures = ["heat"]'), "heat"),
    (output("pictures = 1"), "pictures = 1"),
    (output("pictures = [[1]]"), "pictures"),
    (output("probes = [1]"), "probes = [1]"), (output("probes = { a = [1] }"), "probes = {'a': [1]}"),
    (output("probes = { a = [5, 5] }"), "probes: a = [5, 5]: is outside the body"),
    (output("probes = { a = [0.5, 0.51] }"), "probes: a = [0.5, 0.51]: is outside the body"),
    (RING + "[output]\nprobes = { a = [0, 0] }\n", "probes: a = [0, 0]: is outside the body"),
    (output('probes = { "../a" = [0, 0] }'), "their names may have"), (output("center = 1"), "center = 1"),
    (output("checkpoint = {}"), "checkpoint = {}"), (output("checkpoint = { every = 0 }"), "checkpoint every = 0"),
    (output("checkpoint = { seconds = -1 }"), "seconds = -1"), (output("evry = 1"), "unknown key 'evry'"),
    # regions and quantities
    (BOX + "[[region]]\nbox = [[0, 0], [1, 1]]\n", "name is missing"),
    (BOX + '[[region]]\nname = "a"\n', "must have either box or ring"),
    (BOX + '[[region]]\nname = "a"\nbox = [[1, 1], [0, 0]]\n', "box = [[1, 1], [0, 0]]"),
    (BOX + '[[region]]\nname = "a"\nring = [2, 1]\n', "ring = [2, 1]"),
    (BOX + '[[region]]\nname = "a"\nbox = [[5, 5], [6, 6]]\n[[quantity]]\nname = "b"\nof = "mean p of a"\n', "integration point"),
    (quantity('of = "reaction x of lid"'), "there is no side that a condition holds 'lid'"),
    (quantity('of = "reaction z of top"'), "'z' must be one of x, y"), (quantity('of = "p at here"'), "there is no probe 'here'"),
    (quantity('of = "mean heat"'), "'heat' must be one of"), (quantity('of = "force"'), "must be \"reaction x of SIDE\""),
    (quantity('of = "mean p"\nat = [7]'), "at most until = 6"),
    # a body that nothing holds
    (box("displacement = { x = 0, y = 0 }", "pressure = 0.007").replace(SHEAR, ""), "nothing holds the body against translation"),
]


@pytest.mark.parametrize("number", range(len(SCENES)))
def test_a_malformed_scene_file_is_refused_in_words(tmp_path, number):
    text, words = SCENES[number]
    with pytest.raises(ValueError) as caught:
        scene.solve(written(tmp_path, text), tmp_path / "out")
    assert words in str(caught.value)
    assert not list(tmp_path.glob("out/*.csv"))


GEO = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 1, 0.5};
Rectangle(2) = {1, 0, 0, 1, 0.5};
Coherence;
Physical Surface(1) = {1, 2};
Physical Curve("sides") = {1, 2};
Mesh.CharacteristicLengthMax = 0.25;
"""


@pytest.mark.parametrize("old, new, dimension, words", [
    ("Mesh.", "Recombine Surface {1};\nMesh.", 2, "has cells of the kinds Quadrilateral 4, Triangle 3: must be of one kind"),
    ("Physical Surface(1) = {1, 2};", "", 2, "must have a physical group of surfaces"),
    ("Physical Surface(1) = {1, 2};", "Physical Surface(1) = {1, 2};\nPhysical Surface(2) = {2};", 2, "several physical groups"),
    ("{1, 0, 0, 1, 0.5};", "{1, 0, 0, 1, 0.5};\nRotate {{1, 0, 0}, {0, 0, 0}, 0.3} { Surface{1, 2}; }", 2, "must be flat"),
    ("Mesh.", "Mesh.", 1, "has no cells"),
])
def test_a_gmsh_file_of_other_cells_is_refused_in_words(tmp_path, old, new, dimension, words):
    import gmsh
    (tmp_path / "body.geo").write_text(replaced(GEO, {old: new}))
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(tmp_path / "body.geo"))
    gmsh.model.mesh.generate(dimension)
    gmsh.write(str(tmp_path / "body.msh"))
    gmsh.finalize()
    text = replaced(GMSH, {'on = ["left", "right"]\nperiodic = true': 'on = "sides"\npressure = 0.007'})
    with pytest.raises(ValueError, match=f"body.msh: .*{words}"):
        scene.solve(written(tmp_path, text), tmp_path / "out")
    (tmp_path / "body.msh").write_text("no mesh")
    with pytest.raises(ValueError, match="cannot be read by gmsh"):
        scene.solve(tmp_path / "scene.toml", tmp_path / "out")
