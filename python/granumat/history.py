"""Histories of load paths: their columns, conditions on the columns that end a step early, and the rows while a path is followed.

Stresses in a history have the paper's sign, compression positive; they are in k/d (k_Hz for Hertzian contacts).
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import tensors
from .core import STATE
from .files import write_table
from .material import Material

STATE_COLUMNS = ("phi", "p", "stress_ratio", "Z2", *(f"A_{a}" for a in tensors.AXES), *(f"sigma_{a}" for a in tensors.AXES),
                 "eta", "dilatancy", "eta_t")
COLUMNS = ("step", "gamma", "gamma_total", *STATE_COLUMNS)
ACOUSTIC = "acoustic"       # a column on demand, since it takes longer than following the path

STEADY_RATE = 1e-4          # changes of A/kappa, Z2 and phi per unit of shear strain below which a state is steady

StopCondition = Callable[[Mapping[str, np.ndarray], Material], np.ndarray]


@dataclass
class History:
    """The states along a load path: one row for its start and one after each increment.

    Attributes
    ----------
    material : Material
    states : record array (n,) of dtype STATE
    columns : dict of str to array (n,)
        COLUMNS, and "acoustic" if asked for; `history["p"]` is short for `history.columns["p"]`.
    times : array (n,)
        Pseudo-time: the number of steps that are done. 1.5 is the middle of the second step by its increments; the end of a step is
        its number, also where a condition ends it early.
    """

    material: Material
    states: np.recarray
    columns: dict[str, np.ndarray]
    times: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """A column (n,) by its name."""
        return self.columns[name]

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.states)

    def write_csv(self, filename: str | Path) -> None:
        """Write the columns as a table with a line of names; an old file is replaced only once the new one is complete."""
        write_table(filename, self.columns, ["%d"] + ["%.15g"] * (len(self.columns) - 1))


def state_columns(material: Material, states: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a history that follow from the states alone.

    Parameters
    ----------
    material : Material
    states : array (n,) of dtype STATE

    Returns
    -------
    dict of str to array (n,)
        STATE_COLUMNS: volume fraction, pressure, stress ratio -sigma_xz/p (0 where p is 0), Z2, A, sigma (compression positive),
        eta (4.5), dilatancy tr D/abs(dev D) of the last strain (0 before any) and the transverse modulus eta_t.
    """
    sigma = -states["stress"]
    p = tensors.trace(sigma) / 3
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(p > 0, -sigma[:, 4] / p, 0.0)
        volume, shear = tensors.trace(states["direction"]), tensors.magnitude(tensors.deviator(states["direction"]))
        dilatancy = np.where(volume == 0, 0.0, volume / shear)
    values = [states["volume_fraction"], p, ratio, states["coordination_number"], *states["fabric"].T, *sigma.T,
              material.evaluate(states)[1], dilatancy, material.transverse_modulus(states)]
    return dict(zip(STATE_COLUMNS, values))


# ---- conditions that end a step ----------------------------------------------------------------------------------------

OPERATORS: dict[str, Callable[..., np.ndarray]] = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal}
COMPARISON = re.compile(r"\s*(\w+)\s*(<=|>=|<|>)\s*([-+0-9.eE]+)\s*")


def stop_condition(text: str) -> StopCondition:
    """Read a condition that ends a step.

    Parameters
    ----------
    text : str
        "steady", or a column compared with a number, such as "p < 0.001".

    Returns
    -------
    function of (columns, material)
        Given columns of n + 1 rows, the first of them the row before the increments, it tells for each of the n increments whether
        the step may end after it: a bool array (n,).

    Raises
    ------
    ValueError
        If the text is neither.
    """
    if text == "steady":
        return _is_steady
    match = COMPARISON.fullmatch(text) if isinstance(text, str) else None
    try:
        if match is None or match[1] not in COLUMNS[1:]:
            raise ValueError
        name, operator, value = match[1], OPERATORS[match[2]], float(match[3])
    except ValueError:
        raise ValueError(f"until {text!r}: must be \"steady\" or a column compared with a number, such as \"p < 0.001\"; "
                         f"columns are {', '.join(COLUMNS[1:])}") from None
    return lambda columns, material: operator(columns[name], value)[1:]


def _is_steady(columns: Mapping[str, np.ndarray], material: Material) -> np.ndarray:
    strain = np.abs(np.diff(columns["gamma_total"]))
    change = np.abs(np.diff(columns["Z2"])) + np.abs(np.diff(columns["phi"]))
    for axis in tensors.AXES:
        change += np.abs(np.diff(columns[f"A_{axis}"])) / material["kappa"]
    return (strain > 0) & (change < STEADY_RATE * strain)


# ---- while a path is followed ------------------------------------------------------------------------------------------

@dataclass
class _Block:
    """Rows that were computed together; the accumulated shear strains are those of the whole path."""

    step: int
    times: np.ndarray           # (n,)
    states: np.ndarray          # (n,) of dtype STATE
    gamma: np.ndarray           # (n,)
    gamma_total: np.ndarray     # (n,)

    def __len__(self) -> int:
        return len(self.states)

    def first(self, rows: int) -> "_Block":
        return _Block(self.step, self.times[:rows], self.states[:rows], self.gamma[:rows], self.gamma_total[:rows])


class Recorder:
    """The rows of a history while its path is followed.

    Parameters
    ----------
    material : Material
    state : record of dtype STATE
        Start of the path, the first row.
    acoustic : bool
        Whether the history is to have the column "acoustic".
    """

    def __init__(self, material: Material, state: np.ndarray | np.record, acoustic: bool) -> None:
        self.material, self.acoustic = material, acoustic
        self._blocks = [_Block(0, np.zeros(1), np.array(state, STATE).reshape(1), np.zeros(1), np.zeros(1))]

    @property
    def state(self) -> np.void:
        """The last state."""
        return self._blocks[-1].states[-1]

    @property
    def last_states(self) -> np.ndarray:
        """The states of the rows that were appended last."""
        return self._blocks[-1].states

    def append(self, step: int, times: np.ndarray, states: np.ndarray, gamma: np.ndarray) -> None:
        """Append the states after n increments of a step; n > 0.

        Parameters
        ----------
        step : int
            Counted from 1.
        times : array (n,)
            Pseudo-times after the increments, as in History.
        states : array (n,) of dtype STATE
        gamma : array (n,)
            Signed shear strains of the increments.
        """
        last = self._blocks[-1]
        self._blocks.append(_Block(step, times, states, last.gamma[-1] + np.cumsum(gamma),
                                   last.gamma_total[-1] + np.cumsum(np.abs(gamma))))

    def stop_at(self, condition: StopCondition) -> bool:
        """Whether the rows that were appended last meet a condition; those after the first that does are removed."""
        rows = len(self._blocks[-1])
        columns = self._columns(self._blocks[-2:])
        met = np.flatnonzero(condition({name: column[-rows - 1:] for name, column in columns.items()}, self.material))
        if met.size:
            self._blocks[-1] = self._blocks[-1].first(int(met[0]) + 1)
            self._blocks[-1].times[-1] = self._blocks[-1].step
        return bool(met.size)

    def history(self) -> History:
        """All rows so far."""
        columns = self._columns(self._blocks)
        states = np.concatenate([block.states for block in self._blocks])
        if self.acoustic:
            columns[ACOUSTIC] = self.material.ellipticity(states).eigenvalue
        return History(self.material, states.view(np.recarray), columns, np.concatenate([block.times for block in self._blocks]))

    def _columns(self, blocks: list[_Block]) -> dict[str, np.ndarray]:
        columns = {"step": np.repeat([block.step for block in blocks], [len(block) for block in blocks]),
                   "gamma": np.concatenate([block.gamma for block in blocks]),
                   "gamma_total": np.concatenate([block.gamma_total for block in blocks])}
        return columns | state_columns(self.material, np.concatenate([block.states for block in blocks]))
