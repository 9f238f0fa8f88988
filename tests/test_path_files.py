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
    "test = \"oedometer\"\ncompression = 0.001",
    "test = \"dss\"\nstrain = 0.1",
    "test = \"dss-cyclic\"\nnumber = 2\namplitude = 0.01\ncontrol = \"normal-load\"",
    "velocity_gradient = [[0, 0, 1], [0, 0, 0], [0, 0, 0]]\nstrain = 0.1\nfree = [\"e_xx + e_yy\"]\nstress = { \"p\" = \"hold\" }",
])
@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_every_kind_of_step_runs(tmp_path, step):
    for initial in ("phi = 0.60\nstate = \"steady\"", "phi = 0.60\nstate = \"isotropic\"\npressure = 0.01",
                    "phi = 0.60\nstate = \"isotropic\"\nZ2 = 5.2"):
        history = run(tmp_path, f"[material]\nmu = 0.5\nelastic_strain = 0.005\n[initial]\n{initial}\n[[step]]\n{step}\n")
        assert len(history) > 5
        assert all(np.isfinite(history[name][1:]).all() for name in driver.COLUMNS if name != "dilatancy")


SAND = Material(0.5, elastic_strain=0.001)
RESTING = "[material]\nmu = 0.5\nelastic_strain = 0.001\n[initial]\nphi = 0.60\nstate = \"isotropic\"\npressure = 0.005\n"


@pytest.mark.parametrize("step, made", [
    ("test = \"oedometer\"\nsigma_zz = 0.007", [driver.oedometer(sigma_zz=0.007)]),
    ("test = \"dss\"\nstrain = 0.1", [driver.shear(0.1, "normal-load")]),
    ("test = \"dss\"\nstrain = 0.1\ncontrol = \"volume\"", [driver.shear(0.1)]),
    ("test = \"dss-cyclic\"\nnumber = 2\namplitude = 0.01",
     [driver.shear(strain, increments=100) for strain in (0.01, -0.02, 0.02, -0.02)]),
    ("test = \"dss-cyclic\"\nnumber = 1\nstress_amplitude = 0.0005", driver.cyclic_direct_shear(1, stress_amplitude=0.0005)),
    ("test = \"triaxial-cyclic-undrained\"\nnumber = 2\nstress_amplitude = 0.001", driver.cyclic_triaxial(2, 0.001, drained=False)),
    ("test = \"triaxial-cyclic-drained\"\nnumber = 1\nstress_amplitude = 0.001", driver.cyclic_triaxial(1, 0.001)),
])
@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_a_ready_test_is_the_steps_that_its_name_means(tmp_path, step, made):
    history = run(tmp_path, f"{RESTING}[[step]]\n{step}\n")
    expected = driver.run(SAND, SAND.isotropic(0.60, pressure=0.005), made)
    assert (history.states == expected.states).all() and len(history) > 99


@pytest.mark.parametrize("drained, control", [(True, "normal-load"), (False, "volume")])
@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_cycles_of_controlled_stress_reach_it_on_both_sides_and_hold_the_rest(drained, control):
    start = SAND.isotropic(0.60, pressure=0.005)
    triaxial = driver.run(SAND, start, driver.cyclic_triaxial(3, 0.001, drained))
    ends = np.flatnonzero(np.diff(triaxial["step"], append=99))[1:]
    deviator = triaxial["sigma_zz"] - (triaxial["sigma_xx"] + triaxial["sigma_yy"]) / 2
    np.testing.assert_allclose(deviator[ends], [0.001, -0.001] * 3, rtol=1e-6)
    held = (triaxial["sigma_xx"] + triaxial["sigma_yy"]) / 2 - 0.005 if drained else triaxial["volume_strain"]
    np.testing.assert_allclose(held, 0, atol=1e-11)
    np.testing.assert_allclose(triaxial["e_xx"], triaxial["e_yy"], atol=1e-12)
    shear = driver.run(SAND, start, driver.cyclic_direct_shear(3, stress_amplitude=0.0005, control=control))
    np.testing.assert_allclose(-shear["sigma_xz"][ends], [0.0005, -0.0005] * 3, rtol=1e-6)
    np.testing.assert_allclose(shear["sigma_zz"] - 0.005 if drained else shear["volume_strain"], 0, atol=1e-11)
    assert (shear["e_xx"] == 0).all() and (shear["e_yy"] == 0).all()
    np.testing.assert_allclose(shear["gamma"], 2 * shear["e_xz"], atol=1e-16)
    for history in (triaxial, shear):
        assert (history["p"][ends[-1]] < 0.995 * history["p"][0]) or drained


def test_a_shear_that_is_found_keeps_the_planes_as_one_that_is_given():
    start = SAND.isotropic(0.60, pressure=0.005)
    given = driver.run(SAND, start, [driver.shear(0.02)])
    step = driver.Step("stress", free=("gamma",), stress={"sigma_xz": given["sigma_xz"][-1]}, shear=True)
    found = driver.run(SAND, start, [step])
    assert found["gamma"][-1] == pytest.approx(0.02, rel=1e-5)
    np.testing.assert_allclose(found.states.fabric[-1], given.states.fabric[-1], atol=1e-9)


@pytest.mark.parametrize("step, words", [
    ("test = \"dss\"", "strain is missing"),
    ("test = \"dss\"\nstrain = 0.1\npressure = 1", "unknown key 'pressure': allowed with test"),
    ("test = \"dss-cyclic\"\nnumber = 0\namplitude = 0.0", "(?s)number of cycles = 0: must be.*amplitude = 0.0: must be"),
    ("test = \"dss-cyclic\"\nnumber = 1", "either amplitude or stress_amplitude"),
    ("test = \"oedometer\"", "either compression or"),
    ("test = \"triaxial-cyclic-drained\"", "(?s)number is missing.*stress_amplitude is missing"),
    ("test = \"triaxial-cyclic-drained\"\nnumber = 2.5\nstress_amplitude = 0.1", "number of cycles = 2.5"),
])
def test_a_ready_test_with_wrong_keys_is_refused(tmp_path, step, words):
    with pytest.raises(ValueError, match=words):
        read_path_file(written(tmp_path, f"{RESTING}[[step]]\n{step}\n"))


def test_the_words_for_phi_and_z2_are_accepted_in_their_place(tmp_path):
    symbols, words = "phi = 0.6\nZ2 = 5.2", "volume_fraction = 0.6\ncoordination_number = 5.2"
    step = "[[step]]\nshear = 0.1\n"
    one, other = (run(tmp_path, f"[initial]\nstate = \"isotropic\"\n{names}\n{step}") for names in (symbols, words))
    assert (one.states == other.states).all()
    with pytest.raises(ValueError, match="volume_fraction is phi, which is given too"):
        read_path_file(written(tmp_path, f"[initial]\nstate = \"steady\"\nphi = 0.6\nvolume_fraction = 0.6\n{step}"))
    text = RESTING + step + "[[quantity]]\nname = \"a\"\nof = \"volume_fraction\"\n"
    assert read_path_file(written(tmp_path, text)).quantities[0].of == "volume_fraction"


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
