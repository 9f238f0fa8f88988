"""Histories of load paths: their columns, conditions on the columns that end a step early, and the rows while a path is followed.

Stresses in a history have the paper's sign, compression positive; they are in k/d (k_Hz for Hertzian contacts).
"""

import re
from collections.abc import Callable, ItemsView, Iterator, KeysView, Mapping, ValuesView
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import tensors
from .core import STATE
from .files import write_table
from .material import Material

STATE_COLUMNS = ("phi", "p", "q", "q_over_p", "stress_ratio", "Z2", *(f"A_{a}" for a in tensors.AXES),
                 *(f"sigma_{a}" for a in tensors.AXES), "eta", "dilatancy", "eta_t")
STRAIN_COLUMNS = ("gamma", "gamma_total", *(f"e_{a}" for a in tensors.AXES), "volume_strain")
COLUMNS = ("step", *STRAIN_COLUMNS, *STATE_COLUMNS, "tau_over_sigma_n")
ACOUSTIC = "acoustic"       # a column on demand, since it takes longer than following the path
WORDS = {"volume_fraction": "phi", "coordination_number": "Z2", "q/p": "q_over_p", "tau/sigma_n": "tau_over_sigma_n"}
"""Other names of columns and fields, accepted wherever one is named: those of states, and ratios as one writes them."""

STEADY_RATE = 1e-4          # changes of A/kappa, Z2 and phi per unit of shear strain below which a state is steady

StopCondition = Callable[[Mapping[str, np.ndarray], Material], np.ndarray]


def column_name(name: str) -> str:
    """The name under which a column stands, of a name that may be one of WORDS."""
    return WORDS.get(name, name)


@dataclass(eq=False, repr=False)
class History(Mapping[str, np.ndarray]):
    """The states along a load path: one row for its start and one after each increment.

    A mapping of the columns' names to the columns: `history["p"]`, `"p" in history`, `dict(history)`. As of a DataFrame, its
    length is the number of rows.

    Attributes
    ----------
    material : Material
    states : record array (n,) of dtype STATE
    columns : dict of str to array (n,)
        COLUMNS, and "acoustic" if asked for.
    times : array (n,)
        Pseudo-time: the number of steps that are done. 1.5 is the middle of the second step by its increments; the end of a step is
        its number, also where a condition ends it early.
    """

    material: Material
    states: np.recarray
    columns: dict[str, np.ndarray]
    times: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """A column (n,) by its name, or by one of WORDS."""
        try:
            return self.columns[column_name(name)]
        except KeyError:
            raise KeyError(f"there is no column {name!r}: there are {', '.join(self.columns)}") from None

    def __iter__(self) -> Iterator[str]:
        """The columns' names."""
        return iter(self.columns)

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.states)

    def keys(self) -> KeysView[str]:
        """The columns' names."""
        return self.columns.keys()

    def values(self) -> ValuesView[np.ndarray]:
        """The columns."""
        return self.columns.values()

    def items(self) -> ItemsView[str, np.ndarray]:
        """Pairs of the columns' names and the columns."""
        return self.columns.items()

    def __eq__(self, other: object) -> bool:
        """Whether it is the same object: arrays have no single truth value."""
        return self is other

    __hash__ = object.__hash__

    def __repr__(self) -> str:
        end = ", ".join(f"{name} {self[name][-1]:.4g}" for name in ("gamma", "phi", "p", "q", "Z2"))
        return f"<History: {len(self)} rows, {len(self.columns)} columns; at the end of step {self['step'][-1]} {end}>"

    def to_pandas(self) -> Any:
        """The columns as a pandas.DataFrame, which needs pandas; granumat itself does not.

        Returns
        -------
        pandas.DataFrame
            Its index is the pseudo-time.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        import pandas  # here, as the package does without it
        return pandas.DataFrame(self.columns, index=pandas.Index(self.times, name="t"))

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
        STATE_COLUMNS: volume fraction, pressure, q = sqrt(3 J2), q/p, stress ratio -sigma_xz/p (ratios are 0 where p is 0), Z2, A,
        sigma (compression positive), eta (4.5), dilatancy tr D/abs(dev D) of the last strain (0 before any) and the transverse
        modulus eta_t.
    """
    sigma = -states["stress"]
    p, q = tensors.trace(sigma) / 3, np.sqrt(3) * tensors.magnitude(tensors.deviator(sigma))
    with np.errstate(divide="ignore", invalid="ignore"):
        volume, shear = tensors.trace(states["direction"]), tensors.magnitude(tensors.deviator(states["direction"]))
        dilatancy = np.where(volume == 0, 0.0, volume / shear)
    values = [states["volume_fraction"], p, q, _ratio(q, p), _ratio(-sigma[:, 4], p), states["coordination_number"],
              *states["fabric"].T, *sigma.T, material.evaluate(states)[1], dilatancy, material.transverse_modulus(states)]
    return dict(zip(STATE_COLUMNS, values))


def _ratio(shear: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """A shear stress over a pressure (n,), 0 where there is no pressure."""
    return np.divide(shear, pressure, out=np.zeros_like(pressure), where=pressure > 0) + 0.0                  # no -0


# ---- conditions that end a step ----------------------------------------------------------------------------------------

OPERATORS: dict[str, Callable[..., np.ndarray]] = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal}
COMPARISON = re.compile(r"\s*([\w/]+)\s*(<=|>=|<|>)\s*([-+0-9.eE]+)\s*")


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
        if match is None or column_name(match[1]) not in COLUMNS[1:]:
            raise ValueError
        name, operator, value = column_name(match[1]), OPERATORS[match[2]], float(match[3])
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
    """Rows that were computed together; the accumulated strains are those of the whole path."""

    step: int
    times: np.ndarray           # (n,)
    states: np.ndarray          # (n,) of dtype STATE
    gamma: np.ndarray           # (n,)
    gamma_total: np.ndarray     # (n,)
    strain: np.ndarray          # (n, 6)

    def __len__(self) -> int:
        return len(self.states)

    def first(self, rows: int) -> "_Block":
        return _Block(self.step, self.times[:rows], self.states[:rows], self.gamma[:rows], self.gamma_total[:rows],
                      self.strain[:rows])


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
        self._blocks = [_Block(0, np.zeros(1), np.array(state, STATE).reshape(1), np.zeros(1), np.zeros(1),
                               np.zeros((1, 6)))]

    @property
    def state(self) -> np.void:
        """The last state."""
        return self._blocks[-1].states[-1]

    @property
    def last_states(self) -> np.ndarray:
        """The states of the rows that were appended last."""
        return self._blocks[-1].states

    def append(self, step: int, times: np.ndarray, states: np.ndarray, gamma: np.ndarray, strain: np.ndarray) -> None:
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
        strain : array (n, 6)
            Strains of the increments, the symmetric parts of their displacement gradients.
        """
        last = self._blocks[-1]
        self._blocks.append(_Block(step, times, states, last.gamma[-1] + np.cumsum(gamma),
                                   last.gamma_total[-1] + np.cumsum(np.abs(gamma)),
                                   last.strain[-1] + np.cumsum(strain, axis=0)))

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
        strain = np.concatenate([block.strain for block in blocks])
        columns |= {f"e_{axis}": strain[:, i] for i, axis in enumerate(tensors.AXES)} | {"volume_strain": tensors.trace(strain)}
        columns |= state_columns(self.material, np.concatenate([block.states for block in blocks]))
        return columns | {"tau_over_sigma_n": _ratio(-columns["sigma_xz"], columns["sigma_zz"])}
