"""Errors along runs as a fit counts them."""

from dataclasses import replace

import numpy as np

from granumat import Material, driver
from granumat.grains import Yardstick, predict, read_runs
from granumat.grains.sums import Sums


def test_a_ratio_without_a_pressure_counts_no_more_than_a_law_that_does_not_come(tmp_path):
    law = Material(0.5)
    driver.run(law, law.steady(0.6), [driver.shear(-0.02, increments=20)], out=tmp_path / "run")
    run, = read_runs([tmp_path / "run/history.csv"], mu=0.5)
    prediction, sums = predict(run, law), Sums([Yardstick.of(run)])

    def errors(last):
        ratio = np.append(prediction.columns["stress_ratio"][:-1], last)
        return sums.errors(0, replace(prediction, columns=dict(prediction.columns) | {"stress_ratio": ratio}))
    unreached = errors(np.inf)
    assert unreached.max() > 1
    np.testing.assert_array_equal(errors(1e15), unreached)
    np.testing.assert_allclose(errors(-1e15), -unreached, atol=1e-9)
