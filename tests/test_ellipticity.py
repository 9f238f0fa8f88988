"""The transverse modulus and the acoustic tensor, against finite differences of the law itself and closed forms."""

import numpy as np
import pytest

from granumat import STATE, Material, driver, tensors
from support.states import random_rotations, rotated

CLOSURES = ("critical", "basic", "n2", "full", "kinematic")
QUADRATIC = {"friction": "quadratic", "b1": 0.12, "b2": -2.0, "b3": 15.0}
MODES = np.array([tensors.to_voigt(np.eye(3)[:, [i]] * np.eye(3)[j] + np.eye(3)[:, [j]] * np.eye(3)[i]) / 2
                  for i, j in zip(tensors.ROWS, tensors.COLUMNS)])           # unit engineering strains


def random_states(rng, material, n, volume=0.2):
    """Jammed states with random fabric and direction; their stress is the model's in another direction, so still relaxing."""
    states = np.zeros(n, STATE)
    states["fabric"] = 0.044 * rng.random((n, 1)) * directions(rng, n, 0)
    states["coordination_number"] = material["Zc"] + rng.uniform(0.3, 1.5, n)
    states["volume_fraction"] = material["phic"] + rng.uniform(0.005, 0.04, n)
    states["direction"] = directions(rng, n, 0)
    states["stress"] = material.evaluate(states)[0]
    states["direction"] = directions(rng, n, volume)
    if material.closure == "critical":
        states["fabric"] = material["lambda"] * tensors.deviator(states["direction"])
        states["coordination_number"] = material["Zc"] + 7.5 * np.sqrt(states["volume_fraction"] - material["phic"])
    return states


def directions(rng, n, volume):
    x = tensors.deviator(rng.normal(size=(n, 6)))
    return unit(unit(x) + volume * rng.normal(size=(n, 1)) * tensors.IDENTITY)


def unit(x):
    return x / tensors.magnitude(x)[..., None]


def pressure(material, states):
    return -tensors.trace(material.evaluate(states)[0]) / 3


def turned(states, change):
    """The states with their direction changed, to first order."""
    new = states.copy()
    new["direction"] = unit(states["direction"] + change)
    return new


def acoustic_tensor(material, states, normals):
    """Q (n, 3, 3) by its definition, between vectors normal to n (n, 2, 2) for e_r = 0."""
    at = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
    c = material.response(states)[:, at][:, :, :, at]
    q = np.einsum("nj,nijkl,nl->nik", normals, c, normals)
    if material["elastic_strain"] == 0:
        basis = np.linalg.svd(normals[:, None, :])[2][:, 1:]
        return basis @ q @ np.swapaxes(basis, 1, 2)
    dev = tensors.to_matrix(tensors.deviator(states["stress"]) / pressure(material, states)[:, None])
    traction = np.einsum("nij,nj->ni", dev, normals)
    outer = traction[:, :, None] * normals[:, None, :]
    along = np.einsum("ni,ni->n", traction, normals)[:, None, None] * np.eye(3)
    return q + (along - dev + outer - np.swapaxes(outer, 1, 2)) / 2


def measures(material, states, normals):
    q = acoustic_tensor(material, states, normals)
    return np.linalg.eigvalsh((q + np.swapaxes(q, 1, 2)) / 2)[:, 0], np.linalg.det(q)


# ---- the transverse modulus ------------------------------------------------------------------------------------------

@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("friction", [{}, QUADRATIC])
def test_eta_t_is_the_stress_change_under_a_transverse_change_of_direction(rng, closure, friction):
    a3 = {} if closure == "basic" else {"a3": 0.0}
    material = Material(0.5, closure, **a3, **friction)
    states = random_states(rng, material, 50, volume=0.0)
    change = directions(rng, 50, 0)
    s_hat = states["direction"]
    change -= (tensors.contract(change, s_hat) / 2)[:, None] * s_hat
    step = 1e-5
    plus, minus = (material.evaluate(turned(states, sign * step * change))[0] for sign in (1, -1))
    found = tensors.contract(change, (plus - minus) / (2 * step)) / tensors.contract(change, change)
    np.testing.assert_allclose(found / pressure(material, states), material.transverse_modulus(states), atol=1e-8)


@pytest.mark.parametrize("mu, closure, expected", [(0.5, "basic", -0.10), (0.5, "full", 0.07), (0.1, "full", -0.06)])
def test_eta_t_just_after_a_reversal(mu, closure, expected):
    material = Material(mu, closure)
    history = driver.run(material, material.steady(material["phic"] + 0.013), [driver.shear(-1e-9, increments=1)])
    assert history["eta_t"][-1] == pytest.approx(expected, abs=0.007)
    x = tensors.contract(history.states["fabric"], tensors.deviator(history.states["direction"]))
    np.testing.assert_allclose(history["eta_t"], material["b1"] + (material["b2"] + material["a4"] / 2) * x, rtol=1e-13)


@pytest.mark.parametrize("mu", [0.0, 0.5, *(pytest.param(mu, marks=pytest.mark.release_only) for mu in (0.1, 1.0))])
def test_kinematic_has_eta_t_b1_on_every_path_and_without_a3_no_negative_eigenvalue(rng, mu):
    material = Material(mu, "kinematic", a3=0.0)
    states = np.array([material.isotropic(0.65, coordination_number=6.0)] * 100)
    for _ in range(30):
        gradient = 0.05 * rng.normal(size=(100, 3, 3))
        gradient[:50, 1] = gradient[:50, :, 1] = 0                        # half of them in plane strain
        states = material.update(states, gradient - np.trace(gradient, axis1=1, axis2=2)[:, None, None] / 2 * np.diag([1, 0, 1]))
        found = material.ellipticity(states)
        np.testing.assert_allclose(found.eta_t, material["b1"], atol=1e-15)
        assert found.eigenvalue.min() > -1e-14
        np.testing.assert_allclose(found.eigenvalue[:50], 0, atol=1e-14)
        assert mu == 0 or found.eigenvalue[50:].max() > 0


# ---- the response ----------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("options", [{}, {"contact": "hertzian"}, QUADRATIC, {"g": 0.001}, {"g": 0.001, "contact": "hertzian"}])
def test_response_without_elastic_strain_is_the_derivative_of_the_stress(rng, closure, options):
    material = Material(0.5, closure, **options)
    states = random_states(rng, material, 20)
    found, step = material.response(states), 1e-5
    p = pressure(material, states)[:, None]
    for k, mode in enumerate(MODES):
        plus, minus = (material.evaluate(turned(states, sign * step * mode))[0] for sign in (1, -1))
        np.testing.assert_allclose(found[:, :, k], (plus - minus) / (2 * step * p), atol=1e-8)
    doubled = states["direction"] * [1, 1, 1, 2, 2, 2]
    np.testing.assert_allclose(np.einsum("nik,nk->ni", found, doubled), 0, atol=1e-14)                  # C : D = 0


def stress_rate(material, states, gradients, dt):
    """d sigma/dt at the states, by extrapolated differences of updates."""
    rates = [(material.update(states, share * dt * gradients)["stress"] - states["stress"]) / (share * dt) for share in (1, 0.5)]
    return 2 * rates[1] - rates[0]


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("options", [{}, {"contact": "hertzian"}])
def test_response_with_elastic_strain_is_the_derivative_of_the_rate_that_updates_follow(rng, closure, options):
    material = Material(0.5, closure, elastic_strain=0.01, **options)
    states = random_states(rng, material, 20)
    p = pressure(material, states)[:, None]
    states["stress"] = tensors.deviator(states["stress"]) - p * tensors.IDENTITY
    flow = tensors.to_matrix(states["direction"])
    found, step = material.response(states), 1e-2
    for k, mode in enumerate(tensors.to_matrix(MODES)):
        plus, minus = (stress_rate(material, states, flow + sign * step * mode, 1e-6) for sign in (1, -1))
        np.testing.assert_allclose(found[:, :, k], (plus - minus) / (2 * step * p), atol=3e-3 * np.abs(found).max())
    doubled = states["direction"] * [1, 1, 1, 2, 2, 2]
    rate = np.einsum("nik,nk->ni", found, doubled) * p                                                  # degree 1: C : D
    model = material.evaluate(states)[0]
    np.testing.assert_allclose(tensors.deviator(rate), tensors.deviator(model - states["stress"]) / 0.01, atol=1e-12)


# ---- the acoustic tensor ---------------------------------------------------------------------------------------------

@pytest.mark.parametrize("closure", CLOSURES)
def test_acoustic_tensor_with_spin_is_the_traction_rate_that_updates_give(rng, closure):
    material = Material(0.5, closure, elastic_strain=0.05)
    states = random_states(rng, material, 20)
    p = pressure(material, states)[:, None]
    states["stress"] = tensors.deviator(states["stress"]) - p * tensors.IDENTITY
    n = rng.normal(size=(20, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    flow, step = tensors.to_matrix(states["direction"]), 1e-3
    q = acoustic_tensor(material, states, n)
    for k in range(3):
        change = np.eye(3)[k][:, None] * n[:, None, :]
        plus, minus = (stress_rate(material, states, flow + sign * step * change, 1e-6) for sign in (1, -1))
        traction = np.einsum("nij,nj->ni", tensors.to_matrix((plus - minus) / (2 * step * p)), n)
        np.testing.assert_allclose(q[:, :, k], traction, atol=1e-4 * np.abs(q).max())


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01, pytest.param(0.001, marks=pytest.mark.release_only)])
@pytest.mark.parametrize("closure", CLOSURES)
def test_nothing_is_below_what_is_found_and_it_is_where_it_is_said_to_be(rng, closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    states = random_states(rng, material, 40)
    found = material.ellipticity(states)
    assert np.abs(np.linalg.norm(found.normal, axis=1) - 1).max() < 1e-14
    for i, (least, normal) in enumerate(((found.eigenvalue, found.normal), (found.determinant, found.determinant_normal))):
        scale = np.maximum(np.abs(least), 1e-3)
        np.testing.assert_allclose(measures(material, states, normal)[i] / scale, least / scale, atol=1e-9)
        for _ in range(500):
            n = rng.normal(size=(40, 3))
            assert ((measures(material, states, n / np.linalg.norm(n, axis=1)[:, None])[i] - least) / scale > -1e-9).all()


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
@pytest.mark.parametrize("closure", CLOSURES)
def test_what_is_found_does_not_depend_on_the_axes(rng, closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    states = random_states(rng, material, 400)
    one, other = material.ellipticity(states), material.ellipticity(rotated(random_rotations(rng, 400), states))
    np.testing.assert_allclose(other.eta_t, one.eta_t, rtol=1e-12)
    np.testing.assert_allclose(other.eigenvalue, one.eigenvalue, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(other.determinant, one.determinant, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("b1", [0.3, -0.2])
def test_constant_friction_has_the_eigenvalue_of_the_largest_shear(rng, b1):
    # C:E = b1 (E - D^ (D^:E)/2), and v n has D^:(v n) up to half the difference of the principal rates
    material = Material(0.5, "basic", b1=b1, b2=0.0)
    states = random_states(rng, material, 100, volume=0.0)
    found = material.ellipticity(states)
    principal = np.linalg.eigvalsh(tensors.to_matrix(states["direction"]))
    shear = (principal[:, 2] - principal[:, 0]) / 2
    np.testing.assert_allclose(found.eta_t, b1, rtol=1e-14)
    if b1 > 0:
        np.testing.assert_allclose(found.eigenvalue, b1 / 2 * (1 - shear**2), atol=1e-12)
        along = np.einsum("ni,nij,nj->n", found.normal, tensors.to_matrix(states["direction"]), found.normal)
        np.testing.assert_allclose(along, (principal[:, 2] + principal[:, 0]) / 2, atol=1e-5)
    else:
        np.testing.assert_allclose(found.eigenvalue, b1 / 2, rtol=1e-12)
    np.testing.assert_allclose(found.determinant, (b1 / 2)**2 * (1 - shear**2), atol=1e-12)


@pytest.mark.parametrize("closure, calibration", [
    ("basic", "table-1"), ("full", "table-1"), ("full", "text"), ("kinematic", "table-1")])
def test_coaxial_plane_shear_loses_ellipticity_where_eta_t_is_negative(closure, calibration):
    # C:E = eta_t (E - S^ (S^:E)/2) where A is along S^ and a3 = 0: the characteristics have 0, the diagonals eta_t/2
    a3 = {} if closure == "basic" else {"a3": 0.0}
    material = Material(0.5, closure, calibration=calibration, **a3)
    strain = np.array([1.0, 0, -1, 0, 0, 0])
    states = np.array([material.state(0.6, 5.2, x / 2 * strain, strain) for x in np.linspace(-0.088, 0.088, 45)])
    found = material.ellipticity(states)
    assert (found.eta_t < 0).any() == (closure == "basic")
    np.testing.assert_allclose(found.eigenvalue, np.minimum(found.eta_t / 2, 0), atol=1e-14)


def test_a3_lowers_the_modulus_out_of_plane():
    # v along y, n at an angle in the plane: (eta_t - a3 (A_yy + A_nn))/2
    material = Material(0.5, "n2")
    strain, fabric = np.array([1.0, 0, -1, 0, 0, 0]), np.array([0.04, 0, -0.04, 0, 0, 0])
    found = material.ellipticity(np.array([material.state(0.6, 5.2, fabric, strain)]))
    assert found.eigenvalue[0] == pytest.approx((found.eta_t[0] - 0.04 * abs(material["a3"])) / 2, rel=1e-9)


def test_undefined_states_have_no_eigenvalue():
    material = Material(0.5)
    found = material.ellipticity(np.array([material.isotropic(0.6, coordination_number=5.0)]))
    assert np.isnan(found.eigenvalue).all() and np.isnan(found.normal).all() and found.eta_t[0] == material["b1"]
    unjammed = Material(0.5).steady(0.55)
    assert np.isnan(Material(0.5, elastic_strain=0.01).ellipticity(unjammed).eigenvalue)
    assert np.isfinite(material.ellipticity(unjammed).eigenvalue)                                       # in p, which cancels
    with pytest.raises(ValueError, match="threads = 0"):
        material.ellipticity(unjammed, threads=0)


def test_threads_and_neighbours_do_not_change_a_point(rng):
    material = Material(0.5, elastic_strain=0.01)
    states = random_states(rng, material, 21)
    together, shared = material.ellipticity(states), material.ellipticity(states, threads=2)
    alone = material.ellipticity(states[13:14])
    for one, other, single in zip(together, shared, alone):
        assert (one == other).all() and (one[13] == single[0]).all()


def test_driver_gives_the_acoustic_column_when_asked(tmp_path):
    from granumat.paths import read_path_file
    text = '[initial]\nphi = 0.6\nstate = "steady"\n[[step]]\nshear = -0.1\nincrements = 10\n'
    (tmp_path / "path.toml").write_text(text + "[output]\nacoustic = true\n")
    path = read_path_file(tmp_path / "path.toml")
    history = driver.run(path.material, path.state, path.steps, tmp_path, acoustic=path.acoustic)
    header = (tmp_path / "history.csv").read_text().splitlines()[0]
    assert header == ",".join((*driver.COLUMNS, "acoustic"))
    np.testing.assert_array_equal(history["acoustic"], path.material.ellipticity(history.states).eigenvalue)
    assert "acoustic" not in driver.run(path.material, path.state, path.steps).columns
    (tmp_path / "path.toml").write_text(text + "[output]\nacoustic = 1\nfolder = 2\n")
    with pytest.raises(ValueError, match=r"(?s)unknown key 'folder'.*acoustic = 1: must be true or false"):
        read_path_file(tmp_path / "path.toml")
