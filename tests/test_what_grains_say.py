"""What the discrete-element runs of demos/data say about the form of the law: the numbers of docs/compare.md."""

from pathlib import Path

import numpy as np
import pytest

from granumat import Material
from granumat.grains import read_runs

DATA = Path(__file__).parents[1] / "demos/data"
ON_LINE = 0.05          # strain after a turn from which friction has turned
BEARS = 0.2             # share of the steady p above which ratios count


def reversals(mu):
    """The reversals at constant volume, one run for each packing, and the rows in which ratios count."""
    files = [*DATA.glob(f"cv_mu{mu}_*_s*.csv"), *DATA.glob(f"ensemble/mu{mu}_*/reversal_s[0-9]*.csv")]
    runs = [run for file in sorted(files) for run in read_runs([file])]
    return [(run, run.columns["p"] > BEARS * run.steady_pressure) for run in runs]


def small_cycles(state, amplitude):
    """Columns of small cycles, and the rows in which the shear turns, the first and the last among them."""
    run, = read_runs([DATA / f"ensemble/{state}/small-cycles-{amplitude}_s1.csv"])
    direction = np.sign(np.diff(run.columns["gamma"]))
    return run.columns, np.array([0, *(np.flatnonzero(np.diff(direction)) + 1), len(run) - 1])


def quadratic(run, counts):
    """b1, b2, b3 of (4.6) and of (4.5), and what each leaves of the stress ratio, where friction has turned."""
    rows = counts & (run.since_turn > ON_LINE)
    sense = np.append(1, np.sign(np.diff(run.columns["gamma"])))[rows]
    x, ratio = 2 * run.columns["A_xz"][rows] * sense, run.columns["stress_ratio"][rows] * sense
    fits = [np.polyfit(x, ratio, degree) for degree in (1, 2)]
    return fits[0], [np.sqrt(np.mean((np.polyval(fit, x) - ratio) ** 2)) for fit in fits]


@pytest.mark.parametrize("state, change, modulus", [("mu0.5_phi0.600", 0.011, 0.13), ("mu0.1_phi0.635", 0.024, 0.23)])
def test_at_a_turn_the_stress_goes_on_from_where_it_was_with_equal_slopes_out_and_back(state, change, modulus):
    columns, turns = small_cycles(state, "0.006")
    first = turns[:-1]
    np.testing.assert_allclose(np.abs(np.diff(columns["stress_ratio"]))[first], change, atol=0.003)           # in 0.001 of strain
    slopes = -np.diff(columns["sigma_xz"])[first] / np.diff(columns["gamma"])[first]
    np.testing.assert_allclose(slopes[1:], modulus, rtol=0.1)
    assert slopes[1::2].mean() == pytest.approx(slopes[2::2].mean(), rel=0.08)
    sand = Material(float(state[2:5]))
    steady = sand.steady(float(state[-5:]))
    turned = sand.update(steady, -1e-3 * np.outer([1, 0, 0], [0, 0, 1]))
    jump = np.diff([3 * point.stress[4] / point.stress[:3].sum() for point in (steady, turned)])
    assert abs(jump) > 5 * change                                         # of the law with e_r = 0


@pytest.mark.parametrize("state, kept", [("mu0.5_phi0.600", (0.98, 0.96, 0.82)), ("mu0.1_phi0.635", (0.97, 0.91, 0.75))])
def test_four_small_cycles_lose_little_pressure(state, kept):
    for amplitude, share in zip(("0.006", "0.012", "0.03"), kept):
        p = small_cycles(state, amplitude)[0]["p"]
        assert p[-1] / p[0] == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("mu, found, table_1", [(0.1, 1.03, 0.27), (0.3, 1.24, 0.51), (0.5, 1.08, 0.67)])
def test_a4_is_nearer_to_kinematic_than_table_1_is(mu, found, table_1):
    shares = []
    for run, counts in reversals(mu):
        difference = (run.columns["A_xx"] - run.columns["A_zz"])[counts]                       # N1/p = a4 (A_xx - A_zz)
        a4 = (run.columns["N1/p"][counts] @ difference) / (difference @ difference)
        shares.append(-a4 / (2 * quadratic(run, counts)[0][0]))
    law = Material(mu)
    assert -law["a4"] / (2 * law["b2"]) == pytest.approx(table_1, abs=0.01)
    assert np.mean(shares) == pytest.approx(found, abs=0.02)
    error = np.std(shares, ddof=1) / np.sqrt(len(shares))
    assert abs(np.mean(shares) - 1) < (1 if mu == 0.1 else 2) * error and abs(np.mean(shares) - table_1) > 5 * error


@pytest.mark.parametrize("mu, line, parabola", [(0.1, 0.008, 0.008), (0.3, 0.011, 0.009), (0.5, 0.018, 0.012)])
def test_once_friction_has_turned_a_line_in_A_S_misses_the_stress_ratio_by_little_more_than_a_parabola(mu, line, parabola):
    found = np.mean([quadratic(run, counts)[1] for run, counts in reversals(mu)], axis=0)
    np.testing.assert_allclose(found, (line, parabola), atol=0.001)


@pytest.mark.parametrize("mu, before, after", [(0.1, 0.075, 0.034), (0.3, 0.128, 0.090), (0.5, 0.152, 0.127)])
def test_N2_keeps_its_sign_in_the_first_0_02_of_a_reversal(mu, before, after):
    found = [[run.columns["N2/p"][rows].mean() for rows in (np.isinf(run.since_turn), counts & (run.since_turn <= 0.02))]
             for run, counts in reversals(mu)]
    np.testing.assert_allclose(np.mean(found, axis=0), (before, after), atol=0.005)
