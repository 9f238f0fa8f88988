"""Bodies with a length: the nonlocal strain m beside the displacements."""

import itertools
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem
from granumat.fem import scene, system
from support import scenes
from support.xdmf import records

DEMOS = Path(__file__).parents[2] / "demos"
sys.path.insert(0, str(DEMOS))
import annular_cell  # noqa: E402
import homogeneous_shear  # noqa: E402
import length as demo_of_length  # noqa: E402
import noisy_rings  # noqa: E402
import platen_gravity  # noqa: E402

SAND = Material(0.5, elastic_strain=0.01)
pytestmark = pytest.mark.filterwarnings("ignore:a length does not suit")      # full in three dimensions
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def smooth(x, size, phase):
    """A field that differs from place to place."""
    waves = np.array([[3.0, 2, 1], [1, 3, 2], [2, 1, 3]])[:x.shape[1], :x.shape[1]]
    return size * np.sin(x @ waves + phase + np.arange(x.shape[1]))


def body(cell, **more):
    size = (1, 1) if cell in CELLS[:2] else (1, 1, 1)
    return fem.Problem(
        fem.meshes.box(MPI.COMM_WORLD, size, (3, 3) if len(size) == 2 else (2, 2, 2), cell), SAND,
        SAND.isotropic(0.6, pressure=0.05),
        [fem.Displacement(lambda x: np.isclose(x[0], 0), axes=fem.polar((-0.5, 0.1)), components=[0]),
         fem.Pressure(lambda x: np.isclose(x[0], 1), 0.3)], **more)


@pytest.mark.parametrize("rate_term", [0.0, 0.05])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_stiffness_is_the_derivative_of_forces_and_of_the_equations_of_m(cell, degree, rate_term):
    problem = body(cell, degree=degree, rate_term=rate_term, length=0.3)
    problem.displacement = smooth(problem.positions, 0.02, 0.3)
    x = problem.positions

    def unknowns(phase):
        return np.column_stack([smooth(x, 2e-3, phase), 3e-3 + smooth(x, 1e-3, phase + 1)[:, 0]])

    first, _ = problem.evaluate(unknowns(0.0), 1.0)
    assert not first.failure
    problem.accept(first)
    at, v = unknowns(1.0), np.column_stack([smooth(x, 1.0, 2.0), smooth(x, 1.0, 3.0)[:, 0]])
    trial, _ = problem.evaluate(at, 0.5)
    assert not trial.failure
    vertices = problem.body.cell_nodes[:, :problem.body.element.vertex_values.shape[1]]
    v[np.setdiff1d(np.arange(len(x)), vertices), -1] = 0                   # m lives on the vertices
    scale = problem.nonlocal_field.scale(trial.m, problem.states["stress"])
    stiffness = problem.stiffness(trial)
    direction = problem.body.at_cells(problem.numbering.to_axes(v)).reshape(problem.cells, -1)
    found = np.einsum("crk,ck->cr", stiffness, direction)

    def rows(step):
        trial, _ = problem.evaluate(at + step * v, 0.5)
        assert not trial.failure
        return problem.numbering.forces_to_axes(np.concatenate([trial.forces, scale * trial.nonlocal_residuals[..., None]], axis=2))

    h, weights = 2e-6, {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}          # of 8th order
    expected = sum(w * (rows(k * h) - rows(-k * h)) for k, w in weights.items()) / h
    of_m = np.arange(found.shape[1]) % v.shape[1] == problem.d
    for chosen in (of_m, ~of_m):
        assert abs(found - expected)[:, chosen].max() < 1e-7 * abs(expected[:, chosen]).max()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_homogeneous_shear_equals_the_point_with_any_length(cell, degree):
    tolerances = fem.Tolerances(force=1e-10)
    for length, loaded in ((0.1, False), (3.0, True)):
        problem, platen = homogeneous_shear.box(2, cell, degree, 8, loaded, length=length, tolerances=tolerances)
        found = homogeneous_shear.compare(problem, platen, 8 if loaded else 11)
        assert found["difference"].max() < 1e-10
        m = problem.nonlocal_field.at_points(problem.last.m)
        assert np.ptp(problem.comm.allreduce(m)) < 1e-9 * m.max()


@pytest.mark.parametrize("cell", CELLS)
def test_the_nonlocal_strain_of_a_given_strain_is_of_second_order(cell):
    flat, length = cell in CELLS[:2], 0.3
    d = 2 if flat else 3

    def error(n):
        mesh = fem.meshes.box(MPI.COMM_WORLD, (1,) * d, (n,) * d, cell)
        problem = fem.Problem(mesh, SAND, SAND.isotropic(0.6, pressure=0.01), [], length=length)
        exact = [2 + 0.3 * np.cos(np.pi * x).prod(axis=1) for x in (problem.positions, problem.point_positions())]
        gradients = np.zeros((len(exact[1]), 3, 3))
        gradients[:, 0, 1] = 2 * (exact[1] + length**2 * d * np.pi**2 * (exact[1] - 2))    # abs(D) is half the shear
        found = problem.nonlocal_field.solve(problem.displacement, gradients, np.zeros(len(problem.positions)))
        return np.sqrt(((found - exact[0])**2).mean())

    coarse, fine = (error(n) for n in ((8, 16) if flat else (4, 8)))
    assert fine < 0.01 and coarse / fine > 3.4


def steady_at(R):
    """The state of plane steady shear in x and y at constant abs(D)/m = R, and its rate of shear."""
    state, gradient = SAND.isotropic(0.6, pressure=0.01), np.zeros((3, 3))
    gradient[0, 1] = 0.02
    for _ in range(2000):
        state = SAND.update(state, gradient, nonlocal_strain=0.01 / R)
    return state


def creep(R, cells, height=2.0, length=0.2):
    """m over the height of a layer whose ratio of stresses is the steady one at R, where m = 1e-5 is given at the bottom."""
    state = steady_at(R)
    mesh = fem.meshes.box(MPI.COMM_WORLD, (0.5, height), (2, cells))

    def on(axis, end):
        return lambda x: np.isclose(x[axis], end)

    problem = fem.Problem(mesh, SAND, state, [
        fem.Displacement(on(1, 0)), fem.NonlocalStrain(on(1, 0), 1e-5), fem.Traction(on(1, height), state.stress[[3, 1]]),
        fem.Periodic(on(0, 0.5), lambda x: x - np.array([0.5, 0]))], length=length)
    fem.run(problem, 1.0, 1.0)
    order = np.argsort(problem.positions[:, 1])
    return problem, problem.positions[order, 1], problem.last.m[order]


@pytest.mark.parametrize("R", [0.2, 0.8])                                   # at 0.5 the errors of second order cancel
def test_below_yield_m_decays_over_the_length_over_the_root_of_1_minus_R(R):
    length, errors = 0.2, []
    decay = length / np.sqrt(1 - R)
    for cells in (30, 60):                                                  # a third, a sixth of the length
        problem, y, m = creep(R, cells)
        slope = np.polyfit(y[y < 1], np.arccosh(m[y < 1] / m[-1]), 1)[0]
        errors.append(-1 / slope / decay - 1)
        strain = np.concatenate(problem.comm.allgather(fem.cell_fields(problem, ["R"])["R"]))
        assert strain == pytest.approx(R, rel=1e-5)
    assert abs(errors[0]) < 0.005 and errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.release_only
def test_a_layer_with_weight_flows_as_steady_states_at_constant_R_say():
    rows, (ratio, rates) = 16, platen_gravity.with_length(0.1)
    force, found = platen_gravity.drag_layer(rows, 0.0, 0.1, 0.6, 30)
    expected = rates(1 - (np.arange(20 * rows) + 0.5) / (20 * rows)).reshape(rows, 20).mean(axis=1)
    assert force[-1, 1] == pytest.approx(ratio, rel=0.01)
    assert np.sqrt(((found - expected)**2).mean()) < 0.1 * expected.mean()


def turned(rings=4, sectors=12, turn=0.03, back=0.015, increment=0.005, length=0.2, **more):
    """The annular shear cell, turned and turned back: torque, pressure and phi after every increment, and the problem."""
    problem, inner = annular_cell.ring(more.pop("material", SAND), rings, sectors, turn, length=length, **more)
    watch = annular_cell.Watch(problem, inner, rings, more.get("part", 1.0))
    fem.run(problem, turn + back, increment, events=[turn], observers=[watch])
    return watch, problem


@pytest.fixture(scope="module")
def whole():
    return turned()[0].columns()


@pytest.mark.release_only
def test_newton_converges_quadratically_and_needs_no_increment_cut(whole):
    watch, _ = turned()
    assert len(watch.residuals) == 9
    for history in watch.residuals[1:]:
        first, second, third = history[:3]
        assert second < 200 * first**1.5 and third < max(200 * second**2, 1e-12)


@pytest.mark.release_only
def test_periodic_sides_that_turn_tie_m_without_turning_it(whole):
    part = turned(sectors=1, part=1 / 12)[0].columns()
    for name in ("torque", "pressure", "phi"):
        assert part[name] == pytest.approx(whole[name], rel=1e-9), name


@pytest.mark.slow
@pytest.mark.release_only
@pytest.mark.parametrize(("cell", "degree"), [("triangle", 2), ("quadrilateral", 2), ("hexahedron", 1), ("tetrahedron", 2)])
def test_cells_of_each_kind_agree_in_the_ring(cell, degree, whole):
    found = turned(cell=cell, degree=degree)[0].columns()
    assert found["torque"] == pytest.approx(whole["torque"], abs=0.06 * whole["torque"].max())


def test_ranks_agree(mpirun, whole):
    script = f"""
import itertools
import sys
sys.path[:0] = [{str(DEMOS)!r}, *{[str(path) for path in Path(__file__).parents[:2]]!r}]
from mpi4py import MPI
import test_nonlocal
columns = test_nonlocal.turned()[0].columns()
if MPI.COMM_WORLD.rank == 0:
    for name in ("torque", "pressure", "phi"):
        print(*(repr(float(value)) for value in columns[name]))
"""
    for ranks in (2, 3):
        found = [np.array(line.split(), float) for line in mpirun(script, ranks).splitlines()]
        for name, values in zip(("torque", "pressure", "phi"), found, strict=True):
            assert values == pytest.approx(whole[name], rel=1e-9, abs=1e-12)


def test_ranks_agree_on_every_kind_of_cell_and_with_the_iterative_solver(mpirun):
    script = f"""
import itertools
import sys
sys.path[:0] = [{str(DEMOS)!r}, *{[str(path) for path in Path(__file__).parents[:2]]!r}]
import numpy as np
from mpi4py import MPI
from granumat.fem import system
import test_nonlocal
system.DIRECT_FIRST_UP_TO = {{2: 0, 3: 0}}
for cell, degree in (("triangle", 2), ("hexahedron", 1), ("tetrahedron", 1)):
    watch, problem = test_nonlocal.turned(3, 9, 0.015, 0.01, length=0.3, cell=cell, degree=degree)
    m = problem.nonlocal_field.at_points(problem.last.m)
    sums = problem.comm.allreduce(np.array([m.sum(), (m**2).sum()]))
    if problem.comm.rank == 0:
        print(*watch.columns()["torque"], *sums)
"""
    one, two = (np.array(mpirun(script, ranks).split(), float) for ranks in (1, 2))
    assert two == pytest.approx(one, rel=1e-7)


@pytest.mark.release_only
def test_a_resumed_run_is_the_one_that_went_on(tmp_path):
    def problem():
        return annular_cell.ring(SAND, 4, 1, 0.03, part=1 / 12, length=0.2)[0]

    whole, cut, again = problem(), problem(), problem()
    fem.run(whole, 0.045, 0.005, events=[0.03])
    checkpoint = fem.Checkpoint(tmp_path / "checkpoint.npz", every=1)
    fem.run(cut, 0.03, 0.005, observers=[checkpoint])
    fem.resume(checkpoint.path, again)
    assert (again.last.m == cut.last.m).all()
    fem.run(again, 0.045, 0.005, events=[0.03])
    for name in ("stress", "fabric", "coordination_number", "volume_fraction"):
        assert abs(again.states[name] - whole.states[name]).max() < 1e-10 * abs(whole.states[name]).max(), name
    assert again.last.residuals == whole.last.residuals
    with pytest.raises(ValueError, match=r"length: 0\.2 in the checkpoint, 0\.1 here"):
        fem.resume(checkpoint.path, annular_cell.ring(SAND, 4, 1, 0.03, part=1 / 12, length=0.1)[0])


@pytest.mark.release_only
@pytest.mark.slow
def test_torque_and_width_of_the_ring_settle_at_those_of_the_radial_solution():
    watch, _ = turned(16, 1, 0.12, 0.08, 0.002, length=0.05, part=1 / 48)
    columns = watch.columns()
    at = np.argmin(abs(columns["path"] - 0.12))
    assert columns["torque"][at] == pytest.approx(0.027843, rel=0.01)        # of 256 rings of cells in one dimension
    assert len(columns["path"]) == 100 and columns["iterations"].mean() < 3.3


@pytest.mark.release_only
def test_where_the_last_increment_misleads_after_a_reversal_the_guess_from_rest_needs_no_cut():
    sand = Material(0.5)
    watch, _ = turned(16, 1, 0.12, 0.016, 0.008, length=0.05, part=1 / 48, material=sand, start=sand.isotropic(0.6, pressure=0.01))
    assert len(watch.residuals) == 17
    assert len(watch.residuals[15]) > fem.Tolerances().iterations + 1           # those of the other guess among them


def sheared_box(cells, noise, until, **more):
    """Largest scatter of abs(D) along x, over that of phi, in a box periodic along x, sheared under a constant load."""
    start = annular_cell.uneven(SAND.isotropic(0.6, pressure=0.01), cells**2, noise)

    def top(x):
        return np.isclose(x[1], 1)

    problem = fem.Problem(
        fem.meshes.box(MPI.COMM_WORLD, (1, 1), (cells, cells)), SAND, start,
        [fem.Displacement(lambda x: np.isclose(x[1], 0)), fem.Displacement(top, lambda x, t: [t, 0], components=[0]),
         fem.Tied(top, 1), fem.Pressure(top, 0.01), fem.Periodic(lambda x: np.isclose(x[0], 1), lambda x: x - np.array([1.0, 0]))],
        **more)
    fem.run(problem, until, 0.02)
    strain = fem.cell_fields(problem, ["nonlocal_strain", "R"])
    y = np.round(problem.body.at_cells(problem.positions)[:, :, 1].mean(axis=1), 6)
    local = strain["nonlocal_strain"] * strain["R"]
    return max(local[y == row].std() / local[y == row].mean() for row in np.unique(y)) / noise


@pytest.mark.slow
@pytest.mark.release_only
def test_around_whole_rings_errors_of_the_packing_do_not_grow_with_refinement_where_there_is_a_length(tmp_path):
    largest = noisy_rings.main(**noisy_rings.SHORT, out=tmp_path)                            # asserts bounds and refinement
    assert set(largest) == set(itertools.product(noisy_rings.SHORT["lengths"], (8, 16), noisy_rings.HALVES))
    assert {path.name for path in tmp_path.iterdir()} == {"noisy-rings.csv", "noisy-rings.png"}


@pytest.mark.release_only
def test_errors_of_the_packing_grow_without_a_length_and_not_with_one():
    assert sheared_box(16, 1e-6, 0.6, length=0.05) < 1
    assert sheared_box(16, 1e-6, 0.6) > 10


@pytest.mark.parametrize("low", [0.0, 1e-5])
def test_a_nonlocal_strain_that_drops_at_a_wall_is_the_given_one_at_once(low):
    mesh, sides = fem.meshes.box(MPI.COMM_WORLD, (1, 1), (4, 8)), [lambda x, y=y: np.isclose(x[1], y) for y in (0, 1)]
    problem = fem.Problem(mesh, SAND, SAND.isotropic(0.6, pressure=0.01), [
        fem.Displacement(sides[0]), fem.Displacement(sides[1], lambda x, t: [t, 0]),
        fem.NonlocalStrain(sides[0], lambda t: 0.5 if t < 0.025 else low),
        fem.Periodic(lambda x: np.isclose(x[0], 1), lambda x: x - np.array([1.0, 0]))], length=0.2)
    found, wall = [], np.isclose(problem.positions[:, 1], 0)
    fem.run(problem, 0.05, 0.01, observers=[lambda problem: found.append(problem.last.m[wall]) if problem.last else None])
    for m, given in zip(found, (0.005, 0.005, 0.01 * low, 0.01 * low, 0.01 * low), strict=True):
        assert m == pytest.approx(given, rel=1e-9, abs=1e-15)


def test_a_pause_takes_no_iteration_and_has_no_nonlocal_strain():
    problem, _ = homogeneous_shear.box(2, "quadrilateral", 1, 8, True, length=0.3)
    fem.run(problem, 8, 1.0)
    pause = problem.solve_increment(1.0)
    assert not pause.failure and len(pause.residuals) == 1 and not pause.m.any()
    assert (pause.states.stress == problem.states.stress).all()


def test_wrong_lengths_and_conditions_are_refused_in_words():
    mesh, start = fem.meshes.box(MPI.COMM_WORLD, (1, 1), (2, 2)), SAND.isotropic(0.6, pressure=0.01)
    for length in (-0.1, np.nan, np.inf, "long"):
        with pytest.raises(ValueError, match=r"length = .*: must be a finite number, at least 0"):
            fem.Problem(mesh, SAND, start, length=length)
    given = fem.NonlocalStrain(lambda x: np.isclose(x[0], 0), 0.1)
    with pytest.raises(ValueError, match=r"condition 0 \(NonlocalStrain\): the problem has no length"):
        fem.Problem(mesh, SAND, start, [given])
    falling = fem.NonlocalStrain(given.where, lambda t: -t)
    with pytest.raises(ValueError, match=r"a NonlocalStrain's value at t = 1 is -1.0: must be a finite number, at least 0"):
        fem.Problem(mesh, SAND, start, [falling], length=0.1).solve_increment(1.0)


def test_a_closure_that_a_length_does_not_suit_is_warned_of():
    sand = Material(0.1, closure="basic", elastic_strain=0.01)
    with pytest.warns(UserWarning, match="a length does not suit the closure 'basic'"):
        fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (1, 1), (2, 2)), sand, sand.isotropic(0.6, pressure=0.01), length=0.1)


@pytest.mark.release_only
def test_a_scene_has_its_length_in_the_problem_and_records_the_nonlocal_strain(tmp_path):
    path = tmp_path / "ring.toml"
    path.write_text(scenes.RING.replace("[run]", "[problem]\nlength = 0.1\n[run]"))
    problem, _ = scene.solve(path, tmp_path / "out")
    assert problem.length == 0.1
    _, _, arrays = list(records(tmp_path / "out/fields.xdmf"))[-1]
    m, R = (fem.cell_fields(problem, [name])[name] for name in ("nonlocal_strain", "R"))
    for name, values in (("nonlocal_strain", m), ("R", R)):                 # in the file in the order of the mesh as given
        np.testing.assert_allclose(np.sort(arrays[name]), np.sort(values))
    assert np.ptp(R) > 1e-3 and m.min() > 0


@pytest.mark.release_only
def test_with_degree_2_and_gravity_a_layer_and_a_sector_are_the_whole(tmp_path):
    for text, key, more in ((scenes.BOX, "layer", "degree = 2\ngravity = [0, -1e-3]\n"), (scenes.RING, "sector", "")):
        found = []
        for part in ("false", "true"):
            path = tmp_path / f"{key}-{part}.toml"
            path.write_text(text.replace("[initial]", f"{key} = {part}\n[initial]")
                            .replace("[run]", f"[problem]\nlength = 0.2\n{more}[run]"))
            scene.solve(path, tmp_path / f"{key}-{part}")
            found.append(scenes.read_table(tmp_path / f"{key}-{part}/reactions.csv"))
        for column in found[0].dtype.names:
            np.testing.assert_allclose(found[1][column], found[0][column], rtol=1e-8, atol=1e-10, err_msg=column)


@pytest.mark.release_only
def test_the_demo_shows_a_width_that_the_mesh_does_not_change(tmp_path):
    rows = demo_of_length.main(**demo_of_length.SHORT, out=tmp_path)                         # asserts the widths and torques
    assert {path.name for path in tmp_path.iterdir()} == {"length.csv", "length.png"}
    without, with_length = rows[:2], rows[2:]
    assert all(row["iterations"] < other["iterations"] for row, other in zip(with_length, without, strict=True))


@pytest.mark.release_only
def test_solvers_that_fail_are_followed_by_others_that_give_the_same(monkeypatch):
    def torque():
        return turned(3, 9, 0.015, 0.01, length=0.3, cell="hexahedron")[0].columns()["torque"]

    expected = torque()
    monkeypatch.setattr(system, "DIRECT_FIRST_UP_TO", {2: 0, 3: 0})
    one, another = ({**options, "ksp_max_it": 1} for options in system.ITERATIVE_WITH_LENGTH)
    for solvers in ((one, system.ITERATIVE_WITH_LENGTH[1]), (one, another)):       # ILU(1) takes over, then MUMPS
        monkeypatch.setattr(system, "ITERATIVE_WITH_LENGTH", solvers)
        assert torque() == pytest.approx(expected, rel=1e-7)
