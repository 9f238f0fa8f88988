"""A run that is killed goes on as if nothing had happened."""

import os
import signal
import subprocess
import time

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem
from granumat.material import TURNING
from support.ranks import ENVIRONMENT, on_ranks
from support.scenes import read_table
from support.xdmf import records

pytestmark = pytest.mark.release_only

SCRIPT = """
import os, sys, time
from pathlib import Path
import numpy as np
from mpi4py import MPI
from granumat import Material, fem
from granumat.fem.cellwise import CellOrder

out, resumed, pause = Path(sys.argv[1]), sys.argv[2] == "resumed", float(sys.argv[3])
material = Material(0.5, elastic_strain=1e-2)
def inner(x): return np.isclose(np.hypot(x[0], x[1]), 1)
def outer(x): return np.isclose(np.hypot(x[0], x[1]), 2)
conditions = [fem.Displacement(inner, fem.rotation(lambda t: 0.002 * min(t, 40 - t))), fem.Pressure(outer, 0.01),
              fem.Displacement(outer, components=[1], axes=fem.polar()), fem.Tied(outer, 0, axes=fem.polar())]
problem = fem.Problem(fem.meshes.annulus(MPI.COMM_WORLD, (1, 2), (3, 12)), material, material.isotropic(0.6, pressure=0.01),
                      conditions, rate_term=0.01)
outputs = [fem.Fields(out / "fields.xdmf", every=2), fem.Reactions(out / "reactions.csv", {"inner": inner}),
           fem.Probe(out / "probe.csv", [1.1, 0.0])]
if resumed:
    fem.resume(out / "checkpoint.npz", problem, outputs)
    if MPI.COMM_WORLD.rank == 0:
        print("from", problem.t)
elif MPI.COMM_WORLD.rank == 0:
    (out / "pid").write_text(str(os.getpid()))
fem.run(problem, 30, 1.0, events=[20], observers=[*outputs, fem.Checkpoint(out / "checkpoint.npz", outputs, every=4),
                                                  lambda problem: time.sleep(pause)])
order = CellOrder(problem.mesh)
final = [order.gather(values) for values in (
    problem.states.view(float).reshape(problem.cells, -1), problem.body.at_cells(problem.displacement),
    problem.shear_strain.reshape(problem.cells, -1), problem.volume_strain.reshape(problem.cells, -1))]
if MPI.COMM_WORLD.rank == 0:
    np.savez(out / "final.npz", *final)
"""


def rows(path):
    return path.read_text().count("\n") if path.exists() else 0


def test_killed_on_two_ranks_it_ends_alike_on_one_and_three(mpirun, tmp_path):
    for name in ("whole", "cut"):
        (tmp_path / name).mkdir()
    mpirun(SCRIPT, 1, "whole", "new", 0)
    expected = np.load(tmp_path / "whole/final.npz")
    moment = np.random.default_rng().integers(6, 29)
    with subprocess.Popen(on_ranks(2, "script.py", "cut", "new", 0.05), cwd=tmp_path, stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL, env=ENVIRONMENT) as running:
        while rows(tmp_path / "cut/reactions.csv") < moment:
            assert running.poll() is None
            time.sleep(0.002)
        os.kill(int((tmp_path / "cut/pid").read_text()), signal.SIGKILL)
    assert running.returncode != 0 and not (tmp_path / "cut/final.npz").exists()
    for ranks in (1, 3):
        (tmp_path / f"on{ranks}").mkdir()
        for file in (tmp_path / "cut").iterdir():
            (tmp_path / f"on{ranks}" / file.name).write_bytes(file.read_bytes())
        first = float(mpirun(SCRIPT, ranks, f"on{ranks}", "resumed", 0).split("from")[1])
        assert 0 < first <= moment and first % 4 == 0
        found = np.load(tmp_path / f"on{ranks}/final.npz")
        for name in expected.files:
            np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=1e-10 * abs(expected[name]).max())
        for name in ("reactions.csv", "probe.csv"):
            tables = [read_table(tmp_path / place / name) for place in ("whole", f"on{ranks}")]
            for column in tables[0].dtype.names:
                np.testing.assert_allclose(tables[1][column], tables[0][column], rtol=1e-8, atol=1e-11, err_msg=column)
        assert (tmp_path / f"on{ranks}/fields.xdmf").read_text() == (tmp_path / "whole/fields.xdmf").read_text()
        for (_, _, whole), (_, _, again) in zip(*(records(tmp_path / place / "fields.xdmf") for place in ("whole", f"on{ranks}"))):
            np.testing.assert_allclose(again["p"], whole["p"], rtol=1e-9)


def problem(cells=(3, 2), closure="full", degree=1, size=(1.0, 1.0), mu=0.5, conditions=(), phi=0.6, held=0, **options):
    material = Material(mu, closure=closure, elastic_strain=1e-2)
    bottom = fem.Displacement(lambda x: np.isclose(x[1], 0), held)
    top = fem.Displacement(lambda x: np.isclose(x[1], size[1]), lambda x, t: [0.01 * t, 0])
    return fem.Problem(fem.meshes.box(MPI.COMM_WORLD, size, cells), material, material.isotropic(phi, pressure=0.01),
                       [bottom, top, *conditions], degree=degree, **options)


@pytest.fixture
def checkpoint(tmp_path):
    body = problem()
    fem.run(body, 2, 1.0, observers=[fem.Checkpoint(tmp_path / "checkpoint.npz", every=1)])
    return tmp_path / "checkpoint.npz"


@pytest.mark.parametrize("closure", ["full", *TURNING])
def test_what_is_resumed_is_what_was_left(closure, tmp_path):
    sides = fem.Pressure(lambda x: np.isclose(x[0] * (1 - x[0]), 0), 0.01)
    body, again = (problem(closure=closure, conditions=[sides]) for _ in range(2))
    fem.run(body, 2, 1.0, observers=[fem.Checkpoint(tmp_path / "checkpoint.npz", every=1)])
    fem.resume(tmp_path / "checkpoint.npz", again)
    assert (again.states == body.states).all() and (again.displacement == body.displacement).all()
    for name in ("t", "increments", "next_increment"):
        assert getattr(again, name) == getattr(body, name), name
    for name in ("u", "gradients", "volumes", "stress", "forces"):
        assert (getattr(again.last, name) == getattr(body.last, name)).all(), name
    assert again.last.residuals == body.last.residuals and again.last.duration == body.last.duration
    fem.run(body, 4, 1.0)
    fem.run(again, 4, 1.0)
    assert (again.states == body.states).all() and (again.displacement == body.displacement).all()


def test_a_checkpoint_of_another_problem_is_refused_with_every_difference(checkpoint):
    other = problem(closure="basic", degree=2, mu=0.4, conditions=[fem.Pressure(lambda x: np.isclose(x[0], 0), 0.01)], phi=0.61,
                    held=(0.01, 0), gravity=(0, -1e-3), rate_term=0.01)
    with pytest.raises(ValueError) as caught:
        fem.resume(checkpoint, other)
    for words in ("belongs to another problem", "degree: 1 in the checkpoint, 2 here",
                  "material's mu: 0.5 in the checkpoint, 0.4 here", "material's closure: 'full' in the checkpoint, 'basic' here",
                  "condition 0 (Displacement), value: 0 in the checkpoint, [0.01, 0.0] here",
                  "condition 2 (Pressure), value: None in the checkpoint, 0.01 here",
                  "gravity: None in the checkpoint, [0.0, -0.001] here", "'volume_fraction': 0.61", "rate_term: 0.0 in"):
        assert words in str(caught.value), words
    assert "condition 1" not in str(caught.value)                                  # functions cannot be compared
    with pytest.raises(ValueError, match="number of cells: 6 in the checkpoint, 8 here"):
        fem.resume(checkpoint, problem(cells=(4, 2)))
    with pytest.raises(ValueError, match=r"positions of the nodes: up to 0\.1 apart"):
        fem.resume(checkpoint, problem(size=(1.0, 1.1)))
    with pytest.raises(ValueError, match="has not kept the origin of the material: leave it out"):
        fem.resume(checkpoint, problem(origin=True))


def test_what_is_no_checkpoint_is_refused(checkpoint, tmp_path):
    checkpoint.write_bytes(checkpoint.read_bytes()[:-100])
    with pytest.raises(ValueError, match="is not a checkpoint"):
        fem.resume(checkpoint, problem())
    np.savez(tmp_path / "other.npz", a=1)
    with pytest.raises(ValueError, match="is not a checkpoint"):
        fem.resume(tmp_path / "other.npz", problem())
    with pytest.raises(FileNotFoundError):
        fem.resume(tmp_path / "none.npz", problem())


def test_a_write_that_fails_leaves_the_checkpoint_before(checkpoint, monkeypatch):
    before, body = checkpoint.read_bytes(), problem()
    fem.run(body, 3, 1.0)

    def full(number):
        raise OSError("No space left on device")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        fem.Checkpoint(checkpoint, every=1).write(body)
    assert checkpoint.read_bytes() == before


def test_checkpoints_come_by_time_too(tmp_path):
    body = problem()
    fem.run(body, 1, 1.0, observers=[fem.Checkpoint(tmp_path / "never.npz", seconds=1e9),
                                      fem.Checkpoint(tmp_path / "now.npz", seconds=0)])
    assert (tmp_path / "now.npz").exists() and not (tmp_path / "never.npz").exists()


def test_a_table_that_was_shortened_is_not_continued(tmp_path):
    body, table = problem(), fem.Probe(tmp_path / "p.csv", [0.5, 0.5])
    fem.run(body, 2, 1.0, observers=[table, fem.Checkpoint(tmp_path / "c.npz", [table], every=2)])
    os.truncate(tmp_path / "p.csv", 10)
    with pytest.raises(ValueError, match=r"p\.csv cannot be continued: it is missing or shorter"):
        fem.resume(tmp_path / "c.npz", problem(), [fem.Probe(tmp_path / "p.csv", [0.5, 0.5])])
