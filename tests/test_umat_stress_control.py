"""UMAT: hosts that prescribe stresses and know no line search."""

from itertools import pairwise

import numpy as np
import pytest

from granumat import Material
from granumat.material import CLOSURES
from support.umat_host import DIRECTION, StressControl, call, properties, statev_of

PRESSURE, AMPLITUDE = 0.01, 0.003
ROWS, REVERSALS = 100, 12
PROBE = 1e-4                # abs(D) of the strain whose tangent stands for that at DSTRAN = 0


def triaxial_cycles():
    """Axial compression beyond the side pressure, row by row: 0, AMPLITUDE, -AMPLITUDE, AMPLITUDE ..."""
    turns = AMPLITUDE * np.array([0.0] + [(-1) ** k for k in range(REVERSALS + 1)])
    return np.concatenate([np.linspace(a, b, ROWS + 1)[1:] for a, b in pairwise(turns)])


@pytest.mark.slow
@pytest.mark.parametrize("elastic_strain", [pytest.param(0.001, marks=pytest.mark.release_only), 0.01])
def test_drained_triaxial_stress_cycles_converge_in_every_row(elastic_strain):
    point = StressControl(properties(elastic_strain=elastic_strain, pressure=PRESSURE))
    rows = triaxial_cycles()
    for beyond in rows:
        point.go_to(-PRESSURE * np.array([1.0, 1, 1, 0, 0, 0]) - beyond * np.array([1.0, 0, 0, 0, 0, 0]))
    assert len(rows) == 1300 and point.missed == 0
    assert point.iterations < 4 * len(rows)                  # 5122 and 4231


def sheared(elastic_strain, closure="full"):
    material = Material(0.5, closure, elastic_strain=elastic_strain)
    return material.update(material.isotropic(0.60, pressure=PRESSURE), 0.05 * np.outer([1, 0, 0], [0, 0, 1]))


def tangent_along(state, props, sign):
    """The tangent of a small strain along the last direction."""
    strain = sign * PROBE * state.direction * [1, 1, 1, 2, 2, 2]
    return call(np.zeros(6), statev_of(state), strain, props).ddsdde


@pytest.mark.parametrize("closure", range(len(CLOSURES)))
def test_the_tangent_without_a_strain_is_that_of_unloading(closure):
    state, props = sheared(0.001, CLOSURES[closure]), properties(elastic_strain=0.001, closure=closure)
    found = call(np.zeros(6), statev_of(state), np.zeros(6), props)
    unloading, loading = (tangent_along(state, props, sign) for sign in (-1, 1))
    np.testing.assert_allclose(found.ddsdde, unloading, rtol=0, atol=1e-9 * np.abs(unloading).max())
    assert unloading[4, 4] > 10 * loading[4, 4]
    assert found.statev[DIRECTION].tobytes() == state.direction.tobytes()


def test_without_an_elastic_strain_it_is_that_of_going_on():
    state, props = sheared(0.0), properties()
    found = call(np.zeros(6), statev_of(state), np.zeros(6), props).ddsdde
    going_on = tangent_along(state, props, 1)
    np.testing.assert_allclose(found, going_on, rtol=0, atol=1e-9 * np.abs(going_on).max())
