"""Constants against the printed tables, and the identities that follow from them."""

import numpy as np
import pytest

from granumat import Material
from support import reference

MUS = np.linspace(0, 1, 11)


@pytest.mark.parametrize("closure", ["basic", "n2", "full", "kinematic"])
@pytest.mark.parametrize("mu", MUS)
def test_constants_equal_the_tables(mu, closure):
    material = Material(mu, closure)
    for name, value in reference.constants(mu, closure).items():
        assert material[name] == pytest.approx(value, rel=1e-14, abs=1e-16), name


def test_calibrations_differ_in_a4_as_printed():
    for calibration, (x1, x2, x3) in {"table-1": (-6, -2, 6), "text": (-6.5, -2, 6.5), "figure-16": (-3.7, -1.2, 4)}.items():
        assert Material(0.5, calibration=calibration)["a4"] == pytest.approx(x1 * np.exp(x2 * 0.5) + x3, rel=1e-14)


def test_printed_limits():
    # Zc 6 at mu = 0 and b1 0 (figure 5a, section 4.1); eta about 0.4 at mu 0.5 and friction angle 5.7 degrees at mu = 0
    assert Material(0.0)["Zc"] == pytest.approx(6.0) and Material(0.0)["b1"] == pytest.approx(0.0, abs=1e-16)

    def eta(mu):
        material = Material(mu)
        return material["b1"] + material["b2"] * material["chi"]
    assert eta(0.5) == pytest.approx(0.40, abs=0.01)
    assert np.degrees(np.arctan(eta(0.0))) == pytest.approx(5.7, abs=1.0)
    for mu in MUS:                                                  # the fit printed with figure 8
        assert eta(mu) == pytest.approx(-0.3 * np.exp(-6 * mu) + 0.41, abs=0.012)


def test_identities_a7_to_a9_of_the_fixed_point_without_spin(material):
    assert material["chi"] == pytest.approx(-0.08894, abs=5e-6)
    assert material["kappa"] == pytest.approx(0.04447, abs=5e-6)
    assert material["lambda"] == pytest.approx(material["chi"] / 2, rel=1e-14)
    assert material["kappa"] == pytest.approx(-material["chi"] / 2, rel=1e-14)
    gradient = np.zeros((3, 3))
    gradient[0, 2] = gradient[2, 0] = 20.0                           # pure shear: no spin
    state = material.update(material.isotropic(0.60, coordination_number=5.0), gradient)
    x = 2 * state.fabric[4]                                          # A:S^, (A 7)
    assert x == pytest.approx(material["chi"], rel=1e-13)
    np.testing.assert_allclose(state.fabric, material["lambda"] * np.array([0, 0, 0, 0, 1, 0]), atol=1e-15)   # (A 9)


@pytest.mark.parametrize("closure", ["n2", "full", "kinematic"])
def test_critical_closure_equals_the_steady_state_without_spin_a10_to_a12(closure):
    gradient = np.zeros((3, 3))
    gradient[0, 2] = gradient[2, 0] = 20.0
    evolved = Material(0.5, closure)
    state = evolved.update(evolved.isotropic(0.60, coordination_number=5.0), gradient)
    critical = Material(0.5, "critical")
    steady = critical.update(critical.isotropic(0.60), gradient)
    np.testing.assert_allclose(steady.stress, state.stress, rtol=1e-12, atol=1e-16)      # a4's term vanishes: A = lambda S^
    c = critical.constants
    p = (c["a1"] + c["a2"] * c["kappa"]) * c["beta1"] ** 2 * (0.60 - c["phic"])          # (A 11)
    eta = c["b1"] + c["b2"] * c["chi"]                                                   # (A 12)
    s_hat = np.array([[0, 0, 1.0], [0, 0, 0], [1, 0, 0]])
    sigma = p * np.eye(3) - p * eta * s_hat + 2 * c["a3"] * p * (c["lambda"] * s_hat @ s_hat - c["chi"] * np.eye(3) / 3)
    np.testing.assert_allclose(-steady.stress, sigma[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], rtol=1e-13, atol=1e-17)


def test_steady_projection_with_spin_is_the_speced_number(material):
    assert 2 * material.steady(0.60).fabric[4] == pytest.approx(-0.0875, abs=5e-5)


def test_hertzian_pressure_is_the_hookean_to_the_power_three_halves():
    hookean = -Material(0.5).steady(0.60).stress[:3].sum() / 3
    hertzian = -Material(0.5, contact="hertzian").steady(0.60).stress[:3].sum() / 3
    assert hertzian == pytest.approx(hookean**1.5, rel=1e-13)


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
@pytest.mark.parametrize("closure", ["critical", "basic", "n2", "full", "kinematic"])
def test_isotropic_state_has_the_pressure_asked_for_in_every_closure(closure, contact):
    state = Material(0.3, closure, contact).isotropic(0.62, pressure=0.001)
    np.testing.assert_allclose(state.stress, [-0.001] * 3 + [0] * 3, rtol=1e-13, atol=1e-18)


def test_the_critical_closure_takes_phi_from_the_pressure_or_the_coordination_number():
    material = Material(0.5, "critical")
    c = material.constants
    state = material.isotropic(0.60, pressure=0.01)
    assert state.volume_fraction == pytest.approx(c["phic"] + 0.01 / ((c["a1"] + c["a2"] * c["kappa"]) * c["beta1"]**2))   # (A 11)
    again = material.isotropic(0.55, coordination_number=state.coordination_number)
    assert again.volume_fraction == pytest.approx(state.volume_fraction, rel=1e-14)
    for given, expected in ((0.55, 0.55), (0.60, c["phic"])):                       # no pressure up to phic
        assert material.isotropic(given, pressure=0.0).volume_fraction == expected
    with pytest.raises(ValueError, match=r"needs phi = 2.*in the critical closure"):
        material.isotropic(0.60, pressure=1.0)
    with pytest.raises(ValueError, match=r"volume_fraction = 60: must be in \(0, 1\)"):
        material.isotropic(60, pressure=0.01)
    with pytest.raises(ValueError, match="give either"):
        material.isotropic(0.6, pressure=0.01, coordination_number=5.0)


def test_b1_term_raises_the_isotropic_pressure():
    # (B 1): a1* = a1 + g tr D^, tr D^ = -sqrt(6) in isotropic compression
    g = -5e-4
    start = Material(0.5).isotropic(0.60, pressure=0.005)
    plain, extra = (Material(0.5, g=value).update(start, -1e-3 * np.eye(3)) for value in (0.0, g))
    assert extra.stress[0] / plain.stress[0] == pytest.approx((0.0073 - np.sqrt(6) * g) / 0.0073, rel=1e-12)


@pytest.mark.parametrize("c3", [1e-9, 1e-12, 1e-20, 0.0])
def test_a7_does_not_cancel_as_c3_vanishes(c3):
    c1, c2 = -0.5, -13.0
    material = Material(0.5, c1=c1, c2=c2, c3=c3)
    chi = -2 * c1 / c2                                               # of dx/ds = 2 c1 + c2 x + c3 x^2 at c3 = 0, and
    chi *= 1 + c3 * chi / -c2                                        # the first order in c3
    assert material["chi"] == pytest.approx(-abs(chi), rel=1e-14)
    assert material["lambda"] == pytest.approx(material["chi"] / 2, rel=1e-14)


def test_without_c3_the_fabric_is_the_solution_of_a_linear_equation():
    c1, c2 = -0.5, -13.0
    material = Material(0.5, c1=c1, c2=c2, c3=0.0)
    state = material.state(0.6, 5.3, [0.0, 0.0, 0.0, 0.0, 0.03, 0.0])
    gradient = np.zeros((3, 3))
    gradient[0, 2] = gradient[2, 0] = 0.1                            # abs(D) = 0.1, no spin
    state = material.update(state, gradient)
    x = material["chi"] + (0.06 - material["chi"]) * np.exp(c2 * 0.1)
    assert 2 * state.fabric[4] == pytest.approx(x, rel=1e-13)
    # (4.8) with f = Z2's steady value: integrated by the same exponentials
    d1, d2, f = material["d1"], material["d2"], material["Zc"] + material["beta1"] * (0.6 - material["phic"]) ** 0.5
    share = (np.exp(c2 * 0.1) - np.exp(-d2 * 0.1)) / (c2 + d2)
    Z2 = f + (5.3 - f) * np.exp(-d2 * 0.1) + d1 * (0.06 - material["chi"]) * share
    assert state.coordination_number == pytest.approx(Z2, rel=1e-13)


@pytest.mark.parametrize("closure", ["full", "mobilised"])
def test_the_steady_states_of_several_volume_fractions_are_those_of_each(closure):
    material = Material(0.5, closure, elastic_strain=0.01)
    phi = np.linspace(0.58, 0.64, 18).reshape(3, 6)         # more than the core takes at once
    found = material.steady(phi)
    assert found.shape == phi.shape
    assert all(np.array_equal(found[place], material.steady(float(phi[place]))) for place in np.ndindex(phi.shape))
