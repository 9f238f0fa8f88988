"""The single-point driver: steps, what is free and what is held in them, and the history they give.

Axes x (flow), y (vorticity), z (gradient). Histories have the paper's signs: stress compression positive, in k/d.
"""

import re
import time
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from . import tensors
from .checks import is_number, refuse
from .core import STATE, status_message
from .errors import ConstrainedDeformationWarning, PathError

TOLERANCE = 1e-6            # of fabric/kappa, Z2 and phi in an inner step where stresses are held
TRACE_LIMIT = 0.5           # abs(tr D^) above which a deformation counts as constrained; the paper asks for << 1
STEADY_RATE = 1e-4          # changes of A/kappa, Z2 and phi per unit of shear strain below which a state is steady
CHUNK = 100                 # increments between two looks at the stop condition

STATE_COLUMNS = ("phi", "p", "stress_ratio", "Z2", *(f"A_{a}" for a in tensors.AXES), *(f"sigma_{a}" for a in tensors.AXES),
                 "eta", "dilatancy", "eta_t")
COLUMNS = ("step", "gamma", "gamma_total", *STATE_COLUMNS)
ACOUSTIC = "acoustic"       # the column that is there only when asked for: it takes longer than the path

# What a control leaves free and what it holds instead.
CONTROLS = {
    "volume": ((), ()),
    "pressure": (("volume_strain",), ("p",)),
    "normal-stresses": (("e_xx", "e_yy", "e_zz"), ("sigma_xx", "sigma_yy", "sigma_zz")),
    "normal-load": (("e_zz",), ("sigma_zz",)),
}


@dataclass(frozen=True)
class Step:
    """A part of a path: a prescribed deformation, plus free modes whose amplitudes keep or move stresses.

    Attributes
    ----------
    name : str
        What the history's figure calls it.
    gradient : array (3, 3), or function of the strain measure giving one
        Velocity gradient per unit of `strain`; a function is sampled in the middle of each increment.
    strain : float
        Measure over which the gradient acts: grad u = strain * gradient.
    increments : int
    free : tuple of str
        Deformations that are found: "e_xx" ... "e_yz", "volume_strain", or a linear combination such as "e_xx - e_zz".
    stress : dict of str to float or "hold"
        As many conditions: "sigma_xx" ... "sigma_yz", "p", or a linear combination, to the value (compression positive)
        that it reaches, linearly, at the end of the step.
    until : str
        "steady", or a column compared with a number, "p < 0.001": ends the step early.
    shear : bool
        Whether the strain is a signed shear strain in x-z; otherwise gamma grows by 2 abs(D) per increment.
    table : array (n + 1, 9 + m), optional
        Cumulative displacement gradient and targets row by row, from a file; replaces gradient, strain, targets.
    """

    name: str
    gradient: object = field(default_factory=lambda: np.zeros((3, 3)))
    strain: float = 1.0
    increments: int = 200
    free: tuple = ()
    stress: dict = field(default_factory=dict)
    until: str = ""
    shear: bool = False
    table: object = None

    def __post_init__(self):
        faults = []
        if isinstance(self.increments, bool) or not isinstance(self.increments, (int, np.integer)) or self.increments < 1:
            faults.append(f"increments = {self.increments!r}: must be an integer, at least 1")
        if not is_number(self.strain) or not np.isfinite(self.strain):
            faults.append(f"strain = {self.strain!r}: must be a finite number")
        if not callable(self.gradient):
            try:
                gradient = np.asarray(self.gradient, float)
            except (TypeError, ValueError):
                gradient = np.full(0, np.nan)
            if gradient.shape != (3, 3) or not np.isfinite(gradient).all():
                faults.append(f"velocity_gradient = {self.gradient!r}: must be a 3 x 3 matrix of finite numbers, or a function")
        modes, functionals = [], []
        for text in self.free:
            modes += _collected(faults, linear_combination, text, STRAINS)
        for text, value in self.stress.items():
            functionals += _collected(faults, linear_combination, text, STRESSES)
            if value != "hold" and not (is_number(value) and np.isfinite(value)):
                faults.append(f"stress {text!r} = {value!r}: must be a finite number or \"hold\"")
        if len(self.free) != len(self.stress):
            faults.append(f"{len(self.free)} free deformations ({', '.join(self.free)}) against {len(self.stress)} stress "
                          f"conditions ({', '.join(self.stress)}): must be as many")
        for kind, vectors in (("free deformations", modes), ("stress conditions", functionals)):
            if vectors and np.linalg.matrix_rank(vectors) < len(vectors):
                faults.append(f"{kind} {', '.join(self.free if vectors is modes else self.stress)}: not independent")
        if self.until:
            _collected(faults, stop_condition, self.until)
        refuse(f"the step {self.name!r} cannot be made", faults)

    @property
    def modes(self):
        """Free displacement gradients (m, 3, 3)."""
        return np.array([tensors.to_matrix(linear_combination(text, STRAINS)) for text in self.free]).reshape(-1, 3, 3)

    @property
    def functionals(self):
        """Weights (m, 6) of the tension-positive stress components that are prescribed."""
        return -np.array([linear_combination(text, STRESSES) for text in self.stress]).reshape(-1, 6)

    def gradients(self):
        """Prescribed displacement gradient increments (increments, 3, 3)."""
        if self.table is not None:
            return np.diff(self.table[:, :9], axis=0).reshape(-1, 3, 3)
        size = self.strain / self.increments
        if not callable(self.gradient):
            return np.tile(size * np.asarray(self.gradient, float), (self.increments, 1, 1))
        middles = (np.arange(self.increments) + 0.5) * size
        return size * np.array([np.asarray(self.gradient(s), float) for s in middles])

    def targets(self, stress):
        """Targets (increments + 1, m) from the stress (6,), tension positive, at the start of the step."""
        start = self.functionals @ stress
        if self.table is not None and self.stress:
            return np.vstack([start, self.table[1:, 9:]])
        end = [now if value == "hold" else value for now, value in zip(start, self.stress.values())]
        return np.linspace(start, np.array(end, float).reshape(start.shape), self.increments + 1)


def _collected(faults, function, *arguments):
    """[result], or [] and one more fault."""
    try:
        return [function(*arguments)]
    except ValueError as error:
        faults.append(str(error))
        return []


# ---- names of strains and stresses ---------------------------------------------------------------------------------

STRAINS = {f"e_{axis}": np.eye(6)[i] for i, axis in enumerate(tensors.AXES)}          # tensor components of the mode
STRAINS["volume_strain"] = tensors.IDENTITY / 3
STRESSES = {f"sigma_{axis}": np.eye(6)[i] for i, axis in enumerate(tensors.AXES)}     # weights of stored components
STRESSES["p"] = tensors.IDENTITY / 3

TERM = re.compile(r"\s*([+-]?)\s*(?:([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*\*\s*)?([A-Za-z]\w*)")


def linear_combination(text, names):
    """Six components of a linear combination of named ones, such as "0.5*e_xx - e_zz"."""
    total, position = np.zeros(6), 0
    while position < len(text.rstrip()):
        match = TERM.match(text, position)
        if not match or match[3] not in names or (position > 0 and not match[1]):
            raise ValueError(f"{text!r}: must be a linear combination of {', '.join(names)}, such as \"2*{next(iter(names))}\"")
        total += float(match[2] or 1) * (-1 if match[1] == "-" else 1) * names[match[3]]
        position = match.end()
    if not total.any():
        raise ValueError(f"{text!r}: is zero; must be a linear combination of {', '.join(names)}")
    return total


# ---- the steps of this field -----------------------------------------------------------------------------------------

SHEAR = np.zeros((3, 3))
SHEAR[0, 2] = 1.0           # du_x/dz
AXIAL = np.diag([0.0, 0.0, -1.0])


def controlled(control):
    """What a control of CONTROLS leaves free and holds, as arguments of Step."""
    if control not in CONTROLS:
        raise ValueError(f"control {control!r}: must be one of {', '.join(CONTROLS)}")
    free, held = CONTROLS[control]
    return {"free": free, "stress": dict.fromkeys(held, "hold")}


def shear(strain, control="volume", increments=200, until=""):
    """Simple shear in x-z by a signed shear strain, under a control of CONTROLS."""
    return Step(f"shear {strain:g}", SHEAR, strain, increments, until=until, shear=True, **controlled(control))


def cycles(amplitude, number, control="volume", increments=100):
    """Cyclic simple shear: steps of +amplitude, then -amplitude and +amplitude in turn, 2 per cycle, `increments` each.

    The shear strain runs between 0 and the amplitude, as in figure 10.
    """
    if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or number < 1:
        raise ValueError(f"cycles = {number!r}: must be an integer, at least 1")
    return [shear(sign * amplitude, control, increments) for _ in range(number) for sign in (1, -1)]


def deform(velocity_gradient, strain=1.0, control="volume", increments=200, until=""):
    """grad u = strain * velocity_gradient (3 x 3, or a function of the strain), under a control of CONTROLS."""
    return Step("deformation", velocity_gradient, strain, increments, until=until, **controlled(control))


def pause():
    """No strain: everything holds."""
    return Step("pause", increments=1)


def isotropic_compression(compression=None, pressure=None, increments=100, until=""):
    """Isotropic compression by a logarithmic volume strain, or to a mean pressure."""
    if (compression is None) == (pressure is None):
        raise ValueError("isotropic compression: give either compression or pressure")
    if pressure is not None:
        return Step("isotropic compression", increments=increments, free=("volume_strain",), stress={"p": pressure}, until=until)
    return Step("isotropic compression", -np.eye(3) / 3, compression, increments, until=until)


def biaxial(compression, drained=True, increments=200, until=""):
    """Plane-strain biaxial compression along z (e_yy = 0): drained holds sigma_xx, undrained the volume."""
    if drained:
        return Step("drained biaxial", AXIAL, compression, increments, ("e_xx",), {"sigma_xx": "hold"}, until)
    return Step("undrained biaxial", np.diag([1.0, 0, -1]), compression, increments, until=until)


def triaxial(compression, drained=True, increments=200, until=""):
    """Triaxial compression along z: drained holds sigma_xx = sigma_yy, undrained the volume."""
    if drained:
        held = {"0.5*sigma_xx + 0.5*sigma_yy": "hold"}
        return Step("drained triaxial", AXIAL, compression, increments, ("e_xx + e_yy",), held, until)
    return Step("undrained triaxial", np.diag([0.5, 0.5, -1]), compression, increments, until=until)


# ---- running ---------------------------------------------------------------------------------------------------------

@dataclass
class History:
    """What a path gave: one row at its start and one after each increment.

    Attributes
    ----------
    material : Material
    states : record array (n,) of dtype STATE
    columns : dict of str to array (n,)
        COLUMNS, and "acoustic" if asked for; `history["p"]` is short for `history.columns["p"]`.
    """

    material: object
    states: np.recarray
    columns: dict

    def __getitem__(self, name):
        return self.columns[name]

    def __len__(self):
        return len(self.states)

    def write_csv(self, path):
        """Writes the columns, one row a state; the old file is replaced only by a complete one."""
        path = Path(path)
        formats = ["%d"] + ["%.15g"] * (len(self.columns) - 1)
        partial = path.with_name(path.name + ".part")
        np.savetxt(partial, np.column_stack(list(self.columns.values())), fmt=formats, delimiter=",",
                   header=",".join(self.columns), comments="")
        partial.replace(path)


def state_columns(material, states):
    """STATE_COLUMNS of states (n,): compression positive; stress_ratio is 0 where p is, dilatancy 0 before any strain."""
    sigma = -states["stress"]
    p = tensors.trace(sigma) / 3
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(p > 0, -sigma[:, 4] / p, 0.0)
        volume, size = tensors.trace(states["direction"]), tensors.magnitude(tensors.deviator(states["direction"]))
        dilatancy = np.where(volume == 0, 0.0, volume / size)
    values = [states["volume_fraction"], p, ratio, states["coordination_number"], *states["fabric"].T, *sigma.T,
              material.evaluate(states)[1], dilatancy, material.transverse_modulus(states)]
    return dict(zip(STATE_COLUMNS, values))


OPERATORS = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal}
CONDITION = re.compile(r"\s*(\w+)\s*(<=|>=|<|>)\s*([-+0-9.eE]+)\s*")


def stop_condition(text):
    """The function of columns (with the row before) that says after which rows a step may stop."""
    if text == "steady":
        return _is_steady
    match = CONDITION.fullmatch(text)
    try:
        name, operator, value = match[1], OPERATORS[match[2]], float(match[3])
    except (TypeError, ValueError):
        name = None
    if name not in COLUMNS[1:]:
        raise ValueError(f"until {text!r}: must be \"steady\" or a column compared with a number, such as \"p < 0.001\"; "
                         f"columns are {', '.join(COLUMNS[1:])}")
    return lambda columns, material: operator(columns[name], value)[1:]


def _is_steady(columns, material):
    strain = np.abs(np.diff(columns["gamma_total"]))
    change = np.abs(np.diff(columns["Z2"])) + np.abs(np.diff(columns["phi"]))
    for axis in tensors.AXES:
        change += np.abs(np.diff(columns[f"A_{axis}"])) / material["kappa"]
    return (strain > 0) & (change < STEADY_RATE * strain)


def run(material, state, steps, out=None, tolerance=TOLERANCE, progress=None, acoustic=False):
    """Runs steps one after the other.

    Parameters
    ----------
    material : Material
    state : record of dtype STATE
        Where the path starts: material.steady(0.6), for example.
    steps : list of Step
    out : path, optional
        Directory that receives history.csv, also when a step fails; then failing.toml too, a path file that repeats it.
    tolerance : float
        Largest error of fabric/kappa, Z2 and phi in an inner step, where stresses are held.
    progress : function of (step, increments done, increments), optional
        Called between chunks of increments.
    acoustic : bool
        Whether the history has the column "acoustic", the smallest eigenvalue of Material.ellipticity: 0.05 to 0.2 ms a row,
        some fifty times what the row itself takes.

    Returns
    -------
    History

    Raises
    ------
    PathError
        Where a target cannot be reached or the material gives up; carries the history up to there.
    """
    if not is_number(tolerance) or not 0 < tolerance < 1:
        raise ValueError(f"tolerance = {tolerance!r}: must be a number in (0, 1)")
    recorder = _Recorder(material, state, acoustic)
    try:
        for number, step in enumerate(steps, 1):
            _run_step(recorder, number, step, tolerance, progress)
    except PathError as error:
        if out is not None:
            error.history.write_csv(_directory(out) / "history.csv")
            from .paths import write_path_file
            write_path_file(_directory(out) / "failing.toml", material, recorder.state, recorder.failing)
        raise
    history = recorder.history()
    if out is not None:
        history.write_csv(_directory(out) / "history.csv")
    return history


def _directory(out):
    Path(out).mkdir(parents=True, exist_ok=True)
    return Path(out)


class _Recorder:
    """The rows of a history while it grows."""

    def __init__(self, material, state, acoustic):
        self.material, self.acoustic = material, acoustic
        self.states = [np.array(state, STATE).reshape(1)]
        self.step, self.gamma, self.gamma_total = [np.zeros(1, int)], [np.zeros(1)], [np.zeros(1)]
        self.failing = None

    @property
    def state(self):
        return self.states[-1][-1]

    def append(self, number, states, gamma):
        self.states.append(states)
        self.step.append(np.full(len(states), number))
        self.gamma.append(self.gamma[-1][-1] + np.cumsum(gamma))
        self.gamma_total.append(self.gamma_total[-1][-1] + np.cumsum(np.abs(gamma)))

    def history(self, last=None):
        """The rows of all blocks, with what was asked for; or of the last few, as stop conditions need them."""
        def joined(blocks):
            return np.concatenate(blocks if last is None else blocks[-last:])
        states = joined(self.states).view(np.ndarray)
        columns = {"step": joined(self.step), "gamma": joined(self.gamma), "gamma_total": joined(self.gamma_total)}
        columns |= state_columns(self.material, states)
        if self.acoustic and last is None:
            columns[ACOUSTIC] = self.material.ellipticity(states).eigenvalue
        return History(self.material, states.view(np.recarray), columns)


def _run_step(recorder, number, step, tolerance, progress):
    material = recorder.material
    gradients, modes, functionals = step.gradients(), step.modes, step.functionals
    targets = step.targets(recorder.state["stress"])
    stops = stop_condition(step.until) if step.until else None
    n = len(gradients)
    chunk = CHUNK if stops or progress else n
    largest_trace = 0.0
    for first in range(0, n, chunk):
        last = min(first + chunk, n)
        states, amplitudes, status = material.follow(
            recorder.state, gradients[first:last], modes, functionals, targets[first:last + 1], tolerance)
        total = gradients[first:first + len(states)] + np.tensordot(amplitudes, modes, 1)
        rate = tensors.to_voigt((total + np.swapaxes(total, 1, 2)) / 2)
        gamma = total[:, 0, 2] if step.shear else 2 * tensors.magnitude(rate)
        if len(states):
            recorder.append(number, states.view(np.ndarray), gamma)
        stopped = False
        if stops and len(states):
            rows = recorder.history(last=2)
            kept = {name: column[-len(states) - 1:] for name, column in rows.columns.items()}
            reached = np.flatnonzero(stops(kept, material))
            if reached.size:
                _truncate(recorder, reached[0] + 1)
                stopped = True
        strained = np.abs(gamma[:len(recorder.states[-1])]) > 0
        traces = np.abs(tensors.trace(recorder.states[-1]["direction"]))
        if strained.any():
            largest_trace = max(largest_trace, traces[strained].max())
        if stopped:
            break
        if status:
            done = first + len(states)
            stress = {name: float(value) for name, value in zip(step.stress, targets[done + 1])}
            recorder.failing = replace(step, gradient=gradients[done], strain=1.0, increments=1, stress=stress, until="",
                                       table=None, shear=False)
            raise PathError(f"step {number} ({step.name}), increment {done + 1} of {n}: {status_message(status)}; "
                            + _where(material, recorder.state), recorder.history())
        if progress:
            progress(number, last, n)
    if largest_trace > TRACE_LIMIT:
        warnings.warn(f"step {number} ({step.name}): abs(tr D^) reaches {largest_trace:.2f}; the paper's law is meant for "
                      "abs(tr D^) << 1, constrained deformations are outside what it was fitted to",
                      ConstrainedDeformationWarning, stacklevel=3)


def _truncate(recorder, rows):
    for name in ("states", "step", "gamma", "gamma_total"):
        blocks = getattr(recorder, name)
        blocks[-1] = blocks[-1][:rows]


def _where(material, state):
    """The state in words, for an error message."""
    columns = state_columns(material, np.array(state, STATE).reshape(1))
    return ("state before it: " + ", ".join(f"{name} = {columns[name][0]:.6g}" for name in ("phi", "p", "stress_ratio", "Z2"))
            + f", abs(A) = {tensors.magnitude(state['fabric']):.4g}, Zc = {material['Zc']:.4g}")


class Progress:
    """Prints a line with the remaining time, once a path has run for some seconds."""

    def __init__(self, steps, stream, quiet_seconds=2.0):
        self.sizes = [1 if step.table is not None else step.increments for step in steps]
        self.stream, self.quiet_seconds = stream, quiet_seconds
        self.start = self.last = time.monotonic()

    def __call__(self, step, done, increments):
        now = time.monotonic()
        if now - self.last < self.quiet_seconds:
            return
        self.last = now
        share = (sum(self.sizes[:step - 1]) + done) / sum(self.sizes)
        rest = (now - self.start) * (1 - share) / share
        print(f"step {step} of {len(self.sizes)}, increment {done} of {increments}: {share:.0%}, {rest:.0f} s to go",
              file=self.stream, flush=True)
