"""The single-point driver: controls keep what they hold, to the tolerance stated, and say why when they cannot."""

import io

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granumat import ConstrainedDeformationWarning, Material, PathError, driver, tensors
from granumat.progress import Progress
from support import reference
from support.states import CLOSURES_AND_STRAINS

HOLD = 1e-9      # of the stress held: ten times path.f90's STRESS_TOLERANCE


@pytest.mark.parametrize("control, held", [
    ("pressure", ["p"]), ("normal-stresses", ["sigma_xx", "sigma_yy", "sigma_zz"]), ("normal-load", ["sigma_zz"])])
@pytest.mark.parametrize(("closure", "elastic_strain"), CLOSURES_AND_STRAINS)
def test_controls_hold_their_stresses_through_a_reversal(closure, elastic_strain, control, held):
    if control != "pressure" and closure in ("critical", "basic", "n2"):
        pytest.skip("has no path after a reversal (the next test)")
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    steps = [driver.shear(0.5, control, 50), driver.pause(), driver.shear(-1.0, control, 100)]
    history = driver.run(material, material.steady(0.60), steps)
    for name in held:
        np.testing.assert_allclose(history[name], history[name][0], rtol=HOLD)
    assert history["gamma"][-1] == pytest.approx(-0.5) and history["gamma_total"][-1] == pytest.approx(1.5)


def test_basic_closure_has_no_path_under_constant_normal_load_after_a_reversal():
    # eta = -0.10 there, so sigma_zz = p (1 - eta S^_zz) falls when the point compacts: the branch that holds it runs away
    material = Material(0.5, "basic")
    with pytest.raises(PathError, match="cannot be reached"):
        driver.run(material, material.steady(0.60), [driver.shear(-0.5, "normal-load")])


def constant_pressure_reference(material, state, gamma):
    """Shear by `gamma` at constant p as an ordinary differential equation: tr D from dp/ds = 0, basic closure's variables."""
    c = reference.constants(material["mu"])
    chi = material["chi"]

    def rate(_, y):
        a, z, phi = y[:9].reshape(3, 3), y[9], y[10]

        def rates(tr):
            gradient = np.sign(gamma) * np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]) + tr / 3 * np.eye(3)
            _, w, s, mod_d, mod_s, _ = reference.parts(gradient)
            a_s = reference.double_dot(a, s)
            dot_a = w @ a - a @ w + c["c1"] * s + c["c2"] * mod_d * a + c["c3"] * a_s * a
            f = c["Zc"] + c["beta1"] * max(phi - c["phic"], 0) ** 0.5
            dot_z = c["d1"] * (a_s - chi * mod_s) + c["d2"] * mod_d * (f - z) + c["d3"] * tr
            mod_a = reference.magnitude(a)
            dot_p = (c["a2"] * reference.double_dot(a, dot_a) / 2 / mod_a * (z - c["Zc"])
                     + 2 * (c["a1"] + c["a2"] * mod_a) * dot_z)
            return dot_a, dot_z, dot_p
        low, high = -2.0, 2.0
        for _ in range(60):                                        # secant on the nearly linear dp(tr) = 0
            p_low, p_high = rates(low)[2], rates(high)[2]
            if p_high == p_low:
                break
            low, high = high, high - p_high * (high - low) / (p_high - p_low)
            if abs(high - low) < 1e-15:
                break
        dot_a, dot_z, _ = rates(high)
        return np.concatenate([dot_a.ravel(), [dot_z, -phi * high]])

    start = np.concatenate([tensors.to_matrix(state.fabric).ravel(), [state.coordination_number, state.volume_fraction]])
    y = solve_ivp(rate, (0, abs(gamma)), start, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    return y[:9].reshape(3, 3), y[9], y[10]


def test_constant_pressure_follows_the_differential_equation_and_the_tolerance(material):
    state = material.steady(0.60)
    fabric, z2, phi = constant_pressure_reference(material, state, -0.4)
    found = []
    for tolerance in (1e-5, 1e-6, 1e-7, 1e-8):
        end = driver.run(material, state, [driver.shear(-0.4, "pressure", 4)], tolerance=tolerance).states[-1]
        found.append(max(np.abs(tensors.to_matrix(end["fabric"]) - fabric).max() / material["kappa"],
                         abs(end["coordination_number"] - z2), abs(end["volume_fraction"] - phi)))
        assert found[-1] < 30 * tolerance                            # errors of all substeps together
    assert found[-1] < found[0] / 100


def test_increments_do_not_change_the_end_of_a_controlled_path(material):
    ends = [driver.run(material, material.steady(0.60), [driver.shear(-1.0, "pressure", n)], tolerance=1e-8).states[-1]
            for n in (7, 100)]
    assert ends[0]["volume_fraction"] == pytest.approx(ends[1]["volume_fraction"], abs=1e-6)


@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
@pytest.mark.parametrize("elastic_strain", [0.0, 0.005])
def test_element_tests_hold_what_they_promise(elastic_strain):
    material = Material(0.5, elastic_strain=elastic_strain)
    state = material.isotropic(0.60, pressure=0.01)

    def run(step):
        return driver.run(material, state, [step])
    history = run(driver.triaxial(0.05))
    np.testing.assert_allclose(history["sigma_xx"], 0.01, rtol=HOLD)
    np.testing.assert_allclose(history["sigma_yy"], 0.01, rtol=HOLD)
    assert history["sigma_zz"][-1] > 0.013
    history = run(driver.triaxial(0.2, drained=False))
    np.testing.assert_allclose(history["phi"], 0.60, rtol=1e-13)
    assert history["sigma_zz"][-1] > 1.5 * history["sigma_xx"][-1]
    history = run(driver.biaxial(0.05))
    np.testing.assert_allclose(history["sigma_xx"], 0.01, rtol=HOLD)
    assert (history["sigma_zz"][1:] > history["sigma_yy"][1:]).all()
    assert (history["sigma_yy"][5:] > history["sigma_xx"][5:]).all()
    history = run(driver.biaxial(0.2, drained=False))
    np.testing.assert_allclose(history["phi"], 0.60, rtol=1e-13)
    history = run(driver.isotropic_compression(0.01))
    np.testing.assert_allclose(history["phi"][-1], 0.60 * np.exp(0.01), rtol=1e-14)
    np.testing.assert_allclose(history["sigma_xx"], history["sigma_zz"], rtol=1e-12)
    history = run(driver.isotropic_compression(pressure=0.02, increments=20))
    np.testing.assert_allclose(history["p"], np.linspace(0.01, 0.02, 21), rtol=HOLD)


@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
@pytest.mark.parametrize("make", [driver.biaxial, driver.triaxial])
@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
def test_substeps_of_the_critical_closure_hold_the_tolerance(elastic_strain, make):
    """They are cut by what evolves in it, phi and the relaxing stress; a tenth of the tolerance agrees."""
    material = Material(0.5, "critical", elastic_strain=elastic_strain)
    state = material.isotropic(0.60, pressure=0.01)
    ends = []
    for tolerance in (1e-6, 1e-7):
        history = driver.run(material, state, [make(0.05)], tolerance=tolerance)
        ends.append([history["phi"][-1], *history.states["stress"][-1, :3] / history["p"][-1]])
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-5)


def test_any_linear_combination_can_be_free_and_held(material):
    step = driver.Step("stress path", driver.SHEAR, 0.1, 50, ("e_xx + e_yy", "e_zz"),
                       {"sigma_zz - 0.5*sigma_xx - 0.5*sigma_yy": 2e-4, "0.5*sigma_xx+0.5*sigma_yy": "hold"})
    history = driver.run(material, material.steady(0.60), [step])
    mean = (history["sigma_xx"] + history["sigma_yy"]) / 2
    np.testing.assert_allclose(mean, mean[0], rtol=HOLD)
    assert history["sigma_zz"][-1] - mean[-1] == pytest.approx(2e-4, rel=1e-6)


def test_a_gradient_may_be_a_function_of_strain(material):
    def turning(s):
        return np.array([[np.sin(s), 0, np.cos(s)], [0, 0, 0], [0, 0, -np.sin(s)]])
    ends = [driver.run(material, material.steady(0.60), [driver.deform(turning, 1.0, increments=n)]).states[-1]["fabric"]
            for n in (50, 100, 200)]
    first, second = (np.abs(ends[i + 1] - ends[i]).max() for i in (0, 1))
    assert first / second == pytest.approx(4, rel=0.1)                # the middle of each increment: second order


def test_gamma_of_a_gradient_step_is_twice_mod_d(material):
    history = driver.run(material, material.steady(0.60), [driver.deform(np.diag([1.0, 0, -1]), 0.3, increments=10)])
    assert history["gamma_total"][-1] == pytest.approx(0.6)


@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_strain_that_was_found_is_counted_and_matches_the_volume(material):
    step = driver.isotropic_compression(pressure=0.02, increments=7)
    history = driver.run(material, material.isotropic(0.60, pressure=0.01), [step], tolerance=1e-7)
    compression = np.log(history["phi"] / 0.60)                       # D = -compression/3 I: abs(D) = compression/sqrt(6)
    np.testing.assert_allclose(history["gamma_total"], 2 / np.sqrt(6) * compression, rtol=1e-9, atol=1e-15)


def test_cycles_reverse_and_accumulate(material):
    history = driver.run(material, material.steady(0.60), driver.cycles(0.5, 4, "pressure"))
    assert history["gamma_total"][-1] == pytest.approx(4.0) and history["gamma"][-1] == pytest.approx(0.0, abs=1e-13)
    assert history["gamma"].max() == pytest.approx(0.5) and history["gamma"].min() == pytest.approx(0.0, abs=1e-13)
    assert history["step"][-1] == 8


def test_until_steady_stops_at_the_steady_state(material):
    history = driver.run(material, material.isotropic(0.60, coordination_number=5.0),
                         [driver.shear(10.0, increments=1000, until="steady")])
    assert len(history) < 1000
    steady = material.steady(0.60)
    np.testing.assert_allclose(history.states[-1]["fabric"], steady.fabric, atol=1e-4 * material["kappa"])
    assert history["Z2"][-1] == pytest.approx(steady.coordination_number, abs=1e-4)


def test_until_a_condition_stops_at_the_first_row_that_meets_it(material):
    history = driver.run(material, material.steady(0.60), [driver.shear(-1.0, until="p < 0.003", increments=333), driver.pause()])
    assert (history["p"][:-2] >= 0.003).all() and history["p"][-2] < 0.003 and history["p"][-1] == history["p"][-2]


def test_constrained_deformation_warns_and_shear_at_constant_pressure_does_not(material, recwarn):
    driver.run(material, material.steady(0.60), [driver.shear(-1.0, "pressure")])
    assert not recwarn.list
    with pytest.warns(ConstrainedDeformationWarning, match=r"abs\(tr D\^\) reaches 2.45"):
        driver.run(material, material.isotropic(0.60, pressure=0.01), [driver.isotropic_compression(0.01)])


def test_unreachable_target_raises_and_leaves_history_and_failing_step(material, tmp_path):
    from granumat.paths import read_path_file
    pull = driver.Step("pull", driver.SHEAR, -0.3, 200, ("e_zz",), {"sigma_xz": 0.02})
    words = r"step 2 \(pull\), increment \d+ of 200: the prescribed stress cannot be reached"
    with pytest.raises(PathError, match=words) as caught:
        driver.run(material, material.steady(0.60), [driver.shear(0.1, increments=10), pull], tmp_path)
    written = np.genfromtxt(tmp_path / "history.csv", delimiter=",", names=True)
    assert written.dtype.names == driver.COLUMNS
    history = caught.value.history
    assert len(written) == len(history) > 11 and written["p"][-1] == pytest.approx(history["p"][-1], rel=1e-14)
    again = read_path_file(tmp_path / "failing.toml")
    assert again.state.tobytes() == history.states[-1].tobytes()
    with pytest.raises(PathError, match=r"step 1 \(deformation\), increment 1 of 1: the prescribed stress cannot be reached"):
        driver.run(again.material, again.state, again.steps)


def test_material_failure_in_a_path_is_reported_with_its_history(material):
    with pytest.raises(PathError, match=r"increment 2 of 4: the volume fraction is, or would become, outside \(0, 1\)") as caught:
        driver.run(material, material.steady(0.60), [driver.deform(-0.4 * np.eye(3), 1.0, increments=4)])
    assert len(caught.value.history) == 2


def test_faulty_steps_name_every_fault():
    with pytest.raises(ValueError) as caught:
        driver.Step("odd", [[1, 2], [3, 4]], np.nan, 0, ("e_xx", "e_q"), {"sigma_xx": "keep"}, "r < 1")
    for words in ("increments = 0", "strain = nan", "3 x 3 matrix", "'e_q': must be a linear combination of e_xx", "'keep'",
                  "2 free deformations (e_xx, e_q) against 1 stress conditions", "until 'r < 1'"):
        assert words in str(caught.value)
    with pytest.raises(ValueError, match="not independent"):
        driver.Step("odd", free=("e_xx", "2*e_xx"), stress={"p": "hold", "sigma_xx": "hold"})
    with pytest.raises(ValueError, match="free deformations gamma, e_xz: not independent"):
        driver.Step("odd", free=("gamma", "e_xz"), stress={"p": "hold", "sigma_xz": "hold"})
    with pytest.raises(ValueError, match="control 'volum': must be one of volume, pressure"):
        driver.shear(1.0, "volum")


def test_history_signs_and_columns(material, tmp_path):
    history = driver.run(material, material.steady(0.60), [driver.shear(0.01, increments=2)], tmp_path)
    header = (tmp_path / "history.csv").read_text().splitlines()[0]
    assert header == ("step,gamma,gamma_total,e_xx,e_yy,e_zz,e_xy,e_xz,e_yz,volume_strain,phi,p,q,q_over_p,stress_ratio,Z2,"
                      "A_xx,A_yy,A_zz,A_xy,A_xz,A_yz,sigma_xx,sigma_yy,sigma_zz,sigma_xy,sigma_xz,sigma_yz,"
                      "eta,dilatancy,eta_t,tau_over_sigma_n")
    assert history["stress_ratio"][-1] > 0 and history["A_xz"][-1] < 0 and history["sigma_xz"][-1] < 0
    assert history["p"][-1] == pytest.approx((history["sigma_xx"] + history["sigma_yy"] + history["sigma_zz"])[-1] / 3)
    assert history["eta"][-1] == pytest.approx(history["stress_ratio"][-1], rel=1e-12)       # a3, a4 do not act on xz in shear


def test_progress_counts_the_increments_of_steps_and_tables(material, monkeypatch):
    monkeypatch.setattr(Progress, "QUIET_SECONDS", 0)
    said = io.StringIO()
    steps = [driver.shear(0.1, increments=300), driver.Step("table", table=np.zeros((501, 9)))]
    driver.run(material, material.steady(0.60), steps, progress=said)
    assert said.getvalue().startswith("step 1 of 2, increment 100 of 300: 12%, ")
    shares = [line.split(": ")[1].split(",")[0] for line in said.getvalue().splitlines()]
    assert shares == ["12%", "25%", "38%", "50%", "62%", "75%", "88%", "100%"]


def test_progress_tells_the_time_to_go_and_is_quiet_in_between(monkeypatch):
    clock, said = iter([0.0, 1.9, 10.0, 11.0, 13.0]), io.StringIO()
    monkeypatch.setattr("granumat.progress.time.monotonic", lambda: next(clock))
    progress = Progress(said)
    for share in (0.2, 0.25, 0.5, 0.65):
        progress("so far", share)
    assert said.getvalue() == "so far: 25%, 30 s to go\nso far: 65%, 7 s to go\n"
