"""The UMAT in CalculiX: demos/linking/calculix against the single-point driver and against a solver of our own."""

import re
from pathlib import Path

import numpy as np
import pytest

from support.plane_strain import block_reaction

ROOT = Path(__file__).resolve().parents[1]
PRINTED = 1e-6              # CalculiX prints seven digits


@pytest.fixture(scope="module")
def demo(calculix, tmp_path_factory):
    """What the demo's main returns."""
    import run
    return run.main(tmp_path_factory.mktemp("calculix"))


@pytest.mark.parametrize("name", ["volume", "pressure", "platen", "moving-platen", "biaxial", "rotation", "log-u", "cutback"])
def test_homogeneous_jobs_equal_the_driver_to_the_printed_digits(demo, name):
    errors = demo["errors"][name]
    assert all(error < PRINTED for error in errors.values()), errors


def test_decks_name_the_constants_as_the_page_of_the_umat_does(demo):
    from ccx import CONSTANTS
    table = (ROOT / "docs/umat.md").read_text().split("| PROPS | name |")[1].split("\n\n")[0]
    assert re.findall(r"^\| \d+ \| `(\w+)`", table, re.MULTILINE) == list(CONSTANTS)


def test_most_increments_of_a_homogeneous_job_take_two_iterations(demo):
    for name, output in demo["outputs"].items():
        assert np.median(output.iterations) == 2, name


def test_the_tangent_of_unloading_where_there_is_no_strain_costs_calculix_no_iteration(demo):
    outputs = [*demo["outputs"].values(), *(output for _, _, output in demo["reactions"].values())]
    assert sum(output.iterations.sum() for output in outputs) <= 1896              # with the tangent of going on; docs/umat.md


def test_two_threads_give_the_same_up_to_round_off(demo):
    one, two = demo["outputs"]["platen"], demo["threads"]
    assert np.array_equal(one.iterations, two.iterations)
    for quantity in ("displacement", "force", "stress", "statev"):
        a, b = getattr(one, quantity), getattr(two, quantity)
        assert np.abs(a - b).max() < 1e-12 * np.abs(a).max(), quantity


def test_a_cutback_that_the_umat_asks_for_is_made_and_recovered_from(demo):
    output = demo["outputs"]["cutback"]
    assert output.cutbacks == 1
    assert np.allclose(np.diff(output.time[-5:]), 0.25)          # PNEWDT = 0.25 of the step's only increment
    assert all(demo["outputs"][name].cutbacks == 0 for name in demo["outputs"] if name != "cutback")


def test_a_rigid_turn_through_abaqusnl_turns_the_stress(demo):
    for name in ("rotation", "log-u"):
        before, after = demo["outputs"][name].stress[[29, 59]]   # xx yy zz xy xz yz; z turns to x, x to -z
        turned = before[:, [2, 1, 0, 5, 4, 3]] * [1, 1, 1, 1, -1, -1]
        assert np.abs(after - turned).max() < PRINTED * np.abs(before).max()


def test_log_u_without_its_spin_is_not_the_same_as_shear(demo):
    spin, log_u = (demo["outputs"][name].stress[-1] for name in ("rotation", "log-u"))
    assert np.abs(spin - log_u).max() > 1e-3 * np.abs(spin).max()


def test_the_block_of_trilinear_elements_equals_a_solver_of_our_own(demo):
    import block
    ours, iterations = block_reaction(block.PROBLEM)
    _, force, output = demo["reactions"]["C3D8"]
    assert np.abs(force / ours - 1).max() < PRINTED
    assert np.median(output.iterations) > 2 * np.median(iterations)   # CalculiX keeps the symmetric part of the tangent only


def test_the_block_of_quadratic_elements_is_within_1_percent_of_b_bar_and_trilinear_ones_lock(demo):
    import block
    b_bar, _ = block_reaction(block.PROBLEM, b_bar=True)
    reactions = demo["reactions"]
    for element in ("C3D20R", "C3D8I"):
        assert np.abs(reactions[element][1] / b_bar - 1).max() < 0.01
    assert reactions["C3D8"][1][-1] > 1.05 * b_bar[-1]


def test_a_block_on_the_moving_mesh_departs_from_the_fixed_one_in_proportion_to_the_compression(demo):
    compression, fixed, _ = demo["reactions"]["C3D20R"]
    departure = demo["reactions"]["C3D20R moving"][1] / fixed - 1
    assert np.all((departure[1:] > 0) & (departure[1:] < 2 * compression[1:]))
