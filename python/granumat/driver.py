"""The driver of a single material point: follows load paths made of steps and returns their histories.

Steps and the usual tests are defined in `steps`, histories in `history`; this module offers both, so that

    from granumat import Material, driver
    history = driver.run(material, material.steady(0.60), [driver.shear(-1.0, "pressure")])

needs no other import. Axes are x (flow), y (vorticity), z (gradient). Histories have the paper's sign of stress, compression
positive, in k/d (k_Hz for Hertzian contacts).
"""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from . import tensors
from .checks import check_type, is_number, real_array
from .core import STATE, status_message
from .errors import ConstrainedDeformationWarning, InterruptedRunError, PathError, UnmetConditionWarning
from .history import ACOUSTIC, COLUMNS, STATE_COLUMNS, History, Recorder, state_columns, stop_condition
from .material import Material
from .paths import write_path_file
from .progress import Progress
from .quantities import QUANTITIES_FILE, Quantity, write_history
from .signals import noted_signals
from .steps import (
    CONTROLS,
    SHEAR,
    TOLERANCE,
    Step,
    biaxial,
    controlled,
    cycles,
    cyclic_direct_shear,
    cyclic_triaxial,
    deform,
    direct_shear,
    isotropic_compression,
    oedometer,
    pause,
    shear,
    triaxial,
)

__all__ = ["ACOUSTIC", "COLUMNS", "CONTROLS", "SHEAR", "STATE_COLUMNS", "TOLERANCE", "History", "Step", "biaxial",
           "controlled", "cycles", "cyclic_direct_shear", "cyclic_triaxial", "deform", "direct_shear", "isotropic_compression",
           "oedometer", "pause", "run", "shear", "state_columns", "triaxial"]

KEEP_SECONDS = 30.0         # between two writes of what was computed so far,
KEEP_FACTOR = 20.0          # or so many times as long as the last one took
TRACE_LIMIT = 0.5           # abs(tr D^) above which a deformation counts as constrained; the paper asks for << 1
CHUNK = 100                 # increments between two checks of the stop condition, and two calls of progress,
LONG_CHUNK = 1000           # or, where there is neither, between two looks for a signal


def run(material: Material, state: np.record, steps: Sequence[Step], out: str | Path | None = None, tolerance: float = TOLERANCE,
        progress: TextIO | None = None, acoustic: bool = False,
        quantities: Sequence[Quantity] = ()) -> History:
    """Follow a load path: run steps one after the other.

    Parameters
    ----------
    material : Material
    state : record of dtype STATE
        Start of the path, such as material.steady(0.6).
    steps : list of Step
    out : path, optional
        Directory that receives history.csv, now and then while a path takes long, and also when a step fails; then it receives
        failing.toml too, a path file that repeats the failing increment. Files of an earlier path there are replaced.
    tolerance : float
        Largest error of what evolves (fabric/kappa, Z2 and phi; in the critical closure phi and, with e_r > 0, the stress over its
        largest component) in a substep where stresses are held, in (0, 1).
    progress : text stream, optional
        Where a line with the remaining time is written every few seconds.
    acoustic : bool
        Whether the history has the column "acoustic", the smallest eigenvalue of Material.ellipticity: 0.05 to 0.2 ms a row,
        some fifty times what the row itself takes.
    quantities : sequence of Quantity
        If there are some, and `out`, their values are written there into quantities.csv.

    Returns
    -------
    History

    Raises
    ------
    PathError
        If a prescribed stress cannot be reached or the material cannot follow; carries the history up to there.
    InterruptedRunError
        If Ctrl-C or SIGTERM came; what was computed is in `out`.
    ValueError
        If the tolerance is not in (0, 1), or the state is none that a path of this material can start from
        (Material.check_start).
    TypeError
        If an argument is of another type.

    Warns
    -----
    ConstrainedDeformationWarning
        If abs(tr D^) exceeds 0.5 in a step.
    UnmetConditionWarning
        If a step has come to its end, but its condition `until` is not met.
    """
    check_type("material", material, Material, "a Material")
    check_type("steps", steps, (list, tuple), "a list of steps")
    for number, step in enumerate(steps, 1):
        check_type(f"step {number}", step, Step, "a Step, such as driver.shear(1.0)")
        if callable(step.gradient):
            _gradients(number, step)                             # so that no later step ends what earlier ones have computed
    material.check_start(state)
    if not is_number(tolerance) or not 0 < tolerance < 1:
        raise ValueError(f"tolerance = {tolerance!r}: must be a number in (0, 1)")
    recorder = Recorder(material, state, acoustic)
    lengths, show = [len(step) for step in steps], Progress(progress)

    def show_progress(number: int, done: int) -> None:
        show(f"step {number} of {len(steps)}, increment {done} of {lengths[number - 1]}",
             (sum(lengths[:number - 1]) + done) / sum(lengths))
    files = None if out is None else _Files(Path(out), recorder, quantities)
    failure = None
    with noted_signals() as stop:
        for number, step in enumerate(steps, 1):
            failure = _run_step(recorder, number, step, tolerance, None if progress is None else show_progress, files, stop)
            if failure or stop():
                break
        history = recorder.history() if files is None else files.write()
        if files is not None and failure:
            write_path_file(files.failing, material, recorder.state, failure.increment)
    if failure:
        raise PathError(failure.message, history)
    if stop() and history.times[-1] < len(steps):
        raise InterruptedRunError(f"{stop()} has ended the path in step {number} ({step.name}), after {len(history) - 1} "
                                  "increments")
    return history


class _Files:
    """What a path writes into its directory: now and then while it is followed, so that little is lost with its process."""

    def __init__(self, directory: Path, recorder: Recorder, quantities: Sequence[Quantity]) -> None:
        self._directory, self._recorder, self._quantities = directory, recorder, quantities
        self._due = time.monotonic() + KEEP_SECONDS
        self.failing = directory / "failing.toml"
        directory.mkdir(parents=True, exist_ok=True)
        self.failing.unlink(missing_ok=True)                     # of an earlier path

    def write(self) -> History:
        """Write the history so far, which is returned, and the quantities."""
        start = time.monotonic()
        history = self._recorder.history()
        history.write_csv(self._directory / "history.csv")
        if self._quantities:
            write_history(self._directory / QUANTITIES_FILE, self._quantities, history)
        end = time.monotonic()
        self._due = end + max(KEEP_SECONDS, KEEP_FACTOR * (end - start))
        return history

    def write_if_due(self) -> None:
        if time.monotonic() > self._due:
            self.write()


class _Failure(NamedTuple):
    """Why a step ended early, and the increment at which it did as a step of its own."""

    message: str
    increment: Step


def _run_step(recorder: Recorder, number: int, step: Step, tolerance: float,
              show_progress: Callable[[int, int], None] | None, files: _Files | None,
              stop: Callable[[], str]) -> _Failure | None:
    """Append the states after the increments of a step, in chunks, until there is a reason to stop."""
    gradients, modes, functionals = _gradients(number, step), step.modes, step.functionals
    targets = step.targets(recorder.state["stress"])
    condition = stop_condition(step.until) if step.until else None
    n = len(gradients)
    largest_trace, stopped = 0.0, False
    chunk = CHUNK if condition or show_progress else LONG_CHUNK
    for first in range(0, n, chunk):
        if stop():
            return None
        last = min(first + chunk, n)
        states, amplitudes, status = recorder.material.follow(
            recorder.state, gradients[first:last], modes, functionals, targets[first:last + 1], tolerance)
        done = first + len(states)
        if len(states):
            total = gradients[first:done] + np.tensordot(amplitudes, modes, 1)
            gamma = total[:, 0, 2] if step.shear else 2 * tensors.magnitude(tensors.symmetric(total))
            recorder.append(number, number - 1 + np.arange(first + 1, done + 1) / n, states.view(np.ndarray), gamma,
                            tensors.symmetric(total))
            stopped = condition is not None and recorder.stop_at(condition)
            largest_trace = max(largest_trace, _largest_trace(recorder.last_states, gamma))
        if stopped:
            break
        if status:
            message = f"step {number} ({step.name}), increment {done + 1} of {n}: {status_message(status)}; "
            stress = {name: float(value) for name, value in zip(step.stress, targets[done + 1])}
            return _Failure(message + _in_words(recorder.material, recorder.state),
                            replace(step, gradient=gradients[done], strain=1.0, increments=1, stress=stress, until="", table=None,
                                    shear=False))
        if show_progress:
            show_progress(number, last)
        if files is not None:
            files.write_if_due()
    if condition is not None and not stopped:
        warnings.warn(f"step {number} ({step.name}): its condition until = {step.until!r} was not met, so it ended with its last "
                      "increment", UnmetConditionWarning, stacklevel=3)
    if largest_trace > TRACE_LIMIT:
        warnings.warn(f"step {number} ({step.name}): abs(tr D^) reaches {largest_trace:.2f}; the paper's law is meant for "
                      "abs(tr D^) << 1, constrained deformations are outside what it was fitted to",
                      ConstrainedDeformationWarning, stacklevel=3)
    return None


def _gradients(number: int, step: Step) -> np.ndarray:
    """The displacement gradients (n, 3, 3) of a step; ValueError where a function gives none."""
    try:
        gradients = real_array("velocity_gradient", step.gradients())
    except (TypeError, ValueError) as error:
        raise ValueError(f"step {number} ({step.name}): velocity_gradient: {error}") from None
    if gradients.shape[1:] != (3, 3) or not np.isfinite(gradients).all():
        raise ValueError(f"step {number} ({step.name}): velocity_gradient: must be 3 x 3 finite numbers for every strain")
    return gradients


def _largest_trace(states: np.ndarray, gamma: np.ndarray) -> float:
    """Largest abs(tr D^) of states (n,) after increments with shear strains gamma (at least n,); 0 if there was no strain."""
    strained = np.abs(gamma[:len(states)]) > 0
    return float(np.abs(tensors.trace(states["direction"]))[strained].max(initial=0.0))


def _in_words(material: Material, state: np.void) -> str:
    """The state before a failure, for its message."""
    columns = state_columns(material, np.array(state, STATE).reshape(1))
    return ("state before it: " + ", ".join(f"{name} = {columns[name][0]:.6g}" for name in ("phi", "p", "stress_ratio", "Z2"))
            + f", abs(A) = {tensors.magnitude(state['fabric']):.4g}, Zc = {material['Zc']:.4g}")
