"""Conditions do what they say, bad ones are named, and a failed increment leaves the problem as it was."""

from itertools import pairwise

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from granumat import Material, fem
from granumat.material import TURNING

SAND = Material(0.5, elastic_strain=1e-2)
PRESSURE = 0.01
TURN = fem.rotation(lambda t: t)


def left(x):
    return np.isclose(x[0], 0)


def right(x):
    return np.isclose(x[0], 2)


def bottom(x):
    return np.isclose(x[1], 0)


def top(x):
    return np.isclose(x[1], 1)


def block(conditions, cell="quadrilateral", **options):
    """A block of 2 x 1 on rollers left and below, isotropic at PRESSURE."""
    body = fem.meshes.box(MPI.COMM_WORLD, (2.0, 1.0), (4, 2), cell)
    rollers = [fem.Displacement(left, components=[0]), fem.Displacement(bottom, components=[1])]
    return fem.Problem(body, SAND, SAND.isotropic(0.6, pressure=PRESSURE), rollers + conditions, **options)


def solved(problem, duration=1.0):
    trial = problem.solve_increment(duration)
    assert not trial.failure
    problem.accept(trial)
    return problem


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_body_under_its_own_pressure_stays_where_it_is(cell, degree):
    problem = solved(block([fem.Pressure(right, PRESSURE), fem.Pressure(top, PRESSURE)], cell, degree=degree))
    assert abs(problem.displacement).max() < 1e-13
    assert problem.reaction(left)[0][0] == pytest.approx(PRESSURE, abs=1e-12)
    assert problem.reaction(bottom)[0][1] == pytest.approx(2 * PRESSURE, abs=1e-12)


def test_pressure_and_traction_agree_on_faces_that_do_not_rotate():
    flat = [fem.Tied(top, 1), fem.Tied(right, 0)]
    pressed = solved(block([*flat, fem.Pressure(right, PRESSURE), fem.Pressure(top, 1.01 * PRESSURE)]))
    length, height = (pressed.positions + pressed.displacement).max(axis=0)
    assert height < 1 - 1e-4
    pulled = solved(block([*flat, fem.Traction(right, (-PRESSURE * height, 0)),           # forces per area of the start
                           fem.Traction(top, lambda t: (0, -1.01 * PRESSURE * length / 2))]))
    assert pulled.displacement == pytest.approx(pressed.displacement, abs=1e-9)


def rotated_by_one_side():
    """A body under a pressure all around it, of which one side is rotated."""
    body = fem.meshes.box(MPI.COMM_WORLD, (2.0, 1.0), (4, 2))
    return fem.Problem(body, SAND, SAND.isotropic(0.6, pressure=PRESSURE), [
        fem.Displacement(left, TURN), *(fem.Pressure(side, PRESSURE) for side in (right, top, bottom))])


def test_a_pressure_follows_the_rotating_boundary():
    problem = rotated_by_one_side()
    fem.run(problem, 0.4, 0.1)
    assert problem.displacement == pytest.approx(TURN(problem.positions, 0.4), abs=1e-9)
    assert abs(problem.volume_strain).max() < 1e-9


def test_the_floor_carries_the_weight_of_the_solid():
    weight = np.array([0.0, -0.002])
    problem = block([fem.Pressure(right, PRESSURE), fem.Pressure(top, PRESSURE), fem.Displacement(right, components=[0])],
                    gravity=weight)
    solved(solved(problem, 0.5), 0.5)
    assert problem.reaction(bottom)[0][1] == pytest.approx(2 * PRESSURE + 0.6 * 2 * 0.002, rel=1e-10)


def test_periodic_sides_move_alike():
    problem = block([])
    body = problem.mesh
    problem = fem.Problem(body, SAND, SAND.isotropic(0.6, pressure=PRESSURE), [
        fem.Displacement(bottom), fem.Displacement(top, lambda x, t: [t, 0]), fem.Periodic(right, lambda x: x - [2, 0])])
    assert not solved(problem, 0.01).last.failure
    gradient = np.zeros((3, 3))
    gradient[0, 1] = 0.01
    expected = SAND.update(SAND.isotropic(0.6, pressure=PRESSURE), gradient).stress
    assert problem.states.stress == pytest.approx(np.tile(expected, (len(problem.states), 1)), abs=1e-13)


def test_a_tied_part_moves_as_one_and_carries_the_mean_load():
    problem = solved(block([fem.Pressure(right, PRESSURE), fem.Pressure(top, 1.2 * PRESSURE), fem.Tied(top, 1)]))
    lid = problem.displacement[np.isclose(problem.positions[:, 1], 1), 1]
    assert np.ptp(lid) < 1e-15 and lid[0] < -1e-5
    assert problem.reaction(bottom)[0][1] == pytest.approx(2 * 1.2 * PRESSURE, rel=1e-2)


def test_strains_accumulate_to_those_of_the_whole_way():
    """Shear strain is 2 abs(S) (gamma in simple shear); volume strain the logarithm of the volume."""
    sheared = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (2.0, 1.0), (4, 2)), SAND, SAND.isotropic(0.6, pressure=PRESSURE), [
        fem.Displacement(bottom), fem.Displacement(top, lambda x, t: [t, 0]), fem.Periodic(right, lambda x: x - [2, 0])])
    fem.run(sheared, 0.03, 0.01)
    assert sheared.shear_strain == pytest.approx(0.03, abs=1e-12)
    assert abs(sheared.volume_strain).max() < 1e-12
    squeezed = block([fem.Displacement(top, lambda x, t: [0, -t], components=[1]), fem.Displacement(right, components=[0])])
    fem.run(squeezed, 0.03, 0.01)
    assert squeezed.volume_strain == pytest.approx(np.log(0.97), abs=1e-12)
    assert squeezed.states.volume_fraction == pytest.approx(0.6 / 0.97, rel=1e-12)


def test_layers_that_shear_steadily_are_solved_though_their_increment_is_not_unique():
    start, lid = SAND.steady(0.60), (lambda x: np.isclose(x[2], 1))
    layers = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (1.0, 1.0, 1.0), (1, 1, 4)), SAND, start, [
        fem.Displacement(lambda x: np.isclose(x[2], 0)), fem.Displacement(lid, lambda x, t: [0.01 * t, 0, 0]),
        *(fem.Periodic(lambda x, i=i: np.isclose(x[i], 1), lambda x, i=i: x - np.eye(3)[i]) for i in range(2))])
    fem.run(layers, 30, 1.0, smallest=1.0)
    assert layers.increments == 30
    assert layers.states.stress == pytest.approx(np.tile(start.stress, (len(layers.states), 1)), abs=1e-9)


def test_every_fault_of_a_problem_is_named_at_once():
    body = fem.meshes.box(MPI.COMM_WORLD, (2.0, 1.0), (4, 2))
    with pytest.raises(ValueError) as caught:
        fem.Problem(body, Material(0.5, method="rk4"), SAND.isotropic(0.6, pressure=0.01), [left], degree=3,
                    gravity=(0, 0, -1), rate_term=-1)
    for word in ("degree = 3", "gravity", "rate_term = -1", "'rk4'", "condition 0"):
        assert word in str(caught.value)


def test_every_fault_of_a_meshs_arguments_is_named_at_once():
    with pytest.raises(ValueError) as caught:
        fem.meshes.annulus(MPI.COMM_WORLD, (2, 1), (0, 12, 1), -1.0, "triangle", 0.0, 7.0)
    for words in ("radii = (2, 1): must be 2 numbers above 0, the smaller first", "cells = (0, 12, 1): must be 3 integers above 0",
                  "height = -1.0", "grading = 0.0", "angle = 7.0", "cell = 'triangle': must be one of hexahedron, tetrahedron"):
        assert words in str(caught.value)
    with pytest.raises(ValueError, match=r"cells = \(2, 2\): must be 3 sectors or more a turn"):
        fem.meshes.annulus(MPI.COMM_WORLD, (1, 2), (2, 2))
    with pytest.raises(ValueError) as caught:
        fem.meshes.box(MPI.COMM_WORLD, (1, -1), (2, 2.5), "cube", (1,))
    for words in ("size = (1, -1)", "cells = (2, 2.5)", "cell = 'cube'", "grading = (1,): must be 2 numbers above 0"):
        assert words in str(caught.value)
    with pytest.raises(ValueError, match=r"size = \(1,\): must be 2 or 3 numbers above 0"):
        fem.meshes.box(MPI.COMM_WORLD, (1,), (2,))


def test_conditions_that_meet_no_node_or_contradict_are_named():
    with pytest.raises(ValueError) as caught:
        block([fem.Displacement(lambda x: x[0] > 9), fem.Tied(right, 0, axes=lambda x: np.ones((len(x), 2, 2))),
               fem.Periodic(top, lambda x: x - [0, 7]), fem.Periodic(right, lambda x: x - [2, 0]),
               fem.Displacement(right, components=[1]), fem.Tied(bottom, 1)])
    for word in ("component 1 of its displacement is given", "given on the part, but not on its partner",
                 "condition 2 (Displacement): there is no node", "condition 3 (Tied): its axes are not orthonormal", "no node at"):
        assert word in str(caught.value)


def test_facet_tags_name_parts_of_the_boundary():
    body = fem.meshes.box(MPI.COMM_WORLD, (2.0, 1.0), (4, 2))
    facets = np.sort(mesh.locate_entities_boundary(body, 1, top))
    tags = mesh.meshtags(body, 1, facets, np.full(len(facets), 7, np.int32))
    sand = SAND.isotropic(0.6, pressure=PRESSURE)
    floor = fem.Displacement(bottom)
    by_tag = fem.Problem(body, SAND, sand, [floor, fem.Displacement(7, [0.01, 0])], facet_tags=tags)
    by_place = fem.Problem(body, SAND, sand, [floor, fem.Displacement(top, [0.01, 0])])
    assert (solved(by_tag).displacement == solved(by_place).displacement).all()
    with pytest.raises(ValueError, match="no facet_tags"):
        fem.Problem(body, SAND, sand, [fem.Displacement(7)])


def test_a_tangent_is_found_with_the_state_that_a_correction_follows(monkeypatch):
    """Not with the state that is expected to be the last one; if a correction follows nevertheless, it is found afterwards."""
    calls = []

    def count(name, kind):
        update = getattr(Material, name)

        def counted(*arguments, **options):
            calls.append(kind)
            return update(*arguments, **options)
        monkeypatch.setattr(Material, name, counted)
    count("update", "state")
    count("update_with_tangent", "both")

    def second_increment(tolerances):
        problem = block([fem.Displacement(top, lambda x, t: [0.003 * t**2, -0.002 * t]), fem.Pressure(right, PRESSURE)])
        solved(problem)
        problem.tolerances = tolerances
        calls.clear()
        solved(problem)
        return problem.displacement, len(problem.last.residuals) - 1
    expected, corrections = second_increment(fem.Tolerances(correction=1e-4))
    assert corrections > 1 and calls == ["both"] * corrections + ["state"]
    found, corrections = second_increment(fem.Tolerances(correction=1e9))                  # any correction can be the last
    assert corrections > 1 and calls == ["both", "state"] * corrections
    assert found == pytest.approx(expected, abs=1e-9)


def squeezed():
    """The lid is pushed through the floor: the last increments cannot be solved."""
    return block([fem.Displacement(top, lambda x, t: [0, -t], components=[1]), fem.Pressure(right, PRESSURE)])


def test_a_failed_increment_leaves_the_problem_as_it_was():
    problem = solved(squeezed(), 1e-3)
    before = problem.displacement.copy(), problem.states.copy(), problem.t
    trial = problem.solve_increment(2.0)
    assert "inverted" in trial.failure
    assert (problem.displacement == before[0]).all() and (problem.states == before[1]).all() and problem.t == before[2]
    with pytest.raises(ValueError, match="not solved"):
        problem.accept(trial)


def test_a_snapshot_brings_a_problem_back_to_where_it_was():
    problem = rotated_by_one_side()
    fem.run(problem, 0.2, 0.1)
    before = problem.snapshot()
    found = []
    for _ in range(2):
        problem.restore(before)
        fem.run(problem, 0.4, 0.1)
        found.append((problem.t, problem.increments, problem.displacement, problem.states, problem.shear_strain))
    for first, second in zip(*found):
        assert np.array_equal(first, second)


def test_an_increment_is_cut_until_it_can_be_solved_and_grows_again():
    problem, times = rotated_by_one_side(), []
    fem.run(problem, 1.0, 0.5, observers=[lambda p: times.append(p.t)])
    steps = np.diff(times)
    assert times[-1] == 1.0
    assert steps.min() < 0.5 and (np.diff(steps) > 0).any()


def test_what_cannot_be_solved_stops_with_the_reason_and_the_place():
    problem = squeezed()
    with pytest.raises(fem.SolveError) as caught:
        fem.run(problem, 1.5, 0.25, smallest=0.1)
    assert "cut to" in str(caught.value) and "at (" in str(caught.value)
    assert 0 <= problem.t < 1 and np.isfinite(problem.states.stress).all()


def test_faults_of_a_run_are_named_at_once():
    problem = squeezed()
    with pytest.raises(ValueError) as caught:
        fem.run(problem, -1.0, 0.0, smallest=-1.0)
    for word in ("until = -1.0", "increment = 0.0", "smallest = -1.0"):
        assert word in str(caught.value)


def test_events_are_met_exactly():
    times = []
    fem.run(block([fem.Pressure(right, PRESSURE), fem.Pressure(top, PRESSURE)]), 1.0, 0.3, events=[0.4],
            observers=[lambda p: times.append(p.t)])
    assert times == pytest.approx([0, 0.3, 0.4, 0.7, 1.0]) and 0.4 in times and times[-1] == 1.0


@pytest.mark.parametrize("closure", TURNING)
def test_newton_converges_quadratically_where_friction_turns(closure):
    material = Material(0.5, closure, elastic_strain=0.01)
    conditions = [fem.Displacement(lambda x: np.isclose(x[1], 0)),
                  fem.Displacement(lambda x: np.isclose(x[1], 1), lambda x, t: [0.02 * min(t, 6 - t), 0]),
                  fem.Pressure(lambda x: np.isclose(x[0] * (1 - x[0]), 0), 0.01)]
    square = fem.meshes.box(MPI.COMM_WORLD, (1.0, 1.0), (4, 4))
    body = fem.Problem(square, material, material.isotropic(0.6, pressure=0.01), conditions)
    histories = []
    fem.run(body, 6, 1.0, events=[3], observers=[lambda body: histories.append(body.last.residuals if body.last else [])])
    pairs = [pair for history in histories for pair in pairwise(history[1:]) if 1e-6 < pair[0] < 0.02]
    assert len(pairs) >= 6 and max(second / first**2 for first, second in pairs) < 50
