"""A point with a length, driven by a nonlocal strain m beside |D|: docs/theory.md, section 12."""

import numpy as np
import pytest

from granumat import STATE, Material, MaterialError, tensors
from granumat.material import CLOSURES, TURNING
from support import reference
from support.states import CLOSURES_AND_STRAINS as CASES
from support.states import random_rotations, random_states, rotated
from test_tangent import WEIGHTS, unit_gradients

CONTACTS = ["hookean", pytest.param("hertzian", marks=pytest.mark.release_only)]   # the debug build has both in test_exact.py
SHEAR = np.array([[0.0, 0, 1], [0, 0, 0], [0, 0, 0]])


def isotropic_term(closure, contact="hookean"):
    """A g of (B 1), where it has a role."""
    return {} if closure == "mobilised-pressure" or contact == "hertzian" else {"g": 1e-3}


def strain_magnitude(gradient):
    return tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))


def random_points(rng, material, n, shear, **sampling):
    """States with random directions, displacement gradients, and nonlocal strains from a tenth of |D| to ten times as much."""
    states, gradient = random_states(rng, material, n, shear, **sampling)
    direction = tensors.deviator(rng.normal(size=(n, 6)))
    states["direction"] = direction / tensors.magnitude(direction)[:, None]
    if material.closure in TURNING:
        states["direction"] *= rng.random((n, 1))
    return states, gradient, strain_magnitude(gradient) * 10.0 ** rng.uniform(-1, 1, n)


def evolving(material, states):
    """What (4.8) is the equation of: Z2 - Zc, or p/(2 (a1 + a2 kappa))."""
    if material.closure == "mobilised-pressure":
        return -tensors.trace(states["stress"]) / 3 / (2 * (material["a1"] + material["a2"] * material["kappa"]))
    return states["coordination_number"] - material["Zc"]


def target(material):
    """What that decays to at phi = 0.6."""
    excess = material["beta1"] * np.sqrt(0.6 - material["phic"])
    return excess**2 / 2 if material.closure == "mobilised-pressure" else excess


# ---- the law with m --------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(("closure", "elastic_strain"), CASES)
def test_with_m_equal_to_the_magnitude_of_the_strain_it_is_the_update_without_a_length(rng, closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain, **isotropic_term(closure))
    states, gradient, _ = random_points(rng, material, 200, 0.1)
    m = strain_magnitude(gradient)
    local, tangent = material.update_with_tangent(states, gradient, spin=True)
    new, at_constant_m, by_m = material.update_with_tangent(states, gradient, spin=True, nonlocal_strain=m)
    for name in STATE.names:
        np.testing.assert_allclose(new[name], local[name], rtol=1e-14, atol=1e-14 * np.abs(local[name]).max())
    direction = local["direction"]
    if closure in TURNING:                                                # there it is that of friction
        direction = tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2) / m[:, None]
    total = at_constant_m.copy()                                          # d|D| = D^ : dD/2
    total[:, :, :6] += by_m[:, :, None] * direction[:, None, :] / 2
    np.testing.assert_allclose(total, tangent, rtol=0, atol=1e-12 * np.abs(at_constant_m).max())


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("shear", [0.004, 0.1])
@pytest.mark.parametrize(("closure", "elastic_strain"), CASES)
def test_it_equals_an_8th_order_solution(rng, closure, elastic_strain, shear, contact):
    c = reference.constants(0.5, "n2" if closure == "critical" else closure) | {"elastic_strain": elastic_strain}
    material = Material(0.5, closure, contact, elastic_strain=elastic_strain)
    states, gradient, m = random_points(rng, material, 60, shear, excess=(0.8, 1.2))
    fabric, z2, phi, direction, stress = reference.integrate_with_length(
        c, closure, *(tensors.to_matrix(states[name]) for name in ("fabric", "direction", "stress")),
        states["coordination_number"], states["volume_fraction"], gradient, m, contact)
    new = material.update(states, gradient, nonlocal_strain=m)
    assert np.abs(new["fabric"] - tensors.to_voigt(fabric)).max() / material["kappa"] < 1e-11
    np.testing.assert_allclose(new["coordination_number"], z2, rtol=1e-11)
    np.testing.assert_allclose(new["volume_fraction"], phi, rtol=1e-12)
    if closure in TURNING:
        np.testing.assert_allclose(tensors.deviator(new["direction"]), tensors.to_voigt(direction), rtol=0, atol=1e-11)
    size = np.maximum(np.abs(stress).max((1, 2)), 1e-6)[:, None]                        # some have no pressure at the end
    assert (np.abs(new["stress"] - tensors.to_voigt(stress)) / size).max() < (1e-9 if elastic_strain and shear > 0.01 else 1e-11)


@pytest.mark.parametrize(("ratio", "expected"), [(0.2, 0.139), (1.0, 0.368), (1.5, 0.471)])
def test_steady_shear_has_one_stress_ratio_for_each_ratio_of_local_to_nonlocal_strain(ratio, expected):
    material = Material(0.5, "full", elastic_strain=0.01)
    state = material.steady(0.6)
    for _ in range(600):
        state = material.update(state, 0.01 * SHEAR, nonlocal_strain=0.005 / ratio)
    assert state["stress"][4] / -state["stress"][2] == pytest.approx(expected, abs=6e-4)
    again = material.update(state, 0.01 * SHEAR, nonlocal_strain=0.005 / ratio)
    np.testing.assert_allclose(again["stress"], state["stress"], rtol=1e-6)


@pytest.mark.parametrize("ratio", [0.2, 0.7, 1.0, 1.4])
@pytest.mark.parametrize("closure", CLOSURES)
def test_steady_coaxial_shear_has_the_closed_form_of_the_theory(closure, ratio):
    material = Material(0.5, closure, elastic_strain=0.01)
    c1, c2, c3, lam = (material[name] for name in ("c1", "c2", "c3", "lambda"))
    a = (-c2 - np.sqrt(c2**2 - 8 * ratio**2 * c1 * c3)) / (4 * ratio * c3)        # R (c1 + 2 c3 a^2) + c2 a = 0
    x = 2 * a
    if closure == "critical":
        a, x = lam, material["chi"]
    eta = material["b1"] + material["b2"] * x
    friction = ratio * (eta + material["a4"] * x / 2) - material["a4"] * a
    state = material.steady(0.6)
    for _ in range(200):
        state = material.update(state, 0.05 * np.diag([1.0, 0, -1]), nonlocal_strain=0.05 / ratio)
    p = -tensors.trace(state["stress"]) / 3
    assert (state["stress"][0] - state["stress"][2]) / (2 * p) == pytest.approx(friction, rel=1e-9)
    if closure != "critical":
        forcing = material["d1"] * ratio * (x - material["chi"]) / material["d2"]
        assert evolving(material, state) == pytest.approx(target(material) + forcing, rel=1e-8)


@pytest.mark.parametrize("largest", [0.01, pytest.param(0.3, marks=pytest.mark.release_only)])
def test_the_fabric_stays_below_its_bound_for_every_m(rng, largest):
    material = Material(0.5)
    bound = np.sqrt(-material["c1"] / (2 * material["c3"]))
    states, _, _ = random_points(rng, material, 200, 0.1)
    for _ in range(60):
        _, gradient, _ = random_points(rng, material, 200, 2 * largest, spin=2.0, volume=0.0)
        m = strain_magnitude(gradient) * 10.0 ** rng.uniform(-4, 2, 200)
        states = material.update(states, gradient - np.trace(gradient, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3,
                                 nonlocal_strain=m)
        assert tensors.magnitude(states["fabric"]).max() < bound + 1e-15
    for _ in range(40):                                                   # and reaches it where m is small
        states = material.update(states, np.tile(0.1 * np.diag([1.0, 0, -1]), (200, 1, 1)), nonlocal_strain=np.full(200, 1e-4))
    np.testing.assert_allclose(tensors.magnitude(states["fabric"]), bound, rtol=1e-3)


def test_it_does_not_depend_on_the_axes(rng):
    for closure in CLOSURES:
        material = Material(0.5, closure, elastic_strain=0.01)
        states, gradient, m = random_points(rng, material, 50, 0.1)
        q = random_rotations(rng, 50)
        new = rotated(q, material.update(states, gradient, nonlocal_strain=m))
        other = material.update(rotated(q, states), q @ gradient @ np.swapaxes(q, 1, 2), nonlocal_strain=m)
        for name in STATE.names:
            np.testing.assert_allclose(other[name], new[name], rtol=0, atol=1e-12 * np.abs(new[name]).max())


# ---- the tangent -----------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("shear", [0.01, 0.2])
@pytest.mark.parametrize(("closure", "elastic_strain"), CASES)
def test_the_tangent_by_strain_spin_and_m_equals_8th_order_differences(rng, closure, elastic_strain, shear, contact):
    material = Material(0.5, closure, contact, elastic_strain=elastic_strain, **isotropic_term(closure, contact))
    n = 400 if shear < 0.1 else 100                 # the debug build takes seconds for large increments
    states, gradient, m = random_points(rng, material, n, shear, volume=0.1, excess=(1.0, 1.4))
    size = strain_magnitude(gradient)
    share = np.minimum(size, m) * (1e-3 if shear > 0.1 else 0.01)

    def stress(strain_share, m_share):
        return material.update(states, gradient + strain_share, nonlocal_strain=m + m_share)["stress"]

    found, tangent, by_m = material.update_with_tangent(states, gradient, spin=True, nonlocal_strain=m)
    expected = np.zeros((n, 6, 10))
    for k, weight in enumerate(WEIGHTS, 1):
        for j, unit in enumerate(unit_gradients()):
            step = k * share[:, None, None] * unit
            expected[:, :, j] += weight * (stress(step, 0) - stress(-step, 0))
        expected[:, :, 9] += weight * (stress(0, k * share) - stress(0, -k * share))
    expected /= share[:, None, None]
    good = (size > 0.2 * shear / 2) & (tensors.magnitude(states["fabric"]) > 0.01) & (tensors.magnitude(found["fabric"]) > 0.01)
    good &= -tensors.trace(found["stress"]) / 3 > 1e-5                    # and away from the kink at p = 0
    if closure in TURNING:
        good &= away_from_the_kink(material, states, gradient, m, found)
    assert good.sum() > n / 4
    all_columns = np.concatenate([tangent, by_m[:, :, None]], axis=2)
    for part in (slice(0, 6), slice(6, 9), slice(9, 10)):
        largest = np.maximum(np.abs(expected[:, :, part]).max((1, 2)), 0.1 * np.abs(found["stress"]).max(1))
        error = (np.abs(all_columns - expected)[:, :, part].max((1, 2)) / largest)[good]
        assert error.max() < (1e-7 if shear > 0.1 else 1e-8), (part, error.max())
    plane = material.update_with_tangent(states, gradient, spin=True, plane=True, nonlocal_strain=m)
    np.testing.assert_allclose(plane[1], tangent[:, :4][:, :, [0, 1, 3, 6]], rtol=0, atol=1e-12 * np.abs(tangent).max())
    np.testing.assert_allclose(plane[2], by_m[:, :4], rtol=0, atol=1e-12 * np.abs(by_m).max())


def away_from_the_kink(material, states, gradient, m, found):
    """Where (M + S^ - S/m) : S^ keeps its sign and is not near 0, at the ends of an increment."""
    strain = tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2)
    s_hat = tensors.deviator(strain) / tensors.magnitude(strain)[:, None]
    ratio = tensors.magnitude(strain) / m
    rest = (1 - ratio) * tensors.contract(s_hat, s_hat)
    before, after = (tensors.contract(tensors.deviator(x["direction"]), s_hat) + rest for x in (states, found))
    return (before * after > 0) & (np.minimum(abs(before), abs(after)) > 0.3)


@pytest.mark.parametrize(("closure", "elastic_strain"), CASES)
def test_the_tangent_stays_bounded_as_the_strain_vanishes_beside_m(closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    state = material.steady(0.6)
    along = tensors.to_matrix(state["direction"])
    tangents = [material.update_with_tangent(state, size * along, spin=True, nonlocal_strain=0.003)[1:]
                for size in (1e-9, 1e-14, 0.0)]
    largest = np.abs(tangents[-1][0]).max()
    for one, other, limit in zip(*tangents):
        np.testing.assert_allclose(other, limit, rtol=0, atol=1e-10 * largest)
        np.testing.assert_allclose(one, limit, rtol=0, atol=1e-5 * largest)


# ---- no strain, and what is refused ----------------------------------------------------------------------------------

@pytest.mark.parametrize(("closure", "elastic_strain"), CASES)
def test_without_strain_the_microstructure_decays_with_m_and_the_state_turns_with_the_body(closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    state = np.array([material.steady(0.6)])
    m = np.array([0.02])
    spin = 0.3 * (SHEAR - SHEAR.T)[None]
    new = material.update(state, np.zeros((1, 3, 3)), nonlocal_strain=m)
    a, p = state["fabric"], -tensors.trace(new["stress"])[0] / 3
    if closure != "critical":
        np.testing.assert_allclose(new["fabric"], np.exp(material["c2"] * m) * a, rtol=0, atol=1e-15)
        before, limit = evolving(material, state), target(material)
        np.testing.assert_allclose(evolving(material, new), limit + np.exp(-material["d2"] * m) * (before - limit), rtol=1e-13)
    if elastic_strain == 0:                                               # S/m = 0: what is left is the fabric's own part
        expected = -p * material["a4"] * new["fabric"] - p * tensors.IDENTITY
        np.testing.assert_allclose(new["stress"], expected, rtol=0, atol=1e-15)
    turned = material.update(state, spin, nonlocal_strain=m)
    at_once = rotated(np.array([[[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]]]), new)
    for name in STATE.names:
        np.testing.assert_allclose(turned[name], at_once[name], rtol=0, atol=1e-14)


def test_at_rest_nothing_changes_and_the_tangent_is_that_of_m_equal_to_a_small_strain():
    material = Material(0.5, elastic_strain=0.01)
    state = material.steady(0.6)
    new, tangent, by_m = material.update_with_tangent(state, np.zeros((3, 3)), nonlocal_strain=0.0)
    assert new == state
    along = tensors.to_matrix(1e-4 * state["direction"])
    _, expected, expected_by_m = material.update_with_tangent(state, along, nonlocal_strain=1e-4)
    np.testing.assert_allclose(tangent, expected, rtol=1e-12)
    np.testing.assert_allclose(by_m, expected_by_m, rtol=1e-12)


@pytest.mark.parametrize("m", [-1e-9, np.nan, np.inf, 0.0])
def test_a_nonlocal_strain_that_is_none_is_refused_in_words_and_the_others_are_done(m):
    material = Material(0.5, elastic_strain=0.01)
    states = np.array([material.steady(0.6)] * 3)
    gradient = 0.01 * np.broadcast_to(SHEAR, (3, 3, 3))
    with pytest.raises(MaterialError, match="point 1: the nonlocal strain is negative, not finite, or 0 where") as e:
        material.update_with_tangent(states, gradient, nonlocal_strain=[0.005, m, 0.005])
    assert e.value.status.tolist() == [0, 17, 0]
    assert e.value.states[1] == states[1] and e.value.states[2] == material.update(states[2], gradient[2], nonlocal_strain=0.005)


def test_nonlocal_strains_of_another_shape_or_for_another_method_are_refused():
    material = Material(0.5, method="rk4")
    states = np.array([material.steady(0.6)] * 3)
    with pytest.raises(ValueError, match=r"(?s)shape \(2,\): must be \(3,\).*needs the method 'exact'.* 'rk4'"):
        material.update(states, np.zeros((3, 3, 3)), nonlocal_strain=np.zeros(2))


def test_threads_and_neighbours_do_not_change_a_point(rng):
    material = Material(0.5, elastic_strain=0.01)
    states, gradient, m = random_points(rng, material, 21, 0.1)
    together = material.update_with_tangent(states, gradient, nonlocal_strain=m)
    shared = material.update_with_tangent(states, gradient, nonlocal_strain=m, threads=2)
    alone = material.update_with_tangent(states[13:14], gradient[13:14], nonlocal_strain=m[13:14])
    for one, other, single in zip(together, shared, alone):
        assert (one == other).all() and (one[13] == single[0]).all()
