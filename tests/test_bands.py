"""demos/dem/bands.py: the length of the law in shear bands of grains, and what the collected bands say."""

import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import Material

DEM = Path(__file__).resolve().parents[1] / "demos" / "dem"
sys.path.insert(0, str(DEM))
import bands  # noqa: E402
import collect  # noqa: E402
import profiles  # noqa: E402
from gradient import COLLECTED  # noqa: E402

sys.path.remove(str(DEM))

pytestmark = pytest.mark.release_only       # the debug build sees these calls of the core in test_length.py

LAYERS = 64


@pytest.fixture(scope="module")
def frictions():
    """By law."""
    return {law: bands.Friction.of(Material(0.5, **settings)) for law, settings in bands.LAWS.items()}


def profile_of(band, pressures):
    """The profile that a band would have been measured as."""
    return {"z": band.z, "slip": band.slip, "sigma_zz": pressures.at(band.z), "sigma_xz": np.full(len(band.z), -band.tau)}


@pytest.mark.parametrize("law", bands.LAWS)
@pytest.mark.parametrize("length", [0.4, 0.9])
@pytest.mark.parametrize("gradient", [0.3, 0.5])
def test_a_band_made_with_a_length_gives_it_back(frictions, law, length, gradient):
    pressures = bands.Pressures(0.005, gradient, 31.0)
    profile = profile_of(bands.steady_band(frictions[law], length, pressures, LAYERS), pressures)
    found, difference = bands.fit_length(profile, frictions[law])
    assert found == pytest.approx(length, rel=1e-3) and difference < 1e-3
    assert bands.Pressures.of(profile).gradient == pytest.approx(gradient, rel=1e-3)


def test_noise_far_from_the_band_does_not_count(frictions):
    pressures = bands.Pressures(0.005, 0.5, 31.0)
    profile = profile_of(bands.steady_band(frictions["full"], 0.5, pressures, LAYERS), pressures)
    profile["slip"] = profile["slip"] + 1e-3 * np.sin(np.arange(LAYERS)) * (abs(profile["z"]) > 8)
    assert bands.fit_length(profile, frictions["full"])[0] == pytest.approx(0.5, rel=1e-3)


def test_friction_at_R_of_1_is_that_of_steady_shear(frictions):
    for law, settings in bands.LAWS.items():
        stress = Material(0.5, **settings).steady(0.60).stress
        assert frictions[law].homogeneous == pytest.approx(stress[4] / -stress[2], rel=1e-5), law
        assert (np.diff(frictions[law].ratio) > 0).all(), law


def test_the_steady_equation_holds_between_cells(frictions):
    """l^2 m'' = m (1 - R) integrated over the half height: without flux at both ends, the shear has the mean of m."""
    pressures, length = bands.Pressures(0.005, 0.5, 31.0), 0.8
    band = bands.steady_band(frictions["full"], length, pressures, 2 * bands.CELLS)
    z, step = band.z[bands.CELLS:], band.z[1] - band.z[0]
    shear = np.diff(band.slip[bands.CELLS - 1:]) / step                 # at the lower edges of the cells
    edges = z - step / 2
    m = shear / frictions["full"].R_at(band.tau / pressures.at(edges))
    second = (m[2:] - 2 * m[1:-1] + m[:-2]) / step**2
    near = edges[1:-1] < 6
    assert length**2 * second[near] == pytest.approx((m[1:-1] - shear[1:-1])[near], abs=0.01 * m.max())


def test_elastic_slip_is_not_counted_as_leaving_the_band():
    z, path = (np.arange(LAYERS) + 0.5) / LAYERS * 32 - 16, np.linspace(0, 4, 41)
    tau = np.maximum(1 - path, -1)
    elastic = np.minimum(path, 2)[:, None] * z / 32                     # with the stress, everywhere alike
    band = np.maximum(path - 2, 0)[:, None] * np.clip(z, -2, 2) / 4
    reversal = bands.Reversal(path, tau, elastic + band, z)
    assert reversal.outside(4, 0, 4) == pytest.approx((1 - (2 * 8 / 32 + 2) / 4, 0.0), abs=1e-12)
    assert reversal.path_to(0, 1.0) == pytest.approx(1) and reversal.path_to(-0.9, 1.0) == pytest.approx(1.9)


def test_width_is_the_standard_deviation_of_a_known_band():
    z = (np.arange(400) + 0.5) / 400 * 32 - 16
    band = bands.Band(z, np.clip(z / 4, -0.5, 0.5), 1.0, 32.0)          # uniform over 4
    deviation, ninety = bands.width(band)
    assert deviation == pytest.approx(4 / np.sqrt(12), rel=0.01) and ninety == pytest.approx(3.6, rel=0.01)
    assert bands.half_height(band) == pytest.approx(0.97 * 2, rel=0.02)


# ---- collected data --------------------------------------------------------------------------------------------------------

PROFILES = sorted(COLLECTED.glob("*/*-profile_s*[0-9].csv"))


def test_collected_histories_and_profiles_agree():
    assert PROFILES
    for table in PROFILES:
        name, seed = table.stem.split("-profile_s")
        history, profile = collect.read(table.with_name(f"{name}_s{seed}.csv")), collect.read(table)
        assert all(np.isfinite(column).all() for column in (*history.values(), *profile.values()))
        assert profile["slip"][-1] - profile["slip"][0] == pytest.approx(1, abs=0.05)
        slip = profiles.of_layers(history, "slip").sum(axis=0)
        assert slip[-1] - slip[0] == pytest.approx((np.diff(history["gamma"], prepend=0) * history["height"]).sum(), rel=0.05)
        assert profile["sigma_zz"].mean() == pytest.approx(0.0025 if "gradient0/" in str(table) else 0.005, rel=0.02)


SPREADS = {"full": 1.13, "kinematic": 1.08, "full dem-2026": 1.16, "mobilised dem-2026": 1.15}        # largest over least length


def test_the_lengths_of_three_gradients_differ_by_what_the_page_says_and_less_than_would_refute_a_length(frictions):
    assert set(SPREADS) == set(bands.LAWS) and max(SPREADS.values()) < 1.3
    lengths = {}
    for _, programme, _, found in bands.summary(COLLECTED, frictions):
        if programme == "steady":
            for law in SPREADS:
                lengths.setdefault(law, []).append(found[f"l {law}"][0])
    for law, of_law in lengths.items():
        assert len(of_law) == 3 and max(of_law) / min(of_law) == pytest.approx(SPREADS[law], abs=0.01)
