"""From increment to increment: as large as they go, cut where they fail, and a reason when it must stop."""

import time

import numpy as np

from .. import tensors
from ..checks import refuse
from .errors import SolveError, in_words

CUT = 0.5                          # of an increment that fails
GROWTH = 1.5                       # of the next one after an increment that was solved with ease
EASE = 6                           # Newton iterations
SMALLEST = 1 / 1024                # of the increment that was asked for, if nothing else is said
ROUND_OFF = 1e-9                   # of an increment: closer to an event, the event is reached


def run(problem, until, increment, *, smallest=None, events=(), observers=(), progress=None):
    """Brings a problem to the pseudo-time `until`, and shows it to observers after every accepted increment.

    Parameters
    ----------
    problem : Problem
    until : float
    increment : float or function of t
        The largest increment of pseudo-time.
    smallest : float, optional
        Where cutting ends; 1/1024 of the first increment if not given.
    events : sequence of float, optional
        Times that are met exactly: reversals and other kinks of what is given.
    observers : sequence of functions of the problem
        Called before the first increment and after every accepted one, on all ranks.
    progress : stream, optional
        Where rank 0 writes a line with the remaining time every few seconds.

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    SolveError
        An increment cannot be solved however small; the problem and what observers wrote hold everything up to it.
    """
    size = increment if callable(increment) else lambda t: increment
    smallest = size(problem.t) * SMALLEST if smallest is None else smallest
    faults = []
    if not np.isfinite(until) or until < problem.t:
        faults.append(f"until = {until!r}: must be finite and not before the problem's t = {problem.t:g}")
    if not size(problem.t) > 0:
        faults.append(f"increment = {size(problem.t)!r}: must be above 0")
    if not 0 < smallest <= max(size(problem.t), 0):
        faults.append(f"smallest = {smallest!r}: must be above 0 and at most the increment")
    refuse("the problem cannot be run", faults)
    stops = sorted({float(event) for event in events if event < until} | {float(until)})
    watch = _Progress(problem, until, progress if problem.comm.rank == 0 else None)
    for observe in observers:
        observe(problem)
    while problem.t < until - ROUND_OFF * smallest:
        wanted = min(size(problem.t), problem.next_increment or np.inf)
        stop = next(stop for stop in stops if stop > problem.t + ROUND_OFF * smallest)
        duration = stop - problem.t if problem.t + wanted > stop - ROUND_OFF * wanted else wanted
        trial = problem.solve_increment(duration)
        if trial.failure:
            problem.next_increment = CUT * duration
            if problem.next_increment < smallest:
                raise SolveError(f"the increment from t = {problem.t:g} cannot be solved, although it was cut to {duration:.3g}: "
                                 f"{trial.failure}{diagnosis(problem)}")
            continue
        easy = len(trial.residuals) <= EASE + 1
        if duration == wanted or not easy:                      # one that an event shortened says nothing of the next
            problem.next_increment = duration * (GROWTH if easy else 1.0)
        problem.accept(trial)
        if stop == problem.t or abs(stop - problem.t) <= ROUND_OFF * smallest:
            problem.t = stop
        for observe in observers:
            observe(problem)
        watch()


def diagnosis(problem):
    """What about the last accepted state can explain a failure, in words; the same on all ranks."""
    states = problem.states
    pressure = -tensors.trace(states.stress) / 3
    eta_t = problem.material.transverse_modulus(states)
    words = []
    for count, value, name in ((pressure <= 0, pressure, "are unjammed (p = 0)"),
                               (eta_t < 0, eta_t, "have lost ellipticity (eta_t < 0)")):
        total = problem.comm.allreduce(int(count.sum()))
        if total:
            least, at = _least(problem, value)
            words.append(f"{total} of {problem.comm.allreduce(len(states))} points {name}, least {least:.3g} at {at}")
    return "".join(f"; {word}" for word in words)


def _least(problem, values):
    """The smallest value over all ranks, and its position in words."""
    i = int(np.argmin(values)) if len(values) else None
    mine = (np.inf, "") if i is None else (float(values[i]), in_words(problem.point_positions()[i]))
    return min(problem.comm.allgather(mine))


class _Progress:
    """Prints a line with the remaining time every few seconds."""

    def __init__(self, problem, until, stream, quiet_seconds=2.0):
        self.problem, self.until, self.stream, self.quiet_seconds = problem, until, stream, quiet_seconds
        self.first, self.start = problem.t, time.monotonic()
        self.last = self.start

    def __call__(self):
        now = time.monotonic()
        if self.stream is None or now - self.last < self.quiet_seconds:
            return
        self.last = now
        share = (self.problem.t - self.first) / (self.until - self.first)
        print(f"t = {self.problem.t:.6g} of {self.until:.6g}: {share:.0%}, {(now - self.start) * (1 / share - 1):.0f} s to go",
              file=self.stream, flush=True)
