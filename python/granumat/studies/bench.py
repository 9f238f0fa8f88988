"""Prints what the core costs, beside NumPy, SciPy and an elastic UMAT.

Tables are printed of a point of a batch and its tangent, by the closure, by the size of the batch and the number of threads; of a
UMAT call; of NumPy and SciPy at equal error; of Newton's residuals; and of load paths of 1000 increments, by the driver and by
SciPy's solvers.

The time of a batch is the least of many measurements, in processor time where one thread works: whatever else the machine does
only adds to it. SciPy gets the rate form of the law in plain floats (`rate_form`), the fastest right-hand side that there is for
one point.
"""

import functools
import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from .. import driver
from ..core import ARITHMETIC_A_ROUND, STATE, arithmetic
from ..material import CLOSURES, TURNING, Material
from . import chart, rate_form
from .batches import BATCH_SHEAR, PHI, random_batch
from .bench_umat import print_umat

T = TypeVar("T")


class Effort(NamedTuple):
    """How much is measured."""

    points: int                 # of the batch
    streamed: int               # points' worth of memory that is copied, more than the caches hold
    operations: int             # additions and multiplications in registers
    rounds: int                 # measurements of the batch, of which the least counts
    sizes: tuple[int, ...]      # of batches
    cases: tuple[str, ...]      # of the chart
    case_points: int
    case_rounds: int            # measurements of a case
    umat_points: int
    increments: int             # of a load path
    repeats: int                # of a load path and of the UMAT, of which the median counts


FULL = Effort(points=2_000, streamed=200_000, operations=2_000_000, rounds=300,
              sizes=(1_000, 10_000, 100_000, 1_000_000, 10_000_000),
              cases=tuple(chart.CASES), case_points=chart.POINTS, case_rounds=5, umat_points=20_000, increments=1000, repeats=7)
QUICK = Effort(points=1_000, streamed=100_000, operations=200_000, rounds=10, sizes=(1_000, 10_000),
               cases=("reversal",), case_points=8, case_rounds=1, umat_points=1_000, increments=50, repeats=1)


def print_ratios(quick: bool = False) -> None:
    """Print all tables.

    Parameters
    ----------
    quick : bool
        Whether few, small measurements are enough, a minute at most; ratios are rough then.

    Raises
    ------
    ImportError
        If there is no SciPy, before anything is measured.
    """
    rate_form.scipys_solver()
    effort = QUICK if quick else FULL
    print_batch(effort)
    print_closures(effort)
    print_umat(effort.umat_points, effort.repeats)
    print_sizes(effort)
    print_peers(effort)
    print("Newton's residuals, reversal by 0.02 with all normal stresses held: "
          + " ".join(f"{residual:.1e}" for residual in newton_residuals()))
    print_paths(effort)


# ---- the batch -------------------------------------------------------------------------------------------------------

BYTES = 160 + 72 + 160 + 4        # a point's old state and gradient read, new state and status written
# Additions, multiplications and divisions of one update: about 68 in each of 8 terms of the series, 16 exponentials and series
# at the nodes of 24 each, 300 for stress, nodes and checks.
OPERATIONS = 8 * 68 + 16 * 24 + 300


def least_seconds(actions: Sequence[Callable[[], Any]], rounds: int, clock: Callable[[], float] = time.thread_time) -> list[float]:
    """Least time of each action in some rounds; all actions are run in each round, so that disturbances meet all alike."""
    seconds: list[list[float]] = [[] for _ in actions]
    for _ in range(rounds):
        for action, times in zip(actions, seconds):
            start = clock()
            action()
            times.append(clock() - start)
    return [min(times) for times in seconds]


def print_batch(effort: Effort) -> None:
    """Print the cost of a point of a batch in the cache, with its tangent, and with two threads.

    It is compared with streaming the point's bytes from memory and with the same number of operations in registers.
    """
    n, streamed, operations = effort.points, effort.streamed, effort.operations
    material = Material()
    states, gradient = random_batch(material, n)
    out = np.empty(n, STATE)
    source, target = np.ones(streamed * BYTES // 16), np.empty(streamed * BYTES // 16)
    one_thread = functools.partial(material.update, states, gradient, out=out)
    update, tangent, spin = (seconds / n * 1e9 for seconds in least_seconds([
        one_thread,
        lambda: material.update_with_tangent(states, gradient, out=out),
        lambda: material.update_with_tangent(states, gradient, spin=True, out=out)], effort.rounds))
    stream, multiply = least_seconds([lambda: np.copyto(target, source), lambda: arithmetic(operations // ARITHMETIC_A_ROUND)],
                                     min(50, effort.rounds))
    stream, multiply = stream / streamed * 1e9, multiply / operations * OPERATIONS * 1e9
    single, double = least_seconds([one_thread, functools.partial(one_thread, threads=2)], effort.rounds, time.perf_counter)
    print(f"{n} points, random increments of shear strain up to {BATCH_SHEAR:g}, least of {effort.rounds}, per point:")
    print(f"  update               {update:7.0f} ns: {update / stream:.1f} x streaming its {BYTES} bytes, "
          f"{update / multiply:.1f} x its {OPERATIONS} operations in registers")
    print(f"  with tangent         {tangent:7.0f} ns: {tangent / update:.1f} x the update")
    print(f"  by the spin too      {spin:7.0f} ns: {spin / update:.1f} x the update")
    print(f"  update, two threads  {double / n * 1e9:7.0f} ns: {single / double:.2f} x faster")


def print_closures(effort: Effort) -> None:
    """Print the cost of a point of a batch in each closure over that in the full one, all measured in turn."""
    n = effort.points
    print(f"cost per point of each closure over full's, least of {effort.rounds}:")
    for elastic_strain, plane, tangent in itertools.product((0.0, 0.01), (False, True), (False, True)):
        actions, closures = [], [closure for closure in CLOSURES if elastic_strain > 0 or closure not in TURNING]
        for closure in closures:
            material = Material(closure=closure, elastic_strain=elastic_strain)
            states, gradient = random_batch(material, n, plane=plane)
            act = functools.partial(material.update_with_tangent, plane=plane) if tangent else material.update
            actions.append(functools.partial(act, states, gradient, out=np.empty(n, STATE)))
        seconds = dict(zip(closures, least_seconds(actions, effort.rounds)))
        print(f"  e_r = {elastic_strain:<5g}{'plane' if plane else '3D':6}{'with tangent' if tangent else 'update':13}"
              + "  ".join(f"{name} {seconds[name] / seconds['full']:.2f}" for name in closures if name != "full")
              + f"  full {seconds['full'] / n * 1e9:.0f} ns")


def print_sizes(effort: Effort) -> None:
    """Print the cost of a point against the size of the batch."""
    material = Material()
    print("cost per point against the number of points:")
    for n in effort.sizes:
        states, gradient = random_batch(material, min(n, 100_000))
        states, gradient = np.resize(states, n), np.resize(gradient, (n, 3, 3))
        out = np.zeros(n, STATE)
        rounds = min(100, max(3, 4_000_000 // n), effort.rounds)
        [seconds] = least_seconds([functools.partial(material.update, states, gradient, out=out)], rounds)
        print(f"  {n:>10} {seconds / n * 1e9:7.0f} ns")


def print_peers(effort: Effort) -> None:
    """Print the times of a NumPy Runge-Kutta method of the whole batch and of SciPy point by point, over the cases of the chart."""
    cases = {name: chart.measure(name, effort.case_points, effort.case_rounds) for name in effort.cases}
    print("the fastest of NumPy in the batch, and of SciPy point by point, to reach an error: time over the update's, over "
          f"{len(cases)} cases\n(of exact: its own error, at least {chart.FINEST:.0e})\n{chart.equal_error(cases)}")


# ---- Newton's method -------------------------------------------------------------------------------------------------

RESIDUAL = 1e-13                  # of the stress over p at which Newton's method ends


def newton_residuals(increment: float = 0.02) -> list[float]:
    """Residuals of Newton's method for one increment of reversed shear in which all normal stresses are held.

    Parameters
    ----------
    increment : float
        Shear strain, against the direction of the steady shear before it.

    Returns
    -------
    list of float
        The largest change of a normal stress over p, before each iteration.
    """
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
        if residuals[-1] < RESIDUAL:
            break
        gradient[np.diag_indices(3)] -= np.linalg.solve(tangent[:3, :3], residual)
    return residuals


# ---- load paths ------------------------------------------------------------------------------------------------------

SHEAR = -1.0                      # shear strain, reversed from a steady state
LEAST_ERROR = 2e-12               # that SciPy is asked for: the exact solution is no better
TOLERANCES = tuple(10.0**-k for k in range(3, 14))


class PathCost(NamedTuple):
    """What following a load path took."""

    method: str
    seconds: float
    error: float        # largest of A/kappa, Z2 and phi over the path


def median_seconds(action: Callable[[], T], repeats: int) -> tuple[float, T]:
    """Median time of an action, and its last result."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = action()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


def compare(control: str, rate: Callable[..., list[float]], increments: int, repeats: int,
            tolerance: float = driver.TOLERANCE) -> list[PathCost]:
    """Follow reversed simple shear from a steady state by granumat and by SciPy.

    Parameters
    ----------
    control : str
        Of driver.CONTROLS.
    rate : function
        The same in rate form: `rate_form.rate` or `rate_form.rate_at_constant_pressure`.
    increments, repeats : int
    tolerance : float
        Of driver.run.

    Returns
    -------
    list of PathCost
        granumat, then each of SciPy's methods with the largest tolerance that gives no larger error.
    """
    solve_ivp, material = rate_form.scipys_solver(), Material()
    start = material.steady(PHI)
    step = driver.shear(SHEAR, control, increments)
    flow = rate_form.Flow.of((np.sign(SHEAR) * driver.SHEAR).tolist())               # per unit of accumulated shear strain
    scale = np.array([material["kappa"]] * 6 + [1, 1])

    def solve(method: str, rtol: float) -> np.ndarray:
        solution = solve_ivp(lambda _, y: rate(material.constants, flow, y.tolist()), (0, abs(SHEAR)),
                             rate_form.unknowns(material, np.array([start]))[:, 0], method,
                             np.linspace(0, abs(SHEAR), increments + 1), rtol=rtol, atol=rtol * 1e-2)
        return solution.y.T

    def error(found: np.ndarray) -> float:
        return float((np.abs(found - exact) / scale).max())

    exact = solve("DOP853", 3e-14)
    seconds, history = median_seconds(lambda: driver.run(material, start, [step], tolerance=tolerance), repeats)
    own = PathCost("granumat", seconds, error(rate_form.unknowns(material, history.states).T))
    rows = [own]
    for method in ("DOP853", "LSODA"):
        enough = (rtol for rtol in TOLERANCES if error(solve(method, rtol)) <= max(own.error, LEAST_ERROR))
        rtol = next(enough, TOLERANCES[-1])
        seconds, found = median_seconds(functools.partial(solve, method, rtol), repeats)
        rows.append(PathCost(f"SciPy {method}, rtol {rtol:.0e}", seconds, error(found)))
    return rows


def print_paths(effort: Effort) -> None:
    """Print the times of load paths at constant volume and at constant pressure."""
    for control, rate in (("volume", rate_form.rate), ("pressure", rate_form.rate_at_constant_pressure)):
        print(f"{effort.increments} increments of simple shear by {SHEAR:g} at constant {control}, median of {effort.repeats}:")
        rows = compare(control, rate, effort.increments, effort.repeats)
        for name, seconds, error in rows:
            print(f"  {name:28} {seconds * 1e3:9.2f} ms   {seconds / rows[0].seconds:7.3g} x granumat   error {error:.1e}")
