"""Wrong calls at a material point: each is a ValueError or TypeError that names its fault, or gives what is right."""

import copy
import pickle

import numpy as np
import pytest

from granumat import STATE, Material, driver, tensors
from granumat.material import CLOSURES
from support.refusals import check_refused

SAND, OTHER = Material(0.5), Material(0.3)
STATE_60 = SAND.steady(0.60)
GRADIENT = np.zeros((3, 3))
GRADIENT[0, 2] = 0.01
MANY = np.full(4, STATE_60, STATE)
SHEAR = driver.shear(0.01, increments=2)
HUGE = 12345678901234567890


def reordered(states):
    """States whose fields stand in another order."""
    other = np.zeros(len(states), [(name, STATE[name]) for name in reversed(STATE.names)])
    for name in STATE.names:
        other[name] = states[name]
    return other


def single(states):
    return states.astype([(name, "f4", STATE[name].shape) for name in STATE.names])


def masked(values):
    return np.ma.masked_array(values, np.zeros(np.shape(values), bool))


def set_constant(name, value):
    SAND.constants[name] = value


def set_parameter():
    SAND.parameters[0] = 1


def run(**changes):
    return driver.run(**{"material": SAND, "state": STATE_60, "steps": [SHEAR]} | changes)


def following(gradient):
    return lambda: run(steps=[driver.deform(gradient)])


def with_field(name, value):
    states = np.full(1, STATE_60, STATE)
    states[name] = value
    return states[0]


# A call, the error that it raises, and what this says.
CALLS = [
    # a material that is to change
    (lambda: setattr(SAND, "closure", "basic"), TypeError, "closure cannot be set: a material does not change"),
    (lambda: setattr(SAND, "mu", 0.3), TypeError, "mu cannot be set"),
    (lambda: setattr(SAND, "constants", {}), TypeError, "constants cannot be set"),
    (lambda: setattr(SAND, "elastic_strain", 0.01), TypeError, "Material(**(material.definition | {'elastic_strain': 0.01}))"),
    (lambda: set_constant("Zc", 4.0), TypeError, "does not support item assignment"),
    (set_parameter, ValueError, "read-only"),
    # states
    (lambda: SAND.update(None, GRADIENT), TypeError, "states = None: must be an array of dtype STATE"),
    (lambda: SAND.update([1, 2], GRADIENT), TypeError, "states = [1, 2]"),
    (lambda: SAND.update("state", GRADIENT), TypeError, "states = 'state'"),
    (lambda: SAND.update(np.zeros(20), np.zeros((20, 3, 3))), TypeError, "are of dtype float64"),
    (lambda: SAND.update(reordered(MANY), np.zeros((4, 3, 3))), TypeError, "are of dtype [('volume_fraction'"),
    (lambda: SAND.update(single(MANY), np.zeros((4, 3, 3))), TypeError, "'<f4'"),
    (lambda: SAND.update(masked(MANY), np.zeros((4, 3, 3))), TypeError, "states: are a masked array"),
    (lambda: SAND.evaluate(reordered(MANY)), TypeError, "are of dtype"),
    (lambda: SAND.transverse_modulus(reordered(MANY)), TypeError, "are of dtype"),
    (lambda: SAND.response(masked(MANY)), TypeError, "are a masked array"),
    (lambda: SAND.ellipticity(single(MANY)), TypeError, "are of dtype"),
    (lambda: SAND.ellipticity(7), TypeError, "states = 7"),
    (lambda: driver.state_columns(SAND, reordered(MANY)), TypeError, "are of dtype"),
    (lambda: SAND.update_with_tangent(reordered(MANY), np.zeros((4, 3, 3))), TypeError, "are of dtype"),
    # gradients
    (lambda: SAND.update(STATE_60, GRADIENT + 0j), TypeError, "is one of dtype complex128"),
    (lambda: SAND.update(STATE_60, masked(GRADIENT)), TypeError, "gradient: is a masked array"),
    (lambda: SAND.update(STATE_60, "shear"), TypeError, "gradient = 'shear'"),
    (lambda: SAND.update(STATE_60, None), TypeError, "gradient = None"),
    (lambda: SAND.update(STATE_60, [[0, 1], [2]]), TypeError, "must be an array of real numbers"),
    (lambda: SAND.update(STATE_60, GRADIENT > 0), TypeError, "is one of dtype bool"),
    (lambda: SAND.update(STATE_60, np.zeros(6)), ValueError, "gradient has shape (6,): must be (3, 3)"),
    (lambda: SAND.update(MANY, GRADIENT), ValueError, "must be (4, 3, 3)"),
    (lambda: SAND.update(MANY, np.zeros((3, 3, 4))), ValueError, "gradient has shape (3, 3, 4)"),
    (lambda: SAND.update(STATE_60, 1e3 * GRADIENT * np.nan), Exception, "not finite"),
    (lambda: SAND.update_with_tangent(STATE_60, GRADIENT * 1j), TypeError, "complex128"),
    # out and threads
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), out="new"), ValueError, "out must be a contiguous array"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), out=np.zeros(4)), ValueError, "out must be a contiguous array"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), out=np.zeros(3, STATE)), ValueError, "of shape (4,)"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), out=np.zeros(8, STATE)[::2]), ValueError, "contiguous"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), threads=10**5), ValueError, "threads = 100000: must be an integer from 1"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), threads=0), ValueError, "threads = 0"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), threads=2.0), ValueError, "threads = 2.0"),
    (lambda: SAND.update(MANY, np.zeros((4, 3, 3)), threads=HUGE), ValueError, f"threads = {HUGE}"),
    (lambda: SAND.ellipticity(MANY, threads="2"), ValueError, "threads = '2'"),
    (lambda: SAND.update_with_tangent(MANY, np.zeros((4, 3, 3)), threads=True), ValueError, "threads = True"),
    # what makes states and materials
    (lambda: SAND.steady("dense"), ValueError, "volume_fraction = 'dense'"),
    (lambda: SAND.steady(None), ValueError, "volume_fraction = None"),
    (lambda: SAND.steady(60), ValueError, "volume_fraction = 60: must be in (0, 1)"),
    (lambda: SAND.steady(0.6j), ValueError, "volume_fraction = 0.6j"),
    (lambda: SAND.steady(np.array([0.6, 60.0])), ValueError, "volume_fraction = 60.0: must be in (0, 1)"),
    (lambda: SAND.isotropic(0.6), ValueError, "give either pressure or coordination_number"),
    (lambda: SAND.isotropic(0.6, "high"), ValueError, "pressure = 'high'"),
    (lambda: SAND.isotropic(0.6, -1), ValueError, "pressure = -1"),
    (lambda: SAND.isotropic(0.6, np.nan), ValueError, "pressure = nan"),
    (lambda: SAND.isotropic(0.6, coordination_number=None, pressure=[1]), ValueError, "pressure = [1]"),
    (lambda: SAND.state(0.6, 5.2, fabric=np.eye(3) * 1j), ValueError, "fabric: must be 6 numbers"),
    (lambda: SAND.state(0.6, 5.2, stress=masked(np.zeros(6))), ValueError, "stress: must be 6 numbers"),
    (lambda: SAND.state(0.6, 5.2, fabric=[[0, 1, 0], [0, 0, 0], [0, 0, 0]]), ValueError, "a symmetric 3 x 3 tensor"),
    (lambda: SAND.coordination_number(-1.0), ValueError, "must be finite and at least 0"),
    (lambda: SAND.coordination_number([1, np.nan]), ValueError, "must be finite and at least 0"),
    (lambda: SAND.coordination_number("p"), TypeError, "pressure = 'p'"),
    (lambda: SAND.volume_fraction(2, 5.0), ValueError, "volume fraction = 2"),
    (lambda: SAND.volume_fraction(0.6, None), TypeError, "coordination_number = None"),
    (lambda: SAND["mew"], KeyError, "'mew': must be one of mu, a1"),
    (lambda: Material(0.5, "complete"), ValueError, "closure 'complete'"),
    (lambda: Material("0.5"), ValueError, "mu = '0.5': must be a number"),
    (lambda: Material(None), ValueError, "mu = None"),
    (lambda: Material(0.5 + 0j), ValueError, "mu = (0.5+0j)"),
    (lambda: Material(np.array([0.5])), ValueError, "mu = array([0.5])"),
    (lambda: Material(closure=None), ValueError, "closure None"),
    (lambda: Material(nu=0.5), ValueError, "unknown name 'nu'"),
    # load paths
    (lambda: run(material=None), TypeError, "material = None: must be a Material"),
    (lambda: run(material="sand"), TypeError, "material = 'sand'"),
    (lambda: run(state=None), TypeError, "states = None"),
    (lambda: run(state=reordered(MANY)[0]), TypeError, "are of dtype"),
    (lambda: run(material=OTHER), ValueError, "it is of another material"),
    (lambda: run(material=Material(0.5, "critical")), ValueError, "it is of another material"),
    (lambda: run(material=Material(0.5, contact="hertzian")), ValueError, "it is of another material"),
    (lambda: run(state=with_field("volume_fraction", 1.5)), ValueError, "has a volume fraction outside (0, 1)"),
    (lambda: run(state=with_field("coordination_number", np.nan)), ValueError, "holds numbers that are not finite"),
    (lambda: run(state=with_field("fabric", 1.0)), ValueError, "has a fabric of abs(A) not below"),
    (lambda: run(state=np.zeros((), STATE)[()]), ValueError, "has a volume fraction outside (0, 1)"),
    (lambda: run(steps=SHEAR), TypeError, "must be a list of steps"),
    (lambda: run(steps=["shear"]), TypeError, "step 1 = 'shear': must be a Step"),
    (lambda: run(steps=None), TypeError, "steps = None"),
    (lambda: run(steps=[[SHEAR]]), TypeError, "step 1 = [Step("),
    (lambda: run(tolerance=0), ValueError, "tolerance = 0"),
    (lambda: run(tolerance="small"), ValueError, "tolerance = 'small'"),
    (lambda: driver.shear("far"), Exception, "far"),
    (lambda: driver.shear(np.nan), ValueError, "strain = nan"),
    (lambda: driver.shear(1.0, "stress"), ValueError, "control 'stress'"),
    (lambda: driver.shear(1.0, increments=HUGE), ValueError, "must be an integer from 1 to 2147483647"),
    (lambda: driver.shear(1.0, increments=2.0), ValueError, "increments = 2.0"),
    (lambda: driver.shear(1.0, until="p = 0"), ValueError, "until 'p = 0'"),
    (lambda: driver.cycles(0.1, 0), ValueError, "cycles = 0"),
    (lambda: driver.deform(np.eye(2)), ValueError, "must be a 3 x 3 matrix"),
    (lambda: driver.deform(GRADIENT, strain=None), ValueError, "strain = None"),
    (following(lambda s: np.full((3, 3), np.nan)), ValueError, "must be 3 x 3 finite numbers"),
    (following(lambda s: [1, 2]), ValueError, "must be 3 x 3 finite numbers"),
    (following(lambda s: None), Exception, "step 1 (deformation): velocity_gradient"),
    (following(lambda s: GRADIENT * 1j), Exception, "velocity_gradient"),
    (lambda: driver.isotropic_compression(), ValueError, "give either compression or pressure"),
    (lambda: driver.Step("load", free=("e_zz",), stress={"p": None}), ValueError, "stress 'p' = None"),
    (lambda: driver.Step("load", free=("e_zz",)), ValueError, "must be as many"),
]


@pytest.mark.parametrize("number", range(len(CALLS)))
def test_a_wrong_call_is_refused_in_words(number):
    check_refused(*CALLS[number])


@pytest.mark.parametrize("shape", [(0,), (0, 4), (3, 0)])
def test_no_points_give_nothing(shape):
    none, gradients = np.zeros(shape, STATE), np.zeros((*shape, 3, 3))
    assert SAND.update(none, gradients).shape == shape
    states, tangent = SAND.update_with_tangent(none, gradients, spin=True)
    assert states.shape == shape and tangent.shape == (*shape, 6, 9)
    stress, eta = SAND.evaluate(none)
    assert stress.shape == (*shape, 6) and eta.shape == shape and SAND.ellipticity(none).normal.shape == (*shape, 3)


def test_lists_integers_and_strided_arrays_are_right():
    expected = SAND.update(STATE_60, GRADIENT)
    strided = np.zeros((2, 3, 3))
    strided[:, 0, 2] = 0.01
    for gradient in (GRADIENT.tolist(), np.asfortranarray(GRADIENT), strided[::2][0], GRADIENT.astype(np.longdouble)):
        assert SAND.update(STATE_60, gradient) == expected
    assert SAND.update(STATE_60, np.zeros((3, 3), int)) == SAND.update(STATE_60, np.zeros((3, 3)))
    assert (SAND.update(np.full(8, STATE_60, STATE)[::2], np.tile(GRADIENT, (4, 1, 1)), threads=64) == expected).all()


def test_a_material_that_was_copied_or_pickled_is_the_same():
    for again in (copy.copy(SAND), copy.deepcopy(SAND), pickle.loads(pickle.dumps(SAND)), Material(**SAND.definition)):
        assert (again.parameters == SAND.parameters).all() and repr(again) == repr(SAND)


def test_a_state_after_any_path_can_be_started_from():
    for closure in CLOSURES:
        sand = Material(0.5, closure, elastic_strain=0.005)
        path = [driver.shear(0.2), driver.pause(), driver.shear(-0.3, "pressure"), driver.triaxial(-0.3, drained=False)]
        for state in driver.run(sand, sand.steady(0.60), path).states[::20]:
            sand.check_start(state)
            assert tensors.trace(state.stress) <= 0
