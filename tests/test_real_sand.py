"""demos/real_sand.py and the page about it: the law beside undrained triaxial cycles of a sand."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from granumat import Material, driver

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/real-sand.md").read_text()
TEXT = " ".join(PAGE.split())           # without the ends of lines
STIFF, SOFT = 3e-4, 0.01                # p0 d/k
LOOSE, MIDDLE, DENSE = 0.585, 0.59, 0.60
pytestmark = pytest.mark.release_only


@pytest.fixture(scope="module")
def demo():
    """What demos/real_sand.py defines."""
    return runpy.run_path(str(ROOT / "demos/real_sand.py"))


@pytest.fixture(scope="module")
def pressure(demo):
    """Function that gives p/p0 (4,) at the reversals, of the printed law unless other settings are given."""
    def at_reversals(phi, *start, settings=demo["MATERIALS"]["printed"], **more):
        return demo["follow"](settings, phi, *start, **more)[0][demo["REVERSALS"]]
    return at_reversals


@pytest.mark.slow
def test_the_table_of_the_page_is_what_the_demo_computes(demo, tmp_path):
    lines = demo["main"](tmp_path)
    assert "\n".join(lines) in PAGE
    assert (tmp_path / "real-sand.png").exists()
    assert len(lines) == len(demo["TESTS"]) + 5 * len(demo["MATERIALS"])


def test_the_path_file_is_the_demo_s_packing_of_middle_density(demo, pressure):
    path = demo["PATH"]
    history = driver.run(path.material, path.state, path.steps)
    assert (LOOSE, path.state.volume_fraction, DENSE) == demo["DENSITIES"] == (LOOSE, MIDDLE, DENSE)
    np.testing.assert_array_equal(history["p"][demo["REVERSALS"]] / demo["PRESSURE"], pressure(MIDDLE))
    np.testing.assert_allclose(-history["e_zz"][demo["REVERSALS"]], demo["AMPLITUDE"] * np.array([1, -1, 1, -1]), rtol=1e-12)
    assert demo["overlap"](demo["CONFINEMENT"]) == pytest.approx((demo["CONFINEMENT"] / 40e6)**(2 / 3), rel=0.05)    # E* of quartz


def test_the_ratio_is_three_to_four_times_too_low(demo):
    ranges = {name: [row[-1] for row in demo["rows"]() if row[0].startswith(name)] for name in ("printed", "mobilised")}
    assert len(ranges["printed"]) == len(ranges["mobilised"]) == 5
    assert np.min(ranges["printed"]) > 0.28 and np.max(ranges["printed"]) < 0.34 and np.max(ranges["mobilised"]) < 0.24
    assert f"3^(1/2) b1 = {np.sqrt(3) * Material(mu=0.5)['b1']:.2f}" in TEXT


def test_the_law_goes_from_losing_all_to_losing_nothing_within_half_of_what_the_sand_s_densities_span(demo, pressure):
    first, last = (float(phi) for phi in re.search(r"losing nothing between phi = ([\d.]+) and ([\d.]+)\.", TEXT).groups())
    assert pressure(first)[3] < 0.01 and pressure(last)[3] > 0.99
    loose, dense = (demo["volume_fraction"](index) for index in (0.29, 0.66))
    assert f"volume fractions of {loose:.3f} and {dense:.3f}, {dense - loose:.3f} apart" in TEXT
    assert last - first < 0.5 * (dense - loose)
    assert max(test.p[3] for test in demo["TESTS"]) < 0.1
    denser = DENSE - Material(mu=0.5)["phic"]
    assert f"denser than critical by {denser:.3f} loses {100 * (1 - pressure(DENSE)[3]):.0f} %, and a denser one gains" in TEXT
    assert pressure(0.61)[3] > 1


def test_the_first_compression_takes_too_little_at_any_density(demo, pressure):
    loosest, sand = pressure(LOOSE)[0], demo["TESTS"][0].p[0]
    assert min(pressure(phi)[0] for phi in (0.55, 0.58, *demo["DENSITIES"])) == pytest.approx(loosest, rel=1e-12)
    assert f"the loosest packings lose {100 * (1 - loosest):.0f} %, the loose sand {100 * (1 - sand):.0f} %" in TEXT
    half = pressure(LOOSE, amplitude=0.005)[0]
    assert f"even the loosest packing loses {100 * (1 - half):.0f} % in the first compression" in TEXT


def test_a_compression_takes_as_many_contacts_as_the_page_says(pressure):
    a1 = Material(mu=0.5)["a1"]
    excess = {overlap: np.sqrt(overlap / a1) for overlap in (STIFF, SOFT)}                  # (4.2)
    taken = {overlap: excess[overlap] * (1 - np.sqrt(pressure(LOOSE, overlap)[0])) for overlap in (STIFF, SOFT)}
    lost = {overlap: 100 * (1 - pressure(LOOSE, overlap)[0]) for overlap in (STIFF, SOFT)}
    assert (f"takes {taken[STIFF]:.2f} contacts a grain from a packing at 3e-4, which has {excess[STIFF]:.2f}, "
            f"and {taken[SOFT]:.2f} at 0.01, where there are {excess[SOFT]:.2f}") in TEXT
    assert f"the stiff packing loses {lost[STIFF]:.0f} % of its pressure, the soft one {lost[SOFT]:.0f} %" in TEXT


def test_reversals_take_alike_and_half_the_amplitude_half_of_the_contacts(pressure):
    contacts = np.sqrt(pressure(MIDDLE))                        # in excess, over their first number
    taken = -np.diff(contacts)
    assert taken.max() < 1.25 * taken.min()
    assert 0.45 < (1 - np.sqrt(pressure(MIDDLE, amplitude=0.005)[3])) / (1 - contacts[3]) < 0.6


def test_contacts_evolve_alike_in_hookean_and_hertzian_grains(demo, pressure):
    for settings in demo["MATERIALS"].values():
        for phi in demo["DENSITIES"]:
            hertzian = pressure(phi, STIFF**1.5, settings=settings, contact="hertzian")
            np.testing.assert_allclose(hertzian, pressure(phi, STIFF, settings=settings)**1.5, rtol=1e-9, atol=1e-15)


def test_stiff_grains_make_a_loose_packing_lose_more_and_a_dense_one_less(pressure):
    assert pressure(LOOSE, STIFF)[3] < 0.001 and f"it keeps {100 * pressure(LOOSE, SOFT)[3]:.0f} %" in TEXT
    assert pressure(DENSE, STIFF)[3] > 1.2 * pressure(DENSE, SOFT)[3]
    steady = -Material(mu=0.5).steady(DENSE).stress[:3].mean()
    assert steady < SOFT and f"{steady / STIFF:.0f} times p0 if they are as stiff as quartz" in TEXT


def test_constants_of_spheres_make_the_loss_depend_less_on_the_density_and_the_ratio_lower(demo, pressure):
    settings = demo["MATERIALS"]["dem-2026"]
    printed, fitted = (100 * (1 - pressure(DENSE, settings=one)[3]) for one in (demo["MATERIALS"]["printed"], settings))
    assert f"at phi = 0.6 the printed law loses {printed:.0f} % in four reversals, this one {fitted:.0f} %" in TEXT
    ranges = [row[-1] for row in demo["rows"]() if row[0].startswith("dem-2026")][:4]
    assert f"q/p is {np.min(ranges):.2f} to {np.max(ranges):.2g} at strains of 1 %" in TEXT
    assert f"that of *dem-2026* {settings['phic']:.4f}" in TEXT and f"where e_r is {settings['elastic_strain']:.3f}" in TEXT


def test_mobilised_with_a_small_elastic_strain_is_near_the_printed_law(pressure):
    found = pressure(MIDDLE, settings={"closure": "mobilised", "elastic_strain": 0.001})
    assert "p/p0 is {:.2f}, {:.2f}, {:.2f} and {:.2f}.".format(*found) in TEXT
