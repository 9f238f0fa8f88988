"""A mesh that goes its own way: what is computed on it is what the material does, without end."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, driver, fem
from granumat.fem.scene import solve
from support import scenes
from support.ranks import ENVIRONMENT, on_ranks
from support.scenes import read_table, replaced
from support.xdmf import records

sys.path.insert(0, str(Path(__file__).parents[2] / "demos"))
import annular_cell
import annulus

pytestmark = pytest.mark.release_only
SAND = Material(mu=0.5, elastic_strain=0.01)
DENSE = SAND.isotropic(0.60, pressure=0.01)


def at(axis, value):
    return lambda x: np.isclose(x[axis], value)


def turned(motion, wall="volume", turn=0.06, back=0.03, part=1 / 36, sectors=1, rings=4, **more):
    problem, inner = annular_cell.ring(SAND, rings, sectors, turn, wall=wall, part=part, motion=motion, **more)
    watch = annular_cell.Watch(problem, inner, rings, part)
    fem.run(problem, turn + back, 0.006, events=[turn], observers=[watch])
    return watch.columns(), problem


def layer(motion, cells=(4, 3), **more):
    """A layer between a floor that is held and a lid that goes along x; both sides are periodic."""
    box = fem.meshes.box(MPI.COMM_WORLD, (1, 0.5), cells)
    return fem.Problem(box, SAND, DENSE, [
        fem.Displacement(at(1, 0)), fem.Displacement(at(1, 0.5), lambda x, t: [0.5 * t, 0]),
        fem.Periodic(at(0, 1), lambda x: x - [1, 0])], motion=motion, **more)


@pytest.mark.parametrize("length", [0, 0.1])
def test_uniform_shear_goes_on_as_at_a_point(length):
    problem = layer("fixed", length=length)
    fem.run(problem, 3, 0.02)                      # the lid goes by one and a half lengths of the box
    history = driver.run(SAND, DENSE, [driver.shear(3)])
    for name, values in {"p": -problem.states.stress[:, :3].sum(axis=1) / 3, "Z2": problem.states.coordination_number,
                         "phi": problem.states.volume_fraction}.items():
        assert values == pytest.approx(history[name][-1], rel=1e-7), name
    assert problem.shear_strain == pytest.approx(3)
    assert problem.displacement == pytest.approx(problem.last.u)  # the mesh is where it was


@pytest.mark.parametrize("motion", ["fixed", "lagrangian"])
def test_the_origin_of_what_is_sheared_uniformly_is_where_it_was(motion, tmp_path):
    problem, again = (layer(motion, origin=True) for _ in range(2))
    fem.run(problem, 1, 0.05, observers=[fem.Checkpoint(tmp_path / "checkpoint.npz", every=7)])
    fem.resume(tmp_path / "checkpoint.npz", again)
    fem.run(again, 1, 0.05)
    assert again.origin == pytest.approx(problem.origin, abs=1e-12)
    expected = problem.point_positions() - [1, 0] * problem.point_positions()[:, 1:]
    assert problem.origin == pytest.approx(expected, abs=1e-7)
    fields = fem.cell_fields(problem, ["origin", "origin_y"])
    assert fields["origin"] == pytest.approx(np.pad(expected.reshape(-1, 4, 2).mean(axis=1), ((0, 0), (0, 1))), abs=1e-7)
    assert (fields["origin_y"] == fields["origin"][:, 1]).all()
    with pytest.raises(ValueError, match=r"origin_x: .* is not kept: give Problem\(\.\.\., origin=True\)"):
        fem.cell_fields(layer(motion), ["origin_x"])


@pytest.mark.parametrize("wall, motion", [("volume", "fixed"), ("volume", "boundary"), ("load", "boundary"),
                                          ("volume", lambda x, material, t: x)])
def test_the_ring_has_the_torque_of_a_mesh_that_moves_with_the_material(wall, motion):
    found, problem = turned(motion, wall)
    expected, moved = turned("lagrangian", wall)
    assert found["path"] == pytest.approx(expected["path"])
    assert abs(found["torque"] - expected["torque"]).max() < 1.5e-3 * expected["torque"].max()
    assert found["pressure"] == pytest.approx(expected["pressure"], rel=1e-3)
    solid, solid_moved = ((body.point_volumes() * body.states.volume_fraction).sum() for body in (problem, moved))
    assert solid == pytest.approx(solid_moved, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("wall, motion", [("volume", "fixed"), ("load", "boundary")])
def test_a_ring_turns_for_radians_and_back_as_the_radial_solution(wall, motion):
    turn, back, rings, increment = 4.0, 1.0, 10, 0.005
    problem, inner = annular_cell.ring(SAND, rings, 1, turn, part=1 / 96, wall=wall, motion=motion)
    solid = (problem.point_volumes() * problem.states.volume_fraction).sum()
    watch = annular_cell.Watch(problem, inner, rings, 1 / 96)
    fem.run(problem, turn + back, increment, events=[turn], observers=[watch])
    found, exact = watch.columns(), annulus.radial(wall, rings, turn, back, increment)
    assert found["path"] == pytest.approx(exact["path"])          # no increment was cut
    assert abs(found["torque"] - exact["torque"]).max() < 0.005 * exact["torque"].max()
    assert found["pressure"] == pytest.approx(exact["pressure"], rel=1.5e-3 if wall == "volume" else 1e-3)
    assert found["phi"] == pytest.approx(exact["phi"], abs=1.5e-4)
    assert (problem.point_volumes() * problem.states.volume_fraction).sum() == pytest.approx(solid, rel=1e-6)


def test_a_sector_is_the_ring():
    whole, _ = turned("fixed", part=1, sectors=12)
    part, _ = turned("fixed", part=1 / 12)
    for name in ("torque", "pressure", "phi"):
        assert part[name] == pytest.approx(whole[name], rel=1e-7)
    assert whole["scatter"].max() < 1e-7


def test_hexahedra_between_two_planes_agree_with_quadrilaterals():
    solid, problem = turned("fixed", cell="hexahedron")
    flat, _ = turned("fixed")
    for name in ("torque", "pressure", "phi"):                    # B-bar averages a dilatation of three axes, not of two
        assert abs(solid[name] - flat[name]).max() < 0.003 * flat[name].max()
    assert abs(problem.displacement - problem.last.u).max() < 1e-15


@pytest.mark.slow
def test_what_slips_along_a_turning_wall_turns_with_it_for_ever():
    """A ring that a rough wall takes with it inside a smooth one: rigid rotation, on a mesh that stays."""
    ring = fem.meshes.annulus(MPI.COMM_WORLD, (1, 2), (3, 36))
    inner, outer = (lambda x: np.hypot(x[0], x[1]) < 1.001), (lambda x: np.hypot(x[0], x[1]) > 1.999)
    problem = fem.Problem(ring, SAND, DENSE, [fem.Displacement(inner, fem.rotation(lambda t: t)),
                                              fem.Displacement(outer, components=[0], axes=fem.polar())], motion="fixed")
    solid = (problem.point_volumes() * problem.states.volume_fraction).sum()
    fem.run(problem, 1, 0.005)
    problem.move_mesh()
    assert (problem.point_volumes() * problem.states.volume_fraction).sum() == pytest.approx(solid, rel=1e-6)
    assert -problem.states.stress[:, :3].sum(axis=1) / 3 == pytest.approx(0.01, rel=5e-3)
    assert problem.shear_strain.max() < 2e-3


def test_a_block_under_a_platen_follows_its_boundary():
    ends, forces, solids = [], [], []
    for motion in ("lagrangian", "boundary"):
        bottom, top = at(1, 0), at(1, 1)
        block = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (1, 1), (6, 6)), SAND, DENSE, [
            fem.Displacement(bottom, components=[1]), fem.Displacement(at(0, 0), components=[0]),
            fem.Displacement(top, lambda x, t: [0, -0.01 * t]), fem.Pressure(at(0, 1), 0.01)], motion=motion, gravity=(0, -1e-4))
        fem.run(block, 10, 1.0)
        block.move_mesh()
        ends.append(block.positions + block.displacement)
        solids.append((block.point_volumes() * block.states.volume_fraction).sum())
        forces.append(block.reaction(top)[0])
    corner = np.isclose(block.positions, [1, 0]).all(axis=1)
    assert ends[1][:, 1].max() == pytest.approx(0.9, abs=1e-12)
    assert ends[1][corner, 0] == pytest.approx(ends[0][corner, 0], rel=1e-3) and ends[0][corner, 0] > 1.12
    assert forces[1][1] == pytest.approx(forces[0][1], rel=0.01)
    assert solids == pytest.approx([solids[0]] * 2, rel=1e-5)


def test_what_flows_through_is_in_equilibrium_and_leaves_as_it_enters():
    """A column that moves down through a mesh that stays, with walls that slip: nothing changes."""
    column = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (0.5, 1), (3, 6)), SAND, DENSE, [
        fem.Displacement(at(0, 0), components=[0]), fem.Displacement(at(0, 0.5), components=[0]),
        fem.Displacement(at(1, 0), lambda x, t: [0, -0.1 * t], components=[1]), fem.Outflow(at(1, 0)),
        fem.Displacement(at(1, 1), lambda x, t: [0, -0.1 * t], components=[1]), fem.Inflow(at(1, 1), DENSE)], motion="fixed")
    fem.run(column, 30, 0.5)                                     # by three heights
    assert column.t == 30 and column.states.volume_fraction == pytest.approx(0.6, rel=1e-9)
    assert column.states.stress == pytest.approx(np.tile(DENSE.stress, (len(column.states), 1)), abs=1e-10)


def test_a_layer_with_weight_is_as_on_a_mesh_that_moves_with_the_material():
    found = []
    for motion in ("fixed", "lagrangian"):
        problem = layer(motion, cells=(3, 6), gravity=(0, -0.02))
        fem.run(problem, 0.4, 0.01)                              # the lid goes by 0.2, by 0.6 of a cell
        pressure = -problem.states.stress[:, :3].sum(axis=1).reshape(problem.cells, -1).mean(axis=1) / 3
        at_height = np.argsort(problem.point_positions().reshape(problem.cells, -1, 2)[..., 1].mean(axis=1), kind="stable")
        found.append(pressure[at_height].reshape(6, 3).mean(axis=1))
    fixed, moved = found
    assert fixed == pytest.approx(moved, rel=2e-3)
    assert fixed[0] - fixed[-1] > 0.6 * 0.02 * 0.4 * 0.9         # the weight of the solid between the middles of the outer rows


def test_increments_that_sweep_too_far_are_cut():
    problem = layer("fixed")
    trial = problem.solve_increment(2.0)                         # the lid by four cells
    assert "the mesh would sweep 3" in trial.failure and "at most 1.5 can be convected" in trial.failure
    fem.run(problem, 2.0, 2.0)
    assert problem.increments > 1


def test_a_flow_is_run_until_it_is_steady():
    problem = layer("fixed", cells=(2, 2))
    fem.run(problem, "steady", 0.05)
    steady = SAND.steady(0.60)
    assert 0.3 < problem.t < 5 and problem.states.coordination_number == pytest.approx(steady.coordination_number, rel=1e-4)


def test_a_body_that_is_unjammed_stops_with_words_unless_told_to_go_on():
    def stretched():
        box = fem.meshes.box(MPI.COMM_WORLD, (1, 1), (2, 2))
        return fem.Problem(box, SAND, DENSE, [
            fem.Displacement(lambda x: np.isclose(x[0] * (1 - x[0]), 0), components=[0]),
            fem.Displacement(at(1, 0), components=[1]),
            fem.Displacement(at(1, 1), lambda x, t: [0, 0.01 * t], components=[1])], motion="boundary")
    problem = stretched()
    with pytest.raises(fem.SolveError, match=r"[1-9]\d*% of the body is unjammed at t = .* arbitrary.* give unjammed"):
        fem.run(problem, 4, 1.0)
    assert problem.t < 4 and problem.unjammed_share() > 0.02
    volumes = problem.point_volumes().reshape(problem.cells, -1).sum(axis=1)
    assert np.average(fem.cell_fields(problem)["unjammed"], weights=volumes) == pytest.approx(problem.unjammed_share())
    problem = stretched()
    fem.run(problem, 4, 1.0, unjammed=1)
    assert problem.t == 4


def test_faults_say_what_to_take():
    def layer_of(cell, **more):
        box = fem.meshes.box(MPI.COMM_WORLD, (1, 1), (2, 2), cell)
        return fem.Problem(box, SAND, DENSE, [fem.Displacement(at(1, 0)), *more.pop("conditions", [])], **more)
    with pytest.raises(ValueError, match="motion = 'eulerian': must be one of lagrangian, fixed, boundary, or a function"):
        layer_of("quadrilateral", motion="eulerian")
    for cell, degree in (("triangle", 1), ("quadrilateral", 2)):
        with pytest.raises(ValueError, match=f"shape {cell}, degree {degree}: .* quadrilaterals and hexahedra of degree 1 only"):
            layer_of(cell, degree=degree, motion="fixed")
    with pytest.raises(ValueError, match="Inflow and Outflow are for a mesh that does not follow"):
        layer_of("quadrilateral", conditions=[fem.Outflow(at(1, 1))])
    spoilt = DENSE.copy()
    spoilt["volume_fraction"] = -1
    with pytest.raises(ValueError, match=r"condition 1 \(Inflow\): state: "):
        layer_of("quadrilateral", conditions=[fem.Inflow(at(1, 1), spoilt)], motion="fixed")
    lid = fem.Displacement(at(1, 1), lambda x, t: [0, -0.01 * t])
    with pytest.raises(ValueError, match=r"passes the boundary of the mesh at \(.*, 1\): give an Inflow or an Outflow"):
        fem.run(layer_of("quadrilateral", conditions=[lid], motion="fixed"), 1, 1.0)
    with pytest.raises(ValueError, match=r"motion returns shape \(2,\)"):
        fem.run(layer_of("quadrilateral", conditions=[lid], motion=lambda x, material, t: np.zeros(2)), 1, 1.0)
    with pytest.raises(ValueError, match="strain: the strain since the start is not known"):
        fem.cell_fields(layer("fixed"), ["strain", "p"])


COLUMN = """
[material]
mu = 0.5
elastic_strain = 0.01
[mesh]
kind = "box"
size = [0.5, 1]
cells = [3, 6]
[initial]
state = "isotropic"
phi = 0.60
pressure = 0.01
[motion]
kind = "fixed"
[[condition]]
on = ["left", "right"]
displacement = { x = 0 }
[[condition]]
on = "bottom"
displacement = { y = [[0, 0], [100, -10]] }
outflow = true
[[condition]]
on = "top"
displacement = { y = [[0, 0], [100, -10]] }
inflow = true
[run]
until = 20
increment = 0.5
[output]
fields = ["p", "origin"]
pictures = ["p"]
"""


def test_a_scene_with_what_flows_through(tmp_path):
    (tmp_path / "column.toml").write_text(COLUMN)
    column, _ = solve(tmp_path / "column.toml", tmp_path / "out")
    assert column.t == 20 and column.states.volume_fraction == pytest.approx(0.6, rel=1e-9)
    *_, (_, _, last) = records(tmp_path / "out/fields.xdmf")
    assert last["unjammed"] == pytest.approx(0) and last["p"] == pytest.approx(0.01)
    assert last["origin"][:, 1] == pytest.approx(1, abs=1e-5)    # at the inflow, each in its own column of cells
    assert np.sort(last["origin"][:, 0]) == pytest.approx(np.repeat([1, 3, 5], 6) / 12)


LAYER = replaced(scenes.BOX, {
    "[4, 2]": "[6, 4]", "pressure = 0.007": "pressure = 0.01", "pressure = [[0, 0.007], [10, 0.008]]": "pressure = 0.01",
    "[[0, 0], [3.5, 0.02], [10, -0.02]]": "[[0, 0], [10, 5]]", "until = 6\nincrement = 1": "until = 1.2\nincrement = 0.01"}) + """
[problem]
gravity = [0, -0.02]
[motion]
kind = "boundary"
[output]
every = 7
fields = ["p", "origin"]
probes = { middle = [0.5, 0.25] }
checkpoint = { every = 3 }
"""


@pytest.mark.slow
def test_a_flow_that_is_killed_ends_as_if_it_had_not_been(tmp_path):
    (tmp_path / "layer.toml").write_text(LAYER)

    def command(out, ranks, *more):
        return on_ranks(ranks, "-m", "granumat", "solve", "layer.toml", "--out", out, *more)
    subprocess.run(command("whole", 1), cwd=tmp_path, check=True, capture_output=True, env=ENVIRONMENT)
    moment, table = np.random.default_rng().integers(10, 100), tmp_path / "cut/reactions.csv"
    with subprocess.Popen(command("cut", 1)[3:], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                          env=ENVIRONMENT) as running:                       # without mpirun: the process itself is killed
        while not table.exists() or table.read_text().count("\n") < moment:
            assert running.poll() is None
            time.sleep(0.002)
        running.kill()
    assert table.read_text().count("\n") < 121
    for ranks in (1, 2):
        shutil.copytree(tmp_path / "cut", tmp_path / f"on{ranks}")
        subprocess.run(command(f"on{ranks}", ranks, "--resume"), cwd=tmp_path, check=True, capture_output=True, env=ENVIRONMENT)
        for name in ("reactions.csv", "probe-middle.csv"):
            whole, again = (read_table(tmp_path / place / name) for place in ("whole", f"on{ranks}"))
            assert whole["t"][-1] == 1.2
            for column in whole.dtype.names:                     # next to no shear is left there, whose direction has round-off
                tolerance = 1e-6 if column in ("eta", "dilatancy", "eta_t") else 1e-10
                assert again[column] == pytest.approx(whole[column], rel=0, abs=tolerance * abs(whole[column]).max() + 1e-14)
        for field in ("p", "origin"):
            shown = [[record[field] for *_, record in records(tmp_path / place / "fields.xdmf")]
                     for place in ("whole", f"on{ranks}")]
            assert shown[1] == pytest.approx(np.array(shown[0]), rel=1e-10, abs=1e-12)


def test_mistakes_of_a_scene_are_named_together(tmp_path):
    wrong = COLUMN.replace('"fixed"', '"still"').replace("outflow = true", "outflow = 1").replace(
        "until = 20", 'until = "calm"\nunjammed = 2')
    (tmp_path / "wrong.toml").write_text(wrong)
    with pytest.raises(ValueError) as caught:
        solve(tmp_path / "wrong.toml", tmp_path / "out")
    for words in ("kind = 'still': must be one of lagrangian, fixed, boundary", "outflow = 1: must be true",
                  "until = 'calm': must be a number above 0, or 'steady'", "unjammed = 2: must be a number from 0 to 1"):
        assert words in str(caught.value), words
    for old, new, words in (('kind = "fixed"', 'kind = "lagrangian"', "[motion]: Inflow and Outflow are for a mesh that does not"),
                            ("cells = [3, 6]", 'cells = [3, 6]\ncell = "triangle"', "[motion]: motion = 'fixed' on cells of the")):
        (tmp_path / "wrong.toml").write_text(COLUMN.replace(old, new))
        with pytest.raises(ValueError) as caught:
            solve(tmp_path / "wrong.toml", tmp_path / "out")
        assert words in str(caught.value)


SCRIPT = """
import sys
sys.path[:0] = sys.argv[1:3]
from test_motion import *
from granumat.fem.cellwise import CellOrder
problem, inner = annular_cell.ring(SAND, 3, 4, 1.0, part=1 / 9, motion="boundary", origin=True)
out = Path(sys.argv[3])
path = out / "checkpoint.npz"
if path.exists():
    fem.resume(path, problem)
    assert problem.increments == 7 and problem.is_ahead
fem.run(problem, problem.t + 0.07, 0.01, observers=[fem.Checkpoint(path, every=7)])
order = CellOrder(problem.mesh)
torque = problem.reaction(inner)[1]
problem.move_mesh()
numbers = problem.states.view(float).reshape(problem.cells, -1, 20)
final = [order.gather(np.ascontiguousarray(values).reshape(problem.cells, -1)) for values in (
    numbers[..., :6], numbers[..., 6:12], numbers[..., 12:18], numbers[..., 18], numbers[..., 19],
    problem.body.at_cells(problem.displacement), problem.shear_strain, problem.volume_strain, problem.origin)]
if MPI.COMM_WORLD.rank == 0:
    print(repr(float(torque)))
    for values in final:
        print(*map(repr, values.ravel().tolist()))
"""


def test_ranks_agree_and_a_run_goes_on_on_another_number_of_them(mpirun, tmp_path):
    def run(ranks, place):
        printed = mpirun(SCRIPT, ranks, Path(__file__).parent, Path(__file__).parents[1], place)
        return [np.array(line.split(), float) for line in printed.splitlines()]
    places = {ranks: tmp_path / f"on{ranks}" for ranks in (1, 2, 3)}
    for place in places.values():
        place.mkdir()
    halfway = {ranks: run(ranks, place) for ranks, place in places.items()}
    for ranks in (2, 3):
        for found, expected in zip(halfway[ranks], halfway[1], strict=True):
            assert found == pytest.approx(expected, rel=0, abs=1e-10 * abs(expected).max())
    (tmp_path / "moved").mkdir()
    (tmp_path / "moved/checkpoint.npz").write_bytes((places[1] / "checkpoint.npz").read_bytes())
    there = run(2, tmp_path / "moved")                           # begun on one, gone on with on two
    back = run(1, places[1])
    for found, expected in zip(there, back, strict=True):
        assert found == pytest.approx(expected, rel=0, abs=1e-10 * abs(expected).max())
    assert abs(back[1] - halfway[1][1]).max() > 1e-3 * abs(back[1]).max()
