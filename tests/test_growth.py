"""The growth of plane waves about shear, with and without a length, and which materials a length suits."""

import csv

import numpy as np
import pytest

from granumat import Material, driver, tensors
from granumat.studies import growth

DECADES = np.geomspace(0.1, 1000, 5)


def worst(closure, elastic_strain, length, reverse=False, mu=0.5, wave_numbers=DECADES, normals=361):
    material = Material(mu, closure, elastic_strain=elastic_strain)
    gradient = np.zeros((3, 3))
    gradient[0, 2] = -1 if reverse else 1
    linear = growth.linearise(material, material.steady(material["phic"] + 0.0132), gradient, length > 0)
    return growth.growth(linear, wave_numbers, np.linspace(0, np.pi, normals), length).max(1)


# measured before by another program, which had no core
@pytest.mark.parametrize(("elastic_strain", "length", "expected"), [
    (0.0, 0.0, [98, 6e3, 6e5, 6e7, 6e9]), (0.0, 0.8, [86, -1.3, -1.3, -1.3, -1.3]), (0.01, 0.0, [26, 120, 423]), (0.01, 0.8, [22])])
def test_growth_about_steady_shear(elastic_strain, length, expected):
    np.testing.assert_allclose(worst("full", elastic_strain, length)[:len(expected)], expected, rtol=0.04)


@pytest.mark.parametrize("closure", ["full", "kinematic", "mobilised"])
def test_with_a_length_short_waves_about_steady_shear_decay_and_just_after_a_reversal_grow_as_the_fabric_does(closure):
    assert worst(closure, 0.01, 0.8)[1:].max() < 0
    fabric = Material(0.5)["c2"] / 2 - 2 * Material(0.5)["c3"] * Material(0.5)["chi"] / 2       # c2 + 2 c3 x of |A|, at x = -chi
    assert 0.8 * fabric < worst(closure, 0.001, 0.8, reverse=True).min()
    assert worst(closure, 0.001, 0.8, reverse=True).max() < 1.1 * fabric


@pytest.mark.parametrize("closure", ["full", "kinematic", "mobilised"])
def test_about_steady_shear_short_waves_of_any_closure_grow_without_a_bound_but_with_a_length(closure):
    local, nonlocal_map = (growth.growth_map(closure, "steady", 0.01, length) for length in (0.0, 0.8))
    assert not local.is_bounded and nonlocal_map.is_bounded
    fine = worst(closure, 0.01, 0.0, wave_numbers=growth.WAVE_NUMBERS[-1:], normals=3601)      # a twentieth of a degree apart
    np.testing.assert_allclose(local.worst[-1:], fine, rtol=0.01)


def test_waves_longer_than_the_length_grow_as_without_it():
    long = np.array([0.1, 1.0])
    np.testing.assert_allclose(worst("full", 0.01, 1e-3, wave_numbers=long), worst("full", 0.01, 0.0, wave_numbers=long), rtol=1e-3)


def test_without_an_elastic_strain_short_waves_grow_as_the_acoustic_tensor_says():
    material = Material(0.5, "basic")
    state = driver.run(material, material.steady(0.6), [driver.shear(-1e-6, increments=1)]).states[-1]
    gradient = np.zeros((3, 3))
    gradient[0, 2] = -1
    angle = np.array([np.pi / 4])
    n, v = np.array([1, 0, 1]) / np.sqrt(2), np.array([-1, 0, 1]) / np.sqrt(2)
    strain = tensors.to_voigt(np.outer(v, n) + np.outer(n, v)) / 2 * [1, 1, 1, 2, 2, 2]
    modulus = 2 * strain @ material.response(np.array([state]))[0] @ strain             # |D| = 1/2
    k = 1e3
    found = growth.growth(growth.linearise(material, state, gradient, False), np.array([k]), angle, 0.0)
    np.testing.assert_allclose(found, -modulus * k**2 / growth.INERTIAL_NUMBER**2, rtol=1e-3)


# ---- which materials a length suits ----------------------------------------------------------------------------------

@pytest.mark.parametrize(("mu", "closure"), [
    (0.5, "basic"), (0.5, "n2"), (0.1, "full"), (0.28, "full"), (0.3, "full"), (0.5, "full"), (0.05, "kinematic"),
    (1.0, "kinematic"), (0.05, "mobilised")])
def test_a_length_suits_just_those_materials_whose_short_waves_it_bounds_in_plane_strain(mu, closure):
    bounded = max(worst(closure, e_r, 0.8, reverse=True, mu=mu, wave_numbers=[1e3])[0] for e_r in (0.01, 0.001)) < 10
    fault = Material(mu, closure, elastic_strain=0.01).length_fault(2)
    assert (fault is None) == bounded


@pytest.mark.parametrize(("mu", "closure", "suits"), [
    (0.5, "full", False), (0.52, "full", True), (0.3, "full", False), (1.0, "full", True), (0.5, "kinematic", True),
    (0.005, "kinematic", False), (0.5, "mobilised", True), (0.5, "critical", True), (0.5, "n2", False)])
def test_in_three_dimensions_a3_counts_too(mu, closure, suits):
    assert (Material(mu, closure, elastic_strain=0.01).length_fault(3) is None) == suits


def test_the_fault_is_a_sentence_that_names_the_closures_to_take():
    assert Material(0.5, "basic").length_fault(2) == (
        "a length does not suit the closure 'basic' at mu = 0.5 in 2 dimensions: just after a reversal of shear its transverse "
        "modulus is -0.099 of the pressure, and where it is not above 0.018 a length makes short waves grow faster; take the "
        "closure 'kinematic' or 'mobilised'")
    assert Material(0.0).length_fault(3).endswith("neither 'kinematic' nor 'mobilised' has a larger one at this mu")
    with pytest.raises(ValueError, match="dimensions = 1: must be 2 or 3"):
        Material(0.5).length_fault(1)


@pytest.mark.slow
@pytest.mark.release_only
def test_the_files_hold_every_map(tmp_path, monkeypatch):
    monkeypatch.setattr(growth, "CLOSURES", ("basic", "kinematic"))
    monkeypatch.setattr(growth, "WAVE_NUMBERS", np.geomspace(0.1, 1000, 9))
    monkeypatch.setattr(growth, "ANGLES", np.linspace(0, np.pi, 31)[:-1])
    maps, files = growth.write_study(tmp_path)
    assert len(maps) == 2 * 3 * 2
    with open(files[0], newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(maps) * 9 * 30
    assert files[1].read_bytes()[:4] == b"\x89PNG"
    verdicts = {one[:4]: one.is_bounded for one in maps}
    assert verdicts["kinematic", "steady", 0.01, 0.8] and not verdicts["kinematic", "steady", 0.0, 0.0]
    assert not verdicts["basic", "just reversed", 0.001, 0.8]
    words = growth.growth_in_words(maps)
    assert words.count("bounded") == sum(verdicts.values()) and len(words.splitlines()) == 2 + len(maps)
