"""The annular shear cell against a solution in the radius alone, and against itself."""

import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import fem

DEMOS = Path(__file__).parents[2] / "demos"
sys.path.insert(0, str(DEMOS))
import annular_cell  # noqa: E402
import annulus  # noqa: E402
import regularisation  # noqa: E402
import where_it_fails  # noqa: E402

pytestmark = pytest.mark.release_only


def turned(rings=3, sectors=12, turn=0.03, back=0.015, increment=0.0075, **more):
    problem, inner = annular_cell.ring(annulus.SAND, rings, sectors, turn, **more)
    watch = annular_cell.Watch(problem, inner, rings, more.get("part", 1.0))
    fem.run(problem, turn + back, increment, events=[turn], observers=[watch])
    return watch.columns()


@pytest.fixture(scope="module")
def whole():
    return turned()


@pytest.mark.slow
def test_turning_and_turning_back_follows_the_radial_solution(tmp_path):
    data = annulus.main(**annulus.SHORT, out=tmp_path)    # asserts torque, iterations, scatter
    assert (tmp_path / "annulus.png").exists()
    for wall, (columns, _, _) in data["runs"].items():
        exact = data["radial"][wall]
        assert columns["path"] == pytest.approx(exact["path"])                       # no increment was cut
        assert columns["pressure"] == pytest.approx(exact["pressure"], rel=0.005)
        assert columns["phi"] == pytest.approx(exact["phi"], abs=2e-4)
        assert columns["torque"].max() > 0.02 and columns["torque"][-1] < -0.004
    assert data["runs"]["load"][0]["scatter_points"].max() < 0.1


def test_newton_converges_quadratically():
    _, residuals, _ = annulus.turn_and_back("load", 8, 1, 0.04, 0.0, part=1 / 48)
    for history in residuals[1:]:
        first, second, third = history[:3]                # linear convergence would leave ten times as much
        assert second < 50 * first**2 and third < 50 * second**2


def test_torque_is_of_second_order_before_shear_localises():
    exact = annulus.radial("load", 96, 0.02, 0.0, 0.004)["torque"][-1]
    errors = [abs(turned(rings, 1, 0.02, 0.0, 0.004, part=1 / (6 * rings))["torque"][-1] / exact - 1) for rings in (8, 16)]
    assert errors[0] / errors[1] > 3.5
    assert errors[1] < 1e-3


def test_sheared_zone_is_one_ring_of_cells_on_any_mesh():
    for rings, (_, _, width) in annulus.refine((4, 8), 8).items():
        assert width == pytest.approx(1 / rings, rel=0.15)


def test_scene_rotated_by_37_degrees_has_the_same_torque(whole):
    assert turned(rotated=np.radians(37))["torque"] == pytest.approx(whole["torque"], rel=1e-9, abs=1e-12)


def test_sector_tied_to_itself_is_the_ring(whole):
    part = turned(sectors=1, part=1 / 12)
    for name in ("torque", "pressure", "phi"):
        assert part[name] == pytest.approx(whole[name], rel=1e-9)


def test_hexahedra_between_two_planes_agree_with_quadrilaterals(whole):
    solid = turned(cell="hexahedron")              # B-bar averages a dilatation of three axes, not of two
    for name in ("torque", "pressure", "phi"):
        assert abs(solid[name] - whole[name]).max() < 0.007 * whole[name].max()
    assert solid["scatter"].max() < 1e-9


@pytest.mark.slow
def test_without_an_elastic_strain_full_needs_a_length_which_does_not_suit_basic(tmp_path):
    rows = where_it_fails.main(**where_it_fails.SHORT, out=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"where_it_fails.csv", "where_it_fails.png"}
    for row in rows:
        if row["elastic_strain"] == 0 and row["length"] == 0:
            assert row["reached"] == 0 and "does not converge" in row["why"]
        elif row["length"] and row["closure"] == "basic":                       # after the reversal, where eta_t < 0
            assert where_it_fails.TURN <= row["reached"] < where_it_fails.TURN + where_it_fails.BACK and row["why"]
        else:
            assert row["reached"] == pytest.approx(where_it_fails.TURN + where_it_fails.BACK) and row["why"] == ""
            assert (row["eta_t"] < 0) == (row["closure"] == "basic")


@pytest.mark.slow
def test_only_a_rate_term_or_a_length_gives_the_sheared_zone_a_width_and_the_length_costs_less(tmp_path):
    rows = regularisation.main(**regularisation.SHORT, out=tmp_path)         # asserts the widths
    assert {path.name for path in tmp_path.iterdir()} == {"regularisation.csv", "regularisation.png"}
    neither, fast, smooth = (rows[start:start + 2] for start in (0, 2, 4))              # 8 and 16 rings
    changes = [abs(fine["torque"] / coarse["torque"] - 1) for coarse, fine in (neither, fast, smooth)]
    assert max(changes[1:]) < 0.01 < changes[0]
    assert fast[1]["torque"] > smooth[1]["torque"] > 1.3 * neither[1]["torque"] and smooth[1]["width"] > 1.3 * fast[1]["width"]


def test_scatter_around_the_ring_is_that_of_skewed_cells():
    skewed, narrow, straight = (turned(8, 1, 0.12, 0.015, part=1 / sectors, twist=twist)["scatter_points"]
                                for sectors, twist in ((36, 0), (72, 0), (36, 0.07)))
    assert skewed[:-2].max() < 0.02 and skewed[-1] > 0.02
    assert narrow[-1] == pytest.approx(skewed[-1] / 2, rel=0.1)
    assert straight[-1] < skewed[-1] / 5


def test_ranks_agree(mpirun, whole):
    script = f"""
import sys
sys.path[:0] = [{str(DEMOS)!r}, {str(Path(__file__).parent)!r}]
from mpi4py import MPI
import test_annulus
columns = test_annulus.turned()
if MPI.COMM_WORLD.rank == 0:
    for name in ("torque", "pressure", "phi", "scatter_points"):
        print(*(repr(float(value)) for value in columns[name]))
"""
    for ranks in (2, 3):
        found = [np.array(line.split(), float) for line in mpirun(script, ranks).splitlines()]
        for name, values in zip(("torque", "pressure", "phi", "scatter_points"), found, strict=True):
            assert values == pytest.approx(whole[name], rel=1e-9, abs=1e-12)
