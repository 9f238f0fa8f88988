"""Calibration: what errors count in a fit, and its stages."""

from dataclasses import replace

import numpy as np
import pytest

from granumat import Material, driver
from granumat.grains import Yardstick, calibrate, calibration, predict, read_runs
from granumat.grains.fitting import fit
from granumat.grains.sums import Sums


@pytest.fixture
def run(tmp_path):
    """A reversal of the law with the printed constants, as a measured run."""
    law = Material(0.5)
    driver.run(law, law.steady(0.6), [driver.shear(-0.02, increments=20)], out=tmp_path / "run")
    return read_runs([tmp_path / "run/history.csv"], mu=0.5)[0]


def test_a_ratio_without_a_pressure_counts_no_more_than_a_law_that_does_not_come(run):
    prediction, sums = predict(run, Material(0.5)), Sums([Yardstick.of(run)])

    def errors(last):
        ratio = np.append(prediction.columns["stress_ratio"][:-1], last)
        return sums.errors(0, replace(prediction, columns=dict(prediction.columns) | {"stress_ratio": ratio}))
    unreached = errors(np.inf)
    assert unreached.max() > 1
    np.testing.assert_array_equal(errors(1e15), unreached)
    np.testing.assert_allclose(errors(-1e15), -unreached, atol=1e-9)


def test_runs_that_differ_much_between_packings_do_not_loosen_the_weights_of_others(run):
    def seeds(scatter):
        return Yardstick.of(replace(run, seeds=4, scatter={"p": np.full(len(run), scatter * run.steady_pressure)}))
    other = predict(run, Material(0.5, phic=0.589))
    alike, liquefied = seeds(0.05), seeds(0.5)
    several = Sums([alike, alike, liquefied])
    np.testing.assert_allclose(several.errors(0, other), Sums([alike]).errors(0, other))
    np.testing.assert_allclose(several.errors(2, other)[several.quantities[several.rows([2])] == 0],
                               several.errors(0, other)[several.quantities[several.rows([0])] == 0] / 10)


@pytest.mark.parametrize("stage, name, wrong", [("_stress_errors", "Zc", 6.0), ("_rates_errors", "phic", 0.7)])
def test_a_stage_that_leads_away_from_whole_histories_is_left_out(run, stage, name, wrong, monkeypatch):
    pytest.importorskip("scipy")
    monkeypatch.setattr(calibration._Search, stage, lambda self, material: np.array([1e3 * (material[name] - wrong)]))
    begun = []
    monkeypatch.setattr(calibration, "fit", lambda *arguments: begun.append(arguments[-1].copy()) or fit(*arguments))
    found, = calibrate([run], [name]).sets
    assert begun[0].tolist() == [0] and found.comparison.scores("fitted")[0, 0, 0] < 0.01
