"""Histories that were measured in simple shear, by simulations of grains or in a shear cell: reading, checks, means over seeds.

Columns and signs are those of histories of the driver: stresses are in k/d (k_Hz for Hertzian contacts), compression positive.
"""

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .. import tensors
from ..checks import attempt, choose, is_finite_number, refuse
from ..errors import RepairedDataWarning
from ..files import read_lines
from ..history import column_name
from ..material import CONTACTS
from ..steps import CONTROLS
from ..toml import read_toml

STARTS = ("steady", "data")
SIGNS = ("compression", "extension")
# Words of the ensemble for where a run starts: in the last state of a steady run, a table; in an isotropic packing.
STARTS_OF_ENSEMBLE = {"packed": "data", "thermal": "data", "steady.csv": "steady"}


def _is_positive(value: object) -> bool:
    return is_finite_number(value) and value > 0


# Keys: the check of a value, and what it must be in words.
KEYS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "mu": (lambda value: is_finite_number(value) and 0 <= value <= 1, "a number from 0 to 1"),
    "contact": (lambda value: value in CONTACTS, f"one of {', '.join(CONTACTS)}"),
    "start": (lambda value: value in STARTS or value in STARTS_OF_ENSEMBLE, f"one of {', '.join(STARTS)}"),
    "control": (lambda value: value in CONTROLS, f"one of {', '.join(CONTROLS)}"),
    "phi": (lambda value: is_finite_number(value) and 0 < value < 1, "a number in (0, 1)"),
    "positive": (lambda value: value in SIGNS, f"one of {', '.join(SIGNS)}"),
    "stiffness": (_is_positive, "k/d in the unit of the stresses, a number above 0"),
    "skip": (lambda value: value == 0 or _is_positive(value), "a shear strain of at least 0"),
}
# What files beside tables of the ensemble say too, and a table for what users want to say.
NOTED = ("script", "lammps", "seed", "seeds", "number", "rate", "normal_stress", "timestep", "tangential_stiffness", "damping",
         "step", "provenance")

STRESSES = tuple(f"sigma_{axis}" for axis in tensors.AXES)
FABRIC = tuple(f"A_{axis}" for axis in tensors.AXES)
SYMBOLS = {f"p{axis}": f"sigma_{axis}" for axis in tensors.AXES} | {f"A{axis}": f"A_{axis}" for axis in tensors.AXES}
MEASURED = ("p", "stress_ratio", "Z2", "A_xz")             # at least one of these must be known
COLUMNS = ("step", "gamma", "gamma_total", "phi", "p", "stress_ratio", "Z2", *FABRIC, *STRESSES)
ENDINGS = re.compile(r"(.+)_(s\d+|mean|scatter)")          # of names of one run's tables: of one seed, of all
SEED = re.compile(r".+_s\d+")

LARGEST_PRESSURE = 0.5      # k/d; contacts would overlap by about half a diameter: stresses must be in another unit
LARGEST_STRAIN = 0.5        # between two rows; the law forgets its start over less
CONSTANT_PHI = 1e-4         # variation of phi in what counts as constant volume
EQUAL_STRAIN = 1e-4         # difference of strains that count as the same, over the accumulated strain where that exceeds 1
LARGEST_TRACE = 0.01        # of a fabric that rounding has made
EQUAL_PRESSURE = 0.01       # difference of p and a third of the trace of the stress, over the largest p
NEGATIVE_PRESSURE = 0.05    # magnitude of a negative p that counts as noise, over the largest p
SETTLED = 0.5               # strain after a turn by which shear stress and fabric have the sign of steady shear


@dataclass(frozen=True, eq=False)
class Run:
    """A measured history of simple shear, or the mean of several seeds of one.

    Attributes
    ----------
    name : str
    mu : float
        Friction coefficient between the grains.
    contact : str
        "hookean" or "hertzian".
    start : str
        Where the law starts: "steady", its own steady shear at the first row's phi, or "data", the first row itself.
    controls : tuple of str
        What is held in each of the n - 1 increments, from steps.CONTROLS.
    columns : dict of str to array (n,)
        gamma, gamma_total and phi; p, stress_ratio, N1/p, N2/p, Z2, fabric A_xx ... A_yz and stresses sigma_xx ... sigma_yz as far
        as they are known. What was not measured in a row is NaN.
    scatter : dict of str to array (n,)
        Standard deviations between seeds of the same columns; empty for a single one.
    seeds : int
        Number of seeds.
    """

    name: str
    mu: float
    contact: str
    start: str
    controls: tuple[str, ...]
    columns: Mapping[str, np.ndarray]
    scatter: Mapping[str, np.ndarray]
    seeds: int = 1

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.columns["gamma"])

    def __repr__(self) -> str:
        seeds = f", {self.seeds} seeds" if self.seeds > 1 else ""
        return f"<Run {self.name}: mu {self.mu:g}, phi {self.columns['phi'][0]:.4g}, {len(self)} rows{seeds}>"

    @cached_property
    def since_turn(self) -> np.ndarray:
        """Shear strain (n,) since the last turn; infinite as long as the steady shear of the start goes on.

        Shear that does not start in steady shear turns at its start.
        """
        return _since_turn(np.diff(self.columns["gamma"]), self.start)

    @cached_property
    def held(self) -> np.ndarray:
        """Names (n,) of what is held in the rows: in the increment that ends in a row, in the first row as in the second."""
        return np.array([self.controls[0], *self.controls])


def _directions(increments: np.ndarray, start: str) -> np.ndarray:
    """The sign of the shear at the start (0 where it does not come from steady shear) and in each increment; (n,).

    Without shear it is the last one.
    """
    signs = [1.0 if start == "steady" else 0.0]
    for increment in increments:
        signs.append(float(np.sign(increment)) or signs[-1])
    return np.array(signs)


def _since_turn(increments: np.ndarray, start: str) -> np.ndarray:
    direction = _directions(increments, start)
    since = [np.inf if start == "steady" else 0.0]
    for increment, goes_on in zip(np.abs(increments), direction[1:] == direction[:-1]):
        since.append(increment + (since[-1] if goes_on else 0.0))
    return np.array(since)


# ---- reading -------------------------------------------------------------------------------------------------------------

def read_runs(files: Iterable[str | Path], **keys: Any) -> list[Run]:
    """Read measured histories.

    Tables whose names differ only in their endings `_s<number>` are seeds of one run, whose mean is taken; a name that ends in
    `_mean` or `_scatter` stands for all seeds beside it. What a table does not say (KEYS) stands in a TOML file beside it, of
    the same name without the ending.

    Parameters
    ----------
    files : iterable of path
    **keys
        KEYS for all runs; they take precedence over those in files.

    Returns
    -------
    list of Run

    Raises
    ------
    ValueError
        Names every fault of every table at once.
    OSError
        If a file cannot be read.

    Warns
    -----
    RepairedDataWarning
        If rows were put in order, or some do not count.
    """
    faults = _faults_of_keys(keys, KEYS)
    groups: dict[Path, list[Path]] = {}
    for file in map(Path, files):
        match = ENDINGS.fullmatch(file.stem)
        run = file.with_name(match[1]) if match else file.with_suffix("")
        tables = [file]
        if match and not SEED.fullmatch(file.stem):
            tables = sorted(path for path in file.parent.glob(f"{match[1]}_s*{file.suffix}")
                            if SEED.fullmatch(path.stem) and path.stem.rpartition("_s")[0] == match[1]) or tables
        groups.setdefault(run, []).extend(table for table in tables if table not in groups[run])
    if not groups:
        faults.append("there are no tables: give at least one")
    refuse("the data cannot be read", faults)
    runs = [attempt(faults, "", _read_run, run, tables, keys) for run, tables in groups.items()]
    refuse("the data cannot be read", faults)
    return [replace(run, name=name) for run, name in zip(runs, _short_names(list(groups))) if run]


def _short_names(paths: Sequence[Path]) -> list[str]:
    """Names of runs, with as many of the folders in front as tell all of them apart."""
    absolute = [path.absolute().parts for path in paths]
    count = next(count for count in range(1, max(map(len, absolute)) + 1)
                 if len({parts[-count:] for parts in absolute}) == len(paths))
    return ["_".join(parts[-count:]).strip("/") for parts in absolute]


def _faults_of_keys(keys: Mapping[str, Any], allowed: Iterable[str]) -> list[str]:
    faults: list[str] = []
    for name, value in keys.items():
        if name not in allowed:
            choose("unknown key", name, tuple(allowed), faults)
        elif name in KEYS and not KEYS[name][0](value):
            faults.append(f"{name} = {value!r}: must be {KEYS[name][1]}")
    return faults


def _read_run(name: Path, tables: Sequence[Path], given: Mapping[str, Any]) -> Run:
    """A run from the tables of its seeds and the file beside them; ValueError names every fault."""
    beside = name.with_name(name.name + ".toml")
    said = read_toml(beside) if beside.exists() else {}
    faults = [f"{beside}: {fault}" for fault in _faults_of_keys(said, (*KEYS, *NOTED))]
    keys = said | given
    start = keys.get("start", "steady")
    keys["start"] = STARTS_OF_ENSEMBLE.get(start, start) if isinstance(start, str) else start
    if "mu" not in keys:
        faults.append(f"{tables[0]}: mu, the friction coefficient between the grains, is not known: give it as a key, or in {beside}")
    refuse("keys", faults)
    seeds = [attempt(faults, f"{table}: ", _read_table, table, keys) for table in tables]
    refuse("tables", faults)
    columns = [seed for seed in seeds if seed is not None]
    _check_seeds(tables, columns)
    means = {name: np.mean([seed[name] for seed in columns], axis=0) for name in columns[0]}
    derived = [with_ratios(seed) for seed in columns]
    means = with_ratios(means)
    several = len(columns) > 1
    scatter = {name: np.std([seed[name] for seed in derived], axis=0, ddof=1) for name in means} if several else {}
    controls = attempt(faults, f"{tables[0]}: ", _controls, means, keys)
    refuse("path", faults)
    assert controls is not None
    return Run(name.name, float(keys["mu"]), keys.get("contact", "hookean"), keys["start"], controls, means, scatter, len(columns))


def _check_seeds(tables: Sequence[Path], seeds: Sequence[Mapping[str, np.ndarray]]) -> None:
    """Raises ValueError where seeds of one run do not have the same columns and strains."""
    faults = []
    for table, seed in zip(tables[1:], seeds[1:]):
        if list(seed) != list(seeds[0]):
            faults.append(f"{table}: has the columns {', '.join(seed)}, but {tables[0].name} has {', '.join(seeds[0])}")
        elif seed["gamma"].shape != seeds[0]["gamma"].shape or abs(seed["gamma"] - seeds[0]["gamma"]).max() > EQUAL_STRAIN:
            faults.append(f"{table}: has other strains gamma than {tables[0].name}: seeds of one run must have the same rows")
    refuse("seeds of one run must be alike", faults)


def with_ratios(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns with those that follow from the stresses: p, the stress ratio, and N1/p, N2/p of the normal stress differences.

    N1 = sigma_xx - sigma_zz, N2 = sigma_zz - sigma_yy. Ratios are 0 where p is 0.
    """
    found = dict(columns)
    normal = [columns.get(f"sigma_{axis}") for axis in ("xx", "yy", "zz")]
    if all(column is not None for column in normal):
        xx, yy, zz = normal
        found["p"] = (xx + yy + zz) / 3
        found |= {"N1/p": _ratio(xx - zz, found["p"]), "N2/p": _ratio(zz - yy, found["p"])}
    if "p" in found and "sigma_xz" in found:
        found["stress_ratio"] = _ratio(-found["sigma_xz"], found["p"])
    return found


def _ratio(numerator: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.divide(numerator, p, out=np.zeros_like(p), where=p != 0)


# ---- one table -----------------------------------------------------------------------------------------------------------

def _read_table(filename: Path, keys: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Columns of a table in order, in the law's signs and units; ValueError names every fault."""
    names, table = read_lines(filename)
    names = [column_name(SYMBOLS.get(name, name)) for name in names]
    faults = [f"names the column {name} twice" for name in dict.fromkeys(names) if names.count(name) > 1]
    if table.shape[1] != len(names):
        raise ValueError(f"has {len(names)} names, but {table.shape[1]} numbers a row")
    columns = {name: column for name, column in zip(names, table.T) if name in COLUMNS}
    if "gamma" not in columns:
        faults.append(f"the column gamma, the shear strain, is missing: the table has {', '.join(names)}")
    if "phi" not in columns and "phi" in keys:
        columns["phi"] = np.full(len(table), float(keys["phi"]))
    elif "phi" not in columns:
        faults.append("the column phi is missing, and no key phi says the constant volume fraction")
    known = with_ratios(columns)
    if not any(name in known for name in MEASURED):
        faults.append(f"has nothing to compare: give at least one of {', '.join(MEASURED)}, or the stresses {', '.join(STRESSES)}")
    if len(table) < 2:
        faults.append(f"has {len(table)} row: must have a start and at least one row after it")
    refuse("is no history", faults)
    columns = _in_order(filename, columns)
    columns = _from(columns, keys.get("skip", 0.0))
    columns = _in_units(columns, keys)
    faults = _faults_of_path(columns) + _faults_of_state(columns)
    if not faults:
        faults = _faults_of_signs(with_ratios(columns), keys["start"])
    refuse("is no history in these units and signs", faults)
    missing = {name: int(np.isnan(column).sum()) for name, column in columns.items() if np.isnan(column).any()}
    if missing:
        warnings.warn(f"{filename}: rows that are not a number do not count: " + ", ".join(
            f"{count} of {name}" for name, count in missing.items()), RepairedDataWarning, stacklevel=2)
    return columns


def _in_order(filename: Path, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns in the order of the accumulated strain, if that is there."""
    total = columns.get("gamma_total")
    if total is None or not (np.diff(total) < 0).any():
        return columns
    warnings.warn(f"{filename}: {(np.diff(total) < 0).sum()} rows are not in the order of gamma_total: they were sorted by it",
                  RepairedDataWarning, stacklevel=2)
    order = np.argsort(total, kind="stable")
    return {name: column[order] for name, column in columns.items()}


def _accumulated(gamma: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(gamma)))])


def _from(columns: dict[str, np.ndarray], skip: float) -> dict[str, np.ndarray]:
    """Rows from an accumulated strain on, and this strain from there."""
    keep = _accumulated(columns["gamma"]) >= skip - EQUAL_STRAIN * max(skip, 1) if skip else slice(None)
    kept = {name: column[keep] for name, column in columns.items()}
    if len(kept["gamma"]) < 2:
        raise ValueError(f"skip = {skip:g} leaves {len(kept['gamma'])} rows: the accumulated strain ends at "
                         f"{_accumulated(columns['gamma'])[-1]:.6g}")
    if "gamma_total" in kept:
        kept["gamma_total"] = kept["gamma_total"] - kept["gamma_total"][0]
    else:
        kept["gamma_total"] = _accumulated(kept["gamma"])
    return kept


def _in_units(columns: dict[str, np.ndarray], keys: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Columns with stresses in k/d, compression positive."""
    sign = -1 if keys.get("positive") == "extension" else 1
    factors = dict.fromkeys(STRESSES, sign / keys.get("stiffness", 1.0)) | {"p": 1 / keys.get("stiffness", 1.0)}
    return {name: column * factors.get(name, 1) for name, column in columns.items()}


def _rows(found: np.ndarray) -> str:
    """The rows of a table at which something was found, in words, counted from 1 after the line of names."""
    rows = np.flatnonzero(found) + 1
    return f"in row {rows[0]}" if len(rows) == 1 else f"in {len(rows)} rows, first in row {rows[0]}"


def _faults_of_path(columns: Mapping[str, np.ndarray]) -> list[str]:
    """What is wrong with the strains and volume fractions."""
    faults = [f"{name} is not a number {_rows(~np.isfinite(columns[name]))}" for name in ("gamma", "gamma_total", "phi", "step")
              if name in columns and not np.isfinite(columns[name]).all()]
    if faults:
        return faults
    gamma, phi = columns["gamma"], columns["phi"]
    increments = np.abs(np.diff(gamma))
    if not increments.any():
        faults.append("gamma does not change: there is no shear")
    if (increments > LARGEST_STRAIN).any():
        faults.append(f"gamma changes by up to {increments.max():.4g} from row to row, by more than {LARGEST_STRAIN}: is it in per "
                      "cent? It must be a strain without a unit")
    apart = np.abs(np.diff(columns["gamma_total"]) - increments) > EQUAL_STRAIN * np.maximum(1, columns["gamma_total"][1:])
    if apart.any():
        faults.append(f"gamma_total does not grow by the change of gamma {_rows(np.insert(apart, 0, False))}: the rows are not in "
                      "order, or some at turns are missing")
    elif len(gamma) > 3 and (np.diff(np.sign(np.diff(gamma))) != 0).mean() > 0.5:
        faults.append("gamma turns at more than half of the rows: they are not in order, and gamma_total, by which they could be "
                      "sorted, is missing or of no help")
    if ((phi <= 0) | (phi >= 1)).any():
        faults.append(f"phi is {phi.min():.4g} to {phi.max():.4g}: must be in (0, 1)" + (
            "; is it in per cent?" if phi.max() > 1 else ""))
    return faults


def _faults_of_state(columns: Mapping[str, np.ndarray]) -> list[str]:
    """What is wrong with the stresses, the coordination number and the fabric."""
    faults = []
    for name in (*STRESSES, *FABRIC, "p", "stress_ratio", "Z2"):
        column = columns.get(name, np.zeros(1))
        if np.isinf(column).any():
            faults.append(f"{name} is infinite {_rows(np.isinf(column))}")
        elif np.isnan(column).all():
            faults.append(f"{name} is not a number in any row: leave the column out")
    if faults:
        return faults
    p = with_ratios(columns).get("p", np.zeros(1))
    largest = float(np.nanmax(np.abs(p)))
    if np.nanmin(p) < -NEGATIVE_PRESSURE * largest:
        faults.append(f"p is negative {_rows(p < -NEGATIVE_PRESSURE * largest)}: where stresses are extension positive, give "
                      'positive = "extension"; p itself is a pressure')
    if largest > LARGEST_PRESSURE:
        faults.append(f"p reaches {largest:.4g}: stresses are in k/d, so that p is at most {LARGEST_PRESSURE}; give stiffness, k/d "
                      "in their unit")
    if "p" in columns and np.nanmax(np.abs(p - columns["p"])) > EQUAL_PRESSURE * largest:
        faults.append("p is not a third of sigma_xx + sigma_yy + sigma_zz: leave one of them out")
    if "Z2" in columns and not (np.nanmin(columns["Z2"]) >= 0 and np.nanmax(columns["Z2"]) < 20):
        faults.append(f"Z2 is {np.nanmin(columns['Z2']):.4g} to {np.nanmax(columns['Z2']):.4g}: is a number of contacts per grain")
    if all(name in columns for name in FABRIC[:3]):
        trace = np.nanmax(np.abs(sum(columns[name] for name in FABRIC[:3])))
        if trace > LARGEST_TRACE:
            faults.append(f"the fabric's trace A_xx + A_yy + A_zz reaches {trace:.4g}: must be 0, A is <n n> - I/3")
    return faults


def _faults_of_signs(columns: Mapping[str, np.ndarray], start: str) -> list[str]:
    """Columns that have the sign of backward shear where it is forward: in steady shear, and long after turns."""
    increments = np.diff(columns["gamma"])
    forward = _directions(increments, start)
    settled = _since_turn(increments, start) > SETTLED
    words = {"sigma_xz": 'negative, compression positive; where stresses are extension positive, give positive = "extension"',
             "stress_ratio": "positive", "A_xz": "negative, contacts lie against the flow"}
    ratio = "sigma_xz" if "sigma_xz" in columns else "stress_ratio"
    return [f"{name} has the wrong sign: in steady shear with growing gamma it must be {words[name]}" for name in (ratio, "A_xz")
            if name in columns and settled.any()
            and np.nansum((columns[name] * forward)[settled]) * (1 if name == "stress_ratio" else -1) < 0]


def _controls(columns: Mapping[str, np.ndarray], keys: Mapping[str, Any]) -> tuple[str, ...]:
    """What is held in each increment; ValueError where this is not known, or not among the columns."""
    n = len(columns["gamma"]) - 1
    steps = keys.get("step", [])
    if "control" in keys:
        controls = (keys["control"],) * n
    elif steps and "step" in columns:
        of_steps = [entry.get("control", "pressure" if "pressure" in entry else "volume")
                    for entry in steps for _ in range(2 * entry["cycles"] if "cycles" in entry else 1)]
        numbers = columns["step"][1:].astype(int)
        if numbers.min() < 1 or numbers.max() > len(of_steps):
            raise ValueError(f"has steps {numbers.min()} to {numbers.max()}, but {len(of_steps)} are described, cycles as two each")
        controls = tuple(of_steps[number - 1] for number in numbers)
    else:
        controls = ("volume",) * n
    faults = [f"control = {control!r}: must be one of {', '.join(CONTROLS)}" for control in set(controls) - set(CONTROLS)]
    refuse("path", faults)
    drift = np.ptp(np.cumsum(np.where(np.array(controls) == "volume", np.diff(columns["phi"]), 0)))
    if drift > CONSTANT_PHI:
        faults.append(f"phi changes by {drift:.4g} where the volume should be constant; give control, what is held instead: "
                      f"{', '.join(list(CONTROLS)[1:])}")
    for control in sorted(set(controls)):
        faults += [f"{name} is held (control {control}), but is not known {where}" for name in CONTROLS[control][1]
                   if (where := _unknown(columns.get(name)))]
    refuse("its path cannot be followed", faults)
    return controls


def _unknown(column: np.ndarray | None) -> str:
    """Where a column that is needed lacks numbers, in words; empty if nowhere."""
    if column is None:
        return "in any row"
    return _rows(np.isnan(column)) if np.isnan(column).any() else ""
