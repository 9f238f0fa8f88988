"""Whatever ends a run, nothing that it wrote is lost, and no two runs are mixed."""

import contextlib
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import GranumatError, Material, cli, driver, fem
from granumat.errors import InterruptedRunError
from granumat.fem import scene
from granumat.fem.ladder import Monitor, SceneRunner
from granumat.files import LOCK, appending, locked, run_files
from granumat.progress import Progress
from granumat.runs import Runs
from granumat.toml import read_toml
from support.ranks import ENVIRONMENT, on_ranks
from support.scenes import BOX, read_table, replaced, written
from support.xdmf import records

pytestmark = pytest.mark.release_only

SCENE = BOX + """
[output]
every = 2
probes = { middle = [0.5, 0.25] }
checkpoint = { every = 2 }
"""
PATH = '[initial]\nphi = 0.6\nstate = "steady"\n[[step]]\nshear = 1.0\nincrements = 1000\n'
TABLES = ("reactions.csv", "probe-middle.csv")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The directory of a run that nothing disturbed."""
    directory = tmp_path_factory.mktemp("whole")
    scene.solve(written(directory, SCENE), directory / "out")
    return directory / "out"


def check_same(out, whole):
    """That two directories hold the same results of the scene."""
    for name in TABLES:
        found, expected = read_table(out / name), read_table(whole / name)
        for column in expected.dtype.names:
            np.testing.assert_allclose(found[column], expected[column], rtol=1e-8, atol=1e-11, err_msg=f"{name} {column}")
    assert (out / "fields.xdmf").read_text() == (whole / "fields.xdmf").read_text()
    assert sorted(file.name for file in run_files(out)) == sorted(file.name for file in run_files(whole))


@contextlib.contextmanager
def largest_file(size):
    """Files cannot grow beyond a size in bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


class Signalling:
    """A stream that sends its own process a signal when so many lines have been written to it."""

    def __init__(self, lines, number=signal.SIGTERM):
        self.left, self.number = lines, number

    def write(self, text):
        self.left -= text.count("\n")
        if self.left == 0:
            os.kill(os.getpid(), self.number)

    def flush(self):
        pass


# ---- full disk ---------------------------------------------------------------------------------------------------------

def check_full_disk(directory, size, whole, text=SCENE):
    """A run with files of at most a size names the one that it cannot write, and goes on to the same end; the name's suffix."""
    file, out = written(directory, text), directory / "out"
    with largest_file(size), pytest.raises(OSError, match="File too large") as caught:
        scene.solve(file, out)
    words = str(caught.value)
    named = words.split("'")[1]
    assert str(out) in named and f"in {out} is " in words
    for name in words.split(f"in {out} is ")[1].split(";")[0].split(", "):
        assert name == "nothing" or (out / name).exists()
    with contextlib.suppress(FileNotFoundError):                 # what the record before wrote can be read
        assert all(np.isfinite(fields["p"]).all() for _, _, fields in records(out / "fields.xdmf"))
    if (out / "checkpoint.npz").exists():
        assert "--resume goes on from the checkpoint at t = " in words
        scene.solve(file, out, resumed=True)
    else:
        assert "there is no checkpoint to go on from" in words
        scene.solve(file, out, overwrite=True)
    check_same(out, whole)
    return os.path.splitext(named)[1]


def test_a_full_disk_names_the_file_and_the_run_goes_on(tmp_path, whole):
    assert check_full_disk(tmp_path, (whole / "fields.bin").stat().st_size - 1, whole) in (".bin", ".npz", ".png")


def test_a_record_of_which_the_disk_takes_a_part_is_cut_off(tmp_path, whole):
    text = replaced(SCENE, {"checkpoint = { every = 2 }": "checkpoint = { every = 100 }"})
    assert check_full_disk(tmp_path, (whole / "fields.xdmf").stat().st_size - 1, whole, text) == ".xdmf"
    table = tmp_path / "table.csv"
    table.write_text("1,2\n")
    with largest_file(6), pytest.raises(OSError, match=r"File too large: .*table\.csv"), appending(table), open(table, "a") as file:
        file.write("3,4\n5,6\n")
    assert table.read_text() == "1,2\n"


@pytest.mark.slow
def test_a_full_disk_at_any_file_loses_nothing(tmp_path, whole):
    sizes = [1, 200, 600, 900, 1500, *((whole / name).stat().st_size - 1 for name in (*TABLES, "fields.xdmf", "checkpoint.npz"))]
    suffixes = {check_full_disk(tmp_path / str(size), size, whole) for size in sizes}
    assert suffixes >= {".xdmf", ".bin", ".npz"}


def test_a_full_disk_at_a_point_names_the_file(tmp_path):
    sand = Material(0.5)
    with largest_file(5000), pytest.raises(OSError, match=r"File too large: '.*history\.csv"):
        driver.run(sand, sand.steady(0.6), [driver.shear(1.0)], tmp_path)
    assert not list(tmp_path.iterdir())                          # no part of a file


# ---- signals -----------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_run_that_goes_on_to_the_same_end(tmp_path, whole, monkeypatch, number):
    monkeypatch.setattr(Progress, "QUIET_SECONDS", 0.0)
    file, out, before = written(tmp_path, SCENE), tmp_path / "out", signal.getsignal(number)
    words = f"{number.name} has ended the run at t = 3, .*\n.*--resume goes on from there"
    with pytest.raises(InterruptedRunError, match=words) as error:
        scene.solve(file, out, progress=Signalling(3, number))
    assert signal.getsignal(number) is before
    assert all(name in str(error.value) for name in (*TABLES, "checkpoint.npz", "fields.xdmf"))
    assert read_table(out / "reactions.csv")["t"].tolist() == [1, 2, 3] and list(records(out / "fields.xdmf"))[-1][0] == 3
    scene.solve(file, out, resumed=True)
    for name in TABLES:
        assert read_table(out / name)["t"].tolist() == read_table(whole / name)["t"].tolist()


def test_a_signal_within_an_increment_gives_it_up(tmp_path):
    problem = scene.problem_of(scene.read_scene(written(tmp_path, BOX)), MPI.COMM_WORLD)[0]
    trial = problem.solve_increment(1.0, lambda: True)
    assert trial.failure == "it was given up" and len(trial.residuals) == 1 and problem.t == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_path_and_its_history_is_kept(tmp_path, capsys, monkeypatch, number):
    (tmp_path / "path.toml").write_text(PATH)
    def signalling(self, words, share):
        if words.startswith("step 1 of 1, increment 300 of "):
            os.kill(os.getpid(), number)
    monkeypatch.setattr(Progress, "__call__", signalling)
    command = ["point", str(tmp_path / "path.toml"), "--out", str(tmp_path / "out")]
    assert cli.main(command) == 1
    words = capsys.readouterr().err
    assert f"{number.name} has ended the path in step 1 (shear 1), after 300 increments" in words and "--overwrite" in words
    assert len(read_table(tmp_path / "out/history.csv")) == 301
    assert cli.main(command) == 2 and cli.main([*command, "--overwrite"]) == 1


def test_a_signal_ends_a_ladder_that_goes_on_when_it_is_called_again(tmp_path, monkeypatch):
    text = replaced(BOX, {"until = 6": "until = 3"}) + '[[quantity]]\nname = "force"\nof = "reaction x of top"\n'
    runner = SceneRunner(written(tmp_path, text))
    content = {name: table for name, table in read_toml(tmp_path / "scene.toml").items() if name != "ladder"}
    expected = Runs(runner, tmp_path / "whole").get(content, "all")
    write = Monitor._write

    def signalling(monitor, problem):
        write(monitor, problem)
        if problem.t == 2:
            os.kill(os.getpid(), signal.SIGTERM)
    with monkeypatch.context() as patch, pytest.raises(InterruptedRunError, match="the ladder goes on from there"):
        patch.setattr(Monitor, "_write", signalling)
        Runs(runner, tmp_path / "again").get(content, "all")
    again = Runs(runner, tmp_path / "again").get(content, "all")
    np.testing.assert_allclose(again.table["force"], expected.table["force"], rtol=1e-8)


@pytest.mark.slow
def test_a_path_on_two_ranks_is_followed_by_one(tmp_path):
    (tmp_path / "path.toml").write_text(PATH)
    done = subprocess.run(on_ranks(2, "-m", "granumat", "point", "path.toml", "--out", "out"), cwd=tmp_path, capture_output=True,
                          text=True, env=ENVIRONMENT)
    assert done.returncode == 0 and done.stdout.count("wrote out/history.csv") == 1, done.stderr


def test_a_path_that_takes_long_is_written_now_and_then(tmp_path, monkeypatch):
    monkeypatch.setattr(driver, "KEEP_SECONDS", 0.0)
    monkeypatch.setattr(driver, "KEEP_FACTOR", 0.0)
    sand, rows = Material(0.5), []
    monkeypatch.setattr(Progress, "__call__", lambda *_: rows.append(
        len(read_table(tmp_path / "history.csv")) if (tmp_path / "history.csv").exists() else 0))
    driver.run(sand, sand.steady(0.6), [driver.shear(1.0, increments=300)], tmp_path, progress=sys.stderr)
    assert rows == [0, 101, 201]


# ---- one run in a directory --------------------------------------------------------------------------------------------

def test_a_directory_that_holds_a_run_is_not_written_into(tmp_path, whole):
    file, before = written(tmp_path, SCENE), {file: file.stat().st_mtime_ns for file in run_files(whole)}
    with pytest.raises(ValueError, match=r"holds a run already \(checkpoint.npz, .* more\): give --resume .* --overwrite"):
        scene.solve(file, whole)
    assert {file: file.stat().st_mtime_ns for file in run_files(whole)} == before


def test_overwriting_leaves_nothing_of_the_run_before_and_nothing_else_is_touched(tmp_path, whole):
    out = tmp_path / "out"
    out.mkdir()
    for file in run_files(whole):
        (out / file.name).write_bytes(file.read_bytes())
    for name in ("p-000099.png", "probe-old.csv", "failing.toml", "fields.3.bin", "checkpoint.npz.part"):
        (out / name).write_text("old")
    for name in ("notes.txt", "my.csv", "p-1.png"):
        (out / name).write_text("mine")
    scene.solve(written(tmp_path, SCENE), out, overwrite=True)
    assert all((out / name).read_text() == "mine" for name in ("notes.txt", "my.csv", "p-1.png"))
    check_same(out, whole)


def test_a_faulty_scene_overwrites_nothing(tmp_path, whole):
    before = run_files(whole)
    with pytest.raises(ValueError, match="phi = 6"):
        scene.solve(written(tmp_path, SCENE.replace("phi = 0.60", "phi = 6")), whole, overwrite=True)
    assert run_files(whole) == before


def test_a_second_run_is_kept_out_while_the_first_goes_on(tmp_path):
    with locked(tmp_path / "out"), pytest.raises(ValueError, match=f"another run is writing there .process {os.getpid()} on"):
        scene.solve(written(tmp_path, SCENE), tmp_path / "out", overwrite=True)
    scene.solve(written(tmp_path, SCENE), tmp_path / "out")


def test_the_lock_of_a_killed_run_does_not_hold(tmp_path):
    script = ("import sys, time\nfrom granumat import files\n"
              "with files.locked(sys.argv[1]):\n  print('in', flush=True); time.sleep(60)")
    with subprocess.Popen([sys.executable, "-c", script, tmp_path], stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"in\n"
        with pytest.raises(ValueError, match=f"process {other.pid} on"), locked(tmp_path):
            pass
        other.kill()
        other.wait()
    assert (tmp_path / LOCK).exists()
    with locked(tmp_path):
        pass


def test_a_point_and_a_scene_do_not_share_a_directory(tmp_path, whole, capsys):
    (tmp_path / "path.toml").write_text(PATH)
    assert cli.main(["point", str(tmp_path / "path.toml"), "--out", str(whole)]) == 2
    assert "holds a run already" in capsys.readouterr().err and not (whole / "history.csv").exists()


# ---- going on ----------------------------------------------------------------------------------------------------------

@pytest.fixture(scope="module")
def first_half(tmp_path_factory):
    directory = tmp_path_factory.mktemp("half")
    with pytest.MonkeyPatch.context() as patch, pytest.raises(InterruptedRunError):
        patch.setattr(Progress, "QUIET_SECONDS", 0.0)
        scene.solve(written(directory, SCENE), directory / "out", progress=Signalling(3))
    return directory


@pytest.fixture
def half(first_half, tmp_path):
    """The directory of a run that came to t = 3."""
    shutil.copytree(first_half, tmp_path, dirs_exist_ok=True)
    return tmp_path / "out"


@pytest.mark.parametrize("old, new, words", [
    ("[3.5, 0.02]", "[3.5, 0.03]", r"condition 1 \(Displacement\), value: .*0\.0171.* in the checkpoint, .*0\.0257.* here"),
    ("[[0, 0.007], [10, 0.008]]", "[[0, 0.007], [10, 0.009]]", r"condition 3 \(Pressure\), value: .*0\.0073\]\] in the checkpoint"),
    ('platen = "y"', "traction = { x = 0.001 }", r"condition 2 \(Tied\)"),
    ("phi = 0.60", "phi = 0.61", "initial state"),
    ("elastic_strain = 0.01", "elastic_strain = 0.02", "material's elastic_strain: 0.01 in the checkpoint, 0.02 here"),
    ("middle = [0.5, 0.25]", "middle = [0.5, 0.2]", r"probe-middle\.csv cannot be continued: its rows are of \[0\.5, 0\.25\]"),
])
def test_another_run_is_not_gone_on_with(half, old, new, words):
    before = [file.read_bytes() for file in run_files(half)]
    with pytest.raises(ValueError, match=words):
        scene.solve(written(half.parent, replaced(SCENE, {old: new})), half, resumed=True)
    assert [file.read_bytes() for file in run_files(half)] == before


def test_loads_to_come_may_be_others(half):
    text = replaced(SCENE, {"[10, -0.02]": "[6, 0.04]", "until = 6": "until = 5"})
    problem, _ = scene.solve(written(half.parent, text), half, resumed=True)
    np.testing.assert_allclose(problem.displacement[:, 0].max(), 0.02 + 1.5 * 0.02 / 2.5)


def sheared(displacement, pressure=0.01):
    sand = Material(0.5, elastic_strain=1e-2)
    floor = fem.Displacement(lambda x: np.isclose(x[1], 0))
    lid = fem.Displacement(lambda x: np.isclose(x[1], 1), lambda x, t: [displacement * t, 0])
    side = fem.Pressure(lambda x: np.isclose(x[0] % 1, 0), lambda t: pressure)
    return fem.Problem(fem.meshes.box(MPI.COMM_WORLD, [1, 1], [2, 2]), sand, sand.isotropic(0.6, pressure=0.01), [floor, lid, side])


def test_functions_of_python_are_compared_by_their_values_at_the_checkpoint(tmp_path):
    fem.run(sheared(0.001), 1, 1, observers=[fem.Checkpoint(tmp_path / "c.npz", every=1)])
    fem.resume(tmp_path / "c.npz", sheared(0.001))
    with pytest.raises(ValueError, match=r"displacements that conditions prescribe at t = 1 are up to 0\.001 away"):
        fem.resume(tmp_path / "c.npz", sheared(0.002))
    with pytest.raises(ValueError, match=r"condition 2 \(Pressure\), value: 0\.01 in the checkpoint, 0\.011 here"):
        fem.resume(tmp_path / "c.npz", sheared(0.001, 0.011))


@pytest.mark.parametrize("name", ["description", "places", "displacement", "u", "states", "shear_strain", "volume_strain",
                                  "gradients", "volumes", "stress", "forces"])
def test_a_checkpoint_without_an_array_or_with_another_is_refused(half, name):
    file = half / "checkpoint.npz"
    with np.load(file) as content:
        arrays = dict(content)
    kept = arrays.pop(name)
    for changed in (arrays, arrays | {name: np.zeros((3, 3))}, arrays | {name: kept[1:] if kept.ndim else "{}"}):
        np.savez(file, **changed)
        with pytest.raises(ValueError, match=f"is not a checkpoint|is damaged:\n  its? (lacks the array|array) '{name}'"):
            scene.solve(half.parent / "scene.toml", half, resumed=True)


# ---- processes that are killed -------------------------------------------------------------------------------------------

LONG = replaced(SCENE, {"cells = [4, 2]": "cells = [24, 12]", "until = 6": "until = 80", "[10, -0.02]": "[80, -0.05]"})


def started(directory, ranks, *arguments):
    """`granumat solve` on some ranks of mpirun, or with 0 without it."""
    words = ["-m", "granumat", "solve", "scene.toml", "--out", "out", *arguments]
    command = on_ranks(ranks, *words) if ranks else [sys.executable, *words]
    return subprocess.Popen(command, cwd=directory, stderr=subprocess.PIPE, env=ENVIRONMENT, text=True)


def rows(file):
    return file.read_text().count("\n") if file.exists() else 0


def pids(running):
    """Numbers of the processes that mpirun has started."""
    return [int(pid) for pid in open(f"/proc/{running.pid}/task/{running.pid}/children").read().split()]


@pytest.fixture(scope="module")
def long_whole(tmp_path_factory):
    """The directory of a long run that nothing disturbed."""
    directory = tmp_path_factory.mktemp("long")
    scene.solve(written(directory, LONG), directory / "out")
    return directory / "out"


@pytest.mark.slow
@pytest.mark.parametrize("ranks, ways", [(0, ("kill -9", "SIGTERM", "SIGINT")), (
    2, ("kill -9", "kill -9 of a rank", "SIGTERM", "SIGINT", "SIGTERM of a rank"))])
def test_a_run_that_is_killed_in_any_way_is_gone_on_with_to_the_same_end(tmp_path, long_whole, ranks, ways):
    for way in ways:
        directory, moment = tmp_path / way.replace(" ", "-"), np.random.default_rng().integers(5, 20)
        written(directory, LONG)
        with started(directory, ranks) as running:
            while rows(directory / "out/reactions.csv") < moment:
                assert running.poll() is None, running.stderr.read()
                time.sleep(0.002)
            number = signal.SIGKILL if "-9" in way else signal.SIGINT if way == "SIGINT" else signal.SIGTERM
            processes = pids(running)
            os.kill(processes[-1] if way.endswith("rank") else running.pid, number)
            words = running.communicate()[1]
        assert running.returncode != 0 and "Traceback" not in words, words
        for process in processes if way == "kill -9" else ():    # ranks outlive for a moment an mpirun that was killed
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        came = read_table(directory / "out/reactions.csv")["t"][-1]
        if "SIG" in way and (not ranks or "has ended" in words):     # Open MPI leaves its ranks one second to end an increment
            assert f"has ended the run at t = {came:g}" in words and "--resume goes on from there" in words, words
        written(directory, replaced(LONG, {"until = 80": f"until = {np.ceil(came) + 6:g}"}))
        words = "another run is writing there"
        while "another run is writing there" in words:           # a process that was killed takes a moment to end
            with started(directory, ranks, "--resume") as again:
                words = again.communicate()[1]
        assert again.returncode == 0, words
        check_whole(directory / "out", long_whole, np.ceil(came) + 6)


def test_no_rank_waits_for_ever_at_the_broken_pipe_of_an_mpirun_that_was_killed():
    """PETSc's handler of SIGPIPE, which would, is not there: the signal is ignored."""
    ignored = int(re.search(r"^SigIgn:\s*(\w+)", Path("/proc/self/status").read_text(), re.M)[1], 16)
    assert ignored >> signal.SIGPIPE - 1 & 1


def check_whole(out, whole, end):
    """That tables agree at an end, and go from increment to increment up to it."""
    for name in TABLES:
        found, expected = read_table(out / name), read_table(whole / name)
        expected = expected[expected["t"] <= end]
        assert (np.diff(found["t"]) > 0).all() and found["t"][-1] == expected["t"][-1]        # no row twice, none missing
        assert set(found["t"]) >= set(expected["t"])
        for column in set(expected.dtype.names) - {"iterations"}:
            np.testing.assert_allclose(found[column][-1], expected[column][-1], rtol=1e-7, atol=1e-10, err_msg=column)


@pytest.mark.slow
def test_of_two_runs_in_one_directory_one_goes_on_alone(tmp_path, long_whole):
    written(tmp_path / "both", LONG)
    with started(tmp_path / "both", 1) as one, started(tmp_path / "both", 1, "--overwrite") as other:
        said = [running.communicate()[1] for running in (one, other)]
    assert sorted(running.returncode for running in (one, other))[0] == 0
    assert sum("another run is writing there" in words or "holds a run already" in words for words in said) == 1
    check_whole(tmp_path / "both/out", long_whole, 80)


def test_the_bench_says_at_once_where_it_cannot_write(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    start = time.monotonic()
    assert cli.main(["bench", "--fem", str(tmp_path / "file/there")]) == 2
    assert "file" in capsys.readouterr().err and time.monotonic() - start < 5


def test_a_run_that_fails_names_the_files_that_are_there(tmp_path):
    text = replaced(SCENE, {"[3.5, 0.02]": "[2, 0.01], [2.1, 300]", "increment = 1": "increment = 1\nsmallest = 0.05"})
    with pytest.raises(GranumatError, match=f"everything up to t = 2 is in {tmp_path}/out: (.*); --resume") as caught:
        scene.solve(written(tmp_path, text), tmp_path / "out")
    names = str(caught.value).split("out: ")[1].split("; --resume")[0].split(", ")
    assert set(names) == {"checkpoint.npz", "fields.bin", "fields.xdmf", *TABLES}
    assert all((tmp_path / "out" / name).exists() for name in names)
