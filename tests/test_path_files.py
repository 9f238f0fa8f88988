"""A path is a file: what it may say, and what is refused."""

import numpy as np
import pytest

from granumat import Material, driver
from granumat.paths import read_path_file

EXAMPLE = """
[material]
mu = 0.5
closure = "full"
contact = "hookean"
calibration = "table-1"
elastic_strain = 0.0
[initial]
phi = 0.60
state = "steady"
[[step]]
shear = 1.0
control = "volume"
increments = 200
[[step]]
pause = true
[[step]]
velocity_gradient = [[0, 0, -1], [0, 0, 0], [0, 0, 0]]
strain = 2.0
"""


def written(tmp_path, text):
    file = tmp_path / "path.toml"
    file.write_text(text)
    return file


def run(tmp_path, text):
    path = read_path_file(written(tmp_path, text))
    return driver.run(path.material, path.state, path.steps, tolerance=path.tolerance)


def test_the_example_runs_as_its_steps_say(tmp_path):
    history = run(tmp_path, EXAMPLE)
    material = Material(0.5)
    expected = driver.run(material, material.steady(0.60), [driver.shear(1.0), driver.pause(), driver.shear(-2.0)])
    assert len(history) == 402
    assert (history.states == expected.states).all()
    assert history["gamma"][-1] == pytest.approx(3.0)                 # 2 abs(D) for a gradient, signed for a shear
    assert expected["gamma"][-1] == pytest.approx(-1.0)


@pytest.mark.parametrize("step", [
    "shear = -0.5\ncontrol = \"pressure\"\nincrements = 20",
    "shear = -0.5\ncontrol = \"normal-stresses\"",
    "shear = -0.5\ncontrol = \"normal-load\"\nuntil = \"gamma_total > 0.1\"",
    "cycles = 2\namplitude = 0.1\ncontrol = \"pressure\"",
    "test = \"isotropic\"\npressure = 0.02\nincrements = 10",
    "test = \"isotropic\"\ncompression = 0.001",
    "test = \"biaxial-drained\"\ncompression = 0.01",
    "test = \"biaxial-undrained\"\ncompression = 0.01",
    "test = \"triaxial-drained\"\ncompression = 0.01",
    "test = \"triaxial-undrained\"\ncompression = 0.01",
    "velocity_gradient = [[0, 0, 1], [0, 0, 0], [0, 0, 0]]\nstrain = 0.1\nfree = [\"e_xx + e_yy\"]\nstress = { \"p\" = \"hold\" }",
])
@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_every_kind_of_step_runs(tmp_path, step):
    for initial in ("phi = 0.60\nstate = \"steady\"", "phi = 0.60\nstate = \"isotropic\"\npressure = 0.01",
                    "phi = 0.60\nstate = \"isotropic\"\nZ2 = 5.2"):
        history = run(tmp_path, f"[material]\nmu = 0.5\nelastic_strain = 0.005\n[initial]\n{initial}\n[[step]]\n{step}\n")
        assert len(history) > 5
        assert all(np.isfinite(history[name][1:]).all() for name in driver.COLUMNS if name != "dilatancy")


def test_a_path_from_a_table(tmp_path):
    gamma = np.concatenate([np.linspace(0, 0.3, 31), np.linspace(0.3, -0.2, 51)[1:]])
    p = np.linspace(0.007, 0.008, 81)
    np.savetxt(tmp_path / "path.csv", np.column_stack([gamma, p]), delimiter=",", header="gamma,p", comments="")
    history = run(tmp_path, "[initial]\nphi = 0.60\nstate = \"isotropic\"\npressure = 0.007\n[[step]]\ncsv = \"path.csv\"\n"
                            "free = [\"volume_strain\"]\n")
    np.testing.assert_allclose(history["gamma"], gamma, atol=1e-15)
    np.testing.assert_allclose(history["p"], p, rtol=1e-9)


def test_a_table_of_gradients_equals_the_step(tmp_path):
    shear = np.linspace(0, -0.5, 21)
    zeros = np.zeros(21)
    np.savetxt(tmp_path / "path.csv", np.column_stack([zeros, shear]), delimiter=",", header="G_zx, G_xz", comments="")
    history = run(tmp_path, "[initial]\nphi = 0.60\nstate = \"steady\"\n[[step]]\ncsv = \"path.csv\"\n")
    material = Material(0.5)
    expected = driver.run(material, material.steady(0.60), [driver.shear(-0.5, increments=20)])
    np.testing.assert_allclose(history["p"], expected["p"], rtol=1e-12)


def test_every_fault_of_a_file_comes_in_one_message(tmp_path):
    with pytest.raises(ValueError) as caught:
        read_path_file(written(tmp_path, """
            tolerence = 3
            tolerance = 2
            [material]
            mu = 1.5
            closur = "full"
            [initial]
            phi = 60
            state = "steady"
            Z2 = 5
            [[step]]
            shear = "a"
            control = "volum"
            [[step]]
            pause = true
            increments = 3
            [[step]]
            test = "biaxial"
            [[step]]
            csv = "nowhere.csv"
            [[step]]
            nothing = 1
            [[step]]
            velocity_gradient = [[0, 0, 1], [0, 0]]
            free = ["e_q"]
        """))
    for words in ("'tolerence'", "tolerance = 2", "mu = 1.5", "unknown name 'closur'", "phi = 60: must be a number in (0, 1)",
                  "unknown key 'Z2': allowed with state = 'steady' are phi", "step 1", "shear = 'a'", "control = 'volum'",
                  "unknown key 'increments': allowed with 'pause' are none", "test = 'biaxial': must be one of isotropic",
                  "nowhere.csv", "step 5: must have exactly one of the keys shear, pause", "'e_q'", "3 x 3 matrix"):
        assert words in str(caught.value), words


def test_broken_tables_are_refused(tmp_path):
    for content, words in {"gamma\n0\n": "at least 2 rows", "gamma,G_xz\n0,0\n1,1\n": "both gamma and G_xz",
                           "gamma\n0\nx\n": "not a table", "gamma,gamma\n0,0\n1,1\n": "twice",
                           "gamma\n0\nnan\n": "not finite", "gamma,p\n0,0\n1,1\n": "0 free deformations"}.items():
        (tmp_path / "path.csv").write_text(content)
        with pytest.raises(ValueError, match=words):
            read_path_file(written(tmp_path, "[initial]\nphi = 0.6\nstate = \"steady\"\n[[step]]\ncsv = \"path.csv\"\n"))


def test_a_file_that_is_not_toml_is_refused(tmp_path):
    with pytest.raises(ValueError, match="not a TOML file"):
        read_path_file(written(tmp_path, "[material\n"))


@pytest.mark.parametrize("line", [
    "shear = 0.1\nuntil = 5", "shear = 0.1\ncontrol = [\"volume\"]", "test = [\"isotropic\"]\npressure = 0.1", "test = 1",
    "cycles = [1]\namplitude = 0.1", "velocity_gradient = \"x\"", "shear = 0.1\nfree = \"e_xx\"", "csv = 5", "pause = 1",
    "shear = true", "shear = 0.1\nincrements = 2.5", "shear = 0.1\nfree = [\"e_xx\"]\nstress = { p = [1] }"])
def test_a_value_of_a_wrong_type_is_refused_with_words(tmp_path, line):
    with pytest.raises(ValueError, match="step 1: "):
        read_path_file(written(tmp_path, f"[initial]\nphi = 0.6\nstate = \"steady\"\n[[step]]\n{line}\n"))


@pytest.mark.parametrize("table", ["[initial]\nphi = 0.6\nstate = [\"steady\"]", "initial = 3", "material = 1",
                                   "[material]\nclosure = [\"full\"]\na3 = 1", "[material]\nmu = \"x\""])
def test_a_table_of_a_wrong_type_is_refused_with_words(tmp_path, table):
    with pytest.raises(ValueError, match="cannot be run"):
        read_path_file(written(tmp_path, f"{table}\n[[step]]\nshear = 0.1\n"))
