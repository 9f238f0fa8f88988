"""demos/dem/dem_2026.py and cycles.py: the calibration dem-2026 and the law beside cycles, and the pages about them."""

import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import calibrations
from granumat.grains import compare, read_runs
from granumat.toml import read_toml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos/dem"))
import cycles  # noqa: E402
import dem_2026  # noqa: E402

sys.path.remove(str(ROOT / "demos/dem"))

pytestmark = pytest.mark.release_only       # the debug build sees these calls of the core in test_driver.py

SHIPPED = calibrations.SHIPPED["dem-2026"]
CALIBRATE, COMPARE = ((ROOT / "docs" / name).read_text() for name in ("calibrate.md", "compare.md"))
TEXT = " ".join(COMPARE.split())        # without the ends of lines


def test_the_tables_of_the_page_are_those_of_the_file_that_is_shipped():
    tables = dem_2026.tables(SHIPPED)
    assert len(tables) == 7 and all(table in CALIBRATE for table in tables)


def test_the_file_saw_the_runs_of_the_program():
    runs = read_runs([*dem_2026.OLDER, *dem_2026.files(*dem_2026.FITTED)])
    for noted in read_toml(SHIPPED)["fitted"]:
        of_mu = [(run.name, run.seeds) for run in runs if run.mu == noted["mu"]]
        assert sorted(of_mu) == sorted(zip(noted["runs"], noted["seeds"]))


@pytest.mark.slow
def test_the_tables_of_cycles_on_the_page_are_those_of_the_program():
    for table in (*map(cycles.table, cycles.SCORED), cycles.ends()):
        assert table in COMPARE


@pytest.fixture(scope="module")
def turns():
    """Function that gives a quantity at the start, the turns and the end of cycles, of the grains and of each model by name."""
    def at_turns(programme, place, quantity):
        found = compare(dem_2026.files(programme, place=place), dem_2026.models("dem-2026"))
        run, = found.runs
        rows = [0, *np.flatnonzero(np.diff(np.sign(np.diff(run.columns["gamma"])))) + 1, len(run) - 1]
        columns = {"grains": run.columns} | {name: of_runs[0].columns for name, of_runs in found.predictions.items()}
        return {name: column[quantity][rows] for name, column in columns.items()}
    return at_turns


def test_in_small_cycles_the_grains_undo_what_the_fabric_turned_and_the_law_does_not(turns):
    fabric = turns("small-cycles-0.03", "mu0.5_phi0.600", "A_xz")
    out, back = ({name: abs(A[k + 1] - A[k]) for name, A in fabric.items()} for k in (0, 1))
    for closure in dem_2026.CLOSURES:
        assert out[closure] == pytest.approx(out["grains"], rel=0.15)
        assert back[closure] / out[closure] == pytest.approx(0.2, abs=0.05)
    assert back["grains"] / out["grains"] == pytest.approx(0.9, abs=0.05)
    ratio = turns("small-cycles-0.03", "mu0.5_phi0.600", "stress_ratio")
    ends = sorted(ratio[closure][-1] for closure in dem_2026.CLOSURES)
    assert f"it ends at {ends[0]:.2f} to {ends[-1]:.2f}, and at {ratio['grains'][-1]:.2f} in the grains" in TEXT


def test_two_of_four_loose_packings_liquefy_in_cycles():
    loose = [run.columns["p"].min() / run.columns["p"][0] for file in dem_2026.files("volume-cycles", place="mu0.5_phi0.600")
             for run in read_runs([file])]
    assert len(loose) == 4 and sum(share < 1e-3 for share in loose) == 2
