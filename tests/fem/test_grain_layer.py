"""demos/grain_layer.py: a column of finite elements with a length, beside the steady equation of demos/dem/bands.py."""

import sys
from pathlib import Path

import numpy as np
import pytest

DEMOS = Path(__file__).parents[2] / "demos"
sys.path.insert(0, str(DEMOS))
import grain_layer  # noqa: E402

sys.path.remove(str(DEMOS))
bands = grain_layer.bands


@pytest.mark.slow
@pytest.mark.release_only           # the debug build sees these calls of the core in test_nonlocal.py
def test_the_column_shears_as_the_steady_equation_says_and_its_length_is_found_again(tmp_path):
    (law, gradient), table = next(iter(grain_layer.main(**grain_layer.SHORT, out=tmp_path).items()))
    material, length = grain_layer.SHORT["laws"][law]
    assert (tmp_path / "grain-layer.png").exists()
    profile, friction = grain_layer.steady_profile(table), bands.Friction.of(material)
    pressures = bands.Pressures.of(profile)
    assert pressures.gradient == pytest.approx(gradient, rel=1e-3)
    steady = bands.steady_band(friction, length, pressures, len(profile["z"]))
    assert -profile["sigma_xz"].mean() == pytest.approx(steady.tau, rel=0.01)
    assert length < bands.fit_length(profile, friction)[0] < 1.3 * length       # far from the band it is not quite steady yet
    after = bands.Reversal.of(table)
    assert after.path[-1] == pytest.approx(grain_layer.SHORT["back"], rel=0.02)
    assert np.diff(after.tau).max() < 0                                 # the stress turns


@pytest.mark.release_only
@pytest.mark.parametrize("start, forth, slip, gradient", [(0.04, 0.04, 0.04, 0.5), (3.1, 1.9, 0.1, 0.7)])
def test_no_increment_is_cut_from_rest_nor_where_m_falls_by_decades(monkeypatch, start, forth, slip, gradient):
    for name, value in {"START": start, "FORTH": forth, "SLIP": slip}.items():
        monkeypatch.setattr(grain_layer, name, value)
    material, length = grain_layer.LAWS["mobilised, dem-2026"]
    table = grain_layer.shear_column(material, length, gradient, rows=80, back=slip)
    increments = round((start + forth) / slip) + 1
    assert len(table["step"]) == increments + 2                         # and the starts of the second and the third run
