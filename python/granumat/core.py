"""The compiled core as the package sees it: the only file that imports it.

Parameters `par` (27,) and states (n,) of dtype STATE are passed as the core lays them out; names are those of
fortran/faces/bindings.f90 without their prefix. Nothing is checked here beyond shapes: `material` does that.
"""

import numpy as np

from . import _core

STATE = np.dtype([
    ("stress", "f8", 6), ("fabric", "f8", 6), ("direction", "f8", 6),
    ("coordination_number", "f8"), ("volume_fraction", "f8"),
])
"""What a point remembers, 20 numbers. stress: Cauchy, tension positive, in k/d (k_Hz for Hertzian contacts); fabric: A (3.1);
direction: D/abs(D) of the last strain, 0 before any. Six components are xx yy zz xy xz yz."""

N_CONSTANTS = 20

parameters_from_friction = _core.granumat_parameters_from_friction
complete_parameters = _core.granumat_complete_parameters
element_gradients = _core.granumat_element_gradients
element_forces = _core.granumat_element_forces
element_stiffness = _core.granumat_element_stiffness


def constant_ranges():
    """name -> (lower, upper, closed) of every constant, from the core's table."""
    ranges = {}
    for i in range(1, N_CONSTANTS + 1):
        name, lower, upper, closed = _core.granumat_constant_range(i)
        ranges[name.tobytes().decode().strip()] = (lower[0], upper[0], bool(closed[0]))
    return ranges


def status_message(status):
    """The core's words for a status."""
    return _core.granumat_status_message(int(status)).tobytes().decode().strip()


def numbers(states):
    """States (n,) as the core sees them, (n, 20), without a copy."""
    return states.view(np.ndarray).view(float).reshape(-1, 20)


def update(par, old, gradients, new, status, threads):
    """Writes the states (n,) after displacement gradient increments (n, 3, 3) into new, and status (n,)."""
    _core.granumat_update_states(threads, par, numbers(old), gradients, numbers(new), status)


def update_with_tangent(par, old, gradients, new, status, tangent, threads):
    """As update, and writes the consistent tangent (n, 6, 6 or 9), or in plane strain (n, 4, 3 or 4)."""
    _core.granumat_update_states_with_tangent(threads, par, numbers(old), gradients, numbers(new), status, tangent)


def update_by_method(par, scheme, old, gradients, new, status, threads):
    """As update, by a scheme (method, spin, tolerance) of granumat_methods that is compared with the exact update."""
    _core.granumat_update_states_by_method(threads, *scheme, par, numbers(old), gradients, numbers(new), status)


def evaluate(par, states):
    """Replaces the stress of states (n,) by the model's; returns the friction coefficient eta (n,)."""
    return _core.granumat_evaluate_stress(par, numbers(states))


def transverse_modulus(par, states):
    """eta_t (n,) of states (n,)."""
    return _core.granumat_transverse_modulus(par, numbers(states))


def response(par, states):
    """Response matrices (n, 6, 6) of states (n,)."""
    return _core.granumat_response(par, numbers(states))


def ellipticity(par, states, threads):
    """Smallest eigenvalue and determinant (n, 2) of the acoustic tensor of states (n,), and their normals (n, 2, 3)."""
    return _core.granumat_least_acoustic(threads, par, numbers(states))


def follow_path(par, scheme, start, gradients, modes, functionals, targets, tolerance):
    """States (done,), amplitudes (done, m) and the status of the increments (n, 3, 3) of one point from a state start (1,)."""
    m = len(modes)
    rows = max(m, 1)                                              # the binding takes no empty arrays
    states, amplitudes, done, status = _core.granumat_follow_path(
        m, *scheme, par, numbers(start)[0], gradients, np.resize(modes, (rows, 3, 3)), np.resize(functionals, (rows, 6)),
        np.resize(targets, (len(gradients) + 1, rows)), tolerance)
    done = int(done[0])
    return states[:done].view(STATE)[:, 0].view(np.recarray), amplitudes[:done, :m], int(status[0])


def arithmetic(rounds):
    """Does 192 * rounds additions and multiplications in registers; returns their number."""
    _core.granumat_arithmetic(rounds)
    return 192 * rounds
