"""Speed against accuracy of the update and its alternatives, over the cases of `cases`: measurements, figures and tables.

Cost is the processor time of one thread per point and given increment, in a batch; SciPy's solvers follow a few of the points, one
after the other. Errors are the largest over all points and the ends of all increments, against `rate_form.reference`: of A over
kappa, of Z2, and of the stress over the point's largest pressure.
"""

import csv
import functools
import itertools
import statistics
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..checks import refuse
from ..core import STATE
from ..errors import MaterialError
from ..material import Material
from . import rate_form
from .cases import CASES, Case
from .colours import BLUE, GREEN, ORANGE, PURPLE, RED

POINTS = 1024
POINTS_BY_SCIPY = 4
ROUNDS = 25                               # in each of which all contenders are timed; the median counts
BUDGET = 0.12                             # seconds in all after which a contender is timed no more
PIECES = tuple(2**k for k in range(7))    # into which a given increment is divided
PIECES_BY_NUMPY = tuple(2**k for k in range(12))              # up to the first with no larger error than FINEST or exact
TOLERANCES = tuple(10.0**-k for k in range(2, 13, 2))
TARGETS = (1e-3, 1e-6, 1e-9)              # errors to be reached, in the tables
FINEST = 1e-12                            # smallest error that is told apart: the reference is no better
PEERS = {"NumPy": 20, "SciPy": 1000}      # aims: how many times as long as exact they take

# Methods of the core whose increments are divided into pieces, by their treatment of the spin.
DIVIDED = {"inside": ("forward-euler", "midpoint", "rk4", "backward-euler"), "before": ("exact", "rk4", "backward-euler")}
NUMPY = "NumPy RK4"
SCIPY = {"DOP853": (*TOLERANCES, 3e-14), "LSODA": TOLERANCES, "Radau": TOLERANCES[:4]}      # solvers and values of rtol
COLUMNS = ("case", "method", "spin", "pieces", "tolerance", "error_A", "error_Z2", "error_sigma",
           "end_A", "end_Z2", "end_sigma", "ns_per_update", "status")

STYLES = {
    "exact": (RED, "o"), "rk4": (BLUE, "s"), "midpoint": (GREEN, "^"), "forward-euler": (ORANGE, "v"),
    "backward-euler": (PURPLE, "D"), "bogacki-shampine": ("black", "P"), NUMPY: ("0.45", "s"),
    "SciPy DOP853": ("0.55", "o"), "SciPy LSODA": ("0.65", "^"), "SciPy Radau": ("0.75", "D"),
}
BEST, WORST = 1e-16, 10.0                 # errors at the lower and upper edges of the figures


Trajectory = tuple[np.ndarray, str]     # results (steps, 14, n), or states (steps, n); "", or why points were refused


class Contender(NamedTuple):
    """A method with its setting."""

    method: str
    spin: str
    pieces: int | None
    tolerance: float | None
    points: slice                       # of the case's points that it follows
    run: Callable[[], Trajectory]


class Row(NamedTuple):
    """A line of chart.csv: a contender's setting, its largest errors over the trajectory and at its end, and its cost."""

    case: str
    method: str
    spin: str
    pieces: int | None
    tolerance: float | None
    error_A: float
    error_Z2: float
    error_sigma: float
    end_A: float
    end_Z2: float
    end_sigma: float
    ns_per_update: float
    status: str

    @property
    def error(self) -> float:
        """The largest of the three errors over the trajectory."""
        return max(self.error_A, self.error_Z2, self.error_sigma)


# ---- contenders ------------------------------------------------------------------------------------------------------

def run_core(material: Material, states: np.ndarray, gradients: np.ndarray, pieces: int, trajectory: np.ndarray) -> Trajectory:
    """Follow a case by the core.

    Parameters
    ----------
    material : Material
        With the method.
    states : array (n,) of dtype STATE
        At the start.
    gradients : array (steps, n, 3, 3)
        Displacement gradient of a piece of each increment.
    pieces : int
        Of each increment.
    trajectory : array (steps, n) of dtype STATE
        Receives the states after each increment.

    Returns
    -------
    trajectory : the same array
    refused : str
        "", or at how many points the core returned an error, and the first of the errors.
    """
    spare = itertools.cycle((np.empty_like(trajectory[0]), np.empty_like(trajectory[0])))
    refused, message = np.zeros(len(states), bool), ""
    for gradient, end in zip(gradients, trajectory):
        for piece in range(pieces):
            out = end if piece == pieces - 1 else next(spare)
            try:
                material.update(states, gradient, out=out)
            except MaterialError as error:
                refused |= error.status != 0
                message = message or str(error).split(": ", 1)[1].split(" (and", 1)[0]
            states = out
    return trajectory, f"refused at {np.count_nonzero(refused)} of {len(refused)} points: {message}" if message else ""


def as_results(trajectory: np.ndarray) -> np.ndarray:
    """Results (steps, 14, n), as rate_form.result has them, of states (steps, n)."""
    fields = [np.moveaxis(trajectory["fabric"], 2, 1), trajectory["coordination_number"][:, None],
              trajectory["volume_fraction"][:, None], np.moveaxis(trajectory["stress"], 2, 1)]
    return np.concatenate(fields, 1)


def run_numpy(material: Material, y: np.ndarray, gradients: np.ndarray, substeps: int) -> Trajectory:
    """Follow a case by rate_form.runge_kutta."""
    return rate_form.runge_kutta(material, y, gradients, substeps), ""


def run_scipy(material: Material, y: np.ndarray, gradients: np.ndarray, method: str, rtol: float) -> Trajectory:
    """Follow the points y (m, n) of a case one after the other by rate_form.solve_point, until SciPy gives up at one."""
    trajectory = np.full((len(gradients), 14, y.shape[1]), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")                       # by which LSODA says that it takes too many steps
        for i in range(y.shape[1]):
            try:
                trajectory[:, :, i] = rate_form.solve_point(material, y[:, i], gradients[..., i], method, rtol)
            except ArithmeticError as error:
                return trajectory, f"refused at point {i}: {error}"
    return trajectory, ""


def _core_contender(case: Case, trajectory: np.ndarray, method: str, spin: str, pieces: int = 1,
                    tolerance: float | None = None) -> Contender:
    options: dict[str, Any] = {} if tolerance is None else {"method_tolerance": tolerance}
    material = Material(**case.definition, method=method, spin=spin, **options)
    run = functools.partial(run_core, material, case.states, case.gradients / pieces, pieces, trajectory)
    return Contender(method, spin, None if tolerance else pieces, tolerance, slice(None), run)


def contenders(case: Case) -> list[Contender]:
    """All methods with all their settings, for a case."""
    trajectory = np.zeros(case.gradients.shape[:2], STATE)    # shared: each contender of the core overwrites it
    found = [_core_contender(case, trajectory, "exact", "inside", pieces) for pieces in PIECES[:2]]
    found += [_core_contender(case, trajectory, "bogacki-shampine", "inside", tolerance=tolerance) for tolerance in TOLERANCES]
    for spin, methods in DIVIDED.items():
        for method in methods:
            found += [_core_contender(case, trajectory, method, spin, pieces) for pieces in PIECES]

    material, gradients = Material(**case.definition), rate_form.components_first(case.gradients)
    y, few = rate_form.unknowns(material, case.states), slice(None, None, max(1, len(case.states) // POINTS_BY_SCIPY))
    for pieces in PIECES_BY_NUMPY:
        found.append(Contender(NUMPY, "inside", pieces, None, slice(None),
                               functools.partial(run_numpy, material, y, gradients, pieces)))
    for method, tolerances in SCIPY.items():
        found += [Contender(f"SciPy {method}", "inside", None, rtol, few,
                            functools.partial(run_scipy, material, y[:, few], gradients[..., few], method, rtol))
                  for rtol in tolerances]
    return found


# ---- measurement -----------------------------------------------------------------------------------------------------

def errors(trajectory: np.ndarray, exact: np.ndarray, kappa: float) -> list[float]:
    """Largest errors of a trajectory.

    Parameters
    ----------
    trajectory, exact : array (steps, 14, n)
        Results.
    kappa : float
        Magnitude of the steady fabric (A 7)-(A 9), by which errors of A are divided.

    Returns
    -------
    list of 6 floats
        Of A/kappa, Z2 and the stress over the point's largest pressure, over all increments; then the same three after the last
        increment. Infinite where a result is not finite.
    """
    pressure = -exact[:, 8:11].mean(1).min(0)
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.abs(trajectory - exact)
        parts = [difference[:, :6].max(1) / kappa, difference[:, 6], difference[:, 8:].max(1) / pressure]
    parts = [np.where(np.isfinite(part), part, np.inf).max(1) for part in parts]
    return [float(part.max()) for part in parts] + [float(part[-1]) for part in parts]


def _run(contender: Contender) -> tuple[float, np.ndarray, str]:
    """Seconds, trajectory, and what was refused."""
    start = time.thread_time()
    with np.errstate(all="ignore"):
        trajectory, refused = contender.run()
    return time.thread_time() - start, trajectory, refused


def measure(name: str, points: int = POINTS, rounds: int = ROUNDS) -> list[Row]:
    """Measure all contenders in a case.

    Parameters
    ----------
    name : str
        Of CASES.
    points : int
        Of the batch.
    rounds : int
        Every contender is run once for its errors, and at most so many times, each time all contenders, for its time.

    Returns
    -------
    list of Row
    """
    case = CASES[name](points)
    material = Material(**case.definition)
    exact = rate_form.reference(material, rate_form.unknowns(material, case.states), rate_form.components_first(case.gradients))
    rows: list[Row] = []
    runners: list[Contender] = []
    times: list[list[float]] = []
    for runner in contenders(case):
        if runner.method == NUMPY and best([row for row in rows if row.method == NUMPY], finest(rows)):
            continue                                          # the goal is reached: more pieces would only take longer
        seconds, trajectory, refused = _run(runner)
        trajectory = as_results(trajectory) if trajectory.dtype == STATE else trajectory
        found = errors(trajectory, exact[..., runner.points], material["kappa"])
        status = refused or ("ok" if np.isfinite(found).all() else "not finite")
        error_A, error_Z2, error_sigma, *ends = [np.inf] * 6 if refused else found
        rows.append(Row(name, runner.method, runner.spin, runner.pieces, runner.tolerance, error_A, error_Z2, error_sigma,
                        ends[0], ends[1], ends[2], seconds, status))
        runners.append(runner)
        times.append([seconds])
    for _, (runner, spent) in itertools.product(range(rounds - 1), zip(runners, times)):
        if sum(spent) <= BUDGET:
            spent.append(_run(runner)[0])
    updates = [len(exact) * len(range(points)[runner.points]) for runner in runners]
    return [row._replace(ns_per_update=statistics.median(spent) / n * 1e9) for row, spent, n in zip(rows, times, updates)]


# ---- tables ---------------------------------------------------------------------------------------------------------

def exact_row(rows: Iterable[Row]) -> Row:
    """The row of the exact update of whole increments."""
    return next(row for row in rows if (row.method, row.spin, row.pieces) == ("exact", "inside", 1))


def best(rows: Iterable[Row], target: float) -> Row | None:
    """The fastest row with an error of at most the target; None if there is none."""
    return min((row for row in rows if row.error <= target), key=lambda row: row.ns_per_update, default=None)


def finest(rows: Iterable[Row]) -> float:
    """The error of exact, but at least FINEST."""
    return max(FINEST, exact_row(rows).error)


def ahead(rows: Sequence[Row]) -> Row | None:
    """The most accurate method that is faster than exact; None if there is none.

    For any smaller error than this method's, exact is the fastest. If its error is smaller than exact's, exact is not on the front
    of the chart, where nothing else is both faster and more accurate.
    """
    exact = exact_row(rows)
    faster = [row for row in rows if (row.method, row.spin) != ("exact", "inside") and row.ns_per_update < exact.ns_per_update]
    return min(faster, key=lambda row: row.error, default=None)


def named(row: Row) -> str:
    """Method and setting of a row, in words."""
    setting = f"tolerance {row.tolerance:.0e}" if row.tolerance else f"{row.pieces} piece{'' if row.pieces == 1 else 's'}"
    return f"{row.method}{', spin before' if row.spin == 'before' else ''}, {setting}"


def _cost(row: Row) -> str:
    """Time and error of a row, in words."""
    return f"{row.ns_per_update:,.0f} ns, {row.error:.0e}"


def _ratio(exact: Row, row: Row | None) -> str:
    """Time of a row over exact's, in words."""
    if row is None:
        return "none"
    ratio = row.ns_per_update / exact.ns_per_update
    return f"{ratio:.{0 if ratio >= 10 else 1 if ratio >= 2 else 2}f}"


Cases = Mapping[str, Sequence[Row]]


def _fastest(cases: Cases) -> str:
    """Markdown: cost of exact, and the fastest of the others for every target."""
    lines = ["| case | exact | " + " | ".join(f"error below {target:.0e}" for target in TARGETS) + " |",
             "|---" * (2 + len(TARGETS)) + "|"]
    for name, rows in cases.items():
        exact = exact_row(rows)
        found = [best([row for row in rows if row.method != "exact"], target) for target in TARGETS]
        cells = [f"{named(row)} ({_cost(row)}): {_ratio(exact, row)}" if row else "none" for row in found]
        lines.append(f"| {name} | {_cost(exact)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def peers(cases: Cases) -> str:
    """Markdown: time of the fastest of NumPy and of SciPy over exact's, for every target."""
    lines = ["| case | " + " | ".join(f"{peer}, {target:.0e}" for peer in ("NumPy", "SciPy") for target in TARGETS) + " |",
             "|---" * (1 + 2 * len(TARGETS)) + "|"]
    for name, rows in cases.items():
        cells = [_ratio(exact_row(rows), best([row for row in rows if row.method.startswith(peer)], target))
                 for peer in ("NumPy", "SciPy") for target in TARGETS]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def front(cases: Cases) -> str:
    """In words: the cases in which a method is both faster and more accurate than exact, or faster at an error below TARGETS[0]."""
    faster: list[str] = []
    both: list[str] = []
    for name, rows in cases.items():
        row, exact = ahead(rows), exact_row(rows)
        if row and row.error < TARGETS[0]:
            said = f"{name}: {named(row)} ({_cost(row)}; exact {_cost(exact)})"
            faster.append(said)
            both += [said] if row.error < exact.error else []
    return f"""Both faster and more accurate than exact, in {len(both)} of {len(cases)} cases: {"; ".join(both) or "nothing"}

Faster at an error below {TARGETS[0]:.0e}, in {len(faster)} of {len(cases)} cases (of each the most accurate):
{"; ".join(faster) or "nothing"}"""


def equal_error(cases: Cases) -> str:
    """Markdown: times of NumPy and SciPy over exact's at equal error, over all cases; infinite where the error is not reached."""
    lines = ["| | error | least | median | not reached | below the aim |", "|---" * 6 + "|"]
    for peer, aim in PEERS.items():
        for target in (*TARGETS[1:], None):
            ratios = {}
            for name, rows in cases.items():
                row = best([row for row in rows if row.method.startswith(peer)], target or finest(rows))
                ratios[name] = row.ns_per_update / exact_row(rows).ns_per_update if row else np.inf
            values = list(ratios.values())
            below = [f"{name} {ratio:.3g}" for name, ratio in sorted(ratios.items(), key=lambda item: item[1]) if ratio < aim]
            cells = [f"{peer}, aim {aim}", f"{target:.0e}" if target else "of exact", f"{min(values):.3g}",
                     f"{statistics.median(values):.3g}", f"{values.count(np.inf)} of {len(values)}", ", ".join(below) or "none"]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def summary(cases: Cases) -> str:
    """All tables, in Markdown."""
    return f"""The fastest competitor to reach an error (time per point and increment, its error): its time over exact's

{_fastest(cases)}

The fastest of NumPy in the batch, and of SciPy point by point, to reach an error: time over exact's

{peers(cases)}

The same over all cases; "of exact": exact's own error, at least {FINEST:.0e}

{equal_error(cases)}

{front(cases)}"""


# ---- figures ---------------------------------------------------------------------------------------------------------

def _draw(axes: Axes, rows: Sequence[Row], size: float) -> None:
    """Error against cost, a line for each method and spin; refused contenders and errors beyond WORST are crosses at the top."""
    for (method, spin), rows_of_method in itertools.groupby(rows, lambda row: (row.method, row.spin)):
        group = list(rows_of_method)
        colour, marker = STYLES[method]
        before = spin == "before"
        inside = [row for row in group if row.error <= WORST]
        axes.plot([row.ns_per_update for row in inside], [max(row.error, BEST) for row in inside], color=colour,
                  marker=marker, markersize=size, linewidth=size / 4, linestyle="--" if before else "-",
                  markerfacecolor="white" if before else colour, zorder=3 if method == "exact" else 2)
        beyond = [row.ns_per_update for row in group if row.error > WORST]
        if beyond:
            axes.plot(beyond, [WORST] * len(beyond), color=colour, marker="x", markersize=1.5 * size, linestyle="none",
                      clip_on=False, zorder=4)
    star = exact_row(rows)
    axes.plot(star.ns_per_update, max(star.error, BEST), marker="*", markersize=4 * size, color=RED, zorder=5)
    axes.set(xscale="log", yscale="log", ylim=(BEST, WORST))
    axes.grid(linewidth=0.3)
    axes.tick_params(labelsize=8)


def _legend(figure: Figure, **options: Any) -> None:
    handles = [Line2D([], [], color=colour, marker=marker, markersize=5, label=method)
               for method, (colour, marker) in STYLES.items()]
    handles += [Line2D([], [], color="black", linestyle="--", marker="o", markerfacecolor="white", label='spin="before"'),
                Line2D([], [], color="black", linestyle="none", marker="x", label="refused, not finite or above 10"),
                Line2D([], [], color=RED, linestyle="none", marker="*", markersize=11, label="exact, increments whole")]
    figure.legend(handles=handles, fontsize=8, frameon=False, **options)


X_LABEL, Y_LABEL = "processor time per point and increment, ns", r"largest error of $A/\kappa$, $Z_2$, $\sigma/p$ over the path"


def case_figure(name: str, rows: Sequence[Row]) -> Figure:
    """The figure of one case."""
    figure = Figure(figsize=(9, 5.2))
    figure.set_layout_engine("constrained", rect=(0, 0, 0.74, 1))
    axes = figure.add_subplot(xlabel=X_LABEL, ylabel=Y_LABEL)
    axes.set_title(f"{name}: {CASES[name](1).title}", fontsize=10, pad=10)
    _draw(axes, rows, 5)
    _legend(figure, loc="center left", bbox_to_anchor=(0.74, 0.5))
    return figure


def overview(cases: Cases) -> Figure:
    """One figure with a small panel for each case."""
    columns = min(4, len(cases))
    lines = -(-len(cases) // columns)
    height = 2.7 * lines + 1
    figure = Figure(figsize=(max(3.1 * columns, 6) + 0.4, height))
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - 0.7 / height))
    for i, (name, rows) in enumerate(cases.items()):
        axes = figure.add_subplot(lines, columns, i + 1)
        axes.set_title(name, fontsize=9, pad=7)
        _draw(axes, rows, 2.5)
    figure.supxlabel(X_LABEL, fontsize=10)
    figure.supylabel(Y_LABEL, fontsize=10)
    _legend(figure, loc="upper center", ncol=5)
    return figure


# ---- the command -----------------------------------------------------------------------------------------------------

def write_csv(filename: Path, rows: Iterable[Row]) -> None:
    """Write rows under COLUMNS; a setting that a method does not have is empty."""
    with filename.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow(f"{value:.4g}" if isinstance(value, float) else value for value in row)


def draw_chart(out: str | Path, names: Iterable[str] | None = None,
               progress: TextIO | None = None) -> dict[str, list[Row]]:
    """Measure cases; write chart.csv, <case>.png, and chart.png with all of them.

    Parameters
    ----------
    out : path
        Directory; it is created if it does not exist.
    names : iterable of str, optional
        Keys of CASES; the default is all.
    progress : text stream, optional
        Receives a line for every file that was written.

    Returns
    -------
    dict of str to list of Row
        Of every case.

    Raises
    ------
    ValueError
        Names every case that does not exist.
    ImportError
        If there is no SciPy, before anything is measured.
    """
    names, out = list(names or CASES), Path(out)
    refuse("the chart cannot be drawn", [f"case {name!r}: must be one of {', '.join(CASES)}"
                                         for name in names if name not in CASES])
    rate_form.scipys_solver()
    out.mkdir(parents=True, exist_ok=True)
    cases = {}
    for name in names:
        cases[name] = measure(name)
        case_figure(name, cases[name]).savefig(out / f"{name}.png", dpi=110)
        if progress is not None:
            print(f"wrote {out / f'{name}.png'}", file=progress, flush=True)
    write_csv(out / "chart.csv", itertools.chain(*cases.values()))
    overview(cases).savefig(out / "chart.png", dpi=110)
    if progress is not None:
        print(f"wrote {out / 'chart.csv'}\nwrote {out / 'chart.png'}", file=progress)
    return cases
