"""External work equals stress power, and the volume of the grains is conserved."""

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem, tensors

SAND = Material(0.5, elastic_strain=0.02)


def block(cells=3, degree=1, cell="quadrilateral"):
    """A block between rough platens, bulging against a pressure on its sides while the upper platen sinks and shears it."""
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    mesh = fem.meshes.box(MPI.COMM_WORLD, (1.0,) * d, (cells,) * d, cell)
    motion = np.array([0.03, -0.03] if d == 2 else [0.03, 0.0, -0.03])
    bottom, top = (lambda x: np.isclose(x[d - 1], 0)), (lambda x: np.isclose(x[d - 1], 1))
    problem = fem.Problem(mesh, SAND, SAND.isotropic(0.6, pressure=0.01), [
        fem.Displacement(bottom), fem.Displacement(top, lambda x, t: t * motion),
        fem.Pressure(lambda x: (np.isclose(x[:d - 1], 0) | np.isclose(x[:d - 1], 1)).any(axis=0), 0.01)], degree=degree)
    return problem


class Works:
    """Observer: external work (reactions and loads) and stress power, by the trapezoidal rule over the increments."""

    def __init__(self):
        self.external, self.internal, self.before = 0.0, 0.0, None

    def __call__(self, problem):
        if problem.last is None:
            return
        trial = problem.last
        x = problem.body.at_cells(problem.positions + problem.displacement)
        u = problem.body.at_cells(trial.u)
        outside = trial.forces + problem.loads.dead(trial.t) + problem.loads.pressures(x, trial.t)     # reactions and loads
        strain = tensors.to_voigt((trial.gradients + trial.gradients.transpose(0, 2, 1)) / 2)
        now = outside, trial.stress.reshape(-1, 6), trial.volumes.ravel()
        if self.before is not None:
            self.external += ((self.before[0] + outside) / 2 * u).sum()
            power = [tensors.contract(stress, strain) @ volume for _, stress, volume in (self.before, now)]
            self.internal += sum(power) / 2
        self.before = now


def works(increments, **kind):
    problem, observer = block(**kind), Works()
    fem.run(problem, 0.25, 0.25)                            # after the jump of the first increment's stress
    problem.next_increment = None
    fem.run(problem, 1.0, 0.75 / increments, observers=[observer])
    return observer.external, observer.internal


@pytest.mark.parametrize(("cell", "degree"), [("quadrilateral", 1), ("triangle", 2)])
def test_external_work_is_stress_power_to_second_order(cell, degree):
    found = np.array([works(increments, cell=cell, degree=degree) for increments in (6, 12, 24)])
    difference = abs(found[:, 0] - found[:, 1]) / abs(found[-1, 0])
    assert difference[-1] < 1e-4
    assert (np.log2(difference[:-1] / difference[1:]) > 1.8).all()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_the_volume_of_the_grains_is_conserved(cell, degree):
    problem = block(2, degree, cell)
    volume = problem.point_volumes().sum()
    solid = problem.states.volume_fraction @ problem.point_volumes()
    fem.run(problem, 0.4, 0.2)
    assert abs(problem.point_volumes().sum() / volume - 1) > 1e-4
    assert problem.states.volume_fraction @ problem.point_volumes() == pytest.approx(solid, rel=1e-12)
