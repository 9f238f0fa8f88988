"""Paths of 1000 increments in process, beside SciPy's solvers of the same equations at equal error; prints ratios.

The equations below are the rate form of simple shear in plane components and plain floats: the fastest that SciPy can be given.
"""

import functools
import statistics
import time

import numpy as np

from . import driver
from .material import Material

INCREMENTS = 1000
SHEAR = -1.0                      # reversed from a steady state
REPEATS = 7
PHI = 0.60


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
        xx, yy, zz, xz, z2, phi = state
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


def print_ratios():
    """Prints the comparison for both controls."""
    for control, rate, tolerance in (("volume", _constant_volume, driver.TOLERANCE), ("pressure", _constant_pressure, 1e-6)):
        print(f"{INCREMENTS} increments of simple shear by {SHEAR:g} at constant {control}, median of {REPEATS}:")
        rows = compare(control, rate, tolerance)
        for name, seconds, error in rows:
            print(f"  {name:28} {seconds * 1e3:9.2f} ms   {seconds / rows[0][1]:7.1f} x granumat   error {error:.1e}")
