"""The compiled core as the package sees it: the only file that imports it.

Names are those of the procedures in fortran/faces/bindings.f90, without their prefix. Parameters `par` (25,) and records of states
(n,) of dtype STATE are handed over in the core's own layout. Beyond shapes nothing is checked here; `material` does that.
"""

import numpy as np

from . import _core  # type: ignore[attr-defined]

STATE = np.dtype([
    ("stress", "f8", 6), ("fabric", "f8", 6), ("direction", "f8", 6),
    ("coordination_number", "f8"), ("volume_fraction", "f8"),
])
"""What a point remembers, 20 numbers. stress: Cauchy, tension positive, in k/d (k_Hz for Hertzian contacts); fabric: A (3.1);
direction: D/abs(D) of the last strain, 0 before any; in the closures "mobilised" and "mobilised-pressure" what follows it over the
elastic strain. Six components are xx yy zz xy xz yz."""

N_CONSTANTS = 20                                      # as in granumat_parameters
STATE_NUMBERS = STATE.itemsize // 8
CONVECTED_NUMBERS = 24                                # of a point: a state's and four more, COLUMNS of granumat_convection
CONVECTION_RANGES = 76                                # of a cell, RANGES of granumat_convection
ARITHMETIC_A_ROUND = 192                              # 2 * 12 * LANES, see granumat_arithmetic
Scheme = tuple[int, int, float]
"""How to integrate increments: numbers of method and spin as in granumat_methods, tolerance of the embedded pair."""

parameters_from_friction = _core.granumat_parameters_from_friction
complete_parameters = _core.granumat_complete_parameters
element_gradients = _core.granumat_element_gradients
element_forces = _core.granumat_element_forces
element_stiffness = _core.granumat_element_stiffness
element_helmholtz = _core.granumat_element_helmholtz
element_coupling = _core.granumat_element_coupling
convection_ranges = _core.granumat_convection_ranges
convection_stage = _core.granumat_convection_stage
swept_volumes = _core.granumat_swept_volumes


def constant_ranges() -> dict[str, tuple[float, float, bool]]:
    """Name -> (lower bound, upper bound, whether the bounds are allowed) of every constant, from the core's table."""
    ranges = {}
    for i in range(1, N_CONSTANTS + 1):
        name, lower, upper, closed = _core.granumat_constant_range(i)
        ranges[name.tobytes().decode().strip()] = (lower[0], upper[0], bool(closed[0]))
    return ranges


def status_message(status: int) -> str:
    """The core's words for a status."""
    return _core.granumat_status_message(int(status)).tobytes().decode().strip()


def numbers(states: np.ndarray) -> np.ndarray:
    """States (n,) as the core sees them, (n, 20), without a copy."""
    return states.view(np.ndarray).view(float).reshape(-1, STATE_NUMBERS)


def update(par: np.ndarray, old: np.ndarray, gradients: np.ndarray, new: np.ndarray, status: np.ndarray, threads: int) -> None:
    """Writes the states (n,) after displacement gradient increments (n, 3, 3) into new, and into status (n,) 0 or why it failed."""
    _core.granumat_update_states(threads, par, numbers(old), gradients, numbers(new), status)


def update_with_tangent(par: np.ndarray, old: np.ndarray, gradients: np.ndarray, new: np.ndarray, status: np.ndarray,
                        tangent: np.ndarray, threads: int) -> None:
    """As update, and writes the consistent tangent (n, 6, 6 or 9), in plane strain (n, 4, 3 or 4)."""
    _core.granumat_update_states_with_tangent(threads, par, numbers(old), gradients, numbers(new), status, tangent)


def update_nonlocal(par: np.ndarray, old: np.ndarray, gradients: np.ndarray, nonlocal_strain: np.ndarray, new: np.ndarray,
                    status: np.ndarray, threads: int) -> None:
    """As update, with the nonlocal strains (n,) of the increments."""
    _core.granumat_update_nonlocal_states(threads, par, numbers(old), gradients, nonlocal_strain, numbers(new), status)


def update_nonlocal_with_tangent(par: np.ndarray, old: np.ndarray, gradients: np.ndarray, nonlocal_strain: np.ndarray,
                                 new: np.ndarray, status: np.ndarray, tangent: np.ndarray, by_nonlocal: np.ndarray,
                                 threads: int) -> None:
    """As update_with_tangent and update_nonlocal; also writes the stress by the nonlocal strain, (n, 6), in plane strain (n, 4)."""
    _core.granumat_update_nonlocal_states_with_tangent(threads, par, numbers(old), gradients, nonlocal_strain, numbers(new), status,
                                                       tangent, by_nonlocal)


def update_by_method(par: np.ndarray, scheme: Scheme, old: np.ndarray, gradients: np.ndarray, new: np.ndarray, status: np.ndarray,
                     threads: int) -> None:
    """As update, by a scheme that is compared with the exact update."""
    _core.granumat_update_states_by_method(threads, *scheme, par, numbers(old), gradients, numbers(new), status)


def steady_states(par: np.ndarray, volume_fractions: np.ndarray) -> tuple[np.recarray, np.ndarray]:
    """States (n,) of steady simple shear at volume fractions (n,), and 0 or why there is none (n,)."""
    states, status = _core.granumat_steady_states(par, volume_fractions)
    return states.view(STATE)[:, 0].view(np.recarray), status


def evaluate(par: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Replaces the stress of states (n,) by the model's; returns the friction coefficient eta (n,)."""
    return _core.granumat_evaluate_stress(par, numbers(states))


def transverse_modulus(par: np.ndarray, states: np.ndarray) -> np.ndarray:
    """eta_t (n,) of states (n,)."""
    return _core.granumat_transverse_modulus(par, numbers(states))


def response(par: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Response matrices (n, 6, 6) of states (n,)."""
    return _core.granumat_response(par, numbers(states))


def ellipticity(par: np.ndarray, states: np.ndarray, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Smallest eigenvalue and determinant (n, 2) of the acoustic tensor of states (n,), and their normals (n, 2, 3)."""
    return _core.granumat_least_acoustic(threads, par, numbers(states))


def follow_path(par: np.ndarray, scheme: Scheme, start: np.ndarray, gradients: np.ndarray, modes: np.ndarray,
                functionals: np.ndarray, targets: np.ndarray, tolerance: float) -> tuple[np.recarray, np.ndarray, int]:
    """States (done,), amplitudes (done, m) and the status of the increments (n, 3, 3) of one point, from a state start (1,)."""
    m = len(modes)
    rows = max(m, 1)                                              # the binding takes no empty arrays
    states, amplitudes, done, status = _core.granumat_follow_path(
        m, *scheme, par, numbers(start)[0], gradients, np.resize(modes, (rows, 3, 3)), np.resize(functionals, (rows, 6)),
        np.resize(targets, (len(gradients) + 1, rows)), tolerance)
    done = int(done[0])
    return states[:done].view(STATE)[:, 0].view(np.recarray), amplitudes[:done, :m], int(status[0])


def arithmetic(rounds: int) -> int:
    """Does additions and multiplications in registers, ARITHMETIC_A_ROUND a round; returns their number."""
    _core.granumat_arithmetic(rounds)
    return ARITHMETIC_A_ROUND * rounds
