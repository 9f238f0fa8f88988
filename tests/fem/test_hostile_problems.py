"""Wrong calls at a body: each is a ValueError or TypeError that names its fault."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from granumat import STATE, Material, fem
from support.refusals import check_refused

SAND = Material(0.5, elastic_strain=1e-2)
REST = SAND.isotropic(0.6, pressure=0.01)
MESH = fem.meshes.box(MPI.COMM_WORLD, [1.0, 1.0], [2, 2])
CUBE = fem.meshes.box(MPI.COMM_WORLD, [1.0, 1.0, 1.0], [1, 1, 1])
AT = MPI.COMM_WORLD


def bottom(x):
    return np.isclose(x[1], 0)


def top(x):
    return np.isclose(x[1], 1)


def nowhere(x):
    return x[1] > 5


FLOOR, LID = fem.Displacement(bottom), fem.Displacement(top, lambda x, t: [0.01 * t, 0])


def problem(*conditions, mesh=MESH, material=SAND, state=REST, **options):
    return fem.Problem(mesh, material, state, [FLOOR, LID, *conditions], **options)


def run(*conditions, until=1.0, increment=1.0, **options):
    return fem.run(problem(*conditions), until, increment, **options)


def lid(value, **options):
    return lambda: fem.run(fem.Problem(MESH, SAND, REST, [FLOOR, fem.Displacement(top, value, **options)]), 2.0, 1.0)


def alone(*conditions):
    return lambda: fem.run(fem.Problem(MESH, SAND, REST, conditions), 1.0, 1.0)


def with_condition(condition):
    return lambda: problem(condition)


def with_probe(position):
    return lambda: run(observers=[fem.Probe("none.csv", position)])


# A call, the error that it raises, and what this says.
CALLS = [
    (lambda: problem(state=None), TypeError, "states = None: must be an array of dtype STATE"),
    (lambda: problem(state="rest"), TypeError, "states = 'rest'"),
    (lambda: problem(state=np.zeros(20)), TypeError, "dtype float64"),
    (lambda: problem(state=lambda x: None), TypeError, "states = None"),
    (lambda: problem(state=lambda x: np.full(3, REST, STATE)), ValueError, "returns shape (3,) for 16 points"),
    (lambda: problem(state=Material(0.3).isotropic(0.6, pressure=0.01)), ValueError, "it is of another material"),
    (lambda: problem(state=lambda x: np.zeros(len(x), STATE)), ValueError, "has a volume fraction outside (0, 1)"),
    (lambda: problem(mesh=None), TypeError, "mesh = None: must be a dolfinx.mesh.Mesh"),
    (lambda: problem(material="sand"), TypeError, "material = 'sand': must be a Material"),
    (lambda: problem(material=Material(0.5, method="rk4")), ValueError, "the material's method is 'rk4'"),
    (lambda: problem(degree=3), ValueError, "degree = 3"), (lambda: problem(degree=None), ValueError, "degree = None"),
    (lambda: problem(gravity=9.81), ValueError, "gravity = 9.81"),
    (lambda: problem(gravity="down"), ValueError, "gravity = 'down'"),
    (lambda: problem(gravity=[0, 1j]), ValueError, "must be 2 finite numbers"),
    (lambda: problem(rate_term=np.nan), ValueError, "rate_term = nan"),
    (lambda: problem(origin=1), TypeError, "origin = 1: must be True or False"),
    (lambda: problem(tolerances={"force": 1e-8}), TypeError, "must be a Tolerances"),
    (lambda: problem(solver="lu"), TypeError, "must be a dict of PETSc options"),
    (lambda: problem(solver={"pc_type": "foo"}), ValueError, "find requested PC type foo"),
    (lambda: problem(solver={"pc_type": None}), ValueError, "pc_type = None"),
    # conditions
    (with_condition("held"), ValueError, "condition 2: 'held' is none of Displacement"),
    (with_condition(fem.Displacement), ValueError, "is none of Displacement"),
    (with_condition(fem.Displacement(nowhere)), ValueError, "condition 2 (Displacement): there is no node where it should hold"),
    (with_condition(fem.Pressure(nowhere, 0.01)), ValueError, "condition 2 (Pressure): there is no node where it should hold"),
    (with_condition(fem.Traction(nowhere, [0, 1])), ValueError, "condition 2 (Traction): there is no node where it should hold"),
    (with_condition(fem.Tied(nowhere, 1)), ValueError, "condition 2 (Tied): there is no node where it should hold"),
    (with_condition(fem.Pressure(lambda x: np.isclose(x[0], 0.5), 1)), ValueError, "there is no node where it should hold"),
    (with_condition(fem.Pressure(7, 0.01)), ValueError, "the problem was given no facet_tags"),
    (with_condition(fem.Pressure("top", 0.01)), ValueError, "where = 'top'"),
    (with_condition(fem.Pressure(None, 0.01)), ValueError, "where = None"),
    (with_condition(fem.Pressure(lambda x: np.isclose(x[:, 1], 1), 1)), ValueError, "must be a function of positions x (3, n)"),
    (with_condition(fem.Pressure(lambda x: x[:, 8] == 1, 1)), ValueError, "must be a function of positions x (3, n)"),
    (with_condition(fem.Pressure(lambda x: x[1], 1)), ValueError, "of dtype float64"),
    (with_condition(fem.Pressure(lambda x: True, 1)), ValueError, "where returns shape ()"),
    (with_condition(fem.Pressure(top, "high")), ValueError, "value = 'high': must be a finite number"),
    (with_condition(fem.Pressure(top, np.nan)), ValueError, "value = nan"),
    (with_condition(fem.Pressure(top, [1, 2])), ValueError, "value = [1, 2]"),
    (with_condition(fem.Traction(top, 1.0)), ValueError, "value = 1.0: must be 2 finite numbers"),
    (with_condition(fem.Traction(top, [1, 2, 3])), ValueError, "value = [1, 2, 3]"),
    (with_condition(fem.Tied(top, 2)), ValueError, "component = 2: must be one of 0, 1"),
    (with_condition(fem.Tied(top, -1)), ValueError, "component = -1"),
    (with_condition(fem.Tied(top, "y")), ValueError, "component = 'y'"),
    (with_condition(fem.Displacement(top, 0, [2])), ValueError, "components = [2]"),
    (with_condition(fem.Displacement(top, 0, [0, 0])), ValueError, "components = [0, 0]"),
    (with_condition(fem.Displacement(top, 0, 1)), ValueError, "components = 1"),
    (with_condition(fem.Displacement(top, 0, [])), ValueError, "components = []"),
    (with_condition(fem.Displacement(top, 0, axes="polar")), ValueError, "axes = 'polar'"),
    (with_condition(fem.Displacement(top, 0, axes=lambda x: np.eye(2))), ValueError, "its axes are of shape (2, 2)"),
    (with_condition(fem.Periodic(top, "bottom")), ValueError, "partner = 'bottom'"),
    (with_condition(fem.Periodic(top, lambda x: x[0])), ValueError, "partner returns shape (2,)"),
    (with_condition(fem.Periodic(top, lambda x: x + 7)), ValueError, "there is no node at (7, 8)"),
    (lid(np.nan), ValueError, "value = nan"), (lid([1, 2, 3]), ValueError, "value = [1, 2, 3]"),
    (lid("far"), ValueError, "value = 'far'"),
    (lid([0, 1j]), ValueError, "value = [0, 1j]"),
    (lid(lambda x, t: [np.nan, 0]), ValueError, "is not finite at t = 1 at ("),
    (lid(lambda x, t: [np.inf if t > 1 else 0, 0]), ValueError, "is not finite at t = 2 at ("),
    (lid(lambda x, t: np.zeros((2, 7))), ValueError, "value is of shape (2, 7)"),
    (lid(lambda x, t: None), TypeError, "a Displacement's value = None"),
    (lid(lambda x, t: x * 1j), TypeError, "is one of dtype complex128"),
    (lambda: run(fem.Pressure(top, lambda t: np.nan)), ValueError, "a Pressure's value at t = 1 is nan"),
    (lambda: run(fem.Pressure(top, lambda t: [1, 2])), ValueError, "a Pressure's value at t = 1 is [1.0, 2.0]"),
    (lambda: run(fem.Traction(top, lambda t: 1.0)), ValueError, "a Traction's value at t = 1 is 1.0: must be 2 finite numbers"),
    (lambda: run(fem.Traction(top, lambda t: None)), TypeError, "a Traction's value = None"),
    # a body that nothing holds
    (alone(), ValueError, "nothing holds the body against translation along x, translation along y, rotation"),
    (alone(fem.Pressure(top, 0.01)), ValueError, "nothing holds the body against translation along x"),
    (alone(fem.Displacement(bottom, 0, [1])), ValueError, "nothing holds the body against translation along x:"),
    (alone(fem.Displacement(bottom, 0, [0]), fem.Tied(top, 1)), ValueError, "nothing holds the body against translation along y:"),
    (lambda: fem.run(fem.Problem(CUBE, SAND, REST, [fem.Displacement(bottom, 0, [1])]), 1, 1), ValueError,
     "nothing holds the body against translation along x, translation along z, rotation about y:"),
    # runs and outputs
    (lambda: fem.run(None, 1, 1), TypeError, "problem = None"), (lambda: run(until="end"), ValueError, "until = 'end'"),
    (lambda: run(until=np.inf), ValueError, "until = inf"), (lambda: run(increment=0), ValueError, "increment = 0"),
    (lambda: run(increment=None), ValueError, "increment = None"), (lambda: run(increment=np.nan), ValueError, "increment = nan"),
    (lambda: run(increment=1e-300), ValueError, "increment = 1e-300: is lost beside until = 1"),
    (lambda: run(smallest=2), ValueError, "smallest = 2"), (lambda: run(smallest=1e-300), ValueError, "smallest = 1e-300"),
    (with_probe([5, 5]), ValueError, "position = (5, 5): is outside the body"),
    (with_probe([0.5]), ValueError, "position = [0.5]: must be as many finite numbers"),
    (with_probe([0.5, np.nan]), ValueError, "must be as many finite numbers"),
    (with_probe("middle"), TypeError, "position = 'middle'"), (with_probe([0.5, 0.5j]), TypeError, "complex128"),
    (lambda: fem.Pictures(".", "heat"), ValueError, "heat"),
    # meshes
    (lambda: fem.meshes.box(AT, [1, 1], [2]), ValueError, "cells = [2]: must be 2 integers"),
    (lambda: fem.meshes.box(AT, [1, 1], [2, 10**20]), ValueError, "must be 2 integers"),
    (lambda: fem.meshes.box(AT, [1, 1], [10**5, 10**5]), ValueError, "must be 2147483647 together at most"),
    (lambda: fem.meshes.box(AT, [1], [1]), ValueError, "must be 2 or 3 numbers"),
    (lambda: fem.meshes.box(AT, [1, -1], [1, 1]), ValueError, "size = [1, -1]"),
    (lambda: fem.meshes.box(AT, [1, np.nan], [1, 1]), ValueError, "size = [1, nan]"),
    (lambda: fem.meshes.box(AT, [1, np.inf], [1, 1]), ValueError, "size = [1, inf]"),
    (lambda: fem.meshes.box(AT, 1, 2), ValueError, "size = 1"), (lambda: fem.meshes.box(AT, [1, 1], 2), ValueError, "cells = 2"),
    (lambda: fem.meshes.box(AT, ["1", 1], [1, 1]), ValueError, "size = ['1', 1]"),
    (lambda: fem.meshes.annulus(AT, [2, 1], [2, 12]), ValueError, "radii = [2, 1]"),
    (lambda: fem.meshes.annulus(AT, 1, [2, 12]), ValueError, "radii = 1"),
    (lambda: fem.meshes.annulus(AT, [1, 2], [2, 12], grading="x"), ValueError, "grading = 'x'"),
]


@pytest.mark.parametrize("number", range(len(CALLS)))
def test_a_wrong_call_is_refused_in_words(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check_refused(*CALLS[number])


@pytest.mark.parametrize("conditions", [
    [FLOOR], [fem.Displacement(bottom, 0, [1]), fem.Displacement(lambda x: np.isclose(x[0], 0), 0, [0])],
    [fem.Displacement(bottom, 0, [0]), fem.Displacement(top, 0, [1])],
    [fem.Displacement(lambda x: np.isclose(x[0], 1), 0, [0]), fem.Displacement(bottom, 0, [1]), fem.Tied(top, 1)]])
def test_a_body_that_is_held_has_no_free_motion(conditions):
    assert fem.Problem(MESH, SAND, REST, conditions).numbering.free_motions() == []


def test_a_periodic_body_cannot_rotate_and_a_ring_can():
    right = fem.Periodic(lambda x: np.isclose(x[0], 1), lambda x: x - [1, 0])
    assert fem.Problem(MESH, SAND, REST, [right]).numbering.free_motions() == ["translation along x", "translation along y"]
    ring = fem.meshes.annulus(MPI.COMM_WORLD, (1, 2), (1, 12))
    outer = fem.Tied(lambda x: np.hypot(x[0], x[1]) > 1.9, 0, fem.polar())
    assert fem.Problem(ring, SAND, REST, [outer]).numbering.free_motions() == ["rotation"]


def test_a_mesh_with_fewer_cells_than_processes_is_refused(monkeypatch):
    shared = SimpleNamespace(allgather=lambda cells: [cells, 0, 0])
    monkeypatch.setattr(type(MESH), "comm", property(lambda mesh: shared))
    with pytest.raises(ValueError, match="the mesh has 4 cells, and 2 of the 3 processes got none of them: take fewer processes"):
        problem()
