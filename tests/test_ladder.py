"""The ladder: that it is not fooled by runs made up to fool it, that it can be killed, and what it says of a point."""

import csv
import os
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from granumat import coarsen, driver, estimate, ladder
from granumat.coarsen import MODEL, NUMERICS, Axis, Rung
from granumat.paths import read_path_file
from granumat.quantities import Quantity
from granumat.runs import Result, Runs

pytestmark = pytest.mark.release_only

TIMES = np.linspace(0, 1, 5)


def setting(key, value):
    """A rung that sets a key."""
    return Rung(f"{key} {value:g}" if isinstance(value, float) else str(value), lambda content: {**content, key: value})


MESH = Axis("mesh", NUMERICS, tuple(replace(setting("h", 2.0**k), size=2.0**k) for k in range(-6, 4)), 8, True, setting("h", 1.0))
CLOSURE = Axis("closure", MODEL, (setting("closure", "full"), setting("closure", "n2"), setting("closure", "critical")))
RELAXATION = Axis("elastic strain", MODEL, (setting("e_r", 0.01), setting("e_r", 0.0)))
CONTENT = {"h": 1.0, "closure": "full", "e_r": 0.01}


class MadeUp:
    """A runner whose only quantity follows from a function of the content."""

    kinks = (0.0,)

    def __init__(self, value, seconds=lambda content: 1 / content["h"], share=lambda content: 0.5, quantities=None):
        self.value, self.seconds, self.share = value, seconds, share
        self.quantities = quantities or [Quantity("force", "force")]
        self.ran = []

    def run(self, content, directory):
        self.ran.append(content)
        values = np.broadcast_to(np.asarray(self.value(content), float), (len(self.quantities),))
        table = {"t": TIMES} | {quantity.name: value * np.ones_like(TIMES) for quantity, value in zip(self.quantities, values)}
        return Result(table, self.seconds(content), {}, self.share(content))

    def on_one(self, function):
        return function()


def climb(tmp_path, runner, tolerance=0.05, axes=(MESH, CLOSURE, RELAXATION), budget=None):
    return ladder.Ladder(CONTENT, axes, runner.quantities, tolerance, Runs(runner, tmp_path, budget=budget)).climb()


def study(report, name):
    return next(study for study in report.studies if study.axis.name == name)


def rungs(report):
    return {name: finding.rung.name for name, finding in report.choice.items()}


# ---- runs made up to fool it --------------------------------------------------------------------------------------------

def test_a_smooth_error_is_extrapolated_and_the_coarsest_mesh_within_the_tolerance_is_recommended(tmp_path):
    report = climb(tmp_path, MadeUp(lambda content: 1 + 0.02 * content["h"]))
    true = 0.02 * report.content["h"]
    assert report.is_proved and true <= 0.05 and 0.02 * 2 * report.content["h"] > 0.05
    assert true <= report.predicted[0] <= 2 * true


def test_meshes_that_agree_by_accident_do_not_end_the_refinement(tmp_path):
    # differences of 0.2, 1.7 and 1.1 %, as a biaxial block has them, then falling with order 1
    values = dict(zip(2.0 ** np.arange(2, -7, -1), 1 + np.cumsum([0, 0.002, 0.017, 0.011, 0.0055, 0.0028, 0.0014, 0.0007, 0.0003])))
    values[8.0] = 0.9
    report = climb(tmp_path, MadeUp(lambda content: values[content["h"]]), tolerance=0.02)
    true = abs(values[report.content["h"]] / values[2.0**-6] - 1)
    assert len(study(report, "mesh").findings) > 3
    assert report.is_proved and true <= 0.02 and report.predicted[0] >= true


def remainder(*differences, sizes=None):
    sizes = 2.0 ** -np.arange(len(differences) + 1) if sizes is None else sizes
    return estimate.remainder(differences, sizes)


@pytest.mark.parametrize("differences", [(0.017, 0.002), (0.011, 0.017, 0.002), (0.002, 0.017)])
def test_an_accidental_agreement_is_not_believed(differences):
    assert remainder(*differences) > 0.01


@pytest.mark.parametrize("order", [0.5, 1, 2])
def test_extrapolation_is_exact_up_to_its_factor_for_orders_half_to_two_also_where_sizes_are_not_halved(order):
    for sizes in (np.array([8.0, 4, 2]), np.array([0.0667, 0.0276, 0.0126])):
        assert np.isclose(remainder(*np.abs(np.diff(0.1 * sizes**order)), sizes=sizes), estimate.SAFETY * 0.1 * sizes[-1]**order)


def test_extrapolation_is_careful_beyond_these_orders():
    assert remainder(0.01, 0.01) > 0.02                                                           # order 0
    assert remainder(0.01) > 0.02                                                                 # two meshes only
    assert remainder(np.inf, 0.01) == np.inf and remainder(0.0, 0.0) == 0
    assert remainder(0.01, -0.004) > 0.004                                                        # it turns: at least as far again


def test_each_time_is_extrapolated_by_itself():
    results = [Result({"t": TIMES, "force": np.array([1, 1, 1, first, second])}, 1.0, {}) for first, second in (
        (1.08, 0.97), (1.04, 1.0), (1.02, 0.99))]                # the largest differences fall with order 1, the last value turns
    found = estimate.remainders(results, (4.0, 2.0, 1.0), [Quantity("force", "force", (0.75, 1.0), scale=1.0)])
    assert np.isclose(found[0], max(estimate.SAFETY * 0.02, estimate.SAFETY * 0.01))


def test_what_does_not_converge_gets_no_mesh_and_says_so(tmp_path):
    report = climb(tmp_path, MadeUp(lambda content: 1 + 0.04 * np.log2(content["h"])))
    assert "does not converge" in study(report, "mesh").verdict and not report.is_proved
    assert report.content["h"] == 1                                                               # the file's own


ACCIDENT = dict(zip(2.0 ** np.arange(3, -7, -1), 1 + np.cumsum([0, 0.01, 0.002, 0.017, 0.011, 0.012, 0.01, 0.011, 0.01, 0.01])))


def test_where_no_mesh_is_fine_enough_the_finest_is_recommended_and_nothing_is_proved(tmp_path):
    report = climb(tmp_path, MadeUp(lambda content: 1 + 2.0 * content["h"], quantities=[
        Quantity("force", "force", scale=1.0)]), tolerance=0.01)
    assert report.content["h"] == 2.0**-6 and not report.is_proved and "may be off by 3.9%" in study(report, "mesh").remark


def test_what_localises_gets_no_mesh_although_its_quantity_agrees_on_some(tmp_path):
    report = climb(tmp_path, MadeUp(lambda content: ACCIDENT[content["h"]], share=lambda content: 0.05 * content["h"]))
    assert "localises" in study(report, "mesh").verdict and report.content["h"] == 1


def test_what_localises_but_converges_for_sure_gets_a_mesh_and_a_remark(tmp_path):
    report = climb(tmp_path, MadeUp(lambda content: 1 + 0.02 * content["h"], share=lambda content: 0.05 * content["h"]))
    assert report.is_proved and "localises" in study(report, "mesh").remark and not study(report, "mesh").verdict
    report = climb(tmp_path / "other", MadeUp(lambda content: 1.0, share=lambda content: 0.2 + 0.02 * content["h"]))
    assert not study(report, "mesh").remark and report.content["h"] == 8


def test_noise_far_below_the_tolerance_does_no_harm_and_above_it_is_no_convergence(tmp_path, rng):
    noise = {2.0**k: rng.uniform(-1, 1) for k in range(-6, 4)}
    report = climb(tmp_path, MadeUp(lambda content: 1 + 1e-3 * noise[content["h"]]))
    assert report.is_proved and not study(report, "mesh").verdict
    report = climb(tmp_path / "loud", MadeUp(lambda content: 1 + 0.05 * noise[content["h"]]))
    assert study(report, "mesh").verdict


def test_two_poor_models_that_agree_with_each_other_are_refused(tmp_path):
    def value(content):
        return 0.13 if content["closure"] == "critical" else 1.0                                  # whatever e_r is

    def seconds(content):
        return (0.2 if content["closure"] == "critical" else 1.0) * (0.8 if content["e_r"] == 0 else 1.0) / content["h"]
    report = climb(tmp_path, MadeUp(value, seconds))
    assert rungs(report)["closure"] != "critical" and rungs(report)["elastic strain"] == "e_r 0"
    assert np.isclose(study(report, "closure").findings[2].errors[0], 0.87 * ladder.MODEL_FACTOR)


def test_a_rung_that_costs_the_same_is_not_recommended(tmp_path):
    def seconds(content):
        return {"full": 1.0, "n2": 0.95, "critical": 0.5}[content["closure"]] / content["h"]
    report = climb(tmp_path, MadeUp(lambda content: {"critical": 2.0}.get(content["closure"], 1.0), seconds))
    assert rungs(report)["closure"] == "full"


def test_errors_that_add_up_are_not_allowed_together(tmp_path):
    def value(content):
        return 1 + 0.03 * (content["closure"] != "full") + 0.03 * (content["e_r"] == 0)

    def seconds(content):
        return (0.5 if content["closure"] == "n2" else 1.0) * (0.7 if content["e_r"] == 0 else 1.0) / content["h"]
    report = climb(tmp_path, MadeUp(value, seconds))
    assert rungs(report)["closure"] == "n2" and rungs(report)["elastic strain"] == "e_r 0.01"     # one of the two, the dearer
    assert report.is_proved


def test_errors_that_more_than_add_up_are_found_by_the_proof(tmp_path):
    def value(content):
        return 1 + 0.015 * (content["closure"] != "full") + 0.015 * (content["e_r"] == 0) + 0.2 * (
            content["closure"] != "full" and content["e_r"] == 0)

    def seconds(content):
        return (0.5 if content["closure"] == "n2" else 1.0) * (0.7 if content["e_r"] == 0 else 1.0) / content["h"]
    report = climb(tmp_path, MadeUp(value, seconds))
    assert report.is_proved and report.measured[0] <= 0.05
    assert not (rungs(report)["closure"] == "n2" and rungs(report)["elastic strain"] == "e_r 0")


def test_models_are_compared_on_a_third_mesh_where_two_differ(tmp_path):
    runner = MadeUp(lambda content: 1 + (0.02 / content["h"]**2 if content["closure"] == "n2" else 0))
    found = study(climb(tmp_path, runner), "closure").findings[1]
    assert len({content["h"] for content in runner.ran if content["closure"] == "n2"}) == 3
    assert np.isclose(found.errors[0], ladder.MODEL_FACTOR * 0.02)                                # at h = 1


def test_quantities_that_want_different_rungs_are_named(tmp_path):
    def values(content):
        return (1.0, 1.5) if content["closure"] == "critical" else (1.0, 1.0)

    def seconds(content):
        return (0.5 if content["closure"] == "critical" else 1.0) / content["h"]
    runner = MadeUp(values, seconds, quantities=[Quantity("p", "p"), Quantity("shear", "shear")])
    report = climb(tmp_path, runner)
    assert rungs(report)["closure"] == "full"
    assert {name: choice["closure"].rung.name for name, choice in report.alone.items()} == {"p": "critical", "shear": "full"}


# ---- budget, kill and resume --------------------------------------------------------------------------------------------

@pytest.mark.parametrize("budget", range(4, 12))
def test_a_budget_is_kept_and_what_could_not_be_decided_is_said(tmp_path, budget):
    runner = MadeUp(lambda content: 1 + 0.02 * content["h"] + 0.5 * (content["closure"] == "critical"))
    report = climb(tmp_path, runner, budget=budget)
    assert len(runner.ran) <= budget
    assert report.undecided and report.recommended is not None
    assert "closure" in report.undecided or budget > 7


class Killed(Exception):
    pass


def test_a_climb_that_is_killed_anywhere_goes_on_and_runs_nothing_twice(tmp_path):
    def value(content):
        return 1 + 0.02 * content["h"] + 0.5 * (content["closure"] == "critical")
    whole = MadeUp(value)
    wanted = climb(tmp_path / "whole", whole)

    class Mortal(MadeUp):
        def run(self, content, directory):
            if len(self.ran) == 1:
                raise Killed
            return super().run(content, directory)
    ran = []
    for _ in range(100):
        runner = Mortal(value)
        try:
            report = climb(tmp_path / "killed", runner)
        except Killed:
            report = None
        ran += runner.ran
        if report:
            break
    assert report and rungs(report) == rungs(wanted) and (report.measured == wanted.measured).all()
    assert ran == whole.ran


def test_a_run_of_another_content_is_not_taken_for_the_own(tmp_path):
    runner = MadeUp(lambda content: content["h"])
    assert Runs(runner, tmp_path).get({"h": 1.0}, "a").table["force"][0] == 1
    assert Runs(runner, tmp_path).get({"h": 2.0}, "a").table["force"][0] == 2
    result = next((tmp_path / "runs").glob("*/result.json"))
    result.write_text(result.read_text()[:40])                                                    # as if killed while writing
    assert {Runs(runner, tmp_path).get({"h": h}, "a").table["force"][0] for h in (1.0, 2.0)} == {1, 2} and len(runner.ran) == 3


# ---- coarser contents ---------------------------------------------------------------------------------------------------

def test_increments_of_a_path_are_coarsened_so_that_its_times_are_still_met():
    content = {"step": [{"shear": 1.0}, {"cycles": 2, "amplitude": 0.1, "increments": 24}, {"pause": True},
                        {"shear": 1.0, "increments": 64, "until": "steady"}], "quantity": [{"at": [0.25, 1.25, 2.5]}]}
    axis = next(axis for axis in coarsen.path_axes(content) if axis.name == "increment")
    found = {rung.name: [step.get("increments") for step in rung.change(content)["step"]] for rung in axis.rungs}
    assert found["as in the file"] == [None, 24, None, 64]
    assert found["2 times the file's"] == [100, 12, None, 64] and "4 times the file's" not in found   # row 50 of 200 is wanted
    assert found["0.5 times the file's"] == [400, 48, None, 64]


def test_a_lower_closure_loses_the_constants_that_it_has_no_use_for():
    content = {"material": {"a3": 1.0, "a1": 0.01}}
    names = [rung.change(content)["material"] for rung in coarsen.closures(content).rungs]
    assert names == [{"a3": 1.0, "a1": 0.01}, {"a3": 1.0, "a1": 0.01, "closure": "n2"}, {"a1": 0.01, "closure": "basic"},
                     {"a3": 1.0, "a1": 0.01, "closure": "critical"}]


# ---- at a point ---------------------------------------------------------------------------------------------------------

REVERSAL = """
[material]
elastic_strain = 0.01
[initial]
phi = 0.60
state = "steady"
[[step]]
shear = 1.0
[[step]]
shear = -2.0
increments = 400
"""
START_UP = """
[initial]
phi = 0.60
state = "isotropic"
pressure = 0.01
[[step]]
shear = 3.0
increments = 600
"""


def path_file(tmp_path, text, at, *columns):
    file = tmp_path / "path.toml"
    file.write_text(text + "".join(f'[[quantity]]\nname = "{name}"\nof = "{name}"\nat = {at}\n' for name in columns))
    return file


def found_errors(report, axis, rung):
    errors = next(finding.errors for finding in study(report, axis).findings if finding.rung.name == rung)
    return dict(zip((quantity.name for quantity in report.quantities), errors))


def test_after_a_reversal_critical_is_refused_and_basic_accepted_for_p_but_not_for_the_full_stress(tmp_path):
    stress = [f"sigma_{axis}" for axis in ("xx", "yy", "zz", "xz")]
    file = path_file(tmp_path, REVERSAL, [1.005, 1.05, 1.25, 2], "p", *stress)
    report = ladder.climb(file, 0.05, tmp_path / "out")
    assert found_errors(report, "closure", "critical")["p"] > 0.5
    assert found_errors(report, "closure", "basic")["p"] < 1e-6
    assert max(found_errors(report, "closure", "basic").values()) > 0.05
    assert rungs(report)["closure"] in ("full", "n2")                                             # whichever the clock prefers
    words = (tmp_path / "out/ladder.txt").read_text()
    assert "no transient" in words and "normal stress differences" in words and "elastic strain" in words
    assert "not against grains" in words and "below the floor" in words


@pytest.mark.slow
def test_after_a_strain_of_1_critical_is_accepted_for_p_and_ratio(tmp_path):
    file = path_file(tmp_path, START_UP, "[0.5, 1]", "p", "stress_ratio")
    report = ladder.climb(file, 0.05, tmp_path / "out")
    assert max(found_errors(report, "closure", "critical").values()) < 0.05
    file = path_file(tmp_path, START_UP, "[0.05, 1]", "p", "stress_ratio")
    report = ladder.climb(file, 0.05, tmp_path / "early")
    assert max(found_errors(report, "closure", "critical").values()) > 0.05


def test_the_recommended_file_runs_and_its_error_is_the_printed_one(tmp_path):
    file = path_file(tmp_path, REVERSAL, [1.005, 1.25, 2], "p", "stress_ratio")
    report = ladder.climb(file, 0.05, tmp_path / "out")
    text = (tmp_path / "out/recommended.toml").read_text()
    path = read_path_file(tmp_path / "out/recommended.toml")
    history = driver.run(path.material, path.state, path.steps, tolerance=path.tolerance)
    for number, quantity in enumerate(path.quantities):
        _, values = quantity.pick(history.times, history[quantity.of])
        _, wanted = quantity.pick(report.top.table["t"], report.top.table[quantity.name])
        error = abs(values - wanted).max() / quantity.scale_of(report.top.table[quantity.name])
        assert np.isclose(error, report.measured[number], rtol=1e-9, atol=1e-15)
        assert f"{quantity.name}: error {error:.2%}" in text
    with open(tmp_path / "out/ladder.csv", encoding="utf-8") as table:
        found = list(csv.DictReader(table))
    assert sum(row["state"] == "recommended" for row in found) == len(report.choice)
    assert (tmp_path / "out/ladder.png").read_bytes()[:4] == b"\x89PNG"
    assert tomllib.loads(text)["quantity"][0]["name"] == "p"


@pytest.mark.slow
def test_a_real_kill_loses_nothing(tmp_path):
    file = path_file(tmp_path, REVERSAL, [1.25, 2], "p", "stress_ratio")
    command = [sys.executable, "-m", "granumat", "ladder", str(file), "--tolerance", "0.05", "--out", str(tmp_path / "out")]

    def complete():
        return {result: result.stat().st_mtime_ns for result in (tmp_path / "out").glob("runs/*/result.json")}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while len(complete()) < 3 and process.poll() is None:
            time.sleep(0.005)
        os.kill(process.pid, signal.SIGKILL)
    before = complete()
    assert len(before) >= 3
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and "Recommended" in done.stdout, done.stderr
    assert before.items() <= complete().items() and done.stderr.count("run ") <= len(complete()) - len(before)


def test_mistakes_are_named_before_anything_is_run(tmp_path):
    file = path_file(tmp_path, REVERSAL, [2])
    with pytest.raises(ValueError, match="there is nothing to compare models by"):
        ladder.climb(file, 0.05, tmp_path / "out")
    with pytest.raises(ValueError, match=r"tolerance = 2.*\n.*budget = 3"):
        ladder.climb(file, 2, tmp_path / "out", budget=3)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("step, keeps", [
    ({"test": "dss", "strain": 0.1}, True), ({"test": "dss", "strain": 0.1, "control": "volume"}, False),
    ({"test": "oedometer", "sigma_zz": 0.02}, True), ({"test": "oedometer", "compression": 0.01}, False),
    ({"test": "triaxial-cyclic-drained", "number": 1, "stress_amplitude": 0.001}, True),
    ({"test": "triaxial-cyclic-undrained", "number": 1, "stress_amplitude": 0.001}, False),
    ({"test": "dss-cyclic", "number": 1, "amplitude": 0.01}, False),
    ({"test": "dss-cyclic", "number": 1, "amplitude": 0.01, "control": "normal-load"}, True)])
def test_the_critical_closure_starts_from_the_pressure_only_where_the_volume_is_free(step, keeps):
    content = {"initial": {"state": "isotropic", "phi": 0.6, "pressure": 0.01}, "step": [step]}
    critical = coarsen.closures(content).rungs[-1].change(content)
    assert ("pressure" in critical["initial"]) == keeps and critical["material"]["closure"] == "critical"
