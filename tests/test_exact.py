"""The update is exact: against an adaptive 8th-order solution of the paper's rate equations (support/reference.py)."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from granumat import STATE, Material, tensors
from support import reference

MUS = (0.0, 0.1, 0.3, 0.5, 1.0)
STIFF = pytest.param(1e-4, marks=[pytest.mark.slow, pytest.mark.release_only])       # for SciPy


def errors_of(c, fabric, z2, phi, gradient, deviator, closure="full", contact="hookean", **constants):
    """Largest errors of A/kappa, Z2, phi (relative) and stress (over the larger of p and the deviator) of updates."""
    rtol = 1e-11 if 0 < c["elastic_strain"] <= 1e-3 else 1e-13       # stiff: stability asks for steps that err by far less
    a, z, ph, p, dev = reference.integrate(c, fabric, z2, phi, gradient, deviator, contact, rtol)
    material = Material(c["mu"], closure, contact, elastic_strain=c["elastic_strain"], **constants)
    old = np.zeros(len(z2), STATE)
    old["fabric"], old["coordination_number"], old["volume_fraction"] = tensors.to_voigt(fabric), z2, phi
    old["stress"] = -tensors.to_voigt(deviator)
    new = material.update(old, gradient)
    sigma = tensors.to_voigt(dev + reference.scale(p, np.eye(3)))
    jammed = p > 1e-3 * material["a1"]
    return np.array([
        np.abs(new.fabric - tensors.to_voigt(a)).max() / material["kappa"],
        np.abs(new.coordination_number / z - 1).max(),
        np.abs(new.volume_fraction / ph - 1).max(),
        (np.abs(new.stress + sigma).max(1)[jammed] / np.abs(sigma).max(1)[jammed]).max(),
    ])


def errors(seed, n, shear, closure="full", contact="hookean", elastic_strain=0.0, across=False, isotropic=False,
           margin=0.005, mus=MUS, **sampling):
    """Largest errors, as above by name, of n random updates."""
    rng = np.random.default_rng(seed)
    worst = np.zeros(4)
    for mu in mus:
        m = n // len(mus)
        c = reference.constants(mu, closure) | {"mu": mu, "elastic_strain": elastic_strain}
        fabric, z2, phi, gradient = reference.random_increments(rng, m, mu, shear, margin=margin, **sampling)
        if across:                                   # phi starts within the increment's volume strain of phic, on either side
            volume_strain = rng.choice([-1, 1], m) * 0.5 * reference.parts(gradient)[4]
            gradient = gradient + reference.scale((volume_strain - np.trace(gradient, axis1=1, axis2=2)) / 3, np.eye(3))
            phi = c["phic"] * np.exp(rng.random(m) * volume_strain)
        deviator = reference.scale(1e-3 * rng.random(m), fabric / 0.04)
        if isotropic:
            fabric = np.zeros_like(fabric)
        worst = np.maximum(worst, errors_of(c, fabric, z2, phi, gradient, deviator, closure, contact))
    return dict(zip(("A", "Z2", "phi", "stress"), worst))


def mus_for(elastic_strain):
    """SciPy takes seconds for each of them where it is stiff, however many the points are."""
    return MUS if elastic_strain > 1e-4 else MUS[1::2]


def test_error_is_below_1e_12_for_shear_up_to_0_02_in_one_update():
    assert max(errors(1, 1000, 0.02).values()) < 1e-12


def test_error_is_below_1e_10_for_shear_up_to_1():
    assert max(errors(2, 1000, 1.0).values()) < 1e-10


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
@pytest.mark.parametrize("closure", ["basic", "n2", "full", "kinematic"])
def test_every_closure_and_contact_is_exact(closure, contact):
    assert max(errors(3, 100, 0.02, closure, contact).values()) < 1e-12


@pytest.mark.parametrize("shear", [0.02, 0.2, 1.0])
def test_error_stays_below_1e_10_across_phic(shear):
    assert max(errors(4, 500, shear, across=True).values()) < 1e-10


@pytest.mark.parametrize("shear", [0.002, 0.02, 0.1])
@pytest.mark.parametrize("elastic_strain", [1e-1, 1e-2, 1e-3, STIFF])
def test_error_stays_below_1e_8_with_an_elastic_strain(elastic_strain, shear):
    worst = errors(5, 100, shear, elastic_strain=elastic_strain, mus=mus_for(elastic_strain))
    assert worst.pop("stress") < 1e-8
    assert max(worst.values()) < 1e-12


def test_error_stays_below_1e_8_with_an_elastic_strain_across_phic():
    assert max(errors(6, 250, 0.1, elastic_strain=1e-2, across=True).values()) < 1e-8


@pytest.mark.parametrize("shear", [0.016, 0.024])
def test_error_stays_below_1e_10_with_an_elastic_strain_away_from_kinks(shear):
    """Dense, anisotropic, well jammed and below phic: substeps are as large as they get, their relaxation errs the most."""
    c = reference.constants(0.5) | {"mu": 0.5, "elastic_strain": shear / 20}
    fabric, z2, _, gradient = reference.random_increments(np.random.default_rng(1), 40, 0.5, shear, 0.0, 0.0, excess=(1.0, 1.2))
    fabric, gradient = (reference.scale(size / reference.parts(x)[4], x) for size, x in ((0.042, fabric), (shear / 2, gradient)))
    phi = np.full(40, c["phic"] - 0.02)
    assert errors_of(c, fabric, z2, phi, gradient, np.zeros((40, 3, 3))).max() < 1e-10


def test_large_volume_strain_is_exact_where_fabric_and_coordination_number_are_slow():
    """With the paper's constants these limit the substeps; where they do not, the volume strain must."""
    slow = {"c1": -1e-4, "c2": -1e-3, "c3": 0.1, "d2": 0.1}
    c = reference.constants(0.5) | slow | {"mu": 0.5}
    _, z2, _, gradient = reference.random_increments(np.random.default_rng(3), 20, 0.5, 4e-4, 0.0, 0.0)
    gradient, none = gradient - 0.5 / 3 * np.eye(3), np.zeros((20, 3, 3))
    assert errors_of(c, none, z2, np.full(20, 0.585), gradient, none, **slow).max() < 1e-12


def test_large_spin_is_exact():
    assert max(errors(7, 250, 0.1, spin=100.0).values()) < 1e-11


def test_unjamming_within_the_increment_is_exact():
    assert max(errors(8, 250, 0.5, excess=(-0.5, 0.5)).values()) < 1e-10


def test_quadratic_friction_and_isotropic_term_follow_the_reference():
    rng = np.random.default_rng(9)
    c = reference.constants(0.5) | {"b1": 0.2, "b2": -2.0, "b3": 3.0, "g": 1e-3}
    fabric, z2, phi, gradient = reference.random_increments(rng, 100, 0.5, 0.05)
    _, _, _, p, dev = reference.integrate(c, fabric, z2, phi, gradient)
    old = np.zeros(100, STATE)
    old["fabric"], old["coordination_number"], old["volume_fraction"] = tensors.to_voigt(fabric), z2, phi
    new = Material(0.5, friction="quadratic", b1=0.2, b2=-2.0, b3=3.0, g=1e-3).update(old, gradient)
    np.testing.assert_allclose(-new.stress, tensors.to_voigt(dev + reference.scale(p, np.eye(3))), atol=1e-14)


def test_a_stress_that_does_not_relax_turns_with_the_spin():
    rng = np.random.default_rng(10)
    material = Material(elastic_strain=1.0)
    old = np.zeros(100, STATE)
    old["fabric"] = material.steady(0.60).fabric
    old["coordination_number"], old["volume_fraction"] = material["Zc"] - 1, 0.55       # without pressure, in a strain of round-off
    spin = rng.normal(size=(100, 3, 3))
    spin = spin - np.swapaxes(spin, 1, 2)
    spin *= rng.uniform(0, 1, (100, 1, 1)) / np.sqrt((spin**2).sum((1, 2), keepdims=True) / 2)
    stress = rng.normal(size=(100, 3, 3))
    stress = stress + np.swapaxes(stress, 1, 2)
    stress -= np.trace(stress, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
    old["stress"] = tensors.to_voigt(stress)
    turn = np.array([expm(w) for w in spin])
    new = material.update(old, spin + 1e-16 * np.diag([1, -1, 0]))
    np.testing.assert_allclose(new.stress, tensors.to_voigt(turn @ stress @ np.swapaxes(turn, 1, 2)), rtol=0, atol=1e-14)


@pytest.mark.parametrize("shear", [1e-3, 0.02, 0.1])
@pytest.mark.parametrize("elastic_strain", [1e-2, 1e-3, STIFF])
def test_error_stays_below_1e_8_from_an_isotropic_packing(elastic_strain, shear):
    assert max(errors(8, 100, shear, elastic_strain=elastic_strain, isotropic=True, mus=mus_for(elastic_strain)).values()) < 1e-8


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
@pytest.mark.parametrize("elastic_strain", [0.0, 1e-1, 1e-2])
@pytest.mark.parametrize(("shear", "spin"), [(1e-3, 1.0), (0.02, 1.0), (0.5, 1.0), (0.02, 30.0)])
def test_the_critical_closure_is_exact(contact, elastic_strain, shear, spin):
    c = reference.constants(0.5, "n2") | {"elastic_strain": elastic_strain}
    rng = np.random.default_rng(11)
    fabric, z2, phi, gradient = reference.random_increments(rng, 60, 0.5, shear, spin=spin)
    deviator = reference.scale(2e-3 * rng.random(60), fabric / 0.04)
    direction, p, dev = reference.integrate_critical(c, phi, gradient, deviator, contact)
    old = np.zeros(60, STATE)
    old["fabric"], old["coordination_number"], old["volume_fraction"] = tensors.to_voigt(fabric), z2, phi
    old["stress"] = -tensors.to_voigt(deviator)
    material = Material(0.5, "critical", contact, elastic_strain=elastic_strain)
    new = material.update(old, gradient)
    sigma = tensors.to_voigt(dev + reference.scale(p, np.eye(3)))
    limit = 1e-9 if contact == "hertzian" and elastic_strain > 0 and shear > 0.1 else 5e-12             # phi nears phic
    assert (np.abs(new.stress + sigma).max(1) / np.abs(sigma).max(1)).max() < limit
    np.testing.assert_allclose(new.fabric, tensors.to_voigt(direction), rtol=0, atol=1e-14)


def test_without_elastic_strain_any_increment_of_the_critical_closure_is_one_step():
    material = Material(0.5, "critical")
    state = np.array([material.steady(0.60)])
    gradient = np.array([[[0.1, 0, 1e6], [0, 0, 0], [0, 0, -0.1]]])
    whole, twice = material.update(state, gradient), material.update(material.update(state, gradient / 2), gradient / 2)
    np.testing.assert_allclose(whole["stress"], twice["stress"], rtol=1e-12)
    assert np.isfinite(material.update_with_tangent(state, gradient)[1]).all()


def scaled_to_degree(degree, factor, c, fabric, z2, phi, gradient):
    """Gradients scaled to `factor` times the size up to which the degree is enough: docs/theory.md, 5.2, 5.3, 5.5."""
    _, w, _, mod_d, _, tr = reference.parts(gradient)
    size, excess = reference.magnitude(fabric), np.abs(z2 - c["Zc"])
    chi = -(c["c2"] + np.sqrt(c["c2"]**2 - 8 * c["c1"] * c["c3"])) / (2 * c["c3"])
    smooth = (-c["c2"] + np.sqrt(-2 * c["c1"] * c["c3"]) + 2 * (c["c3"] * size + c["d2"])) * mod_d \
        + 2 * reference.magnitude(w)
    jamming = (-c["d1"] * (2 * size - chi) + c["d2"] * excess) * mod_d + np.abs(c["d3"] * tr)
    rate = np.max([1.5 * smooth, 0.8 * jamming / excess, -1.6 * c["c1"] * mod_d / size,
                   np.where(phi > c["phic"], 1.6 * np.abs(tr / np.log(phi / c["phic"])), 0)], axis=0)
    ratio = mod_d / c["elastic_strain"]
    bound = ratio * rate**2 / 6 if degree == 1 else ratio * rate**3 * (ratio + rate) / 120
    return reference.scale(factor * (1e-12 / bound) ** (1 / (2 * degree + 1)), gradient)


@pytest.mark.parametrize("contact", ["hookean", pytest.param("hertzian", marks=pytest.mark.release_only)])
@pytest.mark.parametrize("closure", ["basic", "n2", "full", "kinematic"])
@pytest.mark.parametrize("degree", [1, 2])
def test_error_stays_below_1e_12_around_the_increments_from_which_a_higher_degree_is_taken(degree, closure, contact):
    rng = np.random.default_rng(12)
    for elastic_strain, margin, spin, factor in itertools.product((0.1, 0.003), (1e-4, 0.005), (1.0, 30.0), (0.99, 2.0, 4.0)):
        c = reference.constants(0.5, closure) | {"mu": 0.5, "elastic_strain": elastic_strain}
        fabric, z2, phi, gradient = reference.random_increments(rng, 20, 0.5, 1e-4, spin=spin, margin=margin, volume=2.0)
        fabric = reference.scale(rng.uniform(0.001, 0.044, 20) / reference.magnitude(fabric), fabric)
        phi[::3] = c["phic"] - 0.01
        gradient = scaled_to_degree(degree, factor, c, fabric, z2, phi, gradient)
        deviator = reference.scale(1e-3 * rng.random(20), fabric / 0.04)
        found = errors_of(c, fabric, z2, phi, gradient, deviator, closure, contact)
        assert found.max() < 1e-12, (elastic_strain, margin, spin, factor, found)
