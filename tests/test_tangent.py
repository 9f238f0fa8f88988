"""The consistent tangent against 8th-order differences of the update itself."""

import numpy as np
import pytest

from granumat import STATE, Material, tensors
from support.states import random_rotations, random_states, rotated

# f'(0) from f(+-h), f(+-2h), f(+-3h), f(+-4h), order 8
WEIGHTS = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
CLOSURES = ("critical", "basic", "n2", "full", "kinematic")


def unit_gradients():
    """Displacement gradients (9, 3, 3) of the unit strains xx yy zz xy xz yz (engineering shears) and spins xy xz yz."""
    units = np.zeros((9, 3, 3))
    for k in range(3):
        units[k, k, k] = 1
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        units[3 + k, i, j] = units[3 + k, j, i] = 0.5
        units[6 + k, i, j], units[6 + k, j, i] = 1, -1
    return units


def differences(material, states, gradient, steps):
    """d stress / d (strain, spin) (n, 6, 9) by central differences with the steps (n,) of each point."""
    result = np.zeros((len(states), 6, 9))
    for k, unit in enumerate(unit_gradients()):
        for m, weight in enumerate(WEIGHTS, 1):
            ahead, behind = (material.update(states, gradient + sign * m * steps[:, None, None] * unit).stress for sign in (1, -1))
            result[:, :, k] += weight * (ahead - behind)
    return result / steps[:, None, None]


def check(material, states, gradient, share, tolerance):
    """Largest error of a point's tangent over its largest entry, by strain and by spin; steps a share of |D|."""
    strain = tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2)
    expected = differences(material, states, gradient, share * tensors.magnitude(strain))
    new, tangent = material.update_with_tangent(states, gradient, spin=True)
    assert (new == material.update(states, gradient)).all()
    smooth = tensors.magnitude(new.fabric) > 2e-3                       # the differences may not reach across the kink at A = 0
    assert smooth.mean() > 0.95
    for part in (slice(0, 6), slice(6, 9)):
        size = np.maximum(np.abs(expected[:, :, part]).max((1, 2)), 0.1 * np.abs(new.stress).max(1))
        error = (np.abs(tangent - expected)[:, :, part].max((1, 2)) / size)[smooth]
        assert error.max() < tolerance, (error.max(), error.argmax())


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
@pytest.mark.parametrize("closure", CLOSURES)
def test_tangent_equals_8th_order_differences(rng, closure, contact):
    material = Material(0.5, closure, contact)
    states, gradient = random_states(rng, material, 1000, 0.02, excess=(0.5, 1.2))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    check(material, states[size > 1e-3], gradient[size > 1e-3], 0.01, 1e-8)


@pytest.mark.parametrize("mu", [0.0, 0.1, 1.0])
def test_tangent_of_large_increments_in_substeps(rng, mu):
    material = Material(mu)
    states, gradient = random_states(rng, material, 300, 0.5, volume=0.1, excess=(1.0, 1.5))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    check(material, states[size > 1e-2], gradient[size > 1e-2], 1e-3, 1e-8)


def test_tangent_without_the_term_that_limits_the_fabric(rng):
    material = Material(0.5, c2=-13.0, c3=0.0)
    states, gradient = random_states(rng, material, 500, 0.02, excess=(0.5, 1.2))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    check(material, states[size > 1e-3], gradient[size > 1e-3], 0.01, 1e-8)


# the model's stress by polynomials of degree 1, 2 and 4, and with a steep kernel; small increments leave differences more round-off
@pytest.mark.parametrize(("elastic_strain", "largest", "share", "tolerance"), [
    (0.01, 1e-6, 0.1, 1e-6), (0.01, 3e-5, 0.1, 1e-7), (0.01, 0.01, 0.01, 1e-8), (1e-4, 2e-3, 0.01, 1e-8)])
@pytest.mark.parametrize("closure", CLOSURES)
def test_tangent_with_an_elastic_strain(rng, closure, elastic_strain, largest, share, tolerance):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    states, gradient = random_states(rng, material, 500, 2 * largest, excess=(0.8, 1.2))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    good = (size > 0.3 * largest) & (tensors.magnitude(states["fabric"]) > 0.02)          # away from the kink at A = 0
    check(material, states[good], gradient[good], share, tolerance)


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
def test_tangent_with_quadratic_friction_and_the_isotropic_term(rng, elastic_strain):
    material = Material(0.5, friction="quadratic", b1=0.1, b2=-3.0, b3=-8.0, g=1e-3, elastic_strain=elastic_strain)
    states, gradient = random_states(rng, material, 300, 0.01, excess=(0.8, 1.2))
    size = tensors.magnitude(tensors.to_voigt((gradient + np.swapaxes(gradient, 1, 2)) / 2))
    good = (size > 5e-4) & (tensors.magnitude(states["fabric"]) > 0.02)          # away from the kink at A = 0; one substep
    check(material, states[good], gradient[good], 0.03, 1e-8)


def test_tangent_is_objective(rng, material):
    states, gradient = random_states(rng, material, 100, 0.02, excess=(0.5, 1.2))
    q = random_rotations(rng, 100)
    _, tangent = material.update_with_tangent(states, gradient)
    _, turned = material.update_with_tangent(rotated(q, states), q @ gradient @ np.swapaxes(q, 1, 2))
    strain = np.zeros((100, 6))
    strain[:] = rng.normal(size=6)
    full = tensors.to_matrix(strain * [1, 1, 1, 0.5, 0.5, 0.5])
    turned_strain = tensors.to_voigt(q @ full @ np.swapaxes(q, 1, 2)) * [1, 1, 1, 2, 2, 2]
    change = tensors.to_voigt(q @ tensors.to_matrix(np.einsum("nij,nj->ni", tangent, strain)) @ np.swapaxes(q, 1, 2))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turned, turned_strain), change,
                               rtol=0, atol=1e-11 * np.abs(tangent).max())


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
def test_tangent_at_zero_strain_is_finite_and_that_of_a_small_strain_in_the_last_direction(elastic_strain):
    material = Material(0.5, elastic_strain=elastic_strain)
    state = np.array([material.steady(0.60)])
    new, tangent = material.update_with_tangent(state, np.zeros((1, 3, 3)))
    assert new.tobytes() == state.tobytes()
    small = 1e-4 * tensors.to_matrix(state["direction"])
    np.testing.assert_allclose(tangent, material.update_with_tangent(state, small)[1], rtol=1e-10, atol=1e-12)
    fresh = np.array([material.isotropic(0.60, pressure=0.01)])
    new, tangent = material.update_with_tangent(fresh, np.zeros((1, 3, 3)))
    assert new.tobytes() == fresh.tobytes() and np.isfinite(tangent).all()
    assert (np.linalg.eigvalsh((tangent + np.swapaxes(tangent, 1, 2)) / 2) > 0).all()


def test_tangent_of_a_failed_point_is_zero_and_of_unjammed_ones_too(material):
    from granumat import MaterialError
    states = np.array([material.steady(0.60)] * 3)
    gradient = np.zeros((3, 3, 3))
    gradient[:, 0, 2] = 0.01
    gradient[1] = -np.eye(3)
    with pytest.raises(MaterialError):
        material.update_with_tangent(states, gradient)
    loose = np.zeros(1, STATE)
    loose["coordination_number"], loose["volume_fraction"] = 3.0, 0.55
    _, tangent = material.update_with_tangent(loose, gradient[:1])
    assert (tangent == 0).all()


def test_tangent_is_the_same_in_any_batch_and_thread(rng, material):
    states, gradient = random_states(rng, material, 101, 0.05)
    _, tangent = material.update_with_tangent(states, gradient, spin=True)
    for i in (0, 7, 50, 100):
        assert material.update_with_tangent(states[i], gradient[i], spin=True)[1].tobytes() == tangent[i].tobytes()
    assert material.update_with_tangent(states, gradient, spin=True, threads=2)[1].tobytes() == tangent.tobytes()
    np.testing.assert_allclose(material.update_with_tangent(states, gradient)[1], tangent[:, :, :6], rtol=1e-14, atol=1e-16)


def test_tangent_of_plane_strain_is_the_part_of_the_whole_one_that_it_needs(rng, material):
    states, gradient = random_states(rng, material, 101, 0.05)
    _, tangent = material.update_with_tangent(states, gradient, spin=True)
    for spin, columns in ((True, [0, 1, 3, 6]), (False, [0, 1, 3])):
        _, plane = material.update_with_tangent(states, gradient, spin=spin, plane=True)
        np.testing.assert_array_equal(plane, tangent[:, :4, columns])
