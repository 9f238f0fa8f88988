"""What a climb of a ladder leaves: ladder.txt, ladder.csv, ladder.png and recommended.toml."""

import csv
import io
import os
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .choice import LEAST_SAVING, Finding, Report, Study, predicted
from .coarsen import DIMENSION, MODEL, relocated
from .estimate import TINY
from .files import replacing
from .toml import write_content

WIDTH = 132
RECOMMENDED, FAILS, SAME = "recommended", "not good enough", "would do, costs the same"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "0.25")


def write_report(report: Report, file: Path, out: Path) -> None:
    """Write all files of a climb; each replaces an old one at once."""
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / "ladder.txt") as text:
        text.write_text(in_words(report, file), encoding="utf-8")
    with replacing(out / "ladder.csv") as table:
        table.write_text(as_csv(report), encoding="utf-8")
    with replacing(out / "ladder.png") as picture:
        draw(report, file.stem).savefig(picture, dpi=130, format="png")
    content = relocated(report.content, lambda name: os.path.relpath(file.parent / name, out))
    write_content(out / "recommended.toml", content, comments(report, file))


def comments(report: Report, file: Path) -> list[str]:
    """The first lines of recommended.toml."""
    lines = [f"{file.name}, as coarse as its quantities allow. Measured against the finest model that was run, not against grains:"]
    for number, quantity in enumerate(report.quantities):
        lines.append(f"  {quantity.name}: error {report.measured[number]:.2%} (tolerance {report.tolerances[number]:.2%}, "
                     f"the finest model's own error at most {report.of_top[number]:.2%})")
    lines += [f"The error of the {' and the '.join(report.unknown)}, which is the file's own, is NOT known: see ladder.txt."
              ] if report.unknown else []
    return lines + ([] if report.is_within else ["NOT within the tolerances: see ladder.txt."])


# ---- rows ---------------------------------------------------------------------------------------------------------------

def time_over_file(report: Report, study: Study, finding: Finding) -> float:
    """Time of the recommendation with another rung of an axis over the file's; over the top's where the file was not run."""
    assert report.recommended is not None and report.top is not None
    reference = report.file if report.file is not None and not report.file.failure else report.top
    ratio = finding.time / max(report.choice[study.axis.name].time, TINY)
    return report.recommended.seconds * ratio / max(reference.seconds, TINY)


def errors_with(report: Report, study: Study, finding: Finding) -> np.ndarray:
    """Predicted errors of the recommendation with another rung of an axis."""
    return predicted({**report.choice, study.axis.name: finding})


def state(report: Report, study: Study, finding: Finding) -> str:
    """What becomes of a rung."""
    chosen = report.choice[study.axis.name]
    if finding is chosen:
        return RECOMMENDED
    if not finding.is_known or (study.verdict and study.axis.kind != DIMENSION):
        return "cannot be recommended"
    if (errors_with(report, study, finding) > report.tolerances).any():
        return FAILS
    if finding.time > (1 + LEAST_SAVING) * chosen.time:
        return "more than needed"
    return SAME if finding.time > (1 - LEAST_SAVING) * chosen.time else "predicted to do"


def why(report: Report, study: Study, finding: Finding) -> str:
    """Why a rung is not good enough."""
    if state(report, study, finding) != FAILS:
        return ""
    if finding.reason:
        return finding.reason
    words = "too coarse" if study.axis.is_sequence else "its error is too large"
    return words if (finding.errors > report.tolerances).any() else f"{words} together with the other errors"


def rows(report: Report) -> list[tuple[Study, Finding]]:
    """All rungs, axis by axis."""
    return [(study, finding) for study in report.studies for finding in study.findings]


def as_csv(report: Report) -> str:
    """The table of rungs: errors of each alone, of the recommendation with it, and its time over the file's."""
    names = [quantity.name for quantity in report.quantities]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["axis", "rung", "state", "time_over_file", *(f"error_{name}" for name in names),
                     *(f"sum_{name}" for name in names), "why"])
    for study, finding in rows(report):
        errors = [f"{error:.4g}" if finding.is_known else "" for error in finding.errors]
        sums = [f"{error:.4g}" for error in errors_with(report, study, finding)]
        writer.writerow([study.axis.name, finding.rung.name, state(report, study, finding),
                         f"{time_over_file(report, study, finding):.4g}", *errors, *sums, why(report, study, finding)])
    for study in report.constants:
        for finding in study.findings[1:]:
            errors = [f"{error:.4g}" for error in finding.errors]
            writer.writerow([study.axis.name, finding.rung.name, "constant", "", *errors, *("" for _ in names), finding.reason])
    return stream.getvalue()


# ---- words --------------------------------------------------------------------------------------------------------------

def in_words(report: Report, file: Path) -> str:
    """All that a user is told."""
    names = [quantity.name for quantity in report.quantities]
    head = ["axis", "rung", "time/file" if report.file is not None else "time/top", *names, ""]
    lines = [[study.axis.name if finding is study.findings[0] else "", finding.rung.name,
              f"{time_over_file(report, study, finding):.3g}", *(_percent(finding, number) for number in range(len(names))),
              ": ".join(filter(None, (state(report, study, finding), why(report, study, finding).split(":")[0])))]
             for study, finding in rows(report)]
    text = [f"{file.name}: errors of each rung alone, and the time of the recommendation with it over the file's", "",
            *_aligned([head, *lines]), ""]
    for paragraphs in (_results, _next_ones, _verdicts, _floor, _alone, _limits):
        for paragraph in paragraphs(report):
            text += textwrap.wrap(paragraph, WIDTH)
    return "\n".join(text) + "\n"


def _percent(finding: Finding, number: int) -> str:
    error = finding.errors[number]
    return "?" if not finding.is_known else "none" if not np.isfinite(error) else f"{error:.2%}"


def _aligned(table: list[list[str]]) -> list[str]:
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    return ["  ".join(cell.ljust(width) if column < 2 or column == len(row) - 1 else cell.rjust(width)
                      for column, (cell, width) in enumerate(zip(row, widths))).rstrip() for row in table]


def _each(report: Report, values: np.ndarray) -> str:
    return ", ".join(f"{quantity.name} {value:.2%}" if np.isfinite(value) else f"{quantity.name} without a value"
                     for quantity, value in zip(report.quantities, values))


def _results(report: Report) -> list[str]:
    assert report.recommended is not None and report.top is not None
    words = "; ".join(f"{name} {finding.rung.name}" for name, finding in report.choice.items())
    found = [f"Recommended: {words}.",
             f"Its error, measured against the top of all axes: {_each(report, report.measured)}.",
             f"Predicted: {_each(report, report.predicted)}. Of this the top itself may be off by {_each(report, report.of_top)}."]
    if report.unknown:
        found.append(f"NONE OF THESE HAS THE ERROR OF THE {' AND THE '.join(report.unknown).upper()}, which is the file's own: "
                     "that error is not known (below).")
    if not report.is_within:
        found.append("THE TOLERANCE IS NOT PROVED: no rung, not even the top, is known to be within it.")
    if report.recommended.failure:
        found.append(f"The recommended model cannot be run to its end: {report.recommended.failure.splitlines()[0]}")
    if report.file is not None and report.file.failure:
        found.append(f"The file itself cannot be run to its end: {report.file.failure.splitlines()[0]}")
    elif report.file is not None:
        of_file, of_recommended = report.file.seconds, max(report.recommended.seconds, TINY)
        found.append(f"The file itself is off by {_each(report, report.of_file)}. It takes {of_file / of_recommended:.3g} times "
                     f"the recommendation's time ({of_file:.3g} s against {of_recommended:.3g} s).")
        found.append(f"The ladder took {report.runs} runs, and the time of {report.seconds / of_file:.3g} runs of the file or "
                     f"{report.seconds / of_recommended:.3g} of the recommendation.")
    if report.of_reduction is not None:
        found.append(f"The file with its dimension reduced differs from the file by {_each(report, report.of_reduction)}.")
    return found


def _next_ones(report: Report) -> list[str]:
    """Why the next cheaper rung of each axis fails."""
    found = []
    for study in report.studies:
        chosen = report.choice[study.axis.name]
        failing = [finding for finding in study.findings if finding is not chosen and state(report, study, finding) == FAILS]
        for finding in [] if study.verdict else failing if study.axis.kind == MODEL else _nearest(report, failing):
            found.append(f"{study.axis.name}: {finding.rung.name} fails ({_each(report, finding.errors)}): "
                         f"{why(report, study, finding)}.")
        same = [finding.rung.name for finding in study.findings if state(report, study, finding) == SAME]
        if study.axis.kind == MODEL and same:
            found.append(f"{study.axis.name}: {', '.join(same)} would do and costs the same: keep {chosen.rung.name}.")
    return found


def _nearest(report: Report, failing: Sequence[Finding]) -> list[Finding]:
    """The one of several findings with the least error, if there is one."""
    return sorted(failing, key=lambda finding: float(np.max(finding.errors / report.tolerances)))[:1]


def _verdicts(report: Report) -> list[str]:
    found = [f"{study.axis.name}: {study.verdict}." for study in report.studies if study.verdict]
    return found + [f"{study.axis.name}: {study.remark}." for study in report.studies if study.remark]


def _floor(report: Report) -> list[str]:
    found = []
    for study in report.constants:
        known = [finding for finding in study.findings[1:] if finding.is_known]
        if known:
            words = "; ".join(f"{finding.rung.name} for {study.findings[0].rung.name}: {_each(report, finding.errors)}"
                              for finding in known)
            found.append(f"{study.axis.name} is no rung, but known no better than this: {words}.")
    below = [f"{quantity.name} ({tolerance:.2%} against {floor:.2%})" for quantity, tolerance, floor
             in zip(report.quantities, report.tolerances, report.floor) if tolerance < floor]
    if below:
        found.append(f"The tolerance is below the floor that these constants leave: {', '.join(below)}. Below the floor it says how"
                     " well the equations are solved, not how well the material is known.")
    return found


def _alone(report: Report) -> list[str]:
    """Where quantities want different rungs."""
    found = []
    for study in report.studies:
        wanted = {name: choice[study.axis.name].rung.name for name, choice in report.alone.items()}
        if len(set(wanted.values())) > 1:
            found.append(f"{study.axis.name}: the quantities want different rungs: "
                         + ", ".join(f"{name} alone {rung}" for name, rung in wanted.items()) + ".")
    return found


def _limits(report: Report) -> list[str]:
    found = ["Errors are against the finest model that was run, not against grains."]
    if report.undecided:
        found.append(f"The budget did not allow: {', '.join(dict.fromkeys(report.undecided))}.")
    return found


# ---- picture ------------------------------------------------------------------------------------------------------------

LEAST_DRAWN = 1e-4                  # error over tolerance


def draw(report: Report, title: str) -> Any:
    """Errors against time: the recommendation with each other rung, the tolerance, the floor, the file.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure
    assert report.recommended is not None and report.top is not None
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots()

    def height(errors: np.ndarray) -> float:
        return max(float(np.max(errors / report.tolerances)), LEAST_DRAWN)
    for study, colour in zip(report.studies, COLOURS):
        known = [finding for finding in study.findings if finding.is_known and np.isfinite(finding.errors).all()]
        points = sorted((time_over_file(report, study, finding), height(errors_with(report, study, finding))) for finding in known)
        if len(points) > 1:
            style = "o" if study.axis.kind == MODEL else "o-"    # models are in no order
            axes.plot(*zip(*points), style, color=colour, markersize=5, linewidth=0.8, label=study.axis.name)
    reference = report.file if report.file is not None and not report.file.failure else report.top
    over = max(reference.seconds, TINY)
    if reference is report.file and np.isfinite(report.of_file).all():
        axes.plot(1, height(report.of_file + report.of_top), "s", color="black", markersize=9, label="the file, measured")
    axes.plot(report.recommended.seconds / over, height(report.measured + report.of_top), "*", color="black", markersize=15,
              label="recommended, measured")
    axes.axhline(1, color="black", linewidth=1, linestyle="--", label="tolerance")
    axes.set(xscale="log", yscale="log")
    floor = height(report.floor)
    if floor > LEAST_DRAWN:
        bottom = min(axes.get_ylim()[0], floor / 2)
        axes.axhspan(bottom, floor, facecolor="0.94", edgecolor="0.6", zorder=0, label="floor: constants known no better")
        axes.set_ylim(bottom=bottom)
    axes.set(title=title, xlabel=f"time over that of the {'file' if reference is report.file else 'top'}",
             ylabel=f"largest error over its tolerance, with that of the top; at least {LEAST_DRAWN:g}")
    axes.grid(linewidth=0.3)
    axes.legend(frameon=False, fontsize=8)
    return figure
