"""The stability maps, against the theory of dx/ds = 2 c1 + c2 x + c3 x^2 linearised about its attractor chi."""

import numpy as np
import pytest

from granumat import Material, tensors
from granumat.cli import main
from granumat.material import METHODS
from granumat.studies import stability

MATERIALS = [Material(method=method) for method in METHODS]
BY_NAME = dict(zip(METHODS, MATERIALS))
RATE = MATERIALS[0]["c2"] + 2 * MATERIALS[0]["c3"] * MATERIALS[0]["chi"]        # per unit of s = gamma/2
REAL_LIMIT = {"forward-euler": 2.0, "midpoint": 2.0, "rk4": 2.785294}           # of the region of absolute stability
AMPLIFICATION = {
    "exact": np.exp, "forward-euler": lambda z: 1 + z, "midpoint": lambda z: 1 + z + z**2 / 2,
    "rk4": lambda z: 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, "backward-euler": lambda z: 1 / (1 - z),
}
EXPLICIT = ("forward-euler", "midpoint", "rk4")


def coaxial(material, x):
    """States with A = x/2 S^."""
    return stability.states_of(material, np.multiply.outer(x, stability.S_HAT) / 2)


def projection(states):
    return tensors.contract(states.fabric, stability.S_HAT)


def line(material, n=60):
    """x from just above the attractor to just below the repeller."""
    return np.linspace(material["chi"], 2 * material["fabric_limit"], n + 2)[1:-1]


@pytest.mark.parametrize("method", AMPLIFICATION)
def test_a_perturbation_of_the_steady_state_is_amplified_as_theory_says(method):
    assert pytest.approx(-20.6, abs=0.05) == RATE
    material, gammas = BY_NAME[method], np.linspace(0.01, 0.3, 30)
    x, status = stability.advance(material, coaxial(material, np.full(30, material["chi"] + 1e-6)), gammas)
    assert (status == 0).all()
    np.testing.assert_allclose((projection(x) - material["chi"]) / 1e-6, AMPLIFICATION[method](RATE * gammas / 2), atol=3e-3)


@pytest.mark.parametrize(("method", "printed"), [("forward-euler", 0.194), ("midpoint", 0.194), ("rk4", 0.271)])
def test_explicit_methods_are_unstable_above_the_increments_of_theory(method, printed):
    limit = stability.stability_limit(BY_NAME[method])
    assert limit == pytest.approx(printed, rel=0.05)
    assert limit == pytest.approx(2 * REAL_LIMIT[method] / -RATE, rel=0.005)


@pytest.mark.parametrize("elastic_strain", [0.01, 0.03])
@pytest.mark.parametrize("method", EXPLICIT)
def test_an_elastic_strain_makes_explicit_methods_unstable_above_its_own_multiple(method, elastic_strain):
    # the stress relaxes at 1/e_r per unit of s
    limit = stability.stability_limit(Material(method=method, elastic_strain=elastic_strain))
    assert limit == pytest.approx(2 * REAL_LIMIT[method] * elastic_strain, rel=0.01)


@pytest.mark.release_only
@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
@pytest.mark.parametrize("method", ["exact", "bogacki-shampine", "backward-euler"])
def test_the_others_have_no_limit(method, elastic_strain):
    assert stability.stability_limit(Material(method=method, elastic_strain=elastic_strain)) == np.inf


def test_the_exact_update_is_stable_up_to_10_and_never_of_the_wrong_sign():
    material, gammas = BY_NAME["exact"], np.geomspace(0.01, 10, 50)
    steady, status = stability.advance(material, coaxial(material, np.full(50, material["chi"])), gammas)
    assert (status == 0).all()
    np.testing.assert_allclose(projection(steady), material["chi"], rtol=1e-12)
    x = line(material)
    low, high = material["chi"], 2 * material["fabric_limit"]
    for gamma in gammas:                                              # to the closed form, so monotonic: no overshoot, no sign
        after, status = stability.advance(material, coaxial(material, x), np.full(x.shape, gamma))
        ratio = (x - low) / (high - x) * np.exp(-material["c3"] * (high - low) * gamma / 2)
        assert (status == 0).all()
        np.testing.assert_allclose(projection(after), (low + high * ratio) / (1 + ratio), atol=1e-12)


def test_one_step_of_forward_euler_is_the_formula_or_reported():
    material = BY_NAME["forward-euler"]
    c1, c2, c3 = (material[name] for name in ("c1", "c2", "c3"))
    x = line(material)
    for gamma in (0.1, 0.5, 2.0):
        after, status = stability.advance(material, coaxial(material, x), np.full(x.shape, gamma))
        expected = x + gamma / 2 * (2 * c1 + c2 * x + c3 * x**2)
        beyond = np.abs(expected) > 2 * material["fabric_limit"]
        assert ((status != 0) == beyond).all()
        np.testing.assert_allclose(projection(after), np.where(beyond, x, expected), atol=1e-14)


@pytest.mark.parametrize("material", MATERIALS, ids=METHODS)
def test_what_is_returned_is_realisable_and_cannot_blow_up(material):
    x = line(material)
    for gamma in np.geomspace(0.01, 10, 40):
        after, _ = stability.advance(material, coaxial(material, x), np.full(x.shape, gamma))
        assert (np.linalg.eigvalsh(tensors.to_matrix(after.fabric) + np.eye(3) / 3) > 0).all()
        assert tensors.magnitude(after.fabric).max() < material["fabric_limit"]


def test_outcomes_of_one_increment_by_method():
    x = np.array([-MATERIALS[0]["chi"]])                              # just reversed
    found = stability.outcomes(MATERIALS, np.outer(x / 2, stability.S_HAT), np.array([0.001, 0.5]))[:, 0]
    assert (found[:, 0] == 0).all()                                   # small increments: all are right
    large = dict(zip(METHODS, found[:, 1]))
    assert large["exact"] == large["bogacki-shampine"] == 0
    assert all(large[method] >= 2 for method in (*EXPLICIT, "backward-euler"))        # wrong or reported (spec, section 3)


def test_the_exact_update_and_the_embedded_pair_have_clean_maps_up_to_10():
    x = line(MATERIALS[0])
    materials = [BY_NAME["exact"], BY_NAME["bogacki-shampine"]]
    assert (stability.outcomes(materials, np.outer(x / 2, stability.S_HAT), np.geomspace(0.01, 10, 40)) == 0).all()


def test_limits_are_the_first_increments_of_their_kind():
    outcome = np.array([[0, 1, 3, 4, 2], [0, 0, 0, 0, 0], [0, 0, 2, 3, 3]])
    np.testing.assert_array_equal(stability.limits(outcome, np.arange(5.0)),
                                  [[1, 2, 3, 4], [np.inf] * 4, [3, 3, np.inf, 2]])


@pytest.mark.slow
@pytest.mark.release_only
def test_the_command_writes_the_picture_and_its_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stability, "GAMMAS", stability.GAMMAS[::15])
    monkeypatch.setattr(stability, "ANGLES", stability.ANGLES[::12])
    assert main(["stability", "--out", str(tmp_path / "new")]) == 0
    names = ("stability.png", "stability.csv", "stability-projection.csv", "stability-size.csv")
    assert capsys.readouterr().out.splitlines() == [f"wrote {tmp_path / 'new' / name}" for name in names]
    assert (tmp_path / "new/stability.png").read_bytes()[:4] == b"\x89PNG"
    table = np.genfromtxt(tmp_path / "new/stability.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert tuple(table["method"]) == METHODS
    assert table["unstable_above"][3] == pytest.approx(0.271, rel=0.05) and np.isinf(table["unstable_above"][[0, 4, 5]]).all()
    for name in names[2:]:
        rows = (tmp_path / "new" / name).read_text().splitlines()
        assert rows[0].endswith("rough_above,wrong_above,wrong_sign_above,reported_above")
        assert {row.split(",")[0] for row in rows[1:]} == set(METHODS)
