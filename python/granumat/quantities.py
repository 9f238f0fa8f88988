"""Quantities of interest: the numbers for which a path or a scene is computed, and their table, quantities.csv.

A path or scene file names them in tables [[quantity]]. What a quantity can be `of` is known where it is evaluated: a column of a
history on a load path (here), a reaction, a probe or a mean in a boundary-value problem (fem.quantities).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .checks import attempt, is_finite_number, refuse, repetitions
from .files import read_lines, write_table
from .history import History
from .toml import tables_of

QUANTITIES_FILE = "quantities.csv"
KEYS = ("name", "of", "at", "tolerance", "scale")
WORDS = ("end", "range")            # what `at` may be besides a list of times
VOLUME_FRACTION = re.compile(r"(mean )?(phi|volume_fraction)( |$)")
SAME_TIME = 1e-9                    # over the larger of 1 and a time: times that differ by less are the same


@dataclass(frozen=True)
class Quantity:
    """A number for which a path or a scene is computed.

    Attributes
    ----------
    name : str
        Of its column in quantities.csv: letters, digits, - and _.
    of : str
        What it is, such as "stress_ratio" or "moment of inner".
    at : tuple of float, or str
        Pseudo-times, which the run meets exactly; or "end", or "range", after every increment.
    tolerance : float or None
        Error that is allowed, relative to the scale.
    scale : float or None
        What errors are relative to; see scale_of.
    """

    name: str
    of: str
    at: tuple[float, ...] | str = "end"
    tolerance: float | None = None
    scale: float | None = None

    @property
    def times(self) -> tuple[float, ...]:
        """Pseudo-times that the run has to meet; none for "end" and "range"."""
        return () if isinstance(self.at, str) else self.at

    def scale_of(self, values: np.ndarray) -> float:
        """What errors are relative to.

        Parameters
        ----------
        values : array (n,)
            The quantity over the whole run.

        Returns
        -------
        float
            `scale` if it is given; for a volume fraction, which hardly changes, the range of the values; otherwise the largest
            absolute value.
        """
        if self.scale is not None:
            return self.scale
        return float(np.ptp(values) if VOLUME_FRACTION.match(self.of) else np.abs(values).max())

    def pick(self, times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The part of a run's values that the quantity is about.

        Parameters
        ----------
        times, values : array (n,)
            Over the whole run.

        Returns
        -------
        times, values : array
            One for "end", all for "range".

        Raises
        ------
        ValueError
            If a time is not among those of the run.
        """
        if self.at == "range":
            return times, values
        if self.at == "end":
            return times[-1:], values[-1:]
        wanted = np.array(self.at, float)
        rows = np.abs(times - wanted[:, None]).argmin(axis=1)
        missed = ~are_same_times(times[rows], wanted)
        if missed.any():
            raise ValueError(f"{self.name}: its times {', '.join(f'{t:g}' for t in wanted[missed])} are not in the run, which has "
                             f"come to {times[-1]:g}")
        return wanted, values[rows]


def are_same_times(one: Any, other: Any) -> Any:
    """Whether pseudo-times differ by round-off only."""
    return np.abs(np.subtract(one, other)) <= SAME_TIME * np.maximum(1, np.abs(other))


# ---- tables [[quantity]] of a file -------------------------------------------------------------------------------------

def read_quantities(content: Mapping[str, Any], check_of: Callable[[str], object],
                    check_time: Callable[[float], object]) -> list[Quantity]:
    """Read the tables [[quantity]] of a path or scene file.

    Parameters
    ----------
    content : dict
        Of the file.
    check_of : function of str
        Raises ValueError where a quantity cannot be `of` this.
    check_time : function of float
        Raises ValueError where the run does not meet a time.

    Returns
    -------
    list of Quantity
        Empty if the file has none.

    Raises
    ------
    ValueError
        Names every mistake in all of the tables.
    """
    entries = tables_of(content, "quantity")
    faults: list[str] = []
    found = [attempt(faults, f"quantity {number}: ", _read_quantity, entry, check_of, check_time)
             for number, entry in enumerate(entries, 1)]
    faults += repetitions("quantity", [entry.get("name") for entry in entries])
    if faults:
        raise ValueError("\n".join(faults))
    return [quantity for quantity in found if quantity is not None]


def _read_quantity(entry: Mapping[str, Any], check_of: Callable[[str], object], check_time: Callable[[float], object]) -> Quantity:
    faults = [f"unknown key {key!r}: allowed are {', '.join(KEYS)}" for key in entry if key not in KEYS]
    faults += [f"{key} is missing" for key in ("name", "of") if key not in entry]
    name = entry.get("name", "some")
    if not isinstance(name, str) or not name.replace("-", "_").isidentifier() or name == "t":
        faults.append(f"name = {name!r}: must begin with a letter, may have letters, digits, - and _, and is not t")
    of = entry.get("of")
    if isinstance(of, str):
        attempt(faults, f"of = {of!r}: ", check_of, of)
    elif "of" in entry:
        faults.append(f"of = {of!r}: must be a text in quotes")
    at = entry.get("at", "end")
    if isinstance(at, list) and at and all(map(is_finite_number, at)) and all(np.diff(at) > 0):
        for t in at:
            attempt(faults, f"at {t!r}: ", check_time, t)
        at = tuple(map(float, at))
    elif at not in WORDS:
        faults.append(f"at = {at!r}: must be a list of increasing times, or one of {', '.join(WORDS)}")
    tolerance, scale = entry.get("tolerance"), entry.get("scale")
    if tolerance is not None and not (is_finite_number(tolerance) and 0 < tolerance < 1):
        faults.append(f"tolerance = {tolerance!r}: must be a number in (0, 1)")
    if scale is not None and not (is_finite_number(scale) and scale > 0):
        faults.append(f"scale = {scale!r}: must be a number above 0")
    refuse("cannot be evaluated", faults)
    return Quantity(name, str(of), at, tolerance, scale)


# ---- the table of values ----------------------------------------------------------------------------------------------

def write_history(filename: str | Path, quantities: Sequence[Quantity], history: History) -> None:
    """Write the quantities of a history, which are columns of it, one row a row of the history; an old file is replaced at once.

    Parameters
    ----------
    filename : path
    quantities : sequence of Quantity
    history : History
    """
    write_table(filename, {"t": history.times} | {quantity.name: history[quantity.of] for quantity in quantities})


def read_values(filename: str | Path, quantities: Sequence[Quantity]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What quantities.csv says of quantities, at the times that they are wanted at.

    Parameters
    ----------
    filename : path
    quantities : sequence of Quantity
        With their own `at`, which the run that wrote the file must have met.

    Returns
    -------
    dict of str to (array, array)
        Times and values by name.

    Raises
    ------
    ValueError
        Names every quantity that is not in the file, and every time.
    OSError
        If the file cannot be read.
    """
    table = read_table(filename)
    faults = [f"there is no column {quantity.name!r}: it has {', '.join(table)}" for quantity in quantities
              if quantity.name not in table]
    found = {quantity.name: attempt(faults, "", quantity.pick, table["t"], table[quantity.name]) for quantity in quantities
             if quantity.name in table}
    refuse(str(filename), faults)
    return {name: values for name, values in found.items() if values is not None}


def read_table(filename: str | Path) -> dict[str, np.ndarray]:
    """All columns of quantities.csv by name, "t" first; ValueError if it is no such table."""
    names, values = read_lines(filename)
    if names[0] != "t" or values.shape[1] != len(names):
        raise ValueError(f"{filename}: not a table with a column t and at least one row")
    return dict(zip(names, values.T))
