"""The chart: its solvers follow the paper, its errors are errors, what fails is shown as failed."""

import csv
import math

import numpy as np
import pytest

from granumat import STATE, Material, tensors
from granumat.cli import main
from granumat.studies import chart, rate_form
from support import reference

pytestmark = [pytest.mark.slow, pytest.mark.release_only]


@pytest.fixture(scope="module")
def reversal():
    return chart.measure("reversal", points=8, rounds=1)


@pytest.fixture(scope="module")
def huge():
    return chart.measure("huge", points=8, rounds=1)


def by_pieces(rows, method, spin="inside"):
    """pieces -> row of a method."""
    return {row.pieces: row for row in rows if (row.method, row.spin) == (method, spin)}


@pytest.mark.parametrize("elastic_strain", [0.0, 1e-2])
def test_rates_agree_with_the_tests_own_equations(rng, elastic_strain):
    fabric, z2, phi, gradient = reference.random_increments(rng, 20, 0.5, 0.05)
    deviator = reference.scale(1e-3 * rng.random(20), fabric / 0.04)
    c = reference.constants(0.5) | {"elastic_strain": elastic_strain}
    a, z, ph, p, dev = reference.integrate(c, fabric, z2, phi, gradient, deviator)
    states = np.zeros(20, STATE)
    states["fabric"], states["coordination_number"], states["volume_fraction"] = tensors.to_voigt(fabric), z2, phi
    states["stress"] = -tensors.to_voigt(deviator)
    material = Material(0.5, elastic_strain=elastic_strain)
    found, = rate_form.reference(material, rate_form.unknowns(material, states), rate_form.components_first(gradient[None]))
    sigma = -tensors.to_voigt(dev + reference.scale(p, np.eye(3)))
    np.testing.assert_allclose(found, [*tensors.to_voigt(a).T, z, ph, *sigma.T], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", ["quarter-turn", "through-phic", "unjamming"])
def test_half_the_steps_of_the_reference_change_it_by_less_than_1e_12(name):
    case = chart.CASES[name](16)
    material = Material(**case.definition)
    y, gradients = rate_form.unknowns(material, case.states), rate_form.components_first(case.gradients)
    exact = rate_form.reference(material, y, gradients)
    halved = rate_form.reference(material, y, gradients, rate_form.REFERENCE_MAX_STEP / 2)
    assert max(chart.errors(halved, exact, material["kappa"])) < 1e-12


def test_every_method_runs_in_a_case(reversal):
    assert {row.method for row in reversal} == set(chart.STYLES)
    assert {row.status for row in reversal} == {"ok"}
    assert all(row.ns_per_update > 0 for row in reversal)


@pytest.mark.parametrize("case", ["reversal", "huge"])
def test_exact_is_at_round_off(case, request):
    assert chart.exact_row(request.getfixturevalue(case)).error < 1e-12


@pytest.mark.parametrize("method, order", [("forward-euler", 1), ("backward-euler", 1), ("midpoint", 2), ("rk4", 4),
                                           ("NumPy RK4", 4)])
def test_errors_fall_with_pieces_at_the_order_of_the_method(reversal, method, order):
    rows = by_pieces(reversal, method)
    for name in ("error_A", "error_Z2", "error_sigma"):
        coarse, fine = getattr(rows[1], name), getattr(rows[4], name)
        assert math.log2(coarse / fine) / 2 == pytest.approx(order, abs=0.25)


def test_rotation_before_the_strain_makes_exact_first_order(reversal):
    rows = by_pieces(reversal, "exact", "before")
    assert math.log2(rows[1].error / rows[4].error) / 2 == pytest.approx(1, abs=0.1)


def test_the_cores_rk4_and_numpys_err_alike(reversal):
    for name in ("error_A", "error_Z2", "error_sigma"):
        core, numpy = (getattr(by_pieces(reversal, method)[1], name) for method in ("rk4", "NumPy RK4"))
        assert core == pytest.approx(numpy, rel=1e-3)


@pytest.mark.parametrize("case", ["reversal", "huge"])
def test_numpy_takes_pieces_until_it_errs_no_more_than_exact_or_1e_12(case, request):
    rows = request.getfixturevalue(case)
    *before, last = by_pieces(rows, "NumPy RK4").values()
    assert last.error <= chart.finest(rows) < min(row.error for row in before)
    assert [row.pieces for row in before] == [2**k for k in range(len(before))]


def row(method, ns, error, spin="inside", pieces=1):
    return chart.Row("made up", method, spin, pieces, None, error, 0.0, error / 2, 0.0, 0.0, 0.0, ns, "ok")


EXACT = row("exact", 100.0, 1e-13)


@pytest.mark.parametrize("rivals, expected", [
    ([row("rk4", 99.0, 1e-5), row("midpoint", 50.0, 1e-4)], 0),             # of two that are faster the more accurate
    ([row("rk4", 99.0, 1e-14)], 0),
    ([row("rk4", 101.0, 1e-14), row("rk4", 100.0, 1e-14)], None),           # more accurate, but not faster
    ([row("exact", 99.0, 1e-14, pieces=2)], None),                          # no rival of itself
    ([row("rk4", 101.0, 1e-14), row("exact", 99.0, 1e-2, spin="before")], 1),
])
def test_ahead_of_exact_is_what_is_faster_and_most_accurate(rivals, expected):
    assert chart.ahead([EXACT, *rivals]) is (None if expected is None else rivals[expected])


def test_the_front_tells_what_beats_exact_in_both_from_what_is_only_faster():
    said = chart.front({
        "behind": [EXACT, row("rk4", 101.0, 1e-14)], "coarse": [EXACT, row("midpoint", 50.0, 2e-3)],
        "quick": [EXACT, row("midpoint", 50.0, 5e-4)], "level": [EXACT, row("forward-euler", 99.0, 9e-14)]})
    both, faster = said.split("\n\n")
    assert "in 1 of 4 cases: level: forward-euler, 1 piece (99 ns, 9e-14; exact 100 ns, 1e-13)" in both and "quick" not in both
    assert "in 2 of 4 cases" in faster and "quick: midpoint" in faster and "level: forward-euler" in faster
    assert not any(name in said for name in ("behind", "coarse"))
    assert chart.front({"behind": [EXACT, row("rk4", 101.0, 1e-14)]}).count("in 0 of 1 cases") == 2


def test_ratios_at_equal_error_over_cases():
    numpy = [row("NumPy RK4", 1000.0, 1e-6), row("NumPy RK4", 500.0, 2e-6), row("NumPy RK4", 3000.0, 1e-12)]
    rough = row("exact", 50.0, 1e-10)
    said = chart.equal_error({"a": [EXACT, *numpy], "b": [rough, *numpy[:2]], "c": [rough, row("NumPy RK4", 2500.0, 9e-11)]})
    lines = [line.strip("| ").split(" | ") for line in said.split("\n")]
    table = {tuple(cells[:2]): cells[2:] for cells in lines}
    assert table["NumPy, aim 20", "1e-06"] == ["10", "20", "0 of 3", "a 10"]          # 10, 20, 50
    assert table["NumPy, aim 20", "1e-09"] == ["30", "50", "1 of 3", "none"]          # 30, not reached, 50
    assert table["NumPy, aim 20", "of exact"] == ["30", "50", "1 of 3", "none"]       # below 1e-12, 1e-10, 1e-10
    assert table["SciPy, aim 1000", "1e-06"] == ["inf", "inf", "3 of 3", "none"]


def test_refused_runs_are_marked_and_drawn_on_the_edge(huge):
    refused = [row for row in huge if row.status.startswith("refused at")]
    assert refused and all(math.isinf(row.error) for row in refused)
    crosses = [line for line in chart.case_figure("huge", huge).axes[0].lines if line.get_marker() == "x"]
    assert sum(len(line.get_xdata()) for line in crosses) == sum(row.error > chart.WORST for row in huge)
    assert all((np.array(line.get_ydata()) == chart.WORST).all() for line in crosses)


def test_what_is_not_finite_counts_as_infinite_error():
    exact = np.ones((1, 14, 2))
    exact[:, 8:11] = -1
    trajectory = exact.copy()
    trajectory[0, 6, 1] = np.nan
    assert chart.errors(trajectory, exact, 1.0) == [0, np.inf, 0] * 2


def test_the_command_writes_csv_and_pictures_and_says_what_is_fastest(huge, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(chart, "measure", lambda name: huge)
    assert main(["chart", "--out", str(tmp_path), "huge"]) == 0
    with (tmp_path / "chart.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert tuple(lines[0]) == chart.COLUMNS and len(lines) == len(huge)
    assert any(line["status"].startswith("refused") and line["error_A"] == "inf" for line in lines)
    assert all(bool(line["pieces"]) != bool(line["tolerance"]) for line in lines)
    for name in ("huge", "chart"):
        assert (tmp_path / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
    assert "| huge | " in capsys.readouterr().out


def test_unknown_cases_are_refused_all_at_once(tmp_path, capsys):
    assert main(["chart", "--out", str(tmp_path / "out"), "huge", "no", "nor"]) == 2
    said = capsys.readouterr().err
    assert "case 'no'" in said and "case 'nor'" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", chart.CASES)
def test_every_case_is_followed_by_exact_to_1e_10(name):
    case = chart.CASES[name](4)
    material = Material(**case.definition)
    exact = rate_form.reference(material, rate_form.unknowns(material, case.states), rate_form.components_first(case.gradients))
    states, refused = chart.run_core(material, case.states, case.gradients, 1, np.zeros(case.gradients.shape[:2], STATE))
    assert refused == "" and max(chart.errors(chart.as_results(states), exact, material["kappa"])) < 1e-10
