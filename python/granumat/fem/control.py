"""A run from increment to increment: they grow while they are solved easily, are cut where they fail, and stop with a reason."""

from collections.abc import Callable, Sequence
from typing import TextIO

import numpy as np

from .. import tensors
from ..checks import check_type, is_finite_number, is_number, refuse
from ..errors import InterruptedRunError
from ..history import STEADY_RATE
from ..progress import Progress
from ..signals import noted_signals
from .errors import SolveError, format_position
from .problem import Problem

CUT_FACTOR = 0.5                    # of an increment that fails
GROWTH_FACTOR = 1.5                 # of the increment after one that was solved easily,
EASY_ITERATIONS = 6                 # in at most so many Newton iterations
SMALLEST_INCREMENT = 1 / 1024       # over the first one, if the user says nothing else
TIME_ROUND_OFF = 1e-9               # over an increment: an event as close as that to its end is its end
STEADY_RESIDUAL = 100               # of the first guess, the last increment again, over what counts as solved: more is not steady
UNJAMMED = 0.02                     # part of a flowing body's volume that may be unjammed, if the user says nothing else
SHORTEST = 1e-12                    # increment over the end of the run, below which t does not grow by it


def run(problem: Problem, until: float | str, increment: float | Callable[[float], float], *, smallest: float | None = None,
        events: Sequence[float] = (), observers: Sequence[Callable[[Problem], object]] = (), unjammed: float | None = None,
        progress: TextIO | None = None) -> None:
    """Brings a problem to the pseudo-time `until`, and shows it to observers after every accepted increment.

    Parameters
    ----------
    problem : Problem
    until : float or "steady"
        With "steady" until A/kappa, Z2 and phi change by less than 1e-4 per unit of shear strain, in the mean over the body, and
        the last increment, repeated, is in equilibrium to 100 times what counts as solved.
    increment : float or function of t
        The largest increment of pseudo-time.
    smallest : float, optional
        Increments are not cut to less; 1/1024 of the first increment if not given.
    events : sequence of float, optional
        Pseudo-times that are met exactly: reversals and other kinks of what is prescribed.
    observers : sequence of functions of the problem
        Called before the first increment and after every accepted one, on all ranks.
    unjammed : float, optional
        Part of the body's volume that may be unjammed (p = 0): there the motion is arbitrary. If not given, 1 (all of it) where the
        mesh moves with the material, else 0.02.
    progress : text stream, optional
        Where rank 0 writes a line with the remaining time every few seconds.

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    SolveError
        An increment cannot be solved however small, or too much of the body is unjammed; the problem and what observers wrote hold
        everything up to it.
    InterruptedRunError
        Ctrl-C or SIGTERM came on one of the ranks; raised on all, with the problem as the last accepted increment left it.
    """
    def largest(t: float) -> float:
        return increment(t) if callable(increment) else increment

    check_type("problem", problem, Problem, "a Problem")
    refuse("the problem cannot be run", _faults(problem, until, largest, smallest, unjammed))
    end = np.inf if isinstance(until, str) else until
    unjammed = (1.0 if problem.moving_mesh is None else UNJAMMED) if unjammed is None else unjammed
    smallest = largest(problem.t) * SMALLEST_INCREMENT if smallest is None else smallest
    stops = sorted({float(event) for event in events if event < end} | {float(end)})
    before: np.ndarray | None = None
    first, show_progress = problem.t, Progress(progress if problem.comm.rank == 0 else None)
    for observe in observers:
        observe(problem)
    with noted_signals() as stop:
        while problem.t < end - TIME_ROUND_OFF * smallest:
            problem.move_mesh()
            if until == "steady":
                if before is not None and _is_steady(problem, before):
                    break
                before = problem.states
            wanted = min(largest(problem.t), problem.next_increment or np.inf)
            following = next(stop for stop in stops if stop > problem.t + TIME_ROUND_OFF * smallest)
            duration = following - problem.t if problem.t + wanted > following - TIME_ROUND_OFF * wanted else wanted
            trial = problem.solve_increment(duration, stop)
            _check_signals(problem, stop)
            if trial.failure:
                problem.next_increment = CUT_FACTOR * duration
                if problem.next_increment < smallest:
                    raise SolveError(f"the increment from t = {problem.t:g} cannot be solved, although it was cut to "
                                     f"{duration:.3g}: {trial.failure}{diagnosis(problem)}")
                continue
            easy = len(trial.residuals) <= EASY_ITERATIONS + 1
            if duration == wanted or not easy:                  # how easy one is that an event shortened tells nothing
                problem.next_increment = duration * (GROWTH_FACTOR if easy else 1.0)
            problem.accept(trial, following if abs(following - trial.t) <= TIME_ROUND_OFF * smallest else None)
            for observe in observers:
                observe(problem)
            _check_unjammed(problem, unjammed)
            show_progress(f"t = {problem.t:.6g} of {end:.6g}", (problem.t - first) / (end - first))


def _is_steady(problem: Problem, before: np.ndarray) -> bool:
    """Whether the states were much the same before the last increment, which would be in equilibrium again; collective."""
    assert problem.last is not None
    volumes = problem.point_volumes()

    def total(values: np.ndarray) -> float:
        return problem.comm.allreduce(float(volumes @ values))
    states = problem.states
    shear = total(2 * tensors.magnitude(tensors.deviator(tensors.symmetric(problem.last.gradients))))
    changes = (tensors.magnitude(states["fabric"] - before["fabric"]) / problem.material["kappa"],
               abs(states["coordination_number"] - before["coordination_number"]),
               abs(states["volume_fraction"] - before["volume_fraction"]))
    largest_residual = STEADY_RESIDUAL * problem.tolerances.force
    return max(map(total, changes)) < STEADY_RATE * shear and problem.last.residuals[0] <= largest_residual


def _check_unjammed(problem: Problem, largest: float) -> None:
    """SolveError if more than this part of the body's volume is unjammed; collective."""
    if largest < 1 and problem.unjammed_share() > largest:
        raise SolveError(f"{problem.unjammed_share():.0%} of the body is unjammed at t = {problem.t:g}: there p = 0, and without "
                         f"inertia the motion is arbitrary{diagnosis(problem)}; give unjammed, a larger part than {largest:g}, "
                         "to go on regardless")


def _faults(problem: Problem, until: object, largest: Callable[[float], float], smallest: float | None,
            unjammed: float | None) -> list[str]:
    """What is wrong with the arguments of run; the same on all ranks."""
    faults = []
    increment, shortest = largest(problem.t), SHORTEST * abs(until) if is_finite_number(until) else 0.0
    if until != "steady" and (not is_finite_number(until) or until < problem.t):
        faults.append(f"until = {until!r}: must be finite and not before the problem's t = {problem.t:g}, or 'steady'")
    if unjammed is not None and (not is_number(unjammed) or not 0 <= unjammed <= 1):
        faults.append(f"unjammed = {unjammed!r}: must be a number from 0 to 1")
    if not is_number(increment) or not increment > 0:
        faults.append(f"increment = {increment!r}: must be a number above 0")
    elif increment < shortest:
        faults.append(f"increment = {increment!r}: is lost beside until = {until}, must be at least {shortest:g}")
    if smallest is not None and (not is_number(smallest) or not smallest >= shortest or not smallest > 0
                                 or (is_number(increment) and smallest > max(increment, 0))):
        faults.append(f"smallest = {smallest!r}: must be above 0, at least {shortest:g} and at most the increment")
    free = problem.numbering.free_motions()
    if free:
        faults.append(f"nothing holds the body against {', '.join(free)}: give it a Displacement, for a pressure or a tie does not")
    return faults


def _check_signals(problem: Problem, stop: Callable[[], str]) -> None:
    """InterruptedRunError on all ranks if a signal has come on one; collective."""
    names = [name for name in problem.comm.allgather(stop()) if name]
    if names:
        raise InterruptedRunError(f"{names[0]} has ended the run at t = {problem.t:g}, after {problem.increments} increments")


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
