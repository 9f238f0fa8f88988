"""The ladder of scenes: a ring whose shear localises at the wall, a block that localises, ranks, kill and resume."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, ladder
from granumat.fem import scene
from granumat.fem.ladder import SceneRunner, share_of_shear
from granumat.quantities import read_values
from granumat.runs import Runs
from granumat.toml import read_toml, write_content
from support import scenes
from support.scenes import replaced

pytestmark = pytest.mark.release_only
ROOT = Path(__file__).parents[2]

RING = replaced(scenes.RING, {"[4, 12]": "[8, 24]", "[10, 0.02]": "[20, 0.04], [40, 0]", "until = 3": "until = 40"}) + """
[[quantity]]
name = "torque"
of = "moment of inner"
at = [10, 20, 30, 40]
[ladder]
symmetry = "axial"
"""
BLOCK = replaced(scenes.BOX, {
    "size = [1, 0.5]\ncells = [4, 2]": "size = [1, 2]\ncells = [8, 16]",
    "phi = 0.60\npressure = 0.007": "phi = 0.60\npressure = 0.003",
    "x = [[0, 0], [3.5, 0.02], [10, -0.02]]": "x = 0, y = [[0, 0], [100, -0.42]]",
    'platen = "y"\npressure = [[0, 0.007], [10, 0.008]]\n': "", "periodic = true": "pressure = 0.003",
    "until = 6\nincrement = 1": "until = 100\nincrement = 4"}) + """
[[quantity]]
name = "force"
of = "reaction y of top"
at = [50, 100]
"""


@pytest.fixture(autouse=True)
def clock_that_counts_updates(monkeypatch):
    """The time of a run is the number of its points' updates: what is recommended does not depend on what else a processor does."""
    counted = 0.0

    def updates(method):
        def count(self, states, *arguments, **keywords):
            nonlocal counted
            counted += 1e-5 * len(states)
            return method(self, states, *arguments, **keywords)
        return count
    for name in ("update", "update_with_tangent"):
        monkeypatch.setattr(Material, name, updates(getattr(Material, name)))
    monkeypatch.setattr("granumat.fem.ladder.time", SimpleNamespace(process_time=lambda: counted))


def study(report, name):
    return next(study for study in report.studies if study.axis.name == name)


@pytest.mark.slow
def test_a_ring_becomes_a_graded_sector_whose_error_is_the_printed_one(tmp_path, capsys):
    file = tmp_path / "ring.toml"
    file.write_text(RING)
    report = ladder.climb(file, 0.05, tmp_path / "out")
    assert report.is_proved and report.content["mesh"]["sector"] and report.content["mesh"]["grading"] > 1
    assert report.of_reduction[0] < 1e-6                        # the ring and its sector are the same
    scene.solve(tmp_path / "out/recommended.toml", tmp_path / "again")
    values = read_values(tmp_path / "again/quantities.csv", report.quantities)["torque"][1]
    wanted = report.quantities[0].pick(report.top.table["t"], report.top.table["torque"])[1]
    error = abs(values - wanted).max() / abs(report.top.table["torque"]).max()
    assert np.isclose(error, report.measured[0], rtol=1e-6)
    assert f"torque: error {error:.2%}" in (tmp_path / "out/recommended.toml").read_text()
    assert (tmp_path / "out/ladder.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize("mu, is_noisy", [(0.1, True), (0.5, False)])
def test_a_symmetry_is_checked_with_noise_where_the_transverse_modulus_becomes_negative(tmp_path, mu, is_noisy):
    content = read_toml(ROOT / "demos/scenes/shear-box.toml")
    content["material"] = {"mu": mu, "elastic_strain": 0.01}
    content["initial"]["phi"] = {0.1: 0.63, 0.5: 0.60}[mu]
    write_content(tmp_path / "box.toml", content)
    report = ladder.climb(tmp_path / "box.toml", 0.05, tmp_path / "out", budget=6)
    assert len(list((tmp_path / "out/runs").glob("dimension-with-noise*"))) == is_noisy
    errors = study(report, "dimension").findings[1].errors
    assert (errors > 1e-5).any() if is_noisy else (errors < 1e-5).all()


@pytest.mark.slow
def test_a_block_localises_and_gets_no_mesh(tmp_path):
    file = tmp_path / "block.toml"
    file.write_text(BLOCK)
    report = ladder.climb(file, 0.05, tmp_path / "out")
    assert "localises" in study(report, "mesh").verdict and report.content["mesh"] == read_toml(file)["mesh"]
    assert "needs a length or a rate term" in " ".join((tmp_path / "out/ladder.txt").read_text().split())
    assert "mesh" in report.unknown and "is NOT known" in (tmp_path / "out/recommended.toml").read_text()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a length does not suit the closure")    # of the rungs n2 and basic
def test_a_block_with_a_length_gets_a_mesh_and_needs_its_length(tmp_path):
    file = tmp_path / "block.toml"
    file.write_text(replaced(BLOCK, {"[8, 16]": "[4, 8]", "increment = 4": "increment = 20",
                                     "[initial]": "[problem]\nlength = 0.25\n[initial]"}))
    report = ladder.climb(file, 0.1, tmp_path / "out")
    assert report.is_proved and "localises" not in study(report, "mesh").verdict
    own, none = study(report, "length").findings
    assert own.rung.name == "0.25" and (none.errors > 0.05).any() and report.content["problem"]["length"] == 0.25
    known = next(study for study in report.constants if study.axis.name == "l")
    assert [finding.rung.name for finding in known.findings] == ["0.25", "0.2", "0.312"]
    assert (known.findings[1].errors > 1e-3).all() and (known.findings[2].errors > 1e-3).all()


def test_a_run_that_is_killed_goes_on_from_its_checkpoint_with_the_same_values(tmp_path, monkeypatch):
    import granumat.fem.ladder as scenes
    file = tmp_path / "ring.toml"
    file.write_text(RING)
    content = read_toml(file) | {"mesh": read_toml(file)["mesh"] | {"sector": True}}
    monkeypatch.setattr(scenes, "CHECKPOINT_SECONDS", 0.0)
    runner = SceneRunner(file)
    whole = Runs(runner, tmp_path / "whole").get(content, "sector")

    class Killed(BaseException):
        pass

    original = scenes.Monitor._write

    def write(self, problem):
        original(self, problem)
        if problem.increments == 7:
            raise Killed
    monkeypatch.setattr(scenes.Monitor, "_write", write)
    with pytest.raises(Killed):
        Runs(runner, tmp_path / "killed").get(content, "sector")
    monkeypatch.setattr(scenes.Monitor, "_write", original)
    resumed = Runs(runner, tmp_path / "killed").get(content, "sector")
    for name in whole.table:
        assert np.array_equal(whole.table[name], resumed.table[name])
    for name in whole.signature:
        assert np.allclose(whole.signature[name], resumed.signature[name], rtol=1e-12)
    assert resumed.share == whole.share


def test_the_share_of_shear_is_a_half_where_it_is_uniform_and_small_where_it_localises():
    volumes = np.array([1.0, 2, 3, 4])
    assert np.isclose(share_of_shear(MPI.COMM_SELF, np.ones(4), volumes), 0.5)
    assert np.isclose(share_of_shear(MPI.COMM_SELF, np.array([1.0, 0, 0, 0]), volumes), 0.05)


def test_a_symmetry_that_the_mesh_cannot_have_is_refused(tmp_path):
    file = tmp_path / "block.toml"
    file.write_text(BLOCK + '[ladder]\nsymmetry = "axial"\n')
    with pytest.raises(ValueError, match="symmetry 'axial' needs a ring"):
        ladder.climb(file, 0.05, tmp_path / "out")


COMMAND = "import sys; from granumat.cli import main; sys.exit(main(sys.argv[1:]))"


def test_a_ladder_is_climbed_on_two_ranks(tmp_path, mpirun):
    (tmp_path / "ring.toml").write_text(RING.replace("increment = 1", "increment = 2"))
    printed = mpirun(COMMAND, 2, "ladder", "ring.toml", "--tolerance", "0.1", "--out", "out", "--budget", "6")
    assert printed.count("Recommended") == 1 and "The budget did not allow" in printed
    assert (tmp_path / "out/recommended.toml").exists()


@pytest.mark.slow
def test_a_real_kill_of_a_scene_loses_no_run(tmp_path):
    (tmp_path / "ring.toml").write_text(RING)
    command = [sys.executable, "-c", COMMAND, "ladder", "ring.toml", "--tolerance", "0.1", "--out", "out", "--budget", "6"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while not list(tmp_path.glob("out/runs/*/result.json")) and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    done = len(list(tmp_path.glob("out/runs/*/result.json")))
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stderr.count("\nrun ") + result.stderr.startswith("run ") == len(
        list(tmp_path.glob("out/runs/*/result.json"))) - done
