"""A run from increment to increment: they grow while they are solved easily, are cut where they fail, and stop with a reason."""

from collections.abc import Callable, Sequence
from typing import TextIO

import numpy as np

from .. import tensors
from ..checks import refuse
from ..progress import Progress
from .errors import SolveError, format_position
from .problem import Problem

CUT_FACTOR = 0.5                    # of an increment that fails
GROWTH_FACTOR = 1.5                 # of the increment after one that was solved easily,
EASY_ITERATIONS = 6                 # in at most so many Newton iterations
SMALLEST_INCREMENT = 1 / 1024       # over the first one, if the user says nothing else
TIME_ROUND_OFF = 1e-9               # over an increment: an event as close as that to its end is its end


def run(problem: Problem, until: float, increment: float | Callable[[float], float], *, smallest: float | None = None,
        events: Sequence[float] = (), observers: Sequence[Callable[[Problem], object]] = (),
        progress: TextIO | None = None) -> None:
    """Brings a problem to the pseudo-time `until`, and shows it to observers after every accepted increment.

    Parameters
    ----------
    problem : Problem
    until : float
    increment : float or function of t
        The largest increment of pseudo-time.
    smallest : float, optional
        Increments are not cut to less; 1/1024 of the first increment if not given.
    events : sequence of float, optional
        Pseudo-times that are met exactly: reversals and other kinks of what is prescribed.
    observers : sequence of functions of the problem
        Called before the first increment and after every accepted one, on all ranks.
    progress : text stream, optional
        Where rank 0 writes a line with the remaining time every few seconds.

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    SolveError
        An increment cannot be solved however small; the problem and what observers wrote hold everything up to it.
    """
    def largest(t: float) -> float:
        return increment(t) if callable(increment) else increment

    smallest = largest(problem.t) * SMALLEST_INCREMENT if smallest is None else smallest
    faults = []
    if not np.isfinite(until) or until < problem.t:
        faults.append(f"until = {until!r}: must be finite and not before the problem's t = {problem.t:g}")
    if not largest(problem.t) > 0:
        faults.append(f"increment = {largest(problem.t)!r}: must be above 0")
    if not 0 < smallest <= max(largest(problem.t), 0):
        faults.append(f"smallest = {smallest!r}: must be above 0 and at most the increment")
    refuse("the problem cannot be run", faults)
    stops = sorted({float(event) for event in events if event < until} | {float(until)})
    first, show_progress = problem.t, Progress(progress if problem.comm.rank == 0 else None)
    for observe in observers:
        observe(problem)
    while problem.t < until - TIME_ROUND_OFF * smallest:
        wanted = min(largest(problem.t), problem.next_increment or np.inf)
        stop = next(stop for stop in stops if stop > problem.t + TIME_ROUND_OFF * smallest)
        duration = stop - problem.t if problem.t + wanted > stop - TIME_ROUND_OFF * wanted else wanted
        trial = problem.solve_increment(duration)
        if trial.failure:
            problem.next_increment = CUT_FACTOR * duration
            if problem.next_increment < smallest:
                raise SolveError(f"the increment from t = {problem.t:g} cannot be solved, although it was cut to {duration:.3g}: "
                                 f"{trial.failure}{diagnosis(problem)}")
            continue
        easy = len(trial.residuals) <= EASY_ITERATIONS + 1
        if duration == wanted or not easy:                      # how easy one is that an event shortened tells nothing
            problem.next_increment = duration * (GROWTH_FACTOR if easy else 1.0)
        problem.accept(trial, stop if abs(stop - trial.t) <= TIME_ROUND_OFF * smallest else None)
        for observe in observers:
            observe(problem)
        show_progress(f"t = {problem.t:.6g} of {until:.6g}", (problem.t - first) / (until - first))


def diagnosis(problem: Problem) -> str:
    """What about the last accepted state can explain a failure, as clauses for a message; collective, the same on all ranks."""
    states = problem.states
    pressure = -tensors.trace(states["stress"]) / 3
    eta_t = problem.material.transverse_modulus(states)
    clauses = []
    for suspect, values, finding in ((pressure <= 0, pressure, "are unjammed (p = 0)"),
                                     (eta_t < 0, eta_t, "have lost ellipticity (eta_t < 0)")):
        total = problem.comm.allreduce(int(suspect.sum()))
        if total:
            least, position = _smallest(problem, values)
            clauses.append(f"{total} of {problem.comm.allreduce(len(states))} points {finding}, least {least:.3g} at {position}")
    return "".join(f"; {clause}" for clause in clauses)


def _smallest(problem: Problem, values: np.ndarray) -> tuple[float, str]:
    """The smallest of values (points) over all ranks, and where it is."""
    i = int(np.argmin(values)) if len(values) else None
    own = (np.inf, "") if i is None else (float(values[i]), format_position(problem.point_positions()[i]))
    return min(problem.comm.allgather(own))
