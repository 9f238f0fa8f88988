"""Results of the commands for programs: what the option --json prints."""

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .choice import Report
from .grains import QUANTITIES, Calibration, Comparison
from .history import History
from .quantities import Quantity, read_values


def to_json(value: Any) -> str:
    """JSON of a result: numbers in full, those that are not finite as null, paths as text."""
    return json.dumps(_plain(value))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def of_error(error: BaseException) -> dict[str, Any]:
    """An error: "error", its first line or sentence, and "faults", every mistake that it names."""
    what, *faults = re.split(r"\n  (?=\S)", str(error))
    return {"error": what.removesuffix(":") if faults else what, "faults": faults}


def of_history(history: History, quantities: Sequence[Quantity]) -> dict[str, Any]:
    """A path: "rows"; "steps", all columns in the first row and at the end of each step; "quantities", times and values by name."""
    last = np.flatnonzero(np.diff(history["step"], append=np.inf))
    values = {quantity.name: quantity.pick(history.times, history[quantity.of]) for quantity in quantities}
    return {"rows": len(history), "steps": [{name: column[row] for name, column in history.items()} for row in last],
            "quantities": _quantities(values)}


def of_quantities(filename: Path, quantities: Sequence[Quantity]) -> dict[str, Any]:
    """Times and values by name of what quantities.csv says of quantities, none if there are none."""
    return _quantities(read_values(filename, quantities) if quantities else {})


def _quantities(values: dict[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
    return {name: {"t": times, "value": of_times} for name, (times, of_times) in values.items()}


def of_comparison(comparison: Comparison) -> dict[str, Any]:
    """A comparison with measured runs: "scores", the rows of scores.csv by column, NaN where nothing counts."""
    return {"scores": [{"run": run, "phase": phase, "model": model} | dict(zip(QUANTITIES, scores))
                       for run, phase, model, scores in comparison.rows()]}


def of_calibration(calibration: Calibration) -> dict[str, Any]:
    """A calibration: "sets", for each closure and mu its constants by name and the notes [[fitted]] of the file."""
    return {"sets": [{"constants": one.constants, **one.note()} for one in calibration.sets]}


def of_report(report: Report) -> dict[str, Any]:
    """A ladder: whether its recommendation is "proved", what it is by axis, its errors by quantity, and the "recommended" file."""
    errors = zip(report.quantities, report.tolerances, report.measured, report.of_file)
    return {"proved": report.is_proved, "choice": {axis: finding.rung.name for axis, finding in report.choice.items()},
            "quantities": {quantity.name: {"tolerance": tolerance, "error": measured, "error_of_file": of_file}
                           for quantity, tolerance, measured, of_file in errors},
            "runs": report.runs, "seconds": report.seconds, "undecided": report.undecided, "recommended": report.content}
