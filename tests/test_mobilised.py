"""The closures "mobilised" and "mobilised-pressure": friction follows the direction of shearing over the elastic strain."""

import numpy as np
import pytest

from granumat import Material, tensors
from granumat.material import TURNING
from support import reference
from support.states import random_rotations, random_states, rotated
from test_tangent import check

SHEAR = np.zeros((3, 3))
SHEAR[0, 2] = 1.0


@pytest.fixture(params=TURNING)
def closure(request):
    return request.param


def turned_states(rng, material, n, shear, against=False, **sampling):
    """Random states, gradients as in random_states, and mobilised directions of any size; or such as oppose the shearing."""
    states, gradient = random_states(rng, material, n, shear, **sampling)
    deviator = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) / 3
    direction = rng.normal(size=(n, 6))
    if against:
        direction = -tensors.to_voigt(gradient + np.swapaxes(gradient, 1, 2)) + 1e-4 * shear * direction
    direction -= tensors.trace(direction)[:, None] * deviator
    direction *= (rng.random(n) if not against else np.ones(n))[:, None] / tensors.magnitude(direction)[:, None]
    states["direction"] = direction
    states["stress"] = material.evaluate(states)[0]
    return states, gradient


def errors(closure, seed, n, shear, elastic_strain, contact="hookean", against=False, **sampling):
    """Largest errors of A/kappa, Z2, phi, M and the stress (over its largest component) of random updates."""
    rng, worst = np.random.default_rng(seed), np.zeros(5)
    for mu in (0.0, 0.1, 0.5, 1.0):
        material = Material(mu, closure, contact, elastic_strain=elastic_strain)
        c = reference.constants(mu, closure) | {"elastic_strain": elastic_strain}
        states, gradient = turned_states(rng, material, n, shear, against, **sampling)
        a, z, ph, m, p, dev = reference.integrate_mobilised(
            c, tensors.to_matrix(states["fabric"]), states["coordination_number"], states["volume_fraction"],
            tensors.to_matrix(states["direction"]), gradient, contact, pressure_evolves=closure == "mobilised-pressure")
        new = material.update(states, gradient)
        sigma = tensors.to_voigt(dev + reference.scale(p, np.eye(3)))
        jammed = p > 0.03 * material["a1"]                                         # below, its error counts relative to more
        worst = np.maximum(worst, [
            np.abs(new.fabric - tensors.to_voigt(a)).max() / material["kappa"], np.abs(new.coordination_number / z - 1).max(),
            np.abs(new.volume_fraction / ph - 1).max(), np.abs(tensors.deviator(new.direction) - tensors.to_voigt(m)).max(),
            (np.abs(new.stress + sigma).max(1)[jammed] / np.abs(sigma).max(1)[jammed]).max()])
    return dict(zip(("A", "Z2", "phi", "M", "stress"), worst))


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
def test_error_is_below_1e_12_for_shear_up_to_0_02(closure, contact):
    assert max(errors(closure, 1, 250, 0.02, 0.01, contact, excess=(0.4, 1.2)).values()) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("elastic_strain", [0.003, 0.02, 0.1])
def test_error_is_below_1e_11_for_shear_up_to_0_3(closure, elastic_strain):
    assert max(errors(closure, 2, 100, 0.3, elastic_strain, volume=0.1, excess=(0.9, 1.5)).values()) < 1e-11


def test_error_is_below_1e_11_where_the_mobilised_share_leaves_0_within_the_increment(closure):
    assert max(errors(closure, 3, 100, 0.05, 0.01, against=True, spin=1.0, excess=(0.6, 1.2)).values()) < 1e-11


def test_error_is_below_1e_12_where_the_body_turns_much_more_than_it_shears(closure):
    assert max(errors(closure, 4, 100, 1e-3, 0.1, spin=500.0, excess=(0.6, 1.2)).values()) < 1e-12


def test_an_increment_equals_its_halves(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    states, gradient = turned_states(rng, material, 500, 0.1, excess=(0.8, 1.2))
    whole, halves = material.update(states, gradient), material.update(material.update(states, gradient / 2), gradient / 2)
    for name in ("stress", "fabric", "direction"):
        np.testing.assert_allclose(whole[name], halves[name], rtol=0, atol=1e-12 * np.abs(whole[name]).max())


def test_the_stress_of_an_update_is_that_of_the_new_state(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    states, gradient = turned_states(rng, material, 200, 0.1, excess=(0.8, 1.2))
    new = material.update(states, gradient)
    np.testing.assert_allclose(material.evaluate(new)[0], new.stress, rtol=0, atol=1e-15)


def test_long_shear_without_spin_has_the_stress_of_the_kinematic_closure(closure):
    shear = 8.0 * (SHEAR + SHEAR.T)
    stresses = []
    for material in (Material(0.5, "kinematic"), Material(0.5, closure, elastic_strain=0.01)):
        stresses.append(material.update(material.state(0.6, 5.3), shear).stress)
    np.testing.assert_allclose(*stresses, rtol=0, atol=1e-14)


@pytest.mark.parametrize("elastic_strain", [0.001, 0.01])
def test_steady_shear_is_a_fixed_point(closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    steady = material.steady(0.6)
    new = material.update(steady, 0.3 * SHEAR)
    for name in ("stress", "fabric", "direction", "coordination_number"):
        np.testing.assert_allclose(new[name], steady[name], rtol=0, atol=1e-13 * np.abs(steady[name]).max())


def test_the_stress_does_not_jump_when_the_direction_of_shearing_changes(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    steady = material.steady(0.6)
    for turn in random_rotations(rng, 20):
        new = material.update(steady, 1e-7 * turn @ SHEAR @ turn.T)
        assert np.abs(new.stress - steady.stress).max() < 1e-4 * np.abs(steady.stress).max()


def test_the_first_contraction_after_a_reversal_is_half_as_fast_as_with_friction_that_turns_at_once():
    rates = []
    for closure in ("kinematic", "mobilised"):
        material = Material(0.5, closure, elastic_strain=0.01)
        steady = material.steady(0.6)
        rates.append(material.update(steady, -1e-5 * SHEAR).coordination_number - steady.coordination_number)
    assert rates[1] / rates[0] == pytest.approx(0.5, abs=0.06)            # d1 A:S in place of d1 (A:S - chi abs(S)), and d2


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
def test_where_the_pressure_evolves_its_first_fall_after_a_reversal_has_one_modulus_in_every_packing(contact):
    material = Material(0.5, "mobilised-pressure", contact, elastic_strain=0.01)
    modulus = (material["a1"] + material["a2"] * material["kappa"]) * 2 * material["d1"]
    for phi in (0.595, 0.60, 0.63):
        steady = material.steady(phi)
        p = [-tensors.trace(state.stress) / 3 for state in (steady, material.update(steady, -1e-6 * SHEAR))]
        fall = (p[1] - p[0]) / 1e-6 if contact == "hookean" else (p[1] ** (2 / 3) - p[0] ** (2 / 3)) / 1e-6
        assert fall == pytest.approx(modulus * -steady.fabric[4], rel=0.06)                 # d1 A:S, and d2 (steady is not f)


def test_where_the_pressure_evolves_the_unjammed_remember_how_far_they_are_from_bearing():
    material = Material(0.5, "mobilised-pressure", elastic_strain=0.01)
    state = material.isotropic(0.57, coordination_number=material["Zc"] + 0.2)
    whole = material.update(state, 0.8 * SHEAR)
    assert whole.coordination_number < material["Zc"] - 0.3 and not whole.stress.any()
    halves = material.update(material.update(state, 0.4 * SHEAR), 0.4 * SHEAR)
    assert halves.coordination_number == pytest.approx(whole.coordination_number, abs=1e-12)


def test_the_update_is_objective(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    states, gradient = turned_states(rng, material, 200, 0.1, excess=(0.8, 1.2))
    q = random_rotations(rng, 200)
    turned = material.update(rotated(q, states), q @ gradient @ np.swapaxes(q, 1, 2))
    expected = rotated(q, material.update(states, gradient))
    for name in ("stress", "fabric", "direction"):
        np.testing.assert_allclose(turned[name], expected[name], rtol=0, atol=1e-13)


def test_the_mobilised_direction_never_exceeds_1(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    states, _ = turned_states(rng, material, 200, 0.1, excess=(0.8, 1.2))
    for _ in range(20):
        gradient = turned_states(rng, material, 200, 0.05)[1]
        gradient -= np.trace(gradient, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
        states = material.update(states, gradient)
        assert tensors.magnitude(states["direction"]).max() <= 1 + 1e-14


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
@pytest.mark.parametrize(("largest", "share", "tolerance"), [(1e-5, 0.03, 1e-6), (0.01, 0.01, 1e-8)])
def test_tangent_equals_8th_order_differences(closure, rng, contact, largest, share, tolerance):
    jump = {"g": 1e-3} if contact == "hookean" and closure == "mobilised" else {}
    material = Material(0.5, closure, contact, elastic_strain=0.01, **jump)
    states, gradient = turned_states(rng, material, 500, 2 * largest, excess=(0.8, 1.2))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    good = (size > 0.3 * largest) & (tensors.magnitude(states["fabric"]) > 0.02)          # away from the kink at A = 0
    before, after = ((tensors.to_matrix(x["direction"]) * gradient).sum((1, 2)) / size
                     for x in (states, material.update(states, gradient)))
    smooth = (before * after > 0) & (np.minimum(abs(before), abs(after)) > 0.3)           # and from that of the mobilised share
    check(material, states[good & smooth], gradient[good & smooth], share, tolerance)


def test_tangent_of_large_increments_across_the_kink_of_the_mobilised_share(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.02)
    states, gradient = turned_states(rng, material, 200, 0.2, against=True, spin=0.5, volume=0.1, excess=(1.0, 1.5))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    check(material, states[size > 0.03], gradient[size > 0.03], 1e-3, 1e-8)


def test_tangent_stays_bounded_as_the_increment_shrinks(closure):
    material = Material(0.5, closure, elastic_strain=0.01)
    steady = material.steady(0.6)
    sizes = [np.abs(material.update_with_tangent(steady, -gamma * SHEAR)[1]).max() for gamma in (1e-3, 1e-6, 1e-9)]
    assert sizes[2] < 1.2 * sizes[0]
    assert sizes[2] == pytest.approx(sizes[1], rel=1e-4)


def test_the_response_is_the_tangent_of_a_vanishing_increment_along_the_direction_of_friction(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    states, _ = turned_states(rng, material, 100, 0.01, excess=(0.8, 1.2))
    states = states[tensors.magnitude(states["direction"]) > 0.1]
    along = tensors.to_matrix(states["direction"] / tensors.magnitude(states["direction"])[:, None])
    _, tangent = material.update_with_tangent(states, 1e-9 * along)
    p = -tensors.trace(states["stress"]) / 3
    expected = p[:, None, None] * material.response(states)
    np.testing.assert_allclose(tangent, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_eta_t_is_b1_on_every_path(closure, rng):
    material = Material(0.5, closure, elastic_strain=0.01)
    states, _ = turned_states(rng, material, 100, 0.01)
    np.testing.assert_allclose(material.transverse_modulus(states), material["b1"], rtol=1e-13)


def test_at_rest_nothing_changes_and_the_state_rotates_with_the_body(closure):
    material = Material(0.5, closure, elastic_strain=0.01)
    steady = material.steady(0.6)
    assert material.update(steady, np.zeros((3, 3))) == steady
    turned = material.update(np.array([steady]), np.pi / 2 * (SHEAR - SHEAR.T)[None])
    expected = rotated(np.array([[[0, 0, 1], [0, 1, 0], [-1, 0, 0]]]), np.array([steady]))
    for name in ("stress", "fabric", "direction"):
        np.testing.assert_allclose(turned[name], expected[name], rtol=0, atol=1e-14)


def test_what_the_closure_cannot_do_is_refused(closure):
    with pytest.raises(ValueError, match=f"elastic_strain = 0: the closure '{closure}' needs one above 0"):
        Material(0.5, closure)
    with pytest.raises(ValueError, match=f"method 'rk4': the closure '{closure}' is integrated by the method 'exact' only"):
        Material(0.5, closure, elastic_strain=0.01, method="rk4")
    with pytest.raises(ValueError, match=rf"a4 = 5\.0: has no role in the closure '{closure}'"):
        Material(0.5, closure, elastic_strain=0.01, a4=5.0)
