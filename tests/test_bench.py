"""The benchmarks run, print every table, and their ratios are numbers. No test depends on a time."""

import itertools
import math
import re

import numpy as np
import pytest

from granumat.cli import main
from granumat.studies import bench, rate_form

NUMBER = r"([-+0-9.einfa]+)"

pytestmark = pytest.mark.release_only          # what the debug build costs is nothing to know


@pytest.fixture(scope="module")
def printed():
    """What `granumat bench --quick` prints."""
    with pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr("builtins.print", lambda *values, sep=" ", **_: lines.append(sep.join(map(str, values))))
        assert main(["bench", "--quick"]) == 0
    return "\n".join(lines)


@pytest.mark.parametrize("table, numbers", [
    (rf"update +{NUMBER} ns: {NUMBER} x streaming its 396 bytes, {NUMBER} x its \d+ operations in registers", 1),
    (rf"with tangent +{NUMBER} ns: {NUMBER} x the update", 1),
    (rf"by the spin too +{NUMBER} ns: {NUMBER} x the update", 1),
    (rf"update, two threads +{NUMBER} ns: {NUMBER} x faster", 1),
    (rf"^  e_r = 0 +(?:plane|3D) +(?:update|with tangent) +critical {NUMBER}  basic {NUMBER}  n2 {NUMBER}"
     rf"  kinematic {NUMBER}  full {NUMBER} ns$", 4),
    (rf"^  e_r = 0.01 +(?:plane|3D) +(?:update|with tangent) +critical {NUMBER}  basic {NUMBER}  n2 {NUMBER}"
     rf"  kinematic {NUMBER}  mobilised {NUMBER}  mobilised-pressure {NUMBER}  full {NUMBER} ns$", 4),
    (rf"one UMAT call with all its arguments, {NUMBER} ns: {NUMBER} x an elastic UMAT's, {NUMBER} x a point in the batch", 1),
    (rf"^ +\d+ +{NUMBER} ns$", len(bench.QUICK.sizes)),
    (rf"^\| NumPy, aim \d+ \| [-0-9a-z ]+ \| {NUMBER} \| {NUMBER} \| 0 of 1 \|", 3),
    (rf"^\| SciPy, aim \d+ \| [-0-9a-z ]+ \| {NUMBER} \| {NUMBER} \| 0 of 1 \|", 3),
    (rf"^  granumat +{NUMBER} ms +{NUMBER} x granumat +error {NUMBER}$", 2),
    (rf"^  SciPy DOP853, rtol [-0-9.e]+ +{NUMBER} ms +{NUMBER} x granumat +error {NUMBER}$", 2),
    (rf"^  SciPy LSODA, rtol [-0-9.e]+ +{NUMBER} ms +{NUMBER} x granumat +error {NUMBER}$", 2),
])
def test_every_table_is_printed_with_positive_finite_numbers(printed, table, numbers):
    found = [[float(number) for number in match.groups()] for match in re.finditer(table, printed, re.M)]
    assert len(found) == numbers
    assert all(math.isfinite(number) and number > 0 for row in found for number in row)


def test_headings_say_what_was_measured(printed):
    for heading in (f"{bench.QUICK.points} points, random increments", "cost per point of each closure over full's",
                    "cost per point against the number of points:", "to reach an error: time over the update's, over 1 cases",
                    "Newton's residuals, reversal by 0.02",
                    f"{bench.QUICK.increments} increments of simple shear by -1 at constant volume",
                    f"{bench.QUICK.increments} increments of simple shear by -1 at constant pressure"):
        assert heading in printed


def test_newtons_residuals_fall_quadratically():
    *residuals, last = bench.newton_residuals()
    assert last < bench.RESIDUAL and len(residuals) < 10
    assert all(after < before for before, after in itertools.pairwise(residuals))
    small = [(before, after) for before, after in itertools.pairwise(residuals) if before < 0.1]
    assert len(small) >= 2 and all(after < 10 * before**2 for before, after in small)


@pytest.mark.parametrize("control, rate", [("volume", rate_form.rate), ("pressure", rate_form.rate_at_constant_pressure)])
def test_all_solvers_of_a_path_find_the_same_states(control, rate):
    rows = bench.compare(control, rate, increments=20, repeats=1)
    assert [row.method.split(",")[0] for row in rows] == ["granumat", "SciPy DOP853", "SciPy LSODA"]
    assert all(row.error < 1e-5 for row in rows)


def test_full_effort_covers_the_chart_and_quick_is_less():
    from granumat.studies.cases import CASES
    assert bench.FULL.cases == tuple(CASES)
    assert all(np.all(np.less(quick, full)) for quick, full in zip(bench.QUICK, bench.FULL) if not isinstance(full, tuple))
