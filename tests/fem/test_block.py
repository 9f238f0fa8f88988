"""The block of demos/linking/calculix/block.toml, as granumat.fem and as CalculiX solve it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from granumat import Material, fem

PROBLEM = tomllib.loads((Path(__file__).parents[2] / "demos/linking/calculix/block.toml").read_text())
BLOCK, LOADING = PROBLEM["block"], PROBLEM["loading"]

# Reactions of CalculiX 2.20 with the UMAT, as demos/linking/calculix/run.sh computes them, after each of the ten increments.
SMALL_C3D20R = [0.0229288, 0.02551271, 0.02783474, 0.02997108, 0.03198246,
                0.03391329, 0.0357942, 0.03764523, 0.03947853, 0.04130049]
MOVING_C3D8 = [0.02314634, 0.02604729, 0.02877904, 0.03141279, 0.03400841,
               0.036613, 0.03926205, 0.0419815, 0.04478979, 0.04769955]


class WithoutSpin(Material):
    """Small displacements: the spin of an increment counts for nothing."""

    def update(self, states, gradient, **options):
        return super().update(states, (gradient + gradient.transpose(0, 2, 1)) / 2, **options)

    def update_with_tangent(self, states, gradient, **options):
        states, tangent = super().update_with_tangent(states, (gradient + gradient.transpose(0, 2, 1)) / 2, **options)
        tangent[..., 3:] = 0                                        # of plane strain: by xx yy xy, and by the spin
        return states, tangent


def block(material, platen, degree=1):
    state = material.isotropic(PROBLEM["initial"]["phi"], pressure=PROBLEM["initial"]["pressure"])
    width, height = BLOCK["width"], BLOCK["height"]
    return fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (width, height), BLOCK["elements"]), material, state, [
        fem.Displacement(lambda x: np.isclose(x[1], 0)), fem.Displacement(top, platen),
        fem.Pressure(lambda x: np.isclose(x[0], 0) | np.isclose(x[0], width), PROBLEM["initial"]["pressure"])], degree=degree)


def top(x):
    return np.isclose(x[1], BLOCK["height"])


STEP = np.array([0.0, -LOADING["compression"] * BLOCK["height"] / LOADING["increments"]])


@pytest.mark.parametrize("degree", [1, 2])
def test_small_displacements_give_the_reaction_of_calculix_within_one_percent(degree):
    problem = block(WithoutSpin(**PROBLEM["material"]), STEP, degree)
    reactions = []
    for _ in range(LOADING["increments"]):
        trial = problem.solve_increment(1.0)
        problem.accept(trial)
        reactions.append(-problem.reaction(top)[0][1])
        problem.displacement[:] = 0                                 # the mesh stays where it is
    assert np.abs(np.array(reactions) / SMALL_C3D20R - 1).max() < 0.01


def test_the_moving_mesh_gives_the_reaction_of_calculix_within_one_percent():
    problem = block(Material(**PROBLEM["material"]), lambda x, t: t * STEP)
    problem._mean = 0                                               # CalculiX's C3D8 has no B-bar: it locks
    reactions = []
    fem.run(problem, LOADING["increments"], 1.0,
            observers=[lambda problem: reactions.append(problem.last and -problem.reaction(top)[0][1])])
    assert np.abs(np.array(reactions[1:]) / MOVING_C3D8 - 1).max() < 0.01
