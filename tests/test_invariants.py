"""What must hold for every path, by derivation: no reference solution is needed."""

import numpy as np
import pytest

from granumat import STATE, Material, tensors
from support.states import CLOSURES_AND_STRAINS, random_rotations, random_states, rotated


def assert_close(x, y, rtol=1e-13):
    for name, unit in (("stress", 0.01), ("fabric", 0.04), ("direction", 1),
                       ("coordination_number", 5), ("volume_fraction", 1)):
        error = np.abs(x[name] - y[name]) / unit
        assert error.max() < rtol, (name, error.max())


def test_fabric_stays_traceless_and_below_kappa_from_an_isotropic_start(rng, material):
    states = np.array([material.isotropic(0.60, coordination_number=5.0)] * 200)
    largest = 0.0
    for _ in range(200):
        _, gradient = random_states(rng, material, 200, 0.5, volume=0.0)
        states = material.update(states, gradient)
        largest = max(largest, tensors.magnitude(states.fabric).max())
        assert np.abs(tensors.trace(states.fabric)).max() < 1e-15
    assert 0.9 * material["kappa"] < largest <= material["kappa"] * (1 + 1e-14)


@pytest.mark.parametrize(("closure", "elastic_strain"), CLOSURES_AND_STRAINS)
def test_rotated_input_gives_rotated_output(rng, closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    states, gradient = random_states(rng, material, 300, 0.1, excess=(0.5, 1.2))
    q = random_rotations(rng, 300)
    turned = material.update(rotated(q, states), q @ gradient @ np.swapaxes(q, 1, 2))
    assert_close(turned, rotated(q, material.update(states, gradient)), 1e-12 if elastic_strain == 0 else 1e-9)


@pytest.mark.parametrize(("closure", "elastic_strain"), CLOSURES_AND_STRAINS)
def test_an_increment_equals_the_same_increment_cut_into_any_pieces(rng, closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    states, gradient = random_states(rng, material, 300, 0.5, excess=(0.8, 1.5))
    whole = material.update(states, gradient)
    for cuts in ([0.5], [0.1, 0.3, 0.31, 0.9], rng.random(30)):
        times = np.concatenate([[0], np.sort(cuts), [1]])
        pieces = states
        for share in np.diff(times):
            pieces = material.update(pieces, share * gradient)
        assert_close(pieces, whole, 1e-12 if elastic_strain == 0 else 1e-8)


def test_the_stress_depends_on_the_direction_of_the_rate_not_on_its_size(rng, material):
    states, gradient = random_states(rng, material, 100, 1e-3)
    small, smaller = material.update(states, gradient * 1e-9), material.update(states, gradient * 2e-9)
    np.testing.assert_allclose(small.stress, smaller.stress, rtol=0, atol=1e-12)
    np.testing.assert_allclose(small.direction, smaller.direction, rtol=0, atol=1e-14)


def test_turning_back_and_forth_a_whole_turn_changes_nothing(rng, material):
    states, gradient = random_states(rng, material, 100, 0.1)
    states = material.update(states, gradient)
    spin = np.zeros((100, 3, 3))
    spin[:, 0, 2], spin[:, 2, 0] = 2 * np.pi, -2 * np.pi
    assert_close(material.update(states, spin), states, 1e-14)


def test_total_volume_of_solid_is_conserved(rng, material):
    states, gradient = random_states(rng, material, 100, 0.5)
    new = material.update(states, gradient)
    volume = np.exp(np.trace(gradient, axis1=1, axis2=2))
    np.testing.assert_allclose(new.volume_fraction * volume, states["volume_fraction"], rtol=1e-15)


def test_basic_n2_full_and_kinematic_differ_in_the_deviator_only(rng):
    states, gradient = random_states(rng, Material(0.5), 50, 0.02)
    pressures = [tensors.trace(Material(0.5, closure).update(states, gradient).stress)
                 for closure in ("basic", "n2", "full", "kinematic")]
    for other in pressures[1:]:
        np.testing.assert_allclose(other, pressures[0], rtol=1e-12, atol=1e-17)


def test_kinematic_equals_full_in_coaxial_shear():
    states = np.zeros(1, STATE)
    states["fabric"] = 0.02 * np.array([0.5, 0.5, -1, 0, 0, 0])
    states["coordination_number"], states["volume_fraction"] = 5.2, 0.61
    gradient = 0.01 * np.diag([0.5, 0.5, -1.0])[None]
    stresses = {closure: Material(0.5, closure).update(states, gradient).stress for closure in ("full", "kinematic")}
    # coaxial with A = a S^ the a4 term is a (1 - S^:S^/2) S^ = 0
    np.testing.assert_allclose(stresses["kinematic"], stresses["full"], rtol=1e-13)


def test_eta_t_of_the_kinematic_closure_is_b1():
    # derivative of the deviator for a direction change transverse to S^ (spec, section 3): -p (b1 + (b2 + a4/2) x)
    for closure, a4 in (("full", None), ("kinematic", "kinematic")):
        material = Material(0.5, closure)
        x, p_scale = 0.06, []
        direction = np.array([0, 0, 0, 0, 1.0, 0])
        turn = 1e-6
        transverse = np.array([1.0, 0, -1, 0, 0, 0])
        shape = direction * np.cos(turn) + transverse * np.sin(turn)
        fabric = 0.5 * x * direction
        states = [material.state(0.6, 5.2, fabric, d) for d in (direction, shape)]
        p_scale = -tensors.trace(states[0].stress) / 3
        slope = -tensors.contract(states[1].stress - states[0].stress, transverse) / 2 / turn / p_scale
        eta_t = material["b1"] + (material["b2"] + material["a4"] / 2) * x
        assert slope == pytest.approx(-eta_t, rel=1e-4)
        if a4:
            assert eta_t == pytest.approx(material["b1"], rel=1e-12)
