"""granumat compare: that histories made by the law itself have no error, that known errors have known scores, and that data which
are not as they must be are refused or repaired in words."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from granumat import Material, driver
from granumat.errors import RepairedDataWarning
from granumat.files import read_lines, write_table
from granumat.grains import KEYS, PHASES, QUANTITIES, Yardstick, compare, predict, read_runs
from test_cli import granumat, undocumented

pytestmark = pytest.mark.release_only

ROOT = Path(__file__).parents[1]
LAW = Material(mu=0.3)
PHI = 0.605
ROUND_OFF = 1e-10           # of scores of order 1; columns are written in full
REVERSAL = [driver.shear(0.5, increments=50), driver.shear(-1.2, increments=120)]
DATA = ("gamma", "phi", "Z2", *(f"A_{axis}" for axis in ("xx", "yy", "zz", "xy", "xz", "yz")),
        *(f"sigma_{axis}" for axis in ("xx", "yy", "zz", "xy", "xz", "yz")))


def history(steps=REVERSAL, law=LAW, start=None):
    """Columns that the law gives for steps from its steady state."""
    found = driver.run(law, law.steady(PHI) if start is None else start, steps)
    return {name: found[name].copy() for name in ("gamma_total", *DATA)}


def write(file, columns, **keys):
    """Write a table, and the keys beside it."""
    write_table(file, columns, "%.17g")
    file.with_suffix(".toml").write_text("".join(f"{name} = {json.dumps(value)}\n" for name, value in ({"mu": 0.3} | keys).items()))
    return file


def pressure(columns):
    return (columns["sigma_xx"] + columns["sigma_yy"] + columns["sigma_zz"]) / 3


def scores(files, **keys):
    """Scores of the printed law by phase and quantity, of the first run."""
    found = compare(files, **keys).scores("printed")[0]
    return {phase: dict(zip(QUANTITIES, of_phase)) for phase, of_phase in zip(PHASES, found)}


def assert_no_errors(found, unknown=(), tolerance=ROUND_OFF):
    for phase, of_phase in found.items():
        for name, score in of_phase.items():
            assert np.isnan(score) if name in unknown else score < tolerance, (phase, name, score)


# ---- the law against itself ----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("control, unknown", [
    ("volume", ["phi"]), ("pressure", ["p"]), ("normal-stresses", ["p", "N1/p", "N2/p"]), ("normal-load", [])])
def test_a_history_of_the_law_has_no_error_in_any_phase(tmp_path, control, unknown):
    steps = [driver.shear(0.5, control, 50), driver.shear(-1.2, control, 120)]
    assert_no_errors(scores([write(tmp_path / "run.csv", history(steps), control=control)]), unknown,
                     ROUND_OFF if control == "volume" else 2 * driver.TOLERANCE)         # that of the history, and that of the law


def test_a_history_of_the_law_that_starts_in_its_first_row_has_no_error(tmp_path):
    columns = history(driver.cycles(0.7, 2, "pressure", 70), start=LAW.isotropic(0.62, pressure=0.005))
    found = scores([write(tmp_path / "run.csv", columns, start="data", control="pressure")])
    assert np.isnan(list(found.pop("steady").values())).all()
    assert_no_errors(found, ["p"], driver.TOLERANCE)


def test_a_history_that_starts_sheared_in_its_first_row_has_no_error(tmp_path):
    found = scores([write(tmp_path / "run.csv", history([driver.shear(-0.7, increments=70)]), start="data")])
    found.pop("steady")
    assert_no_errors(found, ["phi"])


@pytest.mark.parametrize("contact", ["hookean", "hertzian"])
def test_a_start_without_coordination_number_has_that_of_its_pressure_and_fabric(tmp_path, contact):
    law = Material(mu=0.3, contact=contact)
    columns = history([driver.shear(-0.7, increments=70)], law)
    run, = read_runs([write(tmp_path / "run.csv", without("Z2")(columns), start="data", contact=contact)])
    assert predict(run, law).columns["Z2"] == pytest.approx(columns["Z2"], rel=1e-12)


@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_rows_before_the_shear_begins_are_left_out(tmp_path):
    steps = [driver.isotropic_compression(pressure=0.005, increments=5), driver.shear(0.7, "pressure", 70)]
    columns = history(steps, start=LAW.isotropic(0.62, pressure=0.001))
    columns["gamma"][:6] = columns["gamma_total"][:6] = 0.0                   # in the driver they grow by 2 abs(D)
    for name in ("gamma", "gamma_total"):
        columns[name][6:] = np.arange(1, 71) / 100
    run, = read_runs([write(tmp_path / "run.csv", columns, start="thermal", control="pressure")])
    assert len(run) == 71 and run.start == "data"
    assert np.nanmax(compare([run]).scores("printed")) < driver.TOLERANCE


def test_steps_to_a_pressure_hold_it(tmp_path):
    columns = history([driver.shear(0.3, "pressure", 30)]) | {"step": np.repeat([1, 2], [16, 15])}
    file = write(tmp_path / "run.csv", columns)
    file.with_suffix(".toml").write_text('mu = 0.3\n[[step]]\nshear = 0.15\ncontrol = "pressure"\n[[step]]\npressure = 0.01\n')
    assert set(read_runs([file])[0].controls) == {"pressure"}


def test_steps_with_other_controls_are_driven_each_by_its_own(tmp_path):
    steps = [driver.shear(0.3, "volume", 30), driver.shear(-0.3, "normal-stresses", 30), driver.shear(0.3, "pressure", 30)]
    columns = history(steps) | {"step": np.repeat([0, 1, 2, 3], [1, 30, 30, 30])}
    file = write(tmp_path / "run.csv", columns)
    file.with_suffix(".toml").write_text('mu = 0.3\n[[step]]\nshear = 0.3\n[[step]]\nshear = -0.3\ncontrol = "normal-stresses"\n'
                                         '[[step]]\nshear = 0.3\ncontrol = "pressure"\n')
    run, = read_runs([file])
    assert run.controls == ("volume",) * 30 + ("normal-stresses",) * 30 + ("pressure",) * 30
    assert_no_errors({"all": scores([file])["all"]}, tolerance=driver.TOLERANCE)


@pytest.mark.parametrize("change, keys", [
    (lambda columns: {name: -column if name.startswith("sigma") else column for name, column in columns.items()},
     {"positive": "extension"}),
    (lambda columns: {name: 2e5 * column if name.startswith("sigma") else column for name, column in columns.items()},
     {"stiffness": 2e5}),
    (lambda columns: {name.replace("sigma_", "p").replace("A_", "A"): column for name, column in columns.items()}, {}),
    (lambda columns: {name: column for name, column in columns.items() if name != "phi"}, {"phi": PHI}),
    (lambda columns: {"remark": columns["phi"]} | columns, {}),
], ids=["extension", "units", "names", "phi", "others"])
def test_signs_units_names_and_keys_do_not_matter_once_said(tmp_path, change, keys):
    assert_no_errors(scores([write(tmp_path / "run.csv", change(history()), **keys)]), ["phi"])


def test_a_shear_cell_that_has_only_stress_and_volume_is_scored_by_them(tmp_path):
    columns = history()
    cell = {name: columns[name] for name in ("gamma", "phi")} | {"p": 7e5 * pressure(columns),
                                                                "stress_ratio": -columns["sigma_xz"] / pressure(columns)}
    assert_no_errors(scores([write(tmp_path / "run.csv", cell, stiffness=7e5)]), ["phi", "Z2", "A_xz", "N1/p", "N2/p"])


def test_keys_of_a_call_come_before_those_beside_the_table(tmp_path):
    file = write(tmp_path / "run.csv", history(), mu=0.5)
    assert_no_errors(scores([file], mu=0.3), ["phi"])
    assert scores([file])["all"]["p"] > 0.1


def test_what_is_skipped_does_not_count(tmp_path):
    columns = history()
    columns["Z2"][columns["gamma_total"] < 0.195] = 9.0
    assert scores([write(tmp_path / "run.csv", columns)])["steady"]["Z2"] > 1
    assert_no_errors(scores([tmp_path / "run.csv"], skip=0.2), ["phi"])


# ---- known errors ----------------------------------------------------------------------------------------------------------

def test_known_offsets_have_known_scores_in_every_phase(tmp_path):
    columns = history()
    columns["Z2"] += 0.25
    columns["A_xz"] += 0.01
    columns["sigma_yy"] += 0.1 * columns["sigma_yy"]
    found = scores([write(tmp_path / "run.csv", columns)])
    for of_phase in found.values():
        assert of_phase["Z2"] == pytest.approx(0.25, rel=1e-9)
        assert of_phase["A_xz"] == pytest.approx(0.01 / LAW["kappa"], rel=1e-9)
    p, yy = (np.mean([columns[f"sigma_{axis}"][0] for axis in axes]) for axes in (("xx", "yy", "zz"), ("yy",)))
    assert found["steady"]["p"] == pytest.approx(yy / 1.1 * 0.1 / 3 / p, rel=1e-9)


def test_errors_count_by_strain_whatever_the_spacing_of_rows(tmp_path):
    fine, columns = history([driver.shear(-0.4, increments=400)]), {}
    rows = np.r_[0:100:10, 100:400:2, 400]
    columns = {name: column[rows].copy() for name, column in fine.items()}
    columns["Z2"][columns["gamma_total"] > 0.2] += 0.3
    found = scores([write(tmp_path / "run.csv", columns)])
    assert found["all"]["Z2"] == pytest.approx(0.3 * np.sqrt(0.5), rel=0.01)


def test_ratios_count_above_a_fifth_of_the_steady_pressure_and_fabric_above_a_twentieth(tmp_path):
    columns = history()
    steady = np.mean([columns[f"sigma_{axis}"][0] for axis in ("xx", "yy", "zz")])
    for row, share in ((80, 0.19), (90, 0.21), (100, 0.04), (110, 0.06)):
        p = np.mean([columns[f"sigma_{axis}"][row] for axis in ("xx", "yy", "zz")])
        for axis in ("xx", "yy", "zz", "xz"):
            columns[f"sigma_{axis}"][row] *= share * steady / p
    run, = read_runs([write(tmp_path / "run.csv", columns)])
    counted = ~np.isnan(Yardstick.of(run).measured[[80, 90, 100, 110]])
    for name, expected in (("stress_ratio", [0, 1, 0, 0]), ("N2/p", [0, 1, 0, 0]), ("Z2", [1, 1, 0, 1]), ("A_xz", [1, 1, 0, 1]),
                           ("p", [1, 1, 1, 1])):
        assert counted[:, QUANTITIES.index(name)].tolist() == expected, name


def test_phases_are_those_of_the_strain_since_the_last_turn(tmp_path):
    run, = read_runs([write(tmp_path / "run.csv", history())])
    strain = dict(zip(PHASES, Yardstick.of(run).weights.sum(axis=1)))
    assert strain == pytest.approx({"all": 1.7, "steady": 0.505, "first 0.1": 0.1, "0.1 to 0.5": 0.4, "later": 0.695}, abs=1e-9)


# ---- seeds -----------------------------------------------------------------------------------------------------------------

def seeds(tmp_path, *shifts):
    for number, shift in enumerate(shifts, 1):
        columns = history()
        write_table(tmp_path / f"run_s{number}.csv", columns | {"Z2": columns["Z2"] + shift}, "%.17g")
    (tmp_path / "run.toml").write_text("mu = 0.3\n")


def test_the_mean_of_seeds_is_scored_and_their_scatter_beside_it(tmp_path):
    seeds(tmp_path, 0.3, -0.2, -0.1)
    found = compare(sorted(tmp_path.glob("run_s*.csv")))
    assert found.runs[0].seeds == 3 and found.runs[0].name == "run"
    assert np.nanmax(found.scores("printed")) < ROUND_OFF
    deviation = np.std([0.3, -0.2, -0.1], ddof=1)
    assert found.scores("scatter")[0][:, QUANTITIES.index("Z2")] == pytest.approx(deviation, rel=1e-9)
    assert compare([tmp_path / "run_s1.csv"]).scores("printed")[0, 0, QUANTITIES.index("Z2")] == pytest.approx(0.3)


def test_a_table_of_means_or_scatter_stands_for_the_seeds_beside_it(tmp_path):
    seeds(tmp_path, 0.3, -0.3)
    for ending in ("mean", "scatter"):
        run, = read_runs([tmp_path / f"run_{ending}.csv"])
        assert run.seeds == 2 and run.scatter["Z2"] == pytest.approx(0.3 * np.sqrt(2))


def test_errors_of_p_are_relative_to_the_end_of_the_steady_shear_before_the_run(tmp_path):
    before = history([driver.shear(1.5, increments=150)], start=LAW.isotropic(0.605, pressure=0.02))
    columns = history([driver.shear(-0.3, increments=30)])
    for name, table in (("before_s7", before), ("run", columns)):
        write(tmp_path / f"{name}.csv", scaled(7.0, "sigma")(table), start="before.csv")
    (tmp_path / "before.toml").write_text('mu = 0.3\nstart = "packed"\n')
    assert read_runs([tmp_path / "run.csv"], stiffness=7.0)[0].steady_pressure == pytest.approx(pressure(before)[-50:].mean())


def test_without_steady_shear_before_it_errors_of_p_are_relative_to_that_of_the_run(tmp_path):
    def steady(number, columns, **keys):
        return read_runs([write(tmp_path / f"run{number}.csv", columns, **keys)])[0].steady_pressure
    columns = history()
    assert steady(1, columns) == pytest.approx(pressure(columns)[0])
    short = history([driver.shear(0.05, increments=5), driver.shear(-1.2, increments=120)])
    for axis in ("xx", "yy", "zz"):
        short[f"sigma_{axis}"][0] *= 1.3
    assert steady(2, short) == pytest.approx(pressure(short)[0])
    packed = history([driver.shear(1.5, increments=150)], start=LAW.isotropic(0.605, pressure=0.02))
    assert steady(3, packed, start="data") == pytest.approx(pressure(packed)[51:].mean(), rel=5e-3)


def test_scores_of_several_runs_have_their_root_mean_square(tmp_path):
    for number, shift in enumerate((0.3, 0.1)):
        columns = history()
        write(tmp_path / f"run{number}.csv", columns | {"Z2": columns["Z2"] + shift})
    rows = compare([tmp_path / "run0.csv", tmp_path / "run1.csv"]).rows()
    assert {model for _, _, model, _ in rows} == {"printed"}                   # there is no scatter
    assert [of_all[QUANTITIES.index("Z2")] for run, _, _, of_all in rows if run == "all 2 runs"] == pytest.approx(
        [np.sqrt(0.05)] * len(PHASES), rel=1e-9)


# ---- faults ----------------------------------------------------------------------------------------------------------------

def without(*names):
    return lambda columns: {name: column for name, column in columns.items() if name not in names}


def with_value(name, row, value):
    def change(columns):
        columns[name][row] = value
        return columns
    return change


def scaled(factor, *starts):
    return lambda columns: {name: factor * column if name.startswith(starts) else column for name, column in columns.items()}


@pytest.mark.parametrize("change, words", [
    (without("gamma"), "the column gamma, the shear strain, is missing: the table has gamma_total, phi"),
    (without("phi"), "the column phi is missing, and no key phi"),
    (without("Z2", "A_xz", *(f"sigma_{axis}" for axis in ("xx", "yy", "zz"))), "has nothing to compare: give at least one of p, "),
    (lambda columns: {name: column[:1] for name, column in columns.items()}, "has 1 row: must have a start and at least one row"),
    (with_value("gamma", 7, np.nan), "gamma is not a number in row 8"),
    (with_value("phi", slice(3, 5), np.inf), "phi is not a number in 2 rows, first in row 4"),
    (with_value("sigma_xx", 5, np.inf), "sigma_xx is infinite in row 6"),
    (with_value("Z2", slice(None), np.nan), "Z2 is not a number in any row: leave the column out"),
    (scaled(0, "gamma"), "gamma does not change: there is no shear"),
    (scaled(100, "gamma"), "gamma changes by up to 1 from row to row, by more than 0.5: is it in per cent?"),
    (scaled(100, "phi"), r"phi is 60.5 to 60.5: must be in \(0, 1\); is it in per cent?"),
    (scaled(-1, "sigma"), 'p is negative in 171 rows, first in row 1: where stresses are extension positive, give positive = "ext'),
    (scaled(2e5, "sigma"), r"p reaches \d+: stresses are in k/d, so that p is at most 0.5; give stiffness"),
    (scaled(-1, "sigma_xz"), "sigma_xz has the wrong sign: in steady shear with growing gamma it must be negative"),
    (scaled(-1, "A_xz"), "A_xz has the wrong sign: in steady shear with growing gamma it must be negative"),
    (lambda columns: columns | {"e_xz": 0.4 * columns["gamma"]}, "is not simple shear: e_xz is not half of gamma"),
    (scaled(10, "Z2"), "Z2 is 48.2 to 53.0.: is a number of contacts per grain"),
    (lambda columns: columns | {"A_xx": columns["A_xx"] + 1 / 3}, r"the fabric's trace .* reaches 0.333.*: must be 0"),
    (lambda columns: columns | {"p": columns["sigma_zz"] * 1.2}, "p is not a third of sigma_xx"),
    (lambda columns: columns | {"phi": np.linspace(0.605, 0.6, 171)}, "phi drifts by 0.005 where the volume should be constant"),
    (lambda columns: without("gamma_total")({name: column[np.random.default_rng(1).permutation(171)] for name, column in
                                             columns.items()}), "gamma turns at more than half of the rows: they are not in order"),
    (lambda columns: {name: np.delete(column, range(45, 55)) for name, column in columns.items()},
     "gamma_total does not grow by the change of gamma, first at gamma = 0.45.*some at turns are missing"),
])
def test_each_fault_of_a_table_has_its_words(tmp_path, change, words):
    with pytest.raises(ValueError, match=words):
        read_runs([write(tmp_path / "run.csv", change(history()))])


@pytest.mark.parametrize("name", ["sigma_xz", "A_xz"])
def test_wrong_signs_are_seen_long_after_a_turn_too(tmp_path, name):
    columns = history([driver.shear(-1.2, increments=120)], start=LAW.isotropic(0.62, pressure=0.005))
    with pytest.raises(ValueError, match=f"{name} has the wrong sign"):
        read_runs([write(tmp_path / "run.csv", scaled(-1, name)(columns), start="data")])


@pytest.mark.parametrize("keys, words", [
    ({"mu": 3.0}, "mu = 3.0: must be a number from 0 to 1"),
    ({"contact": "soft"}, "contact = 'soft': must be one of hookean, hertzian"),
    ({"start": "loose"}, "start = 'loose': must be one of steady, data, or the table"),
    ({"control": "stress"}, "control = 'stress': must be one of volume, pressure"),
    ({"phi": 60}, r"phi = 60: must be a number in \(0, 1\)"),
    ({"positive": "tension"}, "positive = 'tension': must be one of compression, extension"),
    ({"stiffness": -1}, "stiffness = -1: must be a number above 0"),
    ({"skip": 9}, "skip = 9 leaves 0 rows with shear: the accumulated strain ends at 1.7"),
    ({"contacts": "hookean"}, "unknown key 'contacts': .*did you mean 'contact'"),
])
def test_each_fault_of_a_key_has_its_words(tmp_path, keys, words):
    with pytest.raises(ValueError, match=words):
        read_runs([write(tmp_path / "run.csv", history(), **keys)])


def test_a_strain_to_skip_that_a_table_does_not_reach_is_refused_without_its_accumulated_strain_too(tmp_path):
    with pytest.raises(ValueError, match=r"skip = 9 leaves 0 rows with shear: the accumulated strain ends at 1.7"):
        read_runs([write(tmp_path / "run.csv", without("gamma_total")(history()))], skip=9.0)


def test_all_faults_of_all_tables_are_told_at_once(tmp_path):
    one = write(tmp_path / "one.csv", scaled(-1, "sigma")(without("phi")(history())))
    one.with_suffix(".toml").unlink()
    two = write(tmp_path / "two.csv", scaled(100, "gamma")(with_value("Z2", 3, np.inf)(history())), stiffness=0)
    with pytest.raises(ValueError) as error:
        read_runs([one, two, tmp_path / "three.csv"])
    for words in ("one.csv: mu, the friction coefficient between the grains, is not known", "one.csv: the column phi is missing",
                  "one.csv: p is negative", "two.toml: stiffness = 0: must be", "two.csv: Z2 is infinite",
                  "two.csv: gamma changes by up to 1", "three.csv"):
        assert words in str(error.value)


def test_seeds_of_other_strains_are_refused(tmp_path):
    seeds(tmp_path, 0, 0)
    write_table(tmp_path / "run_s3.csv", history([driver.shear(1.0, increments=170)]))
    with pytest.raises(ValueError, match=r"run_s3.csv: has other strains gamma than run_s1.csv"):
        read_runs(sorted(tmp_path.glob("run_s*.csv")))


def test_a_held_stress_that_is_not_known_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"sigma_zz is held \(control normal-load\), but is not known in any row"):
        read_runs([write(tmp_path / "run.csv", without("sigma_zz")(history()), control="normal-load")])


def test_rows_are_put_in_the_order_of_the_accumulated_strain_with_a_warning(tmp_path):
    columns = history()
    order = np.random.default_rng(1).permutation(171)
    file = write(tmp_path / "run.csv", {name: column[order] for name, column in columns.items()})
    with pytest.warns(RepairedDataWarning, match=r"run.csv: \d+ rows are not in the order of gamma_total: they were sorted by it"):
        assert_no_errors(scores([file]), ["phi"])


def test_rows_without_a_measurement_do_not_count_with_a_warning(tmp_path):
    columns = history()
    columns["Z2"][20:30] += np.nan
    columns["sigma_xx"][40] = np.nan
    file = write(tmp_path / "run.csv", columns)
    with pytest.warns(RepairedDataWarning, match="do not count: 10 of Z2, 1 of sigma_xx"):
        assert_no_errors(scores([file]), ["phi"])


# ---- models ----------------------------------------------------------------------------------------------------------------

def test_a_model_beside_the_printed_one_has_its_own_scores(tmp_path):
    law = Material(mu=0.3, closure="kinematic", Zc=4.5)
    found = compare([write(tmp_path / "run.csv", history(law=law))], {"mine": {"closure": "kinematic", "Zc": 4.5}})
    assert np.nanmax(found.scores("mine")) < ROUND_OFF
    assert found.scores("printed")[0, :, QUANTITIES.index("Z2")] == pytest.approx(abs(LAW["Zc"] - 4.5))


def test_a_model_of_other_grains_or_a_taken_name_is_refused(tmp_path):
    file = write(tmp_path / "run.csv", history())
    with pytest.raises(ValueError, match=r"other, run: the model is of other grains:\s*mu = 0.5, but the run has 0.3"):
        compare([file], {"other": {"mu": 0.5}})
    with pytest.raises(ValueError, match="a model cannot have the name 'printed'"):
        compare([file], {"printed": {}})


def test_rows_that_the_law_does_not_reach_have_infinite_errors_and_words(tmp_path):
    columns = history([driver.shear(-0.7, "normal-stresses", 70)])
    columns["sigma_xx"][51:] *= 8
    found = compare([write(tmp_path / "run.csv", columns, control="normal-stresses")])
    of_phase = dict(zip(PHASES, found.scores("printed")[0, :, QUANTITIES.index("Z2")]))
    assert of_phase["0.1 to 0.5"] < driver.TOLERANCE and of_phase["later"] == of_phase["all"] == np.inf
    assert "printed ends at gamma_total = 0.5" in str(found) and found.predictions["printed"][0].message in str(found)


# ---- the command -----------------------------------------------------------------------------------------------------------

@pytest.mark.slow
def test_the_command_writes_scores_tables_and_pictures(tmp_path):
    seeds(tmp_path, 0.1, -0.1)
    (tmp_path / "mine.toml").write_text('[material]\nclosure = "kinematic"\n')
    result = granumat("compare", "run_mean.csv", "--material", "mine.toml", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0 and result.stderr == ""
    assert "run: mu 0.3, hookean, phi 0.605, held: volume, 2 seeds" in result.stdout
    for name in ("scores.csv", "run.csv", "run.png"):
        assert f"wrote out/{name}" in result.stdout and (tmp_path / "out" / name).stat().st_size
    with (tmp_path / "out/scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["model"] for row in rows} == {"printed", "mine", "scatter"} and {row["phase"] for row in rows} == set(PHASES)
    names, table = read_lines(tmp_path / "out/run.csv")
    assert table.shape == (171, len(names)) and {"Z2", "Z2 scatter", "Z2 printed", "Z2 mine"} < set(names)


@pytest.mark.slow
def test_the_command_gives_json_and_faults_with_status_2(tmp_path):
    write_table(tmp_path / "run.csv", history(), "%.17g")
    result = granumat("compare", "run.csv", "--mu", 0.3, "--out", "out", "--json", cwd=tmp_path)
    found = json.loads(result.stdout)
    assert not undocumented([*found, *found["scores"][0].keys() - set(QUANTITIES)], "`compare`")
    row = found["scores"][0]
    assert (row["run"], row["phase"], row["model"], row["phi"]) == ("run", "all", "printed", None) and row["p"] < ROUND_OFF
    result = granumat("compare", "run.csv", "--mu", 3, "--out", "none", cwd=tmp_path)
    assert result.returncode == 2 and "mu = 3.0: must be" in result.stderr and not (tmp_path / "none").exists()


# ---- pages -------------------------------------------------------------------------------------------------------------------

PAGE = (ROOT / "docs/compare.md").read_text()


def test_the_page_shows_what_the_command_prints():
    shown = re.search(r"^```\n(cv_.*?)^```$", PAGE, re.M | re.S)[1]
    assert shown == f"{compare(sorted((ROOT / 'demos/data').glob('cv_mu0.5_phi0.600_s*.csv')))}\n"


def test_the_page_names_every_key_quantity_and_phase():
    tables = [set(re.findall(r"`([^`]+)`", row)) for row in re.findall(r"^\| (`[^|]+) \|", PAGE, re.M)]
    assert set().union(*tables) >= {*KEYS, *QUANTITIES, *PHASES}


# ---- the data of the repository ------------------------------------------------------------------------------------------

def test_runs_in_the_repository_have_the_steady_values_that_their_page_says():
    found = compare(sorted((ROOT / "demos/data").glob("cv_*.csv")))
    assert [(run.mu, run.seeds, len(run)) for run in found.runs] == [(0.1, 1, 420), (0.3, 1, 420), (0.5, 2, 600)]
    steady = [run.steady_pressure for run in found.runs]
    assert steady == pytest.approx([0.0070, 0.0087, 0.0102], abs=6e-5)          # demos/data/README.md, as what follows
    steady = found.runs[0].since_turn == np.inf
    assert [found.runs[0].columns[name][steady].mean() for name in ("Z2", "A_xz", "stress_ratio", "N1/p", "N2/p")] == pytest.approx(
        [6.16, -0.035, 0.274, -0.062, 0.095], abs=6e-3)


def is_sheared(file):
    names, table = read_lines(file)
    return np.ptp(table[:, names.index("gamma")]) > 0            # a pause and an isotropic compression have no shear


SHEARED = [file for file in sorted((ROOT / "demos/data/ensemble").glob("*/*_s*.csv"))
           if re.search(r"_s\d+$", file.stem) and is_sheared(file)]


@pytest.mark.parametrize("folder", sorted({file.parent for file in SHEARED}), ids=lambda folder: folder.name)
def test_every_shear_of_the_ensemble_can_be_compared(folder):
    files = [file for file in SHEARED if file.parent == folder]
    found = compare(files)
    assert sum(run.seeds for run in found.runs) == len(files)
    for of_run, prediction in zip(found.scores("printed"), found.predictions["printed"]):
        assert np.isfinite(of_run[0][~np.isnan(of_run[0])]).all() == (not prediction.message), prediction.message
