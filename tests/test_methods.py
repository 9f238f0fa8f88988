"""The methods beside the exact one: each converges to it with its order, and reports where it fails."""

import numpy as np
import pytest

from granumat import STATE, Material, MaterialError, core, driver, tensors
from granumat.material import CLOSURES, CONTACTS, METHODS, SPINS
from granumat.paths import read_path_file
from support import reference
from support.states import random_states
from test_bad_input import check, spoiled

OTHERS = METHODS[1:]
ORDERS = {"forward-euler": 1, "midpoint": 2, "rk4": 4, "bogacki-shampine": 3, "backward-euler": 1}
ONE_STEP = 0.999             # a tolerance that lets the embedded pair take the whole increment
SHEAR = np.zeros((3, 3))
SHEAR[0, 2] = 1.0
PURE_SHEAR = SHEAR + SHEAR.T         # |D| = 1


def random_start(n, shear, seed=1, **sampling):
    """Random states of a material with mu 0.5 and increments for them."""
    fabric, z2, phi, gradient = reference.random_increments(np.random.default_rng(seed), n, 0.5, shear, **sampling)
    states = np.zeros(n, STATE)
    states["fabric"], states["coordination_number"], states["volume_fraction"] = tensors.to_voigt(fabric), z2, phi
    states["stress"] = -0.1 * states["fabric"]
    return states, gradient


def error(material, exact, states, gradient, steps, over=np.max):
    """Largest (or other) errors of A/kappa, Z2, phi and stress over all points, after an increment in equal steps."""
    expected = exact.update(states, gradient)
    for _ in range(steps):
        states = material.update(states, gradient / steps)
    return np.array([over(np.abs(states.fabric - expected.fabric).max(1)) / material["kappa"],
                     over(np.abs(states.coordination_number - expected.coordination_number)),
                     over(np.abs(states.volume_fraction - expected.volume_fraction)),
                     over(np.abs(states.stress - expected.stress).max(1)) / np.abs(expected.stress).max()])


@pytest.mark.parametrize(("closure", "elastic_strain"), [("basic", 0.0), ("full", 0.05), ("critical", 0.05)])
@pytest.mark.parametrize("method", OTHERS)
def test_every_method_converges_to_the_exact_update_with_its_order(method, closure, elastic_strain):
    # the median: some points pass A = 0, where abs(A) in the pressure has a kink
    states, gradient = random_start(100, 0.05)
    exact = Material(0.5, closure, elastic_strain=elastic_strain)
    material = Material(0.5, closure, elastic_strain=elastic_strain, method=method, method_tolerance=ONE_STEP)
    coarse, fine = (error(material, exact, states, gradient, steps, np.median) for steps in (4, 8))
    visible = fine > 1e-12
    assert visible[-1]
    np.testing.assert_allclose(np.log2(coarse[visible] / fine[visible]), ORDERS[method], atol=0.3)
    assert fine.max() < {1: 2e-2, 2: 1e-3, 3: 1e-4, 4: 1e-5}[ORDERS[method]]


def test_the_embedded_pair_errs_by_less_than_its_tolerance_and_in_proportion():
    states, gradient = random_start(100, 0.2)
    tolerances = np.array([1e-5, 1e-6, 1e-7, 1e-8])
    materials = [Material(0.5, method="bogacki-shampine", method_tolerance=tolerance) for tolerance in tolerances]
    worst = np.array([error(material, Material(0.5), states, gradient, 1).max() for material in materials])
    assert (worst < 30 * tolerances).all()
    np.testing.assert_allclose(np.log10(worst[:-1] / worst[1:]), 1, atol=0.35)


def test_the_embedded_pair_cuts_what_the_others_cannot_take():
    # reversal of steady shear by gamma = 1 in one increment
    states = np.array([Material(0.5).steady(0.6)])
    errors = {method: error(Material(0.5, method=method), Material(0.5), states, -0.4 * PURE_SHEAR[None], 1)[0]
              for method in ("bogacki-shampine", "backward-euler")}
    assert errors["bogacki-shampine"] < 1e-4 < 1e-2 < errors["backward-euler"]
    for method in ("forward-euler", "midpoint", "rk4"):
        with pytest.raises(MaterialError):
            Material(0.5, method=method).update(states, -0.4 * PURE_SHEAR[None])


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_rotating_first_is_first_order(method):
    states, gradient = random_start(100, 0.05)
    coarse, fine = (error(Material(0.5, method=method, spin="before"), Material(0.5), states, gradient, steps)[0]
                    for steps in (4, 8))
    assert np.log2(coarse / fine) == pytest.approx(1, abs=0.1)


def test_rotating_first_errs_by_5_percent_at_shear_increments_of_an_eighth():
    material, before = Material(0.5), Material(0.5, spin="before")
    state = turned_first = material.steady(0.6)
    for _ in range(16):
        state, turned_first = material.update(state, SHEAR / 8), before.update(turned_first, SHEAR / 8)
    assert tensors.magnitude(turned_first.fabric - state.fabric) / tensors.magnitude(state.fabric) == pytest.approx(5e-2, rel=0.15)


@pytest.mark.parametrize("method", METHODS)
def test_without_spin_its_place_does_not_matter_and_pure_spin_turns_everything(method):
    inside, before = (Material(0.5, method=method, spin=spin, elastic_strain=0.01) for spin in SPINS)
    states, gradient = random_start(20, 0.02, spin=0.0)
    np.testing.assert_allclose(before.update(states, gradient).stress, inside.update(states, gradient).stress, atol=1e-15)
    spin = np.array([SHEAR - SHEAR.T] * 20)
    expected = Material(0.5).update(states, spin)
    for material in (inside, before):
        assert material.update(states, spin).tobytes() == expected.tobytes()


@pytest.mark.parametrize("spin", SPINS)
@pytest.mark.parametrize("elastic_strain", [0.0, 0.02])
@pytest.mark.parametrize("method", METHODS)
def test_batch_equals_single_points_bit_for_bit(rng, method, elastic_strain, spin):
    material = Material(0.5, elastic_strain=elastic_strain, method=method, spin=spin)
    states, gradient = random_states(rng, material, 67, 0.1)
    batch = material.update(states, gradient)
    for i in range(67):
        assert material.update(states[i], gradient[i]).tobytes() == batch[i].tobytes()


@pytest.mark.parametrize("method", METHODS)
def test_blow_up_is_reported_at_every_increment_and_the_old_state_kept(method):
    material = Material(0.5, method=method)
    state = np.zeros(1, STATE)                                    # abs(A) = 0.07: gone at gamma = 0.22 (spec, section 3)
    state["fabric"][0, 4], state["coordination_number"], state["volume_fraction"] = 0.07, 5.0, 0.6
    for gamma in np.geomspace(0.23, 50, 200):
        with pytest.raises(MaterialError) as caught:
            material.update(state, gamma * SHEAR[None])
        assert caught.value.states.tobytes() == state.tobytes()
        assert caught.value.status[0] in (5, 6, 8, 10)


@pytest.mark.parametrize("method", METHODS)
def test_blow_up_is_reported_in_small_steps(method):
    material = Material(0.5, method=method)
    state = np.zeros(1, STATE)
    state["fabric"][0, 4], state["coordination_number"], state["volume_fraction"] = 0.07, 5.0, 0.6
    with pytest.raises(MaterialError, match="blows up"):
        for _ in range(45):
            state = material.update(state, 0.005 * SHEAR[None])


@pytest.mark.parametrize("method", OTHERS)
def test_what_blows_up_without_spin_is_never_returned(rng, method):
    n = 2000
    states, gradient = random_states(rng, Material(0.5), n, 1.0)
    gradient = (gradient + np.swapaxes(gradient, 1, 2)) / 2
    states["fabric"] *= (rng.uniform(0.055, 0.15, n) / tensors.magnitude(states["fabric"]))[:, None]
    with pytest.raises(MaterialError) as caught:
        Material(0.5).update(states, gradient)
    gone = caught.value.status == 6
    assert gone.sum() > 10
    with pytest.raises(MaterialError) as caught:
        Material(0.5, method=method).update(states[gone], gradient[gone])
    assert (caught.value.status != 0).all()
    assert caught.value.states.tobytes() == states[gone].tobytes()


@pytest.mark.parametrize("method", OTHERS)
def test_no_method_returns_a_fabric_that_can_blow_up(rng, method):
    material = Material(0.5, method=method)
    states, gradient = random_states(rng, material, 2000, 1.0)
    try:
        new = material.update(states, 10.0 ** rng.uniform(-2, 1, (2000, 1, 1)) * gradient)
    except MaterialError as failure:
        new = failure.states
    assert tensors.magnitude(new.fabric).max() < material["fabric_limit"]


@pytest.mark.parametrize("spin", range(2))
@pytest.mark.parametrize("method", range(6))
def test_500_random_property_sets_states_and_increments_never_give_nan(rng, method, spin):
    steady = np.array([Material(0.5).steady(0.6)]).view(float).reshape(1, 20)
    done = 0
    for _ in range(500):
        par = core.parameters_from_friction(rng.random(), *(int(k) for k in rng.integers(0, (len(CLOSURES), len(CONTACTS), 3))))
        scheme = method, spin, 10.0 ** rng.uniform(-8, -0.01)
        level = rng.choice([0.0, 0.03, 0.2])
        par[:20] = spoiled(rng, par[:20], level)
        core.complete_parameters(par)
        gradient = spoiled(rng, rng.normal(size=(1, 3, 3)) * 10.0 ** rng.uniform(-6, 0), rng.choice([0.0, 0.05, 0.3]))
        done += check(par, spoiled(rng, steady, level), gradient, scheme) == 0
    assert done > 50


def test_unknown_methods_are_refused_by_name_all_at_once_and_by_the_core():
    with pytest.raises(ValueError) as caught:
        Material(method="rk5", spin="after", method_tolerance=0)
    for words in ("method 'rk5'", "did you mean 'rk4'", "spin 'after'", "method_tolerance = 0: must be a number in (0, 1)"):
        assert words in str(caught.value)
    for wrong in ((6, 0, 1e-6), (-1, 0, 1e-6), (0, 2, 1e-6), (0, 0, np.nan), (0, 0, 1.0)):
        steady = np.array([Material().steady(0.6)]).view(float).reshape(1, 20)
        assert check(np.array(Material().parameters), steady, 0.01 * SHEAR[None], wrong) == 2


def test_a_path_file_names_its_method(tmp_path):
    (tmp_path / "path.toml").write_text("""[material]\nmethod = "rk4"\nspin = "before"
        [initial]\nstate = "steady"\nphi = 0.6\n[[step]]\nshear = 1.0\n""")
    material = read_path_file(tmp_path / "path.toml").material
    assert (material.method, material.spin) == ("rk4", "before")
    assert material.steady(0.6).tobytes() == Material().steady(0.6).tobytes()


@pytest.mark.parametrize("spin", SPINS)
@pytest.mark.parametrize("method", METHODS)
def test_every_method_follows_a_path_with_stresses_held(method, spin):
    step = driver.shear(-0.5, "pressure", increments=50)
    material, exact = Material(method=method, spin=spin, elastic_strain=0.01), Material(elastic_strain=0.01)
    found, expected = (driver.run(each, each.steady(0.6), [step]) for each in (material, exact))
    np.testing.assert_allclose(found["p"], found["p"][0], rtol=1e-8)
    np.testing.assert_allclose(found["phi"], expected["phi"], atol=3e-5)
    np.testing.assert_allclose(found["stress_ratio"], expected["stress_ratio"], atol=3e-3)
