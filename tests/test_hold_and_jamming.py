"""Zero strain, the unjammed, and the blow-up."""

import numpy as np
import pytest

from granumat import STATE, Material, MaterialError, driver, tensors
from support.states import CLOSURES_AND_STRAINS

SHEAR = np.zeros((3, 3))
SHEAR[0, 2] = 1.0


@pytest.mark.parametrize(("closure", "elastic_strain"), CLOSURES_AND_STRAINS)
def test_zero_strain_holds_the_state_bit_for_bit(closure, elastic_strain):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    state = material.steady(0.60)
    assert material.update(state, np.zeros((3, 3))).tobytes() == state.tobytes()


def test_pure_spin_turns_everything_with_the_body(material):
    state = material.steady(0.60)
    turned = material.update(state, np.array([[0, 0, np.pi / 2], [0, 0, 0], [-np.pi / 2, 0, 0]]))
    for name in ("stress", "fabric", "direction"):                 # a quarter turn swaps x and z and the sign of xz, xy/yz
        xx, yy, zz, xy, xz, yz = state[name]
        np.testing.assert_allclose(turned[name], [zz, yy, xx, yz, -xz, -xy], rtol=1e-14, atol=1e-15)
    assert turned.coordination_number == state.coordination_number


def test_the_unjammed_bear_nothing_and_jam_again(material):
    state = material.isotropic(0.60, coordination_number=material["Zc"] - 0.3)
    history = driver.run(material, state, [driver.shear(3.0)])
    jammed = history["Z2"] > material["Zc"]
    assert not jammed[0] and jammed[-1]
    for name in ("p", "stress_ratio", *(f"sigma_{axis}" for axis in tensors.AXES)):
        assert (history[name][~jammed] == 0).all()
    assert (history["p"][jammed] > 0).all()
    assert history["p"][-1] == pytest.approx(-tensors.trace(material.steady(0.60).stress) / 3, rel=0.1)


def test_cyclic_shear_at_constant_volume_liquefies_a_loose_packing_and_not_a_dense_one(material):
    loose, dense = (driver.run(material, material.steady(phi), driver.cycles(0.2, 5)) for phi in (0.59, 0.60))
    assert loose["p"].min() == 0 and loose["p"][-1] < 0.5 * loose["p"][0]
    assert dense["p"].min() > 0


def test_blow_up_is_reported_and_the_old_state_kept(material):
    state = np.zeros(1, STATE)                                    # abs(A) = 0.07: gone at gamma = 0.22 (spec, section 3)
    state["fabric"][0, 4], state["coordination_number"], state["volume_fraction"] = 0.07, 5.0, 0.6
    np.testing.assert_array_less(-1, material.update(state, 0.1 * SHEAR[None])["volume_fraction"])
    with pytest.raises(MaterialError, match="blows up") as caught:
        material.update(state, 1.0 * SHEAR[None])
    assert caught.value.states.tobytes() == state.tobytes()
    with pytest.raises(ValueError, match=r"abs\(A\) = 0.07, must be below 0.0584684"):
        material.state(0.6, 5.0, fabric=state["fabric"][0])


def test_blow_up_comes_at_the_strain_of_the_scalar_equation():
    # coaxial without spin: dx/ds = 2 c1 + c2 x + c3 x^2 from x = 0.14 reaches infinity at a known s
    material = Material(0.5)
    c1, c2, c3 = (material[name] for name in ("c1", "c2", "c3"))
    low, high = np.sort(np.roots([c3, c2, 2 * c1]))
    s_infinite = np.log((0.14 - low) / (0.14 - high)) / (c3 * (high - low))
    state = np.zeros(1, STATE)
    state["fabric"][0, 4], state["coordination_number"], state["volume_fraction"] = 0.07, 5.0, 0.6
    pure_shear = (SHEAR + SHEAR.T)[None]                            # |D| = 1
    s_leaves = np.log((2 / 3 - low) / (2 / 3 - high)) / (c3 * (high - low))      # x = 2/3: no longer realisable
    material.update(state, (s_infinite - s_leaves) * 0.9999 * pure_shear)
    with pytest.raises(MaterialError, match="blows up"):
        material.update(state, (s_infinite - s_leaves) * 1.0001 * pure_shear)


def test_abs_a_below_the_limit_always_decays_and_above_it_some_direction_grows(rng, material):
    limit = material["fabric_limit"]
    assert limit == pytest.approx(0.0585, abs=5e-5)
    worst = tensors.to_voigt((SHEAR + SHEAR.T) / 1)
    for size, grows in ((0.99 * limit, False), (1.01 * limit, True)):
        state = np.zeros(1, STATE)
        state["fabric"], state["coordination_number"], state["volume_fraction"] = size * worst, 5.0, 0.6
        new = material.update(state, 1e-3 * (SHEAR + SHEAR.T)[None])
        assert (tensors.magnitude(new.fabric)[0] > size) == grows


def test_huge_increments_are_refused_not_truncated(material):
    with pytest.raises(MaterialError, match="more than 10000 substeps"):
        material.update(material.steady(0.60), 1e6 * SHEAR)


def test_unjammed_steady_state_with_an_elastic_strain_is_found():
    state = Material(0.5, elastic_strain=0.01).steady(0.55)
    assert state.coordination_number < Material(0.5)["Zc"] and (state.stress == 0).all()
