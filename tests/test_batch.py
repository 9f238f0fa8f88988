"""The batch does what the single point does, in place, without holding the interpreter."""

import threading

import numpy as np
import pytest

from granumat import STATE, Material, MaterialError
from support.states import random_states


@pytest.mark.parametrize("elastic_strain", [0.0, 1e-3])
def test_batch_equals_single_points_bit_for_bit(rng, elastic_strain):
    material = Material(0.5, elastic_strain=elastic_strain)
    states, gradient = random_states(rng, material, 257, 0.1)
    gradient[::2] *= 10 ** rng.uniform(-6, 0, 129)[:, None, None]       # beside large increments, those that take low degrees
    batch = material.update(states, gradient)
    nothing_free = np.zeros((0, 3, 3)), np.zeros((0, 6)), np.zeros((2, 0))
    for i in range(257):
        assert material.update(states[i], gradient[i]).tobytes() == batch[i].tobytes()
        one, _, status = material.follow(states[i], gradient[i:i + 1], *nothing_free, 1e-6)
        assert status == 0 and one[0].tobytes() == batch[i].tobytes()


def test_results_do_not_depend_on_the_position_in_the_batch(rng, material):
    states, gradient = random_states(rng, material, 100, 0.1)
    order = rng.permutation(100)
    assert material.update(states[order], gradient[order]).tobytes() == material.update(states, gradient)[order].tobytes()


def test_any_leading_shape_and_a_buffer_of_ones_own(rng, material):
    states, gradient = random_states(rng, material, 12, 0.1)
    flat = material.update(states, gradient)
    out = np.empty((3, 4), STATE)
    result = material.update(states.reshape(3, 4), gradient.reshape(3, 4, 3, 3), out=out)
    assert np.shares_memory(result, out)
    assert out.tobytes() == flat.tobytes()


def test_update_in_place_is_the_same(rng, material):
    states, gradient = random_states(rng, material, 20, 0.1)
    expected = material.update(states, gradient)
    material.update(states, gradient, out=states)
    assert states.tobytes() == expected.tobytes()


def test_one_bad_point_spares_the_others(rng, material):
    states, gradient = random_states(rng, material, 10, 0.1)
    expected = material.update(states, gradient)
    gradient[3, 0, 0] = np.nan
    states["volume_fraction"][7] = 1.5
    with pytest.raises(MaterialError, match=r"point 3: .*not finite \(and 1 more\)") as caught:
        material.update(states, gradient)
    assert caught.value.status.nonzero()[0].tolist() == [3, 7]
    good = [0, 1, 2, 4, 5, 6, 8, 9]
    assert caught.value.states[good].tobytes() == expected[good].tobytes()
    assert caught.value.states[[3, 7]].tobytes() == states[[3, 7]].tobytes()


def test_wrong_shapes_are_refused(material):
    states = np.array([material.steady(0.6)] * 2)
    with pytest.raises(ValueError, match=r"gradient has shape \(3, 3, 3\): must be \(2, 3, 3\)"):
        material.update(states, np.zeros((3, 3, 3)))
    with pytest.raises(ValueError, match="out must be a contiguous array"):
        material.update(states, np.zeros((2, 3, 3)), out=np.zeros(3, STATE))


@pytest.mark.release_only
def test_other_python_threads_run_during_an_update(rng, material):
    states, gradient = random_states(rng, material, 100_000, 1.0)
    worker = threading.Thread(target=material.update, args=(states, gradient))
    ticks = 0
    worker.start()
    while worker.is_alive():
        ticks += 1
    assert ticks > 1000
