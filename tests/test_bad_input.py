"""Whatever comes in, what goes out is finite and admissible, or a status with its message and the old state."""

import numpy as np
import pytest

from granumat import Material, core
from granumat.core import status_message
from granumat.material import RANGES
from granumat.tensors import to_matrix, trace

WILD = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-200, 1e-16, 1e16, 1e200, -1e200, 1.7e308, -1.7e308,
                 1.0, -1.0, 0.5, 2.0, 100.0])


def spoiled(rng, values, probability):
    """A copy some entries of which are wild, or off by a random factor."""
    values = np.array(values, float)
    hit = rng.random(values.shape) < probability
    values[hit] = np.where(rng.random(hit.sum()) < 0.5, rng.choice(WILD, hit.sum()),
                           values[hit] * rng.normal(size=hit.sum()) * 10.0 ** rng.integers(-3, 4, hit.sum()))
    return values


def check(par, old, gradient, scheme=None):
    """One update through the core, if given by a scheme of integration; returns its status."""
    new, status = np.full((1, 20), np.nan), np.full(1, -1, np.int32)
    kept = old.tobytes()
    if scheme is None:
        core.update(par, old, gradient, new, status, 1)
    else:
        core.update_by_method(par, scheme, old, gradient, new, status, 1)
    assert old.tobytes() == kept
    if status[0]:
        assert new.tobytes() == kept
        assert status_message(status[0]) not in ("done", "unknown status", "")
    else:
        assert np.isfinite(new).all()
        eigenvalues = np.linalg.eigvalsh(to_matrix(new[0, 6:12]) + np.eye(3) / 3)
        assert eigenvalues[0] > -1e-10 and eigenvalues[-1] < 1 + 1e-10
        assert 0 < new[0, 19] < 1
    return status[0]


def statuses_of_random_input(rng, number):
    """How often each status came, of random property sets, states and increments."""
    steady = np.array([Material(0.5).steady(0.6)]).view(float).reshape(1, 20)
    seen = np.zeros(20, int)
    for _ in range(number):
        par = core.parameters_from_friction(rng.random(), *(int(k) for k in rng.integers(0, (5, 2, 3))))
        level = rng.choice([0.0, 0.03, 0.2])
        par[:20] = spoiled(rng, par[:20], level)
        _, valid = core.complete_parameters(par)
        old = spoiled(rng, steady, level)
        gradient = spoiled(rng, rng.normal(size=(1, 3, 3)) * 10.0 ** rng.uniform(-6, 0), rng.choice([0.0, 0.05, 0.3]))
        status = check(par, old, gradient)
        assert valid[0] or status == 2
        seen[status] += 1
    return seen


@pytest.mark.slow
@pytest.mark.release_only          # 5 000 are enough to meet every check of bounds
def test_30_000_random_property_sets_states_and_increments(rng):
    seen = statuses_of_random_input(rng, 30_000)
    assert (seen[[0, 1, 2, 3, 4, 5, 6, 7]] > 0).all(), seen          # every status was met, and success


@pytest.mark.slow
def test_5_000_random_property_sets_states_and_increments(rng):
    seen = statuses_of_random_input(rng, 5_000)
    assert (seen[[0, 1, 2, 3, 6]] > 0).all(), seen


@pytest.mark.parametrize("gradient", WILD)
def test_wild_shear_increments(material, gradient):
    shear = np.zeros((1, 3, 3))
    shear[0, 0, 2] = gradient
    status = check(np.array(material.parameters), np.array([material.steady(0.6)]).view(float).reshape(1, 20), shear)
    assert (status == 0) == (abs(gradient) <= 100)


def test_2000_random_property_sets_are_refused_in_words_or_give_a_usable_material(rng):
    made = 0
    for _ in range(2000):
        name = rng.choice([name for name in RANGES if name not in ("mu", "b3", "elastic_strain")])
        overrides = {str(name): rng.choice(WILD)}
        try:
            material = Material(rng.choice([0.3, 0.5, 1.0]), **overrides)
        except ValueError as error:
            assert str(name) in str(error) and "must be" in str(error)
        else:
            made += 1
            assert np.isfinite(list(material.constants.values())).all()
    assert 200 < made < 1800


def test_all_faults_come_in_one_message():
    with pytest.raises(ValueError) as caught:
        Material(mu=1.5, closure="ful", contact="hooke", friction="quadratic", calibration="table", elastic_strain=-1,
                 zc=3, c3=-1, a1="x")
    for words in ("mu = 1.5: must be at least 0 and at most 1", "closure 'ful'", "did you mean 'full'", "contact 'hooke'",
                  "calibration 'table'", "elastic_strain = -1.0: must be at least 0", "unknown name 'zc'",
                  "c3 = -1.0: must be at least 0", "a1 = 'x': must be a number, above 0", "give b1, b2, b3"):
        assert words in str(caught.value)


def test_all_faults_of_a_state_come_in_one_message(material):
    with pytest.raises(ValueError) as caught:
        material.state(1.2, np.inf, fabric=[0.8, 0, 0, 0, 0, 0], direction=[1, 0, 0, 0, 0], stress=[np.nan] * 6)
    for words in ("coordination_number = inf", "its trace is 0.8", "eigenvalues of A + I/3",
                  "abs(A) = 0.565685, must be below 0.0584684", "direction: must be 6 numbers", "stress = [nan"):
        assert words in str(caught.value)
    with pytest.raises(ValueError, match=r"volume_fraction = 1.2: must be in \(0, 1\)"):
        material.state(1.2, 5.0)


def test_a_constant_without_a_role_in_the_closure_is_refused():
    with pytest.raises(ValueError, match="a4 = 3: has no role in the closure 'n2'"):
        Material(0.5, "n2", a4=3)


def test_tensile_pressure_is_reported(material):
    shear = np.zeros((3, 3))
    shear[0, 2] = 0.01
    state = Material(0.5).steady(0.6)
    with pytest.raises(Exception, match="pressure would be tensile"):
        Material(0.5, a2=-1.0).update(state, shear)


def test_subnormal_increments_keep_the_direction(material):
    state = material.isotropic(0.6, pressure=0.01)
    shear = np.zeros((3, 3))
    shear[0, 2] = 1e-300
    np.testing.assert_allclose(material.update(state, shear).direction, [0, 0, 0, 0, 1, 0], atol=1e-15)
    assert trace(material.update(state, shear).stress) == pytest.approx(-0.03)
