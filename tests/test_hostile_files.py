"""Malformed path files and scene files: each is refused in words that name its fault, or runs rightly."""

import pytest

from granumat import Material, cli, driver
from granumat.errors import UnmetConditionWarning
from granumat.paths import read_path_file

pytestmark = pytest.mark.release_only

MATERIAL, INITIAL, STEP = "mu = 0.5", 'phi = 0.6\nstate = "steady"', "shear = 0.01\nincrements = 2"
HUGE = 12345678901234567890


def path(material=MATERIAL, initial=INITIAL, step=STEP, more=""):
    return f"{more}\n[material]\n{material}\n[initial]\n{initial}\n[[step]]\n{step}\n"


def step(text):
    return path(step=text)


def quantity(text):
    return path() + f"[[quantity]]\n{text}\n"


GIVEN = 'state = "given"\nphi = 0.6\nZ2 = 5.2\n'

# Text of a path file, and what is said of it.
PATHS = [
    # not TOML
    ("", "state = None"), ("hello", "not a TOML file"), ("[material", "not a TOML file"), ("\x00\x01", "not a TOML file"),
    (path(material="mu = 0.5\nmu = 0.4"), "not a TOML file"), (path(material="mu = .5"), "not a TOML file"),
    (path(material="mu == 0.5"), "not a TOML file"), (path() + "[initial]\nphi = 0.6\n", "not a TOML file"),
    (path(material="mu = 1e"), "not a TOML file"), (path(material="mu = 0,5"), "not a TOML file"),
    (path(material="mu = true false"), "not a TOML file"), (path(step="shear = [0.1"), "not a TOML file"),
    (path(material="closure = full"), "not a TOML file"), (b"\xff\xfe[\x00m\x00", "not a TOML file"),
    (b"[material]\nmu = 0.5 # \xe4\n", "not a TOML file"), ("{\"material\": 1}", "not a TOML file"),
    # tables
    ("[material]\nmu = 0.5\n", "no steps"), (path(more="material = 3").replace("[material]", "[materials]"), "materials"),
    (path(more="steps = 3"), "'steps'"), (path(more="tolerance = 0"), "tolerance = 0"), (path(more="tolerance = nan"), "tolerance"),
    (path(more='tolerance = "small"'), "tolerance = 'small'"), (path(more="tolerance = 1e400"), "tolerance = inf"),
    (path().replace("[[step]]", "[step]"), "no steps"), (path() + "[output]\nacustic = true\n", "'acustic'"),
    (path() + "[output]\nacoustic = 1\n", "acoustic = 1"), ("output = 3\n" + path(), "output: must be a table"),
    (path() + "[ladders]\n", "'ladders'"), ("step = []\n", "no steps"), ("step = [1, 2]\n", "no steps"),
    # material
    (path("mu = -1"), "mu = -1.0: must be at least 0"), (path("mu = nan"), "mu = nan"), (path("mu = inf"), "mu = inf"),
    (path("mu = [0.5]"), "mu = [0.5]: must be a number"), (path("mu = true"), "mu = True: must be a number"),
    (path("mu = 1979-05-27"), "must be a number"), (path("nu = 0.5"), "unknown name 'nu'"), (path("zc = 4"), "did you mean 'Zc'"),
    (path('closure = "Full"'), "closure 'Full'"), (path('closure = ""'), "closure ''"), (path("closure = 1"), "closure 1"),
    (path('contact = "hertz"'), "did you mean 'hertzian'"), (path('friction = "quadratic"'), "give b1, b2, b3"),
    (path("elastic_strain = -0.01"), "elastic_strain = -0.01: must be at least 0"),
    (path("c3 = -1"), "c3 = -1.0: must be at least 0"),
    (path('method = "euler"'), "method 'euler'"), (path("method_tolerance = 2"), "method_tolerance = 2"),
    (path(f"mu = {HUGE}"), "must be at least 0 and at most 1"), (path('spin = "outside"'), "spin 'outside'"),
    (path('closure = "n2"\na4 = 1'), "has no role in the closure 'n2'"), (path('calibration = "figure"'), "calibration 'figure'"),
    (path("phic = 0"), "phic = 0.0: must be above 0"), (path('mu = "0.5"'), "mu = '0.5': must be a number"),
    (path("Zc = -4"), "Zc = -4.0: must be"), (path("d2 = -1"), "d2 = -1.0: must be at least 0"),
    (path("b1 = {}"), "b1 = {}: must be a number"),
    # initial state
    (path(initial='state = "steady"'), "phi is missing"), (path(initial="phi = 0.6"), "state = None: must be one of"),
    (path(initial='phi = 1.6\nstate = "steady"'), "phi = 1.6"), (path(initial='phi = "0.6"\nstate = "steady"'), "phi = '0.6'"),
    (path(initial='phi = nan\nstate = "steady"'), "phi = nan"), (path(initial='phi = 0.6\nstate = "stedy"'), "state = 'stedy'"),
    (path(initial='phi = 0.6\nstate = ["steady"]'), "state = ['steady']"), (path(initial='phi = 0\nstate = "steady"'), "phi = 0"),
    (path(initial='phi = 0.6\nstate = "isotropic"'), "give either pressure or coordination_number"),
    (path(initial='phi = 0.6\nstate = "isotropic"\npressure = -1'), "pressure = -1"),
    (path(initial='phi = 0.6\nstate = "isotropic"\npressure = nan'), "pressure = nan"),
    (path(initial='phi = 0.6\nstate = "isotropic"\npressure = "1"'), "pressure = '1'"),
    (path(initial='phi = 0.6\nstate = "isotropic"\npressure = 0.01\nZ2 = 5'), "give either pressure or coordination_number"),
    (path(initial='phi = 0.6\nstate = "isotropic"\nZ2 = inf'), "coordination_number = inf"),
    (path(initial='phi = 0.6\nstate = "steady"\npresure = 1'), "unknown key 'presure'"),
    (path(initial='phi = 0.6\nstate = "given"'), "Z2 is missing"), (path(initial=GIVEN + 'Z2 = 5'), "not a TOML file"),
    (path(initial=GIVEN + "fabric = [1, 0, 0]"), "fabric: must be 6 numbers"),
    (path(initial=GIVEN + "fabric = [1, 0, 0, 0, 0, 0]"), "its trace is 1"),
    (path(initial=GIVEN + "fabric = [0.4, -0.4, 0, 0, 0, 0]"), "eigenvalues of A + I/3"),
    (path(initial=GIVEN + 'fabric = "none"'), "fabric: must be 6 numbers"),
    (path(initial=GIVEN + "direction = [2, -2, 0, 0, 0, 0]"), "its magnitude is 2"),
    (path(initial=GIVEN + "stress = [nan, 0, 0, 0, 0, 0]"), "must be finite"),
    (path(initial=GIVEN + "stress = [-9, -9, -9, 0, 0, 0]"), "has the pressure 9, but this material's law gives"),
    (path(initial=GIVEN + "stress = [[1, 2], [3]]"), "stress: must be 6 numbers"),
    # steps
    (step(""), "must have exactly one of the keys"), (step("shear = 1\npause = true"), "must have exactly one of the keys"),
    (step('shear = "1"'), "shear = '1': must be a finite number"), (step("shear = nan"), "shear = nan"),
    (step("shear = inf"), "shear = inf"), (step("shear = 0.1\nincrements = 0"), "increments = 0"),
    (step("shear = 0.1\nincrements = -5"), "increments = -5"), (step("shear = 0.1\nincrements = 1.5"), "increments = 1.5"),
    (step(f"shear = 0.1\nincrements = {HUGE}"), "must be an integer from 1 to 2147483647"),
    (step("shear = 0.1\nincrements = true"), "increments = True"), (step('shear = 0.1\ncontrol = "stress"'), "control = 'stress'"),
    (step("shear = 0.1\ncontrl = 1"), "unknown key 'contrl'"), (step('shear = 0.1\nuntil = "steadi"'), "until 'steadi'"),
    (step('shear = 0.1\nuntil = "p == 1"'), "until 'p == 1'"), (step('shear = 0.1\nuntil = "r < 1"'), "until 'r < 1'"),
    (step('shear = 0.1\nuntil = "p < 1e"'), "until 'p < 1e'"), (step('shear = 0.1\nfree = ["e_zz"]'), "1 free deformations"),
    (step('shear = 0.1\nfree = ["e_qq"]\nstress = { p = 1 }'), "'e_qq'"), (step("pause = false"), "pause = False"),
    (step('shear = 0.1\nfree = ["e_zz"]\nstress = { p = nan }'), "stress 'p' = nan"),
    (step('shear = 0.1\nfree = ["e_zz"]\nstress = { p = "held" }'), "stress 'p' = 'held'"),
    (step('shear = 0.1\nfree = ["e_zz", "e_zz"]\nstress = { p = 1, sigma_xx = 1 }'), "not independent"),
    (step('shear = 0.1\nfree = ["e_zz - e_zz"]\nstress = { p = 1 }'), "is zero"),
    (step('shear = 0.1\ncontrol = "pressure"\nfree = ["e_zz"]\nstress = { p = 1 }'), "control excludes free and stress"),
    (step("cycles = 2"), "amplitude is missing"), (step("cycles = 0\namplitude = 0.1"), "cycles = 0"),
    (step(f"cycles = {HUGE}\namplitude = 0.1"), "must be an integer from 1 to"),
    (step("cycles = 2\namplitude = nan"), "amplitude = nan"),
    (step('test = "triaxial"'), "test = 'triaxial'"), (step('test = "triaxial-drained"'), "compression is missing"),
    (step('test = "isotropic"'), "give either compression or pressure"),
    (step('test = "triaxial-drained"\ncompression = 0.1\npressure = 1'), "unknown key 'pressure'"),
    (step('test = "isotropic"\ncompression = "x"'), "compression = 'x'"),
    (step("velocity_gradient = [[0, 0, 1]]"), "must be a 3 x 3 matrix"), (step("velocity_gradient = 1"), "must be a 3 x 3 matrix"),
    (step("velocity_gradient = [[0, 0, nan], [0, 0, 0], [0, 0, 0]]"), "3 x 3 matrix of finite numbers"),
    (step('velocity_gradient = [[0, 0, 1], [0, 0, 0], [0, 0, 0]]\nstrain = "x"'), "strain = 'x'"),
    (step('csv = "none.csv"'), "none.csv"), (step('csv = "."'), "Is a directory"), (step("csv = 3"), "No such file"),
    # quantities
    (quantity(""), "name is missing"), (quantity('name = "a"'), "of is missing"), (quantity('name = "t"\nof = "p"'), "name = 't'"),
    (quantity('name = "a b"\nof = "p"'), "name = 'a b'"), (quantity('name = "a"\nof = "r"'), "of = 'r'"),
    (quantity('name = "a"\nof = "acoustic"'), "needs acoustic = true"), (quantity('name = "a"\nof = 1'), "of = 1"),
    (quantity('name = "a"\nof = "p"\nat = [2]'), "at 2: must be from 0 to 1"),
    (quantity('name = "a"\nof = "p"\nat = []'), "at = []"),
    (quantity('name = "a"\nof = "p"\nat = [0.3]'), "must be the end of one of them"),
    (quantity('name = "a"\nof = "p"\nat = "start"'), "at = 'start'"), (quantity('name = "a"\nof = "p"\nscale = 0'), "scale = 0"),
    (quantity('name = "a"\nof = "p"\ntolerance = 1'), "tolerance = 1"),
    (quantity('name = "a"\nof = "p"\n[[quantity]]\nname = "a"\nof = "p"'), "'a' is given 2 times"),
]

TABLES = [      # of a step csv = "table.csv", and what is said of it
    (b"", "not a table of numbers"), (b"gamma\n", "not a table of numbers"), (b"gamma\n0\n", "at least 2 rows"),
    (b"gamma;p\n0;1\n1;1\n", "separated by semicolons"), (b"gamma\tp\n0\t1\n1\t1\n", "separated by tabs"),
    (b"gamma\n0,5\n1,5\n", "must have 1 columns"), (b"gamma,p\n0,1\n1\n", "not a table of numbers"),
    (b"gamma\n0\ninf\n", "not finite"), (b"gama\n0\n1\n", "'gama'"), (b"gamma,gamma\n0,0\n1,1\n", "twice"),
    ("gamma\n0\n1\n".encode("utf-16"), "not text in UTF-8"), (b"\x00\x01\x02", "not a table of numbers"),
    (b"gamma,p\n0,1\n1,1\n", "0 free deformations"), (b"0\n0.1\n0.2\n", "'0'"),
]


def said(capsys, tmp_path, command, text):
    """Exit status and what the command says of a file, which may be text or bytes."""
    file = tmp_path / "file.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    status = cli.main([command, str(file), "--out", str(tmp_path / "out")])
    return status, capsys.readouterr().err


@pytest.mark.parametrize("number", range(len(PATHS)))
def test_a_malformed_path_file_is_refused_in_words(capsys, tmp_path, number):
    text, words = PATHS[number]
    status, error = said(capsys, tmp_path, "point", text)
    assert (status, words in error, error.startswith("granumat: ")) == (2, True, True), error
    assert not list(tmp_path.glob("out/*.csv"))


@pytest.mark.parametrize("number", range(len(TABLES)))
def test_a_malformed_table_is_refused_in_words(capsys, tmp_path, number):
    content, words = TABLES[number]
    (tmp_path / "table.csv").write_bytes(content)
    status, error = said(capsys, tmp_path, "point", path(step='csv = "table.csv"'))
    assert (status, words in error, "table.csv" in error or "step 1" in error) == (2, True, True), error


def test_a_byte_order_mark_does_no_harm(tmp_path):
    (tmp_path / "table.csv").write_bytes("\ufeffgamma\r\n0\r\n0.1\r\n".encode())
    (tmp_path / "file.toml").write_text("\ufeff" + path(step='csv = "table.csv"').lstrip(), encoding="utf-8")
    found = read_path_file(tmp_path / "file.toml")
    assert driver.run(found.material, found.state, found.steps)["gamma"].tolist() == [0.0, 0.1]


def test_a_condition_that_is_never_met_is_said(tmp_path):
    (tmp_path / "file.toml").write_text(path(step=STEP + '\nuntil = "p < 0"'))
    found = read_path_file(tmp_path / "file.toml")
    with pytest.warns(UnmetConditionWarning, match="step 1 .shear 0.01.: its condition until = 'p < 0' was not met"):
        assert len(driver.run(found.material, found.state, found.steps)) == 3


def test_a_condition_that_is_met_is_not_complained_of(recwarn):
    sand = Material(0.5)
    driver.run(sand, sand.steady(0.6), [driver.shear(1.0, until="gamma > 0.3"), driver.shear(0.1, until="steady")])
    assert not recwarn
