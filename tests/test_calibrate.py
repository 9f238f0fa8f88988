"""Calibration: constants of made data come back, what data cannot see is said, and the file is taken by every part."""

import os
import re
import signal
from dataclasses import replace

import numpy as np
import pytest

from granumat import Material, driver
from granumat.cli import main
from granumat.files import write_table
from granumat.grains import Run, Yardstick, calibrate, calibration, predict
from granumat.grains.fitting import Constants, Sample, fit
from granumat.grains.measured import FABRIC, STRESSES, with_ratios
from granumat.grains.sums import Sums, bins_of
from granumat.toml import read_toml, write_content

pytest.importorskip("scipy")
pytestmark = pytest.mark.release_only       # the debug build sees these calls of the core in test_driver and test_compare

KNOWN = {"a1": 0.0081, "b1": 0.17, "b2": -2.5, "phic": 0.583, "c1": -0.6, "c2": -9.0, "c3": 50.0, "d1": -60.0, "d2": 4.5,
         "d3": -25.0, "beta1": 8.5, "elastic_strain": 0.015}
TEN = [name for name in KNOWN if name not in ("a1", "elastic_strain")]
MEASURED = ("Z2", *FABRIC, *STRESSES)
CELL = ("p", "stress_ratio")


def made(material, phi, control="volume", name="", columns=MEASURED, increments=(25, 40)):
    """A reversal of the law as a measured run."""
    steps = [driver.shear(gamma, control, increments=n) for gamma, n in zip((-0.1, -0.8), increments)]
    history = driver.run(material, material.steady(phi), steps)
    found = {column: np.array(history[column]) for column in ("gamma", "gamma_total", "phi", *columns)}
    return Run(name or f"mu{material['mu']:g}_phi{phi:g}_{control}", material["mu"], material.contact, "steady",
               (control,) * (len(history) - 1), with_ratios(found), {}, 1, float(history["p"][0]))


def noisy(run, rng, share=0.02):
    """A run whose numbers err by a share of their sizes; what is held does not."""
    columns = {name: column.copy() for name, column in run.columns.items()}
    p, n = run.steady_pressure, len(run)
    held = set(run.controls) != {"volume"}
    for name, size in {"sigma_xx": p * (not held), "sigma_yy": p * (not held), "sigma_zz": p * (not held), "sigma_xz": 0.4 * p,
                       "Z2": 1.0, "A_xz": 0.045, "phi": 0.01 * held}.items():
        columns[name] += share * size * rng.standard_normal(n)
    return replace(run, columns=with_ratios(columns))


@pytest.fixture(scope="module")
def known():
    return Material(0.5, **KNOWN)


@pytest.fixture(scope="module")
def runs(known):
    return [made(known, phi, control) for phi, control in (
        (0.592, "volume"), (0.600, "volume"), (0.620, "volume"), (0.600, "normal-stresses"))]


# ---- made data come back ---------------------------------------------------------------------------------------------------

def test_constants_of_made_data_come_back_from_the_printed_ones(runs):
    found, = calibrate(runs, list(KNOWN)).sets
    for name, value in KNOWN.items():
        assert found.constants[name] == pytest.approx(value, rel=2e-3), name
    assert not found.unseen and not found.on_bounds
    assert found.comparison.scores("fitted")[:, 0, 0][:3].max() < 1e-3 < found.comparison.scores("start")[:, 0, 0][:3].min()


@pytest.mark.slow
def test_with_noise_they_come_back_within_three_deviations(runs, rng):
    found, = calibrate([noisy(run, rng) for run in runs], list(KNOWN)).sets
    for name, value in KNOWN.items():
        assert abs(found.constants[name] - value) < 3 * found.deviations[name], name
        assert found.deviations[name] < 0.3 * abs(value)


@pytest.mark.slow
def test_in_fifty_trials_with_two_per_cent_noise_each_constant_is_within_two_deviations_nine_times_in_ten(known, rng, tmp_path):
    runs = [made(known, phi, control, increments=(20, 16)) for phi, control in (
        (0.592, "volume"), (0.620, "volume"), (0.600, "normal-stresses"))]
    start = {name: value * (1.05 if name in TEN and name != "phic" else 1) for name, value in KNOWN.items()}
    write_content(tmp_path / "near.toml", {"constants": [{"mu": 0.5} | start]})
    inside = []
    for _ in range(50):
        found, = calibrate([noisy(run, rng) for run in runs], TEN, calibration=str(tmp_path / "near.toml")).sets
        inside.append([abs(found.constants[name] - KNOWN[name]) < 2 * found.deviations[name] for name in TEN])
    assert (np.mean(inside, axis=0) >= 0.9).all(), dict(zip(TEN, np.mean(inside, axis=0)))


def test_constants_of_mobilised_come_back_too(known, calibration_of):
    material = Material(**(known.definition | {"closure": "mobilised"}))
    names = ["elastic_strain", "b1", "b2", "d1", "phic"]
    found, = calibrate([made(material, phi) for phi in (0.592, 0.605, 0.620)], names, ["mobilised"], calibration_of(material)).sets
    for name in names:
        assert found.constants[name] == pytest.approx(material[name], rel=2e-3)


# ---- what the data do not see ----------------------------------------------------------------------------------------------

@pytest.fixture
def calibration_of(tmp_path):
    """Writes a calibration file with the constants of a material but some, and returns its name."""
    def write(material, **others):
        names = [name for name in calibration.RANGES_OF_FITS if (material.closure, name) != ("mobilised", "a4")]
        row = {"mu": material["mu"]} | {name: material[name] for name in names} | others
        write_content(tmp_path / "start.toml", {"constants": [row]})
        return str(tmp_path / "start.toml")
    return write


def direction(found, name):
    """The one direction that has a constant, in changes relative to the constants, of that constant 1."""
    mine, = (one for one in found.unseen if abs(one[name]) > 1e-3 * calibration.RANGES_OF_FITS[name][2])
    relative = {other: change / found.constants[other] for other, change in mine.items()}
    return {other: change / relative[name] for other, change in relative.items()}


def test_without_a_fabric_its_scale_is_found_as_a_direction_that_nothing_sees(known, calibration_of):
    scaled = Material(0.5, "basic", **{name: value for name, value in KNOWN.items() if name != "elastic_strain"}, a2=0.0)
    runs = [made(scaled, phi, columns=("Z2", *CELL)) for phi in (0.592, 0.620)]
    found, = calibrate(runs, ["b1", "b2", "c1", "c2", "c3", "d1"], ["basic"], calibration_of(scaled)).sets
    # A times 1 + e: c1 grows by e; what multiplies A, b2, c3 and d1, falls by e
    assert direction(found, "c1") == pytest.approx({"b1": 0, "b2": -1, "c1": 1, "c2": 0, "c3": -1, "d1": -1}, abs=0.01)
    assert found.unseen_in_words() == ["b2 by +10.0%, c1 by -10.0%, c3 by +10.0%, d1 by +10.0%"]


def test_without_z2_its_scale_and_its_zero_are_found(known, calibration_of):
    columns = tuple(name for name in MEASURED if name != "Z2")
    runs = [made(known, phi, columns=columns) for phi in (0.592, 0.620)]
    found, = calibrate(runs, ["a1", "a2", "Zc", "phic", "beta1", "d1", "d2"], calibration=calibration_of(known)).sets
    assert "Zc by +0.05" in found.unseen_in_words()
    expected = dict.fromkeys(found.deviations, 0.0) | {"a1": 1, "a2": 1, "beta1": -0.5, "d1": -0.5}
    assert direction(found, "a1") == pytest.approx(expected, abs=0.02)


def test_constant_volume_does_not_see_d3_which_stays_as_it_was(runs):
    found, = calibrate(runs[:3], ["phic", "d1", "d3"]).sets
    assert found.constants["d3"] == -40 and found.unseen_in_words() == ["d3 by +10.0%"]
    with_pressure, = calibrate(runs, ["phic", "d1", "d3"]).sets
    assert not with_pressure.unseen and with_pressure.deviations["d3"] < 10


@pytest.mark.slow
def test_one_volume_fraction_does_not_tell_phic_from_beta1(runs, rng):
    data = [noisy(run, rng) for run in runs]
    names = ["phic", "beta1", "d1", "d2"]
    one, several = (calibrate(data[:n], names).sets[0] for n in (1, 3))
    assert one.deviations["phic"] > 10 * several.deviations["phic"]
    assert ("phic", "beta1") in [pair[:2] for pair in one.correlated] or one.unseen


def test_a_shear_cell_holds_what_stress_and_volume_do_not_show(known):
    cell = [made(known, phi, columns=CELL) for phi in (0.592, 0.600, 0.620)]
    found, = calibrate(cell).sets
    assert set(found.held) == {"a1", "a2", "Zc", "c1", "a3", "a4"}
    assert all(found.constants[name] == Material(0.5)[name] for name in found.held)
    assert "held at their start, since nothing measured shows them: a1, a2, a3, a4, Zc, c1" in str(found)
    assert found.comparison.scores("fitted")[:, 0, :2].max() < 0.02          # p and the ratio, as good as with all columns


def test_constants_on_their_bounds_are_named(known, calibration_of):
    material = Material(**(known.definition | {"c2": -13.0, "c3": 0.0}))
    found, = calibrate([made(material, phi) for phi in (0.592, 0.620)], ["c1", "c2", "c3"], calibration=calibration_of(known)).sets
    assert found.on_bounds == ["c3"] and np.isnan(found.deviations["c3"])
    assert re.search(r"c3 +\S+ +on bound", str(found))
    assert found.constants["c2"] == pytest.approx(-13.0, rel=1e-2)


def test_the_deviations_are_those_of_linear_least_squares(rng):
    design = rng.standard_normal((400, 2)) @ [[1.0, 0.4], [0.0, 0.3]]
    r = design @ [0.7, -0.2] + 0.01 * rng.standard_normal(400)
    constants = Constants(("one", "two", "none"), np.zeros(3), np.full(3, -9.0), np.full(3, 9.0), np.ones(3))
    sample = Sample(np.full(400, 1 / 400), np.zeros(400, int))
    found = fit(lambda y: design @ y[:2] - r, sample, constants, np.zeros(3))
    np.testing.assert_allclose(found.y[:2], np.linalg.lstsq(design, r, rcond=None)[0], atol=1e-4)
    np.testing.assert_allclose(found.covariance[:2, :2], 0.01**2 * np.linalg.inv(design.T @ design), rtol=0.5)
    assert found.unseen.T.tolist() == [[0, 0, 1]] and found.y[2] == 0


# ---- weights ---------------------------------------------------------------------------------------------------------------

def test_bins_hold_equal_strain_within_phases_and_no_turn(known):
    run = made(known, 0.6, increments=(50, 160))
    phases, bins = bins_of(run)
    since = run.since_turn
    assert [len(np.unique(bins[phases == phase])) for phase in range(3)] == [20, 20, 8 + 1]     # and the row of steady shear
    for number in np.unique(bins):
        assert np.ptp(since[bins == number]) < 0.05 if np.isfinite(since[bins == number]).all() else (bins == number).sum() == 1


def test_an_equal_error_everywhere_is_the_error_of_every_mean_and_phases_count_alike(known, runs):
    sums = Sums([Yardstick.of(run) for run in runs])
    prediction = predict(runs[0], known)
    columns = dict(prediction.columns) | {"stress_ratio": runs[0].columns["stress_ratio"] + 0.034}
    errors = sums.errors(0, replace(prediction, columns=columns))
    ratio = sums.quantities[sums.rows([0])] == 1
    np.testing.assert_allclose(errors[ratio], 0.034 / 0.017, rtol=1e-12)
    np.testing.assert_allclose(errors[~ratio], 0, atol=1e-9)
    for number in range(len(runs)):
        for quantity in np.unique(sums.quantities[sums.rows([number])]):
            assert sums.sample.weights[sums.rows([number]) & (sums.quantities == quantity)].sum() == pytest.approx(1)


def test_the_scatter_of_seeds_weighs_errors(runs):
    scatter = {name: np.full(len(runs[0]), 0.2) for name in ("Z2",)}
    seeds = replace(runs[0], seeds=4, scatter=scatter)
    sums = Sums([Yardstick.of(run) for run in (seeds, runs[1])])
    assert sums.scatter[2] == pytest.approx(0.2) and sums.scatter[0] == 0.1         # Z2; p, whose scatter is not known
    prediction = predict(runs[0], Material(0.5))
    one, four = (Sums([Yardstick.of(run)]).errors(0, prediction) for run in (replace(runs[0], scatter=scatter), seeds))
    np.testing.assert_allclose(four, one * np.sqrt(2 / 1.25), rtol=1e-12)            # half of it is the packing's, half the law's


# ---- the file ----------------------------------------------------------------------------------------------------------------

def test_every_closure_takes_its_own_constants_from_the_file(runs, known, tmp_path):
    other = made(Material(0.3), 0.61)
    found = calibrate([*runs[:2], other], ["phic", "elastic_strain", "b1"], ["full", "mobilised"])
    found.write(tmp_path / "sand.toml")
    content = read_toml(tmp_path / "sand.toml")
    assert [row["mu"] for row in content["constants"]] == [0.3, 0.5] == [row["mu"] for row in content["mobilised"]]
    for one in found.sets:
        material = Material(one.mu, one.closure, calibration=str(tmp_path / "sand.toml"))
        for name, value in one.constants.items():
            assert material[name] == pytest.approx(value, rel=1e-5), name
    kinematic = Material(0.4, "kinematic", calibration=str(tmp_path / "sand.toml"))
    assert kinematic["phic"] == pytest.approx(np.mean([one.constants["phic"] for one in found.sets[:2]]), rel=1e-5)
    noted = content["fitted"][1]
    assert (noted["closure"], noted["mu"], noted["phi"], noted["seeds"]) == ("full", 0.5, [0.592, 0.6], [1, 1])
    assert noted["deviations"].keys() == {"b1", "phic", "elastic_strain"} and "p" in noted["scores run left out"]["all"]


@pytest.mark.slow
def test_runs_left_out_are_scored_by_run_by_phi_and_by_programme(runs):
    found, = calibrate([*runs, replace(runs[0], name="again_volume")], ["phic", "d1"]).sets
    assert list(found.comparison.predictions) == ["start", "fitted", "run left out", "phi left out", "programme left out"]
    single, = calibrate(runs[:1], ["phic"]).sets
    assert list(single.comparison.predictions) == ["start", "fitted"]


@pytest.mark.slow
def test_a_constant_is_as_if_its_only_run_had_not_been_there_where_that_run_is_left_out(runs):
    found, = calibrate(runs, ["phic", "d1", "d3"]).sets
    without, = calibrate(runs[:3], ["phic", "d1", "d3"]).sets
    expected = predict(runs[3], Material(0.5, **{name: without.constants[name] for name in ("phic", "d1", "d3")}))
    left_out = found.comparison.predictions["run left out"][3]
    np.testing.assert_allclose(left_out.columns["phi"], expected.columns["phi"], atol=2e-4)


# ---- the command -------------------------------------------------------------------------------------------------------------

@pytest.fixture
def table(runs, tmp_path):
    write_table(tmp_path / "cell.csv", {name: runs[0].columns[name] for name in ("gamma", "phi", *CELL)}, "%.8g")
    return tmp_path / "cell.csv"


def test_the_command_writes_a_file_that_compare_takes(table, tmp_path, capsys):
    out = tmp_path / "sand.toml"
    assert main(["calibrate", str(table), "--mu", "0.5", "--fit", "phic,fabric", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "mu 0.5, closure full, 1 run\n" in printed and "held at their start" in printed and f"wrote {out}" in printed
    (tmp_path / "fitted.toml").write_text(f'[material]\ncalibration = "{out.name}"\n')
    arguments = ["--material", str(tmp_path / "fitted.toml"), "--out", str(tmp_path / "scores")]
    assert main(["compare", str(table), "--mu", "0.5", *arguments]) == 0


def test_ctrl_c_leaves_the_constants_so_far_and_the_old_file(table, tmp_path, capsys, monkeypatch):
    count = iter(range(100))

    def predict_some(*arguments):
        if next(count) == 30:
            os.kill(os.getpid(), signal.SIGINT)
        return predict(*arguments)
    monkeypatch.setattr(calibration, "predict", predict_some)
    out = tmp_path / "sand.toml"
    out.write_text("old")
    arguments = ["calibrate", str(table), "--mu", "0.5", "--fit", "phic,fabric", "--out", str(out)]
    assert main(arguments) == 1
    assert "SIGINT has ended the calibration" in capsys.readouterr().err and out.read_text() == "old"
    partial = Material(0.5, calibration=str(tmp_path / "sand.partial.toml"))
    assert partial["phic"] != Material(0.5)["phic"]
    monkeypatch.undo()
    assert main([*arguments, "--calibration", str(tmp_path / "sand.partial.toml")]) == 0


def test_all_that_is_wrong_comes_in_one_message(table, tmp_path):
    (tmp_path / "bad.csv").write_text("gamma,phi,sigma_xz\n0,60,1\n0.1,60,nan\n")
    with pytest.raises(ValueError) as caught:
        calibrate([table, tmp_path / "bad.csv"], ["phi_c", "a4"], ["mobilised", "ful", "mobilised"], mu=0.5)
    for words in ("closure 'mobilised' is given 2 times", "did you mean 'full'", "bad.csv: phi is 60 to 60", "did you mean 'phic'",
                  "a4: has no role in the closure 'mobilised'"):
        assert words in str(caught.value)


def test_two_kinds_of_contacts_and_an_empty_list_are_refused(runs):
    with pytest.raises(ValueError, match="runs have hookean and hertzian contacts"):
        calibrate([runs[0], replace(runs[0], contact="hertzian")])
    with pytest.raises(ValueError, match="there is nothing to be fitted"):
        calibrate(runs, [])


@pytest.mark.parametrize("out, words", [
    ("sand", "must be a file that ends in .toml, in a directory that is there"), ("none/sand.toml", "in a directory that is there"),
    ("cell.toml", "the file that says what the data beside it are")])
def test_the_name_of_the_file_is_checked_before_anything_is_fitted(table, tmp_path, capsys, out, words):
    assert main(["calibrate", str(table), "--mu", "0.5", "--out", str(tmp_path / out)]) == 2
    assert words in capsys.readouterr().err and not (tmp_path / out).exists()
