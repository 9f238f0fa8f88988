"""What points have is carried to the points of another mesh without loss, and in second order."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem, tensors
from granumat.core import STATE, numbers
from granumat.fem.body import Body
from granumat.fem.convection import Convection

KAPPA = 0.0445
POLAR = fem.polar()
PHI, SCALARS = 19, [18, 19, 20, 21]
TENSORS = [slice(0, 6), slice(6, 12), slice(12, 18)]
BOXES = {2: (7, 6), 3: (4, 3, 5)}


def two_meshes(d, cells=None, size=0.25):
    """A box, and two positions of its nodes, inside by up to `size` cells away from the regular ones."""
    cells = BOXES[d] if cells is None else cells
    body = Body(fem.meshes.box(MPI.COMM_WORLD, (1.0,) * d, cells), 1)
    x = body.positions
    inside = (np.minimum(x, 1 - x) > 1e-9).all(axis=1)[:, None]
    phase = x @ np.array([91.7, 57.3, 33.1])[:d, None] * np.arange(1, 2 * d + 1)            # the same on any number of ranks
    shifts = np.sin(phase + np.arange(2 * d)) * size * inside / np.tile(cells, 2)
    return body, x + shifts[:, :d], x + shifts[:, d:]


def volumes(body, x):
    cells = body.at_cells(x)
    return body.kinematics(cells, np.zeros_like(cells))[1].reshape(-1, 1)


def random_values(body, seed=3):
    values = np.random.default_rng(seed).uniform(-1, 1, (body.cells * 2**body.d, 22))
    values[:, PHI] = 0.6 + 0.1 * values[:, PHI]
    for tensor in TENSORS[1:]:
        values[:, tensor] = tensors.deviator(values[:, tensor])
    return values


def turned(values, rotation):
    result = values.copy()
    for tensor in TENSORS:
        result[:, tensor] = tensors.to_voigt(rotation @ tensors.to_matrix(values[:, tensor]) @ rotation.T)
    return result


def about_z(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


@pytest.mark.parametrize("d", [2, 3])
def test_constants_stay(d):
    body, x, x_new = two_meshes(d)
    values = np.tile(random_values(body)[:1], (body.cells * 2**d, 1))
    convection = Convection(body, [], KAPPA)
    assert convection.swept(x, x_new) > 0.3                                                   # several substeps
    assert abs(convection.convect(values, x, x_new) - values).max() < 1e-13


@pytest.mark.parametrize("d", [2, 3])
def test_solid_and_what_it_carries_are_conserved(d):
    body, x, x_new = two_meshes(d)
    values = random_values(body) + 2
    found = Convection(body, [], KAPPA).convect(values, x, x_new)
    solid, solid_found = (volumes(body, at) * of[:, [PHI]] for at, of in ((x, values), (x_new, found)))
    assert abs(found - values).max() > 0.1
    assert solid_found.sum() == pytest.approx(solid.sum(), rel=1e-14)
    assert (solid_found * found).sum(axis=0)[:19] == pytest.approx((solid * values).sum(axis=0)[:19], rel=2e-14)


def waves(body, x):
    at = body.point_positions(body.at_cells(x))
    values = np.sin(np.pi * at @ np.arange(1, body.d + 1) / body.d + np.arange(22)[:, None] / 4).T
    values[:, PHI] = 0.6 + 0.05 * values[:, PHI]
    return values


@pytest.mark.parametrize("d", [2, 3])
def test_smooth_fields_are_carried_in_second_order(d):
    errors = []
    for n in {2: (12, 24), 3: (8, 16)}[d]:
        body, x, x_new = two_meshes(d, (n,) * d, 0.15)

        found = Convection(body, [], KAPPA).convect(waves(body, x), x, x_new)
        errors.append(abs(found - waves(body, x_new)).mean(axis=0))
    order = np.log2(errors[0] / errors[1])
    assert order.min() > 1.7 and order.mean() > 1.85


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_leaves_its_range(d):
    body, x, x_new = two_meshes(d)
    values = np.sign(random_values(body))
    values[:, PHI] = 0.6 + 0.1 * values[:, PHI]
    for tensor in TENSORS[1:]:                                                              # all of one magnitude, at random
        values[:, tensor] = tensors.deviator(random_values(body)[:, tensor])
        values[:, tensor] *= KAPPA / tensors.magnitude(values[:, tensor])[:, None]
    found, convection = values, Convection(body, [], KAPPA)
    for _ in range(5):                                                                      # there and back again
        found = convection.convect(convection.convect(found, x, x_new), x_new, x)
    slack = 1e-13
    for column in SCALARS:
        assert values[:, column].min() - slack < found[:, column].min()
        assert found[:, column].max() < values[:, column].max() + slack
    assert tensors.magnitude(found[:, 6:12]).max() < KAPPA * (1 + slack)
    assert abs(tensors.trace(found[:, 6:12])).max() < 1e-15


@pytest.mark.parametrize("d", [2, 3])
def test_the_same_in_any_axes(d):
    body, x, x_new = two_meshes(d)
    values, rotation = random_values(body), about_z(0.7)
    convection, plane = Convection(body, [], KAPPA), about_z(0.7)[:d, :d]
    found = convection.convect(turned(values, rotation), x @ plane.T, x_new @ plane.T)
    assert found == pytest.approx(turned(convection.convect(values, x, x_new), rotation), abs=1e-11)


def ring_of(rings, sectors, part, radii, axes=POLAR):
    """A ring of so many sectors, or a part of it, whose sides are periodic then."""
    angle = 2 * np.pi / part
    body = Body(fem.meshes.annulus(MPI.COMM_WORLD, radii, (rings, sectors // part), angle=angle), 1)
    ties = [] if part == 1 else [fem.Periodic(lambda x: np.isclose(np.arctan2(x[1], x[0]), angle),
                                              lambda x: np.column_stack([np.hypot(*x.T), 0 * x[:, 1]]), axes)]
    return body, Convection(body, ties, KAPPA)


def half_turn(sectors=96, part=1, axes=POLAR):
    """What a rigid turn by half a turn leaves of a pattern cos 3 theta in Z2 and of a fabric along the radius.

    The material turns by a quarter of a sector, its tensors with it, then the mesh turns back, and so on.
    """
    body, convection = ring_of(3, sectors, part, (1, 1.3), axes)
    x = body.positions
    theta = np.arctan2(*body.point_positions(body.at_cells(x)).T[::-1])
    values = np.zeros((len(theta), 22))
    values[:, PHI], values[:, 18] = 0.6, 4 + np.cos(3 * theta)
    values[:, 6], values[:, 7], values[:, 9] = 0.044 * np.array([np.cos(2 * theta), -np.cos(2 * theta), np.sin(2 * theta)])
    start, step = values, about_z(np.pi / 2 / sectors)
    for _ in range(2 * sectors):
        values = convection.convect(turned(values, step), x @ step[:2, :2].T, x)
    kept = (values[:, 18] - 4) @ -np.cos(3 * theta) / (np.cos(3 * theta)**2).sum()
    fabric = tensors.contract(values[:, 6:12], start[:, 6:12]).sum() / tensors.contract(start[:, 6:12], start[:, 6:12]).sum()
    return kept, fabric, values


@pytest.fixture(scope="module")
def whole_turn():
    return half_turn()


def test_half_a_turn_keeps_a_pattern_and_a_tensor(whole_turn):
    kept, fabric, _ = whole_turn
    assert 0.99 < kept < 1.0001 and 0.999 < fabric < 1.0001


def test_a_sector_is_the_ring_if_what_crosses_its_sides_is_turned_their_way(whole_turn):
    kept, fabric, _ = half_turn(part=3)                          # cos 3 theta has a period of a third of a turn
    assert (kept, fabric) == pytest.approx(whole_turn[:2], rel=1e-7)

    def mirrored(x):
        return np.swapaxes(POLAR(x), -1, -2)
    assert half_turn(part=3, axes=mirrored)[1] < 0.99 * fabric    # turned the wrong way


@pytest.mark.parametrize("d", [2, 3])
def test_what_flows_in_replaces_what_flows_out(d):
    body, _, _ = two_meshes(d)
    x, n = body.positions, BOXES[d][0]
    values = random_values(body)
    entering = np.zeros(1, STATE)
    entering["volume_fraction"], entering["coordination_number"], entering["fabric"] = 0.63, 5, [0.01, -0.01, 0, 0.02, 0, 0]
    ends = [fem.Inflow(lambda x: np.isclose(x[0], 0), entering[0]), fem.Outflow(lambda x: np.isclose(x[0], 1))]
    convection = Convection(body, ends, KAPPA)
    for _ in range(10 * n):                                                      # the material moves by ten lengths of the box
        values = convection.convect(values, x + np.eye(d)[0] / n, x)
    assert values[:, :20] == pytest.approx(np.tile(numbers(entering), (len(values), 1)), abs=1e-10)
    assert values[:, 20:] == pytest.approx(0, abs=1e-10)


def origins_turned_back(n, part=1):
    """Errors of origins in a ring that has turned by half a turn in a mesh that stays, and of their mean by solid."""
    sectors = 24 * n
    body, convection = ring_of(3 * n, sectors, part, (1, 2))
    x, step = body.positions, about_z(np.pi / 2 / sectors)[:2, :2]
    at = body.point_positions(body.at_cells(x))
    values = np.zeros((len(at), 22))
    values[:, PHI] = 0.6 + 0.05 * np.sin(3 * np.arctan2(*at.T[::-1]))
    origins, solid = at, values[:, PHI] * volumes(body, x)[:, 0]
    mean = solid @ origins / solid.sum()
    for _ in range(2 * sectors):
        origins = convection.convect_positions(origins, values[:, PHI], x @ step.T, x)
        values = convection.convect(values, x @ step.T, x)
    solid = values[:, PHI] * volumes(body, x)[:, 0]
    return np.linalg.norm(origins + at, axis=1), solid @ origins / solid.sum() - mean


def test_after_half_a_turn_the_origin_of_a_point_is_the_point_turned_back():
    (coarse, _), (fine, change) = (origins_turned_back(n) for n in (1, 2))
    assert np.sqrt((coarse**2).mean() / (fine**2).mean()) > 3.5
    assert fine.max() < 2.5e-3 and abs(change).max() < 1e-13       # the solid's mean is kept
    sector, _ = origins_turned_back(1, 3)
    assert np.sort(np.tile(sector, 3)) == pytest.approx(np.sort(coarse), abs=1e-11)        # it is a third of the ring


@pytest.mark.parametrize("d", [2, 3])
def test_origins_beyond_periodic_sides_are_those_of_the_material_that_goes_on_there(d):
    body, _, _ = two_meshes(d)
    x, sheared = body.positions, np.eye(d)
    sheared[0, -1] = 0.4 / BOXES[d][0]
    sides = fem.Periodic(lambda x: np.isclose(x[0], 1), lambda x: x - np.eye(d)[0])
    at = body.point_positions(body.at_cells(x))
    convection, origins = Convection(body, [sides], KAPPA), at
    for _ in range(30):                                          # the upper side by more than one length of the box
        origins = convection.convect_positions(origins, np.full(len(at), 0.6), x @ sheared.T, x)
    assert origins == pytest.approx(at @ np.linalg.matrix_power(sheared, -30).T, abs=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_what_has_flowed_in_comes_from_where_it_passed_the_inflow(d):
    """A box through which material flows at an angle; it is periodic along the last axis."""
    errors = []
    for n in {2: (12, 24), 3: (6, 12)}[d]:
        body, _, _ = two_meshes(d, (n, *(2,) * (d - 2), 4))
        x, step = body.positions, np.zeros(d)
        step[[0, -1]] = 0.125 / n, 0.05 / n
        at = body.point_positions(body.at_cells(x))
        entering = Material(0.5).isotropic(0.6, pressure=0.01)
        convection, origins = Convection(body, [
            fem.Inflow(lambda x: np.isclose(x[0], 0), entering), fem.Outflow(lambda x: np.isclose(x[0], 1)),
            fem.Periodic(lambda x: np.isclose(x[d - 1], 1), lambda x: x - np.eye(d)[-1])], KAPPA), at
        for _ in range(4 * n):                                   # by half the length
            origins = convection.convect_positions(origins, np.full(len(at), 0.6), x + step, x)
        passed = np.minimum(4 * n, at[:, 0] / step[0])           # steps since it was there
        errors.append(abs(origins - (at - passed[:, None] * step)).max(axis=1))
    away = abs(at[:, 0] - 0.5) > 0.25
    assert errors[1][away].max() < 2e-3 and errors[1].mean() < errors[0].mean() / 2.5      # between old and new there is a kink


SCRIPT = """
import sys
sys.path[:0] = sys.argv[1:]
from test_convection import *
from granumat.fem.cellwise import CellOrder
for d in (2, 3):
    body, x, x_new = two_meshes(d)
    order = CellOrder(body.mesh)
    found, at = Convection(body, [], KAPPA).convect(waves(body, x), x, x_new), body.point_positions(body.at_cells(x))
    flow = Convection(body, [fem.Inflow(lambda x: x[0] < 1e-9, Material(0.5).isotropic(0.6, pressure=0.01)),
                             fem.Outflow(lambda x: x[0] > 1 - 1e-9)], KAPPA)
    origins = flow.convect_positions(at**2, waves(body, x)[:, PHI], x + 0.03 * np.eye(d)[0], x_new)
    found = order.gather(np.column_stack([found, origins]).reshape(body.cells, -1))
    if MPI.COMM_WORLD.rank == 0:
        print(*map(repr, found.ravel()[::37].tolist()))
kept, fabric, values = half_turn(24, 3)
sums = MPI.COMM_WORLD.allreduce((values**2).sum(axis=0))
if MPI.COMM_WORLD.rank == 0:
    print(*map(repr, sums.tolist()))
"""


def test_ranks_agree(mpirun):
    one, two, three = ([np.array(line.split(), float) for line in mpirun(SCRIPT, ranks, Path(__file__).parent,
                                                                        Path(__file__).parents[1]).splitlines()]
                       for ranks in (1, 2, 3))
    for other in (two, three):
        for found, expected in zip(other, one, strict=True):
            assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
