"""Prints what the core costs: per point of a batch, with the tangent, by size and threads; beside NumPy and SciPy at equal error;
Newton's residuals; and paths of 1000 increments in process, beside SciPy's solvers of the same equations.

Times of a batch are the least of many runs in turn, in processor time where one thread works: what others do on the machine only
adds to them. The equations below are the rate form of simple shear in plane components and plain floats: the fastest that SciPy
can be given.
"""

import functools
import statistics
import time

import numpy as np

from .. import driver, tensors
from ..core import STATE, arithmetic
from ..material import Material
from .batches import BATCH_SHEAR, PHI, random_batch

INCREMENTS = 1000
SHEAR = -1.0                      # reversed from a steady state
REPEATS = 7
ROUNDS = 300


def _rates(c, state, tr):
    """d/dgamma of (A_xx, A_yy, A_zz, A_xz, Z2, phi) in simple shear, gamma falling, with volume strain rate tr; and A:S, |D|."""
    xx, yy, zz, xz, z2, phi = state
    d_xz, w_xz = -0.5, -0.5                                        # per unit of accumulated gamma
    mod_s = 0.5
    mod_d = (0.25 + tr * tr / 6) ** 0.5
    a_s = 2 * xz * d_xz
    grow = c["c2"] * mod_d + c["c3"] * a_s                          # (4.7)
    f = c["Zc"] + c["beta1"] * max(phi - c["phic"], 0.0) ** c["beta2"]
    return (2 * w_xz * xz + grow * xx, grow * yy, -2 * w_xz * xz + grow * zz,
            w_xz * (zz - xx) + c["c1"] * d_xz + grow * xz,
            c["d1"] * (a_s - c["chi"] * mod_s) + c["d2"] * mod_d * (f - z2) + c["d3"] * tr,     # (4.8)
            -phi * tr)


def _constant_volume(c):
    return lambda _, state: _rates(c, state, 0.0)


def _constant_pressure(c):
    """tr D from dp = 0: p is affine in tr D but for |D|, so a few fixed-point turns give it to round-off."""
    def rate(_, state):
        xx, yy, zz, xz, z2, _ = state
        mod_a = ((xx * xx + yy * yy + zz * zz) / 2 + xz * xz) ** 0.5
        factor, excess = c["a1"] + c["a2"] * mod_a, z2 - c["Zc"]
        tr = 0.0
        for _ in range(50):
            r = _rates(c, state, tr)
            dot_a = (xx * r[0] + yy * r[1] + zz * r[2] + 2 * xz * r[3]) / (2 * mod_a)
            dot_p = c["a2"] * dot_a * excess + 2 * factor * r[4]
            change = -dot_p / (2 * factor * c["d3"])
            tr += change
            if abs(change) < 1e-14:
                break
        return _rates(c, state, tr)
    return rate


def _timed(action):
    """Median seconds and the last result."""
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = action()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


def _error(found, exact):
    """Largest error over the path of A/kappa, Z2, phi."""
    return float(np.abs((found - exact) / np.array([0.0445] * 4 + [1, 1])).max())


def compare(control, rate, tolerance):
    """Rows (method, seconds, error) for one path: granumat, then SciPy's methods at the loosest tolerance of no larger error."""
    from scipy.integrate import solve_ivp
    material = Material()
    start = material.steady(PHI)
    step = [driver.shear(SHEAR, control, INCREMENTS)]

    def solve(method, rtol):
        state = [*start.fabric[[0, 1, 2, 4]], start.coordination_number, start.volume_fraction]
        solution = solve_ivp(rate(material.constants), (0, abs(SHEAR)), state, method, np.linspace(0, abs(SHEAR), INCREMENTS + 1),
                             rtol=rtol, atol=rtol * 1e-2)
        return solution.y.T

    exact = solve("DOP853", 3e-14)
    seconds, history = _timed(lambda: driver.run(material, start, step, tolerance=tolerance))
    states = history.states
    own = np.column_stack([states.fabric[:, [0, 1, 2, 4]], states.coordination_number, states.volume_fraction])
    rows = [("granumat", seconds, _error(own, exact))]
    for method in ("DOP853", "LSODA"):
        tolerances = [10.0**-k for k in range(3, 14)]
        reached = [rtol for rtol in tolerances if _error(solve(method, rtol), exact) <= max(rows[0][2], 2e-12)]
        rtol = reached[0] if reached else tolerances[-1]
        seconds, found = _timed(functools.partial(solve, method, rtol))
        rows.append((f"SciPy {method}, rtol {rtol:.0e}", seconds, _error(found, exact)))
    return rows


# ---- the batch -------------------------------------------------------------------------------------------------------

BYTES = 160 + 72 + 160 + 4        # a point's old state and gradient read, new state and status written
# Additions, multiplications and divisions of one update: about 68 in each of 8 terms of the series, 16 exponentials and series
# at the nodes of 24 each, 300 for stress, nodes and checks.
OPERATIONS = 8 * 68 + 16 * 24 + 300


def _least(actions, clock=time.thread_time, rounds=ROUNDS):
    """Least seconds of actions, run in turn so that noise hits all alike."""
    seconds = [[] for _ in actions]
    for _ in range(rounds):
        for action, times in zip(actions, seconds):
            start = clock()
            action()
            times.append(clock() - start)
    return [min(times) for times in seconds]


def print_batch(n=2_000, streamed=200_000):
    """Cost per point of a batch in the cache: as multiples of streaming bytes from memory and of arithmetic, with the tangent, on
    two threads."""
    material = Material()
    states, gradient = random_batch(material, n)
    out = np.empty(n, STATE)
    source, target = np.ones(streamed * BYTES // 16), np.empty(streamed * BYTES // 16)
    operations = 2_000_000
    one = functools.partial(material.update, states, gradient, out=out)
    update, tangent, spin = (seconds / n * 1e9 for seconds in _least([
        one,
        lambda: material.update_with_tangent(states, gradient, out=out),
        lambda: material.update_with_tangent(states, gradient, spin=True, out=out)]))
    stream, multiply = _least([lambda: np.copyto(target, source), lambda: arithmetic(operations // 192)], rounds=50)
    stream, multiply = stream / streamed * 1e9, multiply / operations * OPERATIONS * 1e9
    single, double = _least([one, functools.partial(one, threads=2)], time.perf_counter)
    print(f"{n} points, random increments of shear strain up to {BATCH_SHEAR:g}, least of {ROUNDS}, per point:")
    print(f"  update               {update:7.0f} ns: {update / stream:.1f} x streaming its {BYTES} bytes, "
          f"{update / multiply:.1f} x its {OPERATIONS} operations in registers")
    print(f"  with tangent         {tangent:7.0f} ns: {tangent / update:.1f} x the update")
    print(f"  by the spin too      {spin:7.0f} ns: {spin / update:.1f} x the update")
    print(f"  update, two threads  {double / n * 1e9:7.0f} ns: {single / double:.2f} x faster")


def print_sizes(sizes=(1_000, 10_000, 100_000, 1_000_000, 10_000_000)):
    """Cost per point against the size of the batch."""
    material = Material()
    print("cost per point against the number of points:")
    for n in sizes:
        states, gradient = random_batch(material, min(n, 100_000))
        states, gradient = np.resize(states, n), np.resize(gradient, (n, 3, 3))
        out = np.zeros(n, STATE)
        rounds = min(100, max(3, 4_000_000 // n))
        [seconds] = _least([functools.partial(material.update, states, gradient, out=out)], rounds=rounds)
        print(f"  {n:>10} {seconds / n * 1e9:7.0f} ns")


def print_peers():
    """Beside a NumPy Runge-Kutta of the whole batch and SciPy point by point, over the cases of the chart."""
    from . import chart
    cases = {name: chart.measure(name, rounds=5) for name in chart.CASES}
    print("the fastest of NumPy in the batch, and of SciPy point by point, to reach an error: time over the update's, over "
          f"{len(cases)} cases\n(of exact: its own error, at least {chart.FINEST:.0e})\n{chart.equal_error(cases)}")


def newton_residuals(increment=0.02):
    """Residuals (stress over p) of Newton's method for one reversed increment with all normal stresses held."""
    material = Material()
    state = material.steady(PHI)
    gradient = np.zeros((3, 3))
    gradient[0, 2] = -increment
    pressure = -state.stress[:3].mean()
    residuals = []
    for _ in range(12):
        new, tangent = material.update_with_tangent(state, gradient)
        residual = (new.stress - state.stress)[:3]
        residuals.append(float(np.abs(residual).max() / pressure))
        if residuals[-1] < 1e-13:
            break
        gradient[np.diag_indices(3)] -= np.linalg.solve(tangent[:3, :3], residual)
    return residuals


def print_ratios():
    """Prints everything."""
    from .bench_umat import print_umat
    print_batch()
    print_umat()
    print_sizes()
    print_peers()
    print("Newton's residuals, reversal by 0.02 with all normal stresses held: "
          + " ".join(f"{residual:.1e}" for residual in newton_residuals()))
    print_paths()


def print_paths():
    """Paths beside SciPy's solvers, for both controls."""
    for control, rate, tolerance in (("volume", _constant_volume, driver.TOLERANCE), ("pressure", _constant_pressure, 1e-6)):
        print(f"{INCREMENTS} increments of simple shear by {SHEAR:g} at constant {control}, median of {REPEATS}:")
        rows = compare(control, rate, tolerance)
        for name, seconds, error in rows:
            print(f"  {name:28} {seconds * 1e3:9.2f} ms   {seconds / rows[0][1]:7.1f} x granumat   error {error:.1e}")
