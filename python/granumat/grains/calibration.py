"""Calibration: constants of the law fitted to measured runs, how well they are known, and how they do on runs left out."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from .. import __version__, tensors
from ..calibrations import COMMON
from ..checks import attempt, choose, refuse, repetitions
from ..core import STATE
from ..errors import MaterialError
from ..material import CLOSURES, RANGES, UNUSED, Material
from ..progress import Progress
from ..signals import noted_signals
from ..steps import SHEAR
from ..toml import write_content
from .comparison import SCATTER, Comparison
from .fitting import FIRST_WEIGHT, Constants, Fit, Sample, differences, fit, remembered, robust, search
from .measured import FABRIC, Run, read_runs
from .predicted import Prediction, columns_of, predict
from .scores import PHASES, QUANTITIES, ROUNDING, Yardstick, root_mean_square
from .sums import UNREACHED, Sums

# Least and largest value of each constant that can be fitted, and the size of a change that matters.
RANGES_OF_FITS = {
    "a1": (1e-3, 0.1, 0.0073), "a2": (0.0, 1.0, 0.05), "a3": (-10.0, 10.0, 2.0), "a4": (-20.0, 20.0, 5.0),
    "b1": (0.0, 1.0, 0.15), "b2": (-20.0, 0.0, 3.0), "Zc": (2.0, 7.0, 0.5), "elastic_strain": (1e-3, 0.2, 0.02),
    "c1": (-5.0, -0.05, 0.5), "c2": (-50.0, 0.0, 10.0), "c3": (0.0, 500.0, 100.0),
    "d1": (-300.0, 0.0, 45.0), "d2": (0.2, 100.0, 5.0), "d3": (-500.0, 0.0, 40.0),
    "phic": (0.3, 0.8, 0.02), "beta1": (0.5, 50.0, 7.5), "beta2": (0.2, 2.0, 0.5), "g": (-0.1, 0.1, 0.005)}
GROUPS = {
    "stress": ("a1", "a2", "a3", "a4", "b1", "b2", "Zc", "elastic_strain"),
    "fabric": ("c1", "c2", "c3"),
    "coordination": ("phic", "beta1", "d1", "d2", "d3")}
ALL = "all"
OFFSETS = ("Zc", "phic", "elastic_strain")      # whose changes are not relative to themselves
START_OF_ELASTIC_STRAIN = 0.01

# What the measured microstructure decides by itself: the stress by its closure, the rates by what it is a little later.
OF_CLOSURE = ("a1", "a2", "a3", "a4", "b1", "b2", "Zc")
OF_RATES = ("c1", "c2", "c3", "d1", "d2", "d3", "phic", "beta1", "beta2")
SETTLED_FRICTION = 0.1      # strain after a turn from where friction has the direction of the shear in every closure
STRIDE = 0.05               # of strain from one row to the later one
OF_STRESS, OF_STATE = ([QUANTITIES.index(name) for name in names]
                       for names in (("p", "stress_ratio", "N1/p", "N2/p"), ("Z2", "A_xz")))
# Held where no run has one of the columns: scales of fabric and excess coordination that stresses do not show.
HELD_WITHOUT = {("Z2", "A_xz"): ("a1", "a2", "Zc", "c1"), ("Z2", "A_xz", "N1/p"): ("a3", "a4")}

PATH_TOLERANCE = 1e-4       # of histories where stresses are held
# For the remaining time: rounds of differences in a fit, and of errors in one without some of the runs, 1.5 of these for each run.
ROUNDS, ROUNDS_LEFT_OUT = 13, 7
NOTED_PHASES = ("all", "first 0.1")         # whose scores are in the file
SHOWN_CHANGE = 0.1          # largest change of a direction in words, relative to the constants or in sizes
LEAST_SHOWN = 0.02          # smallest that is shown, of the largest
NUMBER = re.compile(r"(^|_)(mu|phi)[\d.]+|-[\d.]+$")             # in the name of a run: what does not belong to its programme


@dataclass(frozen=True, eq=False)
class FittedSet:
    """Constants of a closure for one friction coefficient.

    Attributes
    ----------
    mu : float
    closure : str
    runs : list of Run
        That they were fitted to.
    constants, start : dict of str to float
        All constants that have a role, fitted or not, and what they were before.
    deviations : dict of str to float
        Standard deviations of those that were fitted; NaN on bounds.
    held : tuple of str
        Constants that were asked for but not fitted, because the columns are missing that show them.
    on_bounds : tuple of str
    correlated : list of (str, str, float)
        Pairs of constants whose correlation coefficient is beyond 0.95.
    unseen : list of dict of str to float
        Joint changes of constants that the data do not see.
    comparison : Comparison or None
        Scores of the start, of the fit, and of fits without the run, without its phi, without its programme; None if interrupted.
        The start is without an elastic strain where its calibration has none.
    """

    mu: float
    closure: str
    runs: Sequence[Run]
    constants: Mapping[str, float]
    start: Mapping[str, float]
    deviations: Mapping[str, float]
    held: Sequence[str]
    on_bounds: Sequence[str]
    correlated: Sequence[tuple[str, str, float]]
    unseen: Sequence[Mapping[str, float]]
    comparison: Comparison | None

    def unseen_in_words(self) -> list[str]:
        """Each direction that the data do not see."""
        return [_direction_in_words(direction, self.constants) for direction in self.unseen]

    def __str__(self) -> str:
        """What was found, in words."""
        lines = [f"mu {self.mu:g}, closure {self.closure}, {len(self.runs)} {'run' if len(self.runs) == 1 else 'runs'}",
                 f"  {'constant':16}{'value':>10}{'deviation':>11}{'start':>10}"]
        for name, deviation in self.deviations.items():
            known = "on bound" if name in self.on_bounds else f"{deviation:.2g}"
            lines.append(f"  {name:16}{self.constants[name]:>10.4g}{known:>11}{self.start[name]:>10.4g}")
        if self.held:
            lines.append(f"  held at their start, since nothing measured shows them: {', '.join(self.held)}")
        lines += [f"  the data hardly tell {first} from {second}: correlation {coefficient:.3f}"
                  for first, second, coefficient in self.correlated]
        lines += [f"  the data do not see {words}" for words in self.unseen_in_words()]
        return "\n".join(lines + ([] if self.comparison is None else [self.comparison.total()]))

    def note(self) -> dict[str, Any]:
        """What a calibration file says of them."""
        phi = np.hstack([run.columns["phi"] for run in self.runs])
        said = {"closure": self.closure, "mu": self.mu, "phi": [phi.min(), phi.max()],
                "strain": max(run.columns["gamma_total"][-1] for run in self.runs),
                "runs": [run.name for run in self.runs], "seeds": [run.seeds for run in self.runs],
                "deviations": {name: _rounded(value, 2) for name, value in self.deviations.items() if np.isfinite(value)},
                "held": list(self.held), "on_bounds": list(self.on_bounds), "unseen": self.unseen_in_words()}
        if self.comparison is not None:
            for model in (*self.comparison.predictions, SCATTER):
                scores = self.comparison.scores(model)
                said[f"scores {model}"] = {
                    phase: {name: _rounded(score, 3) for name, score in zip(QUANTITIES, of_phase) if np.isfinite(score)}
                    for phase, of_phase in zip(PHASES, root_mean_square(scores)) if phase in NOTED_PHASES}
                said[f"p {model}"] = {run.name: _rounded(p, 3) for run, p in zip(self.runs, scores[:, 0, 0]) if np.isfinite(p)}
        return said


@dataclass(frozen=True, eq=False)
class Calibration:
    """Constants as a table over mu, for each closure.

    Attributes
    ----------
    contact : str
    sets : list of FittedSet
    settings : dict
        What was asked for.
    interrupted : str
        Name of the signal that came; then sets later than that have their start.
    """

    contact: str
    sets: Sequence[FittedSet]
    settings: Mapping[str, Any]
    interrupted: str

    def __str__(self) -> str:
        """What was found, in words."""
        return "\n\n".join(map(str, self.sets))

    def write(self, filename: str | Path) -> None:
        """Write the calibration file, which `calibration = "NAME.toml"` reads; an old one is replaced at once."""
        tables: dict[str, list[dict[str, float]]] = {}
        for one in self.sets:
            constants = {name: _rounded(value, 6) for name, value in one.constants.items()}
            tables.setdefault(COMMON if one.closure == "full" else one.closure, []).append({"mu": one.mu} | constants)
        write_content(filename, {"contact": self.contact, **tables, "fitted": [one.note() for one in self.sets],
                                 "provenance": {"by": f"granumat {__version__}, granumat calibrate", **self.settings}})


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _direction_in_words(direction: Mapping[str, float], constants: Mapping[str, float]) -> str:
    """A joint change of constants such as "c1 by +10.0%, c3 by -10.0%", of their values."""
    relative = {name: change / constants[name] if constants[name] and name not in OFFSETS
                else change / RANGES_OF_FITS[name][2] for name, change in direction.items()}
    largest = max(map(abs, relative.values()))
    sign = next(np.sign(value) for value in relative.values() if abs(value) >= LEAST_SHOWN * largest)
    factor = sign * SHOWN_CHANGE / largest
    return ", ".join(f"{name} by {direction[name] * factor:+.2g}" if name in OFFSETS or not constants[name]
                     else f"{name} by {value * factor:+.1%}"
                     for name, value in relative.items() if abs(value) >= LEAST_SHOWN * largest)


# ---- what is asked for -----------------------------------------------------------------------------------------------------

def calibrate(runs: Iterable[Run | str | Path], fit: Sequence[str] = (ALL,), closures: Sequence[str] = ("full",),
              calibration: str = "table-1", progress: TextIO | None = None, **keys: Any) -> Calibration:
    """Fit constants of the law to measured runs, a set for each friction coefficient in them.

    First come the constants that the measured microstructure decides by itself, where Z2 and the fabric were measured: those of the
    stress, from the rows in which it is settled, and those of the rates, from rows that follow one another by a strain of 0.05.
    Then all are fitted together to the whole histories.

    Parameters
    ----------
    runs : iterable of Run, or of path
        What `read_runs` gives, or files for it.
    fit : sequence of str
        Constants by name, or groups: "stress" a1 a2 a3 a4 b1 b2 Zc elastic_strain; "fabric" c1 c2 c3; "coordination" phic beta1 d1
        d2 d3; "all" these three. beta2 and g by name only.
    closures : sequence of str
        Each is fitted by itself.
    calibration : str
        As in Material: where constants start, and what those are that are not fitted.
    progress : text stream, optional
        Where a line with the remaining time is written every few seconds.
    **keys
        As in `read_runs`, for files.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        Names every fault of what is asked for, or of the data.
    """
    given = list(runs)
    found = [run for run in given if isinstance(run, Run)]
    faults = repetitions("closure", closures)
    if len(found) < len(given) or not given:
        tables = [run for run in given if not isinstance(run, Run)]
        found += attempt(faults, "", lambda: read_runs(tables, **keys)) or []
    if not closures:
        faults.append("there is no closure: give at least one")
    for closure in closures:
        choose("closure", closure, CLOSURES, faults)
    contacts = list(dict.fromkeys(run.contact for run in found))
    if len(contacts) > 1:
        faults.append(f"runs have {' and '.join(contacts)} contacts: give those of one kind")
    names = {closure: _names(fit, closure, faults) for closure in closures if closure in CLOSURES}
    mus = sorted({run.mu for run in found})
    starts = {(closure, mu): attempt(faults, "", _start, mu, closure, contacts[0], calibration)
              for closure in names for mu in mus if contacts}
    refuse("the law cannot be calibrated", list(dict.fromkeys(faults)))
    show = Progress(progress)
    sets: list[FittedSet] = []
    with noted_signals() as stop:
        for (closure, mu), start in starts.items():
            assert start is not None                             # or there were faults
            of_mu = [run for run in found if run.mu == mu]

            def tell(words: str, share: float, before: int = len(sets), about: str = f"closure {closure}, mu {mu:g}") -> None:
                show(f"{about}, {words}", (before + share) / len(starts))
            sets.append(_Search(of_mu, closure, start, names[closure], tell, stop).run())
        interrupted = stop()
    settings = {"fit": list(fit), "closures": list(closures), "start": calibration}
    return Calibration(contacts[0], sets, settings, interrupted)


def _names(fit: Sequence[str], closure: str, faults: list[str]) -> list[str]:
    """Names of the constants to be fitted, in the order of the core; those of groups as far as the closure has them."""
    every = [name for group in GROUPS.values() for name in group]
    unused = _unused(closure)
    names: set[str] = set()
    for name in [fit] if isinstance(fit, str) else fit:
        if name == ALL or name in GROUPS:
            names |= {*(every if name == ALL else GROUPS[name])} - unused
        elif name in unused:
            faults.append(f"{name}: has no role in the closure {closure!r}")
        elif name in RANGES_OF_FITS:
            names.add(name)
        else:
            choose("to be fitted:", name, (ALL, *GROUPS, *RANGES_OF_FITS), faults)
    if not fit:
        faults.append(f"there is nothing to be fitted: give some of {', '.join((ALL, *GROUPS, *RANGES_OF_FITS))}")
    return [name for name in RANGES if name in names]


def _start(mu: float, closure: str, contact: str, calibration: str) -> Material:
    """The material in which a fit starts, with all of its constants given: no file is read again."""
    definition: dict[str, Any] = {"mu": mu, "closure": closure, "contact": contact}
    try:
        material = Material(**definition, calibration=calibration)
    except ValueError:                                           # a calibration without elastic_strain, for mobilised
        material = Material(**definition, calibration=calibration, elastic_strain=START_OF_ELASTIC_STRAIN)
    return Material(**(definition | {name: material[name] for name in RANGES if name not in _unused(closure)}))


def _unused(closure: str) -> set[str]:
    """Names of numbers of a material that are no constants to be written or fitted."""
    return {*UNUSED[closure], "b3", "mu"}


# ---- one friction coefficient, one closure ---------------------------------------------------------------------------------

class _Stopped(Exception):
    """A signal has come."""


class _Search:
    """The search for the constants of a closure for one friction coefficient."""

    def __init__(self, runs: Sequence[Run], closure: str, start: Material, names: Sequence[str], tell: Callable[[str, float], None],
                 stop: Callable[[], str]) -> None:
        self.runs, self.start = runs, start
        self.first = start                                       # of the search
        if "elastic_strain" in names and not start["elastic_strain"]:
            self.first = Material(**(start.definition | {"elastic_strain": START_OF_ELASTIC_STRAIN}))
        self.sums = Sums([Yardstick.of(run) for run in runs])
        columns = {name for run in runs for name in run.columns}
        held = {name for missing, constants in HELD_WITHOUT.items() if not columns.intersection(missing) for name in constants}
        self.held = [name for name in names if name in held]
        fitted = tuple(name for name in names if name not in held)
        lower, upper, sizes = np.array([RANGES_OF_FITS[name] for name in fitted]).reshape(-1, 3).T
        first = np.array([self.first[name] for name in fitted])
        self.constants = Constants(fitted, first, np.minimum(lower, first), np.maximum(upper, first), sizes)
        self.y = np.zeros(len(fitted))                           # the best so far
        self._tell, self._stop = tell, stop
        self._done, self._expected = 0, (ROUNDS * (len(fitted) + 1) + ROUNDS_LEFT_OUT * 1.5 * len(runs)) * len(runs)
        self._stage = "histories"

    def run(self) -> FittedSet:
        """Search in stages, as far as no signal comes."""
        found, comparison = None, None
        try:
            everything = range(len(self.runs))
            for names, errors in ((OF_CLOSURE, self._stress_errors), (OF_RATES, self._rates_errors)):
                before = self.y
                self.y = self._search_part(names, errors)
                if self._sum(self.y) > self._sum(before):        # far from the whole histories, which may have no way back
                    self.y = before
            if self.constants.names:
                found = fit(lambda y: self._errors(y, everything), self.sums.sample, self.constants, self.y)
                self.y = found.y
            comparison = self._compare(found)
        except _Stopped:
            pass
        return self._result(found, comparison)

    def _result(self, found: Fit | None, comparison: Comparison | None) -> FittedSet:
        names = self.constants.names
        start = {name: self.start[name] for name in RANGES if name not in _unused(self.start.closure)}
        deviations, on_bounds, correlated, unseen = dict.fromkeys(names, np.nan), [], [], []
        if found is not None:
            deviations = dict(zip(names, (np.sqrt(np.diag(found.covariance)) * self.constants.sizes).tolist()))
            on_bounds = [name for name, is_there in zip(names, found.on_bounds) if is_there]
            correlated = found.correlated(names)
            unseen = [dict(zip(names, (direction * self.constants.sizes).tolist())) for direction in found.unseen.T]
        return FittedSet(self.start["mu"], self.start.closure, self.runs, start | self.constants.values(self.y), start, deviations,
                         self.held, on_bounds, correlated, unseen, comparison)

    def _material(self, y: np.ndarray) -> Material | None:
        """The law with constants y (n,); None if there is none."""
        try:
            return Material(**(self.first.definition | self.constants.values(y)))
        except ValueError:
            return None

    def _predict(self, material: Material | None, numbers: Sequence[int]) -> list[Prediction | None]:
        """What the law gives along some of the runs; None where it cannot start. Their steady states are found together."""
        starts: dict[float, np.record] = {}
        if material is not None:
            phis = np.unique([self.runs[number].columns["phi"][0] for number in numbers if self.runs[number].start == "steady"])
            with suppress(ValueError, MaterialError):
                starts = dict(zip(phis.tolist(), material.steady(phis)))
        return [self._predict_one(material, number, starts) for number in numbers]

    def _predict_one(self, material: Material | None, number: int, starts: Mapping[float, np.record]) -> Prediction | None:
        self._done += 1
        self._tell(self._stage, min(self._done / self._expected, 0.99))
        if self._stop():
            raise _Stopped
        run = self.runs[number]
        start = starts.get(run.columns["phi"][0]) if run.start == "steady" else None
        try:
            return None if material is None else predict(run, material, PATH_TOLERANCE, start)
        except (ValueError, MaterialError):
            return None

    def _errors(self, y: np.ndarray, numbers: Sequence[int]) -> np.ndarray:
        """Errors (m,) of the means along some of the runs."""
        found = self._predict(self._material(y), numbers)
        return np.concatenate([self.sums.errors(number, prediction) for number, prediction in zip(numbers, found)])

    def _sum(self, y: np.ndarray) -> float:
        """The sum of robust squares of the errors along all runs."""
        return float(self.sums.sample.weights @ robust(self._errors(y, range(len(self.runs))) ** 2)[0])

    # ---- what the measured microstructure decides by itself

    def _search_part(self, names: Sequence[str], errors: Callable[[Material], np.ndarray]) -> np.ndarray:
        """The y (n,) with constants of some names fitted to errors (m,) of the law for measured states, if there are any."""
        which, size = self.constants.among(names), len(errors(self.first))
        if not which.any() or not size:
            return self.y

        def of_part(part: np.ndarray) -> np.ndarray:
            y = self.y.copy()
            y[which] = part
            material = self._material(y)
            try:
                return np.full(size, UNREACHED) if material is None else errors(material)
            except MaterialError:
                return np.full(size, UNREACHED)
        constants, of_measured = self.constants.part(which), remembered(of_part)
        sample = Sample(np.full(size, 1 / size), np.zeros(size, int))
        y = self.y.copy()
        y[which] = search(of_measured, lambda y: differences(of_measured, y, constants), sample, constants, FIRST_WEIGHT, y[which])
        return y

    def _stress_errors(self, material: Material) -> np.ndarray:
        """Errors of the stress that the law gives for the microstructure of settled rows."""
        errors = [np.zeros(0)]
        for yardstick in self.sums.yardsticks:
            states, known = _measured_states(yardstick.run)
            rows = known & (yardstick.run.since_turn > SETTLED_FRICTION)
            if rows.any():
                states["stress"][rows] = material.evaluate(states[rows])[0]
                difference = yardstick.errors(Prediction(columns_of(states)))[rows][:, OF_STRESS] / self.sums.scatter[OF_STRESS]
                errors.append(difference[np.isfinite(difference)])
        return np.concatenate(errors)

    def _rates_errors(self, material: Material) -> np.ndarray:
        """Errors of Z2 and A_xz that the law gives for rows from those that come before by STRIDE."""
        errors = [np.zeros(0)]
        for yardstick in self.sums.yardsticks:
            run = yardstick.run
            states, known = _measured_states(run)
            total, gamma, phi = (run.columns[name] for name in ("gamma_total", "gamma", "phi"))
            later = np.searchsorted(total, total + STRIDE - ROUNDING)
            rows = np.flatnonzero(known & (later < len(run)))
            rows = rows[known[later[rows]] & (run.since_turn[later[rows]] > run.since_turn[rows] - ROUNDING)]
            if len(rows):
                later = later[rows]
                gradients = np.multiply.outer(gamma[later] - gamma[rows], SHEAR)
                gradients -= np.multiply.outer(np.log(phi[later] / phi[rows]) / 3, np.eye(3))
                states[later] = material.update(states[rows], gradients)
                difference = yardstick.errors(Prediction(columns_of(states)))[later][:, OF_STATE] / self.sums.scatter[OF_STATE]
                errors.append(difference[np.isfinite(difference)])
        return np.concatenate(errors)

    # ---- runs left out

    def _compare(self, found: Fit | None) -> Comparison:
        """Scores of the start, of the fit, and of fits without the run, without all of its phi, without all of its programme."""
        everything = range(len(self.runs))
        predictions = {"start": self._predictions(self.start, everything),
                       "fitted": self._predictions(self._material(self.y), everything)}
        self._stage = "runs left out"
        for words, of_run in {"run left out": lambda run: run.name, "phi left out": lambda run: round(run.columns["phi"][0], 3),
                              "programme left out": programme_of}.items():
            groups = [of_run(run) for run in self.runs]
            if found is None or len(set(groups)) == 1 or (len(set(groups)) == len(groups) and words != "run left out"):
                continue
            of_words: dict[int, Prediction] = {}
            for group in dict.fromkeys(groups):
                left_out = [number for number in everything if groups[number] == group]
                material = self._material(self._without(left_out, found))
                of_words |= dict(zip(left_out, self._predictions(material, left_out)))
            predictions[words] = [of_words[number] for number in everything]
        return Comparison(self.sums.yardsticks, predictions)

    def _without(self, left_out: Sequence[int], found: Fit) -> np.ndarray:
        """The best y without some runs, by the chord method from that of all."""
        others = [number for number in range(len(self.runs)) if number not in left_out]
        rows, sample = self.sums.rows(others), self.sums.sample
        return search(lambda y: self._errors(y, others), lambda y: found.jacobian[rows],
                      Sample(sample.weights[rows], sample.kinds[rows]), self.constants, found.weight, found.y)

    def _predictions(self, material: Material | None, numbers: Sequence[int]) -> list[Prediction]:
        """What the law gives along some of the runs, for scores."""
        return [Prediction(dict.fromkeys((*QUANTITIES, *FABRIC), np.full(len(self.runs[number]), np.nan)), "cannot start")
                if found is None else found for number, found in zip(numbers, self._predict(material, numbers))]


def programme_of(run: Run) -> str:
    """The name of a run's programme: that of the run without mu, phi and amplitudes."""
    return NUMBER.sub("", run.name).strip("_")


def _measured_states(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """States (n,) of a run's rows as measured, without stress, and in which rows (n,) they are known."""
    columns = run.columns
    states = np.zeros(len(run), STATE)
    known = np.zeros(len(run), bool)
    if all(name in columns for name in ("Z2", *FABRIC)):
        states["volume_fraction"], states["coordination_number"] = columns["phi"], columns["Z2"]
        states["fabric"] = tensors.deviator(np.column_stack([columns[name] for name in FABRIC]))
        signs = np.sign(np.diff(columns["gamma"], prepend=np.nan))
        signs[0] = 1.0 if run.start == "steady" else np.nan
        states["direction"] = np.multiply.outer(signs, tensors.symmetric(2 * SHEAR))
        known = np.isfinite(signs) & (signs != 0) & np.isfinite(states["fabric"]).all(axis=1) & np.isfinite(columns["Z2"])
    return states, known
