"""Speed against accuracy: the update and its alternatives over the cases of granumat.cases, measured, charted, tabulated.

Cost is processor time per point and given increment, of one thread, in a batch; SciPy's solvers go point by point, over a few
of the points. Errors are the largest over points and increments' ends, against rate_form.reference: of A over kappa, of Z2, and of
the stress over the point's largest pressure.
"""

import csv
import functools
import itertools
import statistics
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..checks import refuse
from ..core import STATE
from ..errors import MaterialError
from ..material import Material
from . import rate_form
from .cases import CASES
from .colours import BLUE, GREEN, ORANGE, PURPLE, RED

POINTS = 1024
POINTS_BY_SCIPY = 4
ROUNDS = 25                               # of timing, all contenders in turn; the median counts
BUDGET = 0.12                             # seconds in all after which a contender rests
PIECES = tuple(2**k for k in range(7))    # of a given increment
PIECES_BY_NUMPY = tuple(2**k for k in range(12))              # up to the first that errs no more than FINEST or exact
TOLERANCES = tuple(10.0**-k for k in range(2, 13, 2))
TARGETS = (1e-3, 1e-6, 1e-9)              # errors to be reached, in the table
FINEST = 1e-12                            # and at best: the reference is no better
PEERS = {"NumPy": 20, "SciPy": 1000}      # how many times as long they are to take as exact

CUT = {"inside": ("forward-euler", "midpoint", "rk4", "backward-euler"), "before": ("exact", "rk4", "backward-euler")}
NUMPY = "NumPy RK4"
SCIPY = {"DOP853": (*TOLERANCES, 3e-14), "LSODA": TOLERANCES, "Radau": TOLERANCES[:4]}      # and the values of rtol
COLUMNS = ("case", "method", "spin", "pieces", "tolerance", "error_A", "error_Z2", "error_sigma",
           "end_A", "end_Z2", "end_sigma", "ns_per_update", "status")

STYLES = {
    "exact": (RED, "o"), "rk4": (BLUE, "s"), "midpoint": (GREEN, "^"), "forward-euler": (ORANGE, "v"),
    "backward-euler": (PURPLE, "D"), "bogacki-shampine": ("black", "P"), NUMPY: ("0.45", "s"),
    "SciPy DOP853": ("0.55", "o"), "SciPy LSODA": ("0.65", "^"), "SciPy Radau": ("0.75", "D"),
}
BEST, WORST = 1e-16, 10.0                 # errors on the pictures' edges


class Contender(NamedTuple):
    """A method with its setting. `run` gives (path of results (steps, 14, n), "" or why points were refused)."""

    method: str
    spin: str
    pieces: int | None
    tolerance: float | None
    points: slice
    run: object


class Row(NamedTuple):
    """A line of chart.csv."""

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
    def error(self):
        """The worst of the three."""
        return max(self.error_A, self.error_Z2, self.error_sigma)


# ---- contenders ------------------------------------------------------------------------------------------------------

def run_core(material, states, gradients, pieces, path):
    """Fills path (steps, n) of dtype STATE; what was refused, in words."""
    spare = itertools.cycle((np.empty_like(path[0]), np.empty_like(path[0])))
    refused, message = np.zeros(len(states), bool), ""
    for gradient, end in zip(gradients, path):
        for piece in range(pieces):
            out = end if piece == pieces - 1 else next(spare)
            try:
                material.update(states, gradient, out=out)
            except MaterialError as error:
                refused |= error.status != 0
                message = message or str(error).split(": ", 1)[1].split(" (and", 1)[0]
            states = out
    return path, f"refused at {np.count_nonzero(refused)} of {len(refused)} points: {message}" if message else ""


def as_results(path):
    """Results (steps, 14, n) of states (steps, n)."""
    fields = [np.moveaxis(path["fabric"], 2, 1), path["coordination_number"][:, None], path["volume_fraction"][:, None],
              np.moveaxis(path["stress"], 2, 1)]
    return np.concatenate(fields, 1)


def run_numpy(material, y, gradients, substeps):
    return rate_form.runge_kutta(material, y, gradients, substeps), ""


def run_scipy(material, y, gradients, method, rtol):
    """Point by point."""
    path = np.full((len(gradients), 14, y.shape[1]), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")                       # LSODA's, of steps too many
        for i in range(y.shape[1]):
            try:
                path[:, :, i] = rate_form.solve_point(material, y[:, i], gradients[..., i], method, rtol)
            except ArithmeticError as error:
                return path, f"refused at point {i}: {error}"
    return path, ""


def _core_contender(case, path, method, spin, pieces=1, tolerance=None):
    options = {} if tolerance is None else {"method_tolerance": tolerance}
    material = Material(**case.definition, method=method, spin=spin, **options)
    run = functools.partial(run_core, material, case.states, case.gradients / pieces, pieces, path)
    return Contender(method, spin, None if tolerance else pieces, tolerance, slice(None), run)


def contenders(case):
    """All methods with all their settings, for a case."""
    path = np.zeros(case.gradients.shape[:2], STATE)         # all of the core's write it, in turn
    found = [_core_contender(case, path, "exact", "inside", pieces) for pieces in PIECES[:2]]
    found += [_core_contender(case, path, "bogacki-shampine", "inside", tolerance=tolerance) for tolerance in TOLERANCES]
    for spin, methods in CUT.items():
        for method in methods:
            found += [_core_contender(case, path, method, spin, pieces) for pieces in PIECES]

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

def errors(path, exact, kappa):
    """Largest errors over all increments, then after the last one: of A/kappa, Z2, stress; infinite where not finite."""
    pressure = -exact[:, 8:11].mean(1).min(0)
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.abs(path - exact)
        parts = difference[:, :6].max(1) / kappa, difference[:, 6], difference[:, 8:].max(1) / pressure
    parts = [np.where(np.isfinite(part), part, np.inf).max(1) for part in parts]
    return [float(part.max()) for part in parts] + [float(part[-1]) for part in parts]


def _run(runner):
    """Seconds, path, what was refused."""
    start = time.thread_time()
    with np.errstate(all="ignore"):
        path, refused = runner.run()
    return time.thread_time() - start, path, refused


def measure(name, points=POINTS, rounds=ROUNDS):
    """Rows of a case: every contender once for its errors, and in turn up to `rounds` times for its time."""
    case = CASES[name](points)
    material = Material(**case.definition)
    exact = rate_form.reference(material, rate_form.unknowns(material, case.states), rate_form.components_first(case.gradients))
    rows, runners, times = [], [], []
    for runner in contenders(case):
        if runner.method == NUMPY and best([row for row in rows if row.method == NUMPY], finest(rows)):
            continue                                          # more pieces would only take longer
        seconds, path, refused = _run(runner)
        path = as_results(path) if path.dtype == STATE else path
        worst = errors(path, exact[..., runner.points], material["kappa"])
        status = refused or ("ok" if np.isfinite(worst).all() else "not finite")
        rows.append(Row(name, *runner[:4], *([np.inf] * 6 if refused else worst), seconds, status))
        runners.append(runner)
        times.append([seconds])
    for _, (runner, seconds) in itertools.product(range(rounds - 1), zip(runners, times)):
        if sum(seconds) <= BUDGET:
            seconds.append(_run(runner)[0])
    updates = [len(exact) * len(range(points)[runner.points]) for runner in runners]
    return [row._replace(ns_per_update=statistics.median(seconds) / n * 1e9) for row, seconds, n in zip(rows, times, updates)]


# ---- what it says ----------------------------------------------------------------------------------------------------

def exact_row(rows):
    """The exact update of whole increments."""
    return next(row for row in rows if (row.method, row.spin, row.pieces) == ("exact", "inside", 1))


def best(rows, target):
    """The fastest row with no larger error, or None."""
    return min((row for row in rows if row.error <= target), key=lambda row: row.ns_per_update, default=None)


def finest(rows):
    """The error of exact, or FINEST where that is smaller."""
    return max(FINEST, exact_row(rows).error)


def ahead(rows):
    """The most accurate rival that is faster than exact, or None: to any smaller error exact is the fastest way.

    With the smaller error of the two it is ahead in both, and exact not on the front of the chart.
    """
    exact = exact_row(rows)
    faster = [row for row in rows if (row.method, row.spin) != ("exact", "inside") and row.ns_per_update < exact.ns_per_update]
    return min(faster, key=lambda row: row.error, default=None)


def named(row):
    """Method and setting of a row, in words."""
    setting = f"tolerance {row.tolerance:.0e}" if row.tolerance else f"{row.pieces} piece{'s' if row.pieces > 1 else ''}"
    return f"{row.method}{', spin before' if row.spin == 'before' else ''}, {setting}"


def _cost(row):
    """Time and error of a row, in words."""
    return f"{row.ns_per_update:,.0f} ns, {row.error:.0e}"


def _ratio(exact, row):
    """Time of a row, or None, over exact's, in words."""
    if row is None:
        return "none"
    ratio = row.ns_per_update / exact.ns_per_update
    return f"{ratio:.{0 if ratio >= 10 else 1 if ratio >= 2 else 2}f}"


def _fastest(cases):
    """Markdown: exact, then for every target its fastest competitor."""
    lines = ["| case | exact | " + " | ".join(f"error below {target:.0e}" for target in TARGETS) + " |",
             "|---" * (2 + len(TARGETS)) + "|"]
    for name, rows in cases.items():
        exact = exact_row(rows)
        found = [best([row for row in rows if row.method != "exact"], target) for target in TARGETS]
        cells = [f"{named(row)} ({_cost(row)}): {_ratio(exact, row)}" if row else "none" for row in found]
        lines.append(f"| {name} | {_cost(exact)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def peers(cases):
    """Markdown: the fastest of NumPy and of SciPy for every target, over exact."""
    lines = ["| case | " + " | ".join(f"{peer}, {target:.0e}" for peer in ("NumPy", "SciPy") for target in TARGETS) + " |",
             "|---" * (1 + 2 * len(TARGETS)) + "|"]
    for name, rows in cases.items():
        cells = [_ratio(exact_row(rows), best([row for row in rows if row.method.startswith(peer)], target))
                 for peer in ("NumPy", "SciPy") for target in TARGETS]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def front(cases):
    """In words: where something is ahead of exact, by both time and error, or at an error that matters."""
    faster, both = [], []
    for name, rows in cases.items():
        row, exact = ahead(rows), exact_row(rows)
        if row and row.error < TARGETS[0]:
            said = f"{name}: {named(row)} ({_cost(row)}; exact {_cost(exact)})"
            faster.append(said)
            both += [said] if row.error < exact.error else []
    return f"""Both faster and more accurate than exact, in {len(both)} of {len(cases)} cases: {"; ".join(both) or "nothing"}

Faster at an error below {TARGETS[0]:.0e}, in {len(faster)} of {len(cases)} cases (of each the most accurate):
{"; ".join(faster) or "nothing"}"""


def equal_error(cases):
    """Markdown: over cases, how many times as long as exact the peers take to an error; what they cannot reach is infinite."""
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


def summary(cases):
    """What the rows of all cases say, in Markdown."""
    return f"""The fastest competitor to reach an error (time per point and increment, its error): its time over exact's

{_fastest(cases)}

The fastest of NumPy in the batch, and of SciPy point by point, to reach an error: time over exact's

{peers(cases)}

The same over all cases; "of exact": exact's own error, at least {FINEST:.0e}

{equal_error(cases)}

{front(cases)}"""


# ---- pictures --------------------------------------------------------------------------------------------------------

def _draw(axes, rows, size):
    """Error against cost, a line for each method and spin; what was refused or is beyond WORST is a cross on the upper edge."""
    for (method, spin), group in itertools.groupby(rows, lambda row: (row.method, row.spin)):
        group = list(group)
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


def _legend(figure, **options):
    handles = [Line2D([], [], color=colour, marker=marker, markersize=5, label=method)
               for method, (colour, marker) in STYLES.items()]
    handles += [Line2D([], [], color="black", linestyle="--", marker="o", markerfacecolor="white", label='spin="before"'),
                Line2D([], [], color="black", linestyle="none", marker="x", label="refused, not finite or above 10"),
                Line2D([], [], color=RED, linestyle="none", marker="*", markersize=11, label="exact, increments whole")]
    figure.legend(handles=handles, fontsize=8, frameon=False, **options)


X_LABEL, Y_LABEL = "processor time per point and increment, ns", r"largest error of $A/\kappa$, $Z_2$, $\sigma/p$ over the path"


def case_figure(name, rows):
    """The picture of one case."""
    figure = Figure(figsize=(9, 5.2))
    figure.set_layout_engine("constrained", rect=(0, 0, 0.74, 1))
    axes = figure.add_subplot(xlabel=X_LABEL, ylabel=Y_LABEL)
    axes.set_title(f"{name}: {CASES[name](1).title}", fontsize=10, pad=10)
    _draw(axes, rows, 5)
    _legend(figure, loc="center left", bbox_to_anchor=(0.74, 0.5))
    return figure


def overview(cases):
    """All cases, small."""
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

def write_csv(path, rows):
    """COLUMNS, a line a row; a setting that a method does not have is empty."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow(f"{value:.4g}" if isinstance(value, float) else value for value in row)


def draw_chart(out, names=None, progress=print):
    """Measures cases; writes chart.csv, <case>.png, and chart.png with all of them.

    Parameters
    ----------
    out : path
        Directory; made if need be.
    names : iterable of str, optional
        Keys of CASES; the default is all.
    progress : function of str
        Told of every file.

    Returns
    -------
    dict of str to list of Row
        Of every case.

    Raises
    ------
    ValueError
        Names every case that does not exist.
    """
    names, out = names or list(CASES), Path(out)
    refuse("the chart cannot be drawn", [f"case {name!r}: must be one of {', '.join(CASES)}"
                                         for name in names if name not in CASES])
    out.mkdir(parents=True, exist_ok=True)
    cases = {}
    for name in names:
        cases[name] = measure(name)
        case_figure(name, cases[name]).savefig(out / f"{name}.png", dpi=110)
        progress(f"wrote {out / f'{name}.png'}")
    write_csv(out / "chart.csv", itertools.chain(*cases.values()))
    overview(cases).savefig(out / "chart.png", dpi=110)
    progress(f"wrote {out / 'chart.csv'}\nwrote {out / 'chart.png'}")
    return cases
