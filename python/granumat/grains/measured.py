"""Histories that were measured in simple shear, by simulations of grains or in a shear cell: reading, checks, means over seeds.

Columns and signs are those of histories of the driver: stresses are in k/d (k_Hz for Hertzian contacts), compression positive.
"""

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

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
STARTS_OF_ENSEMBLE = {"packed": "data", "thermal": "data"}      # isotropic packings
SIGNS = ("compression", "extension")


def _is_positive(value: object) -> bool:
    return is_finite_number(value) and value > 0


def _is_start(value: object) -> bool:
    return isinstance(value, str) and (value in STARTS or value in STARTS_OF_ENSEMBLE or value.endswith(".csv"))


class Key(NamedTuple):
    """What is to be known of a run beside its table."""

    kind: type
    holds: Callable[[Any], bool]            # whether a value may be given
    must_be: str
    words: str


KEYS = {
    "mu": Key(float, lambda value: is_finite_number(value) and 0 <= value <= 1, "a number from 0 to 1",
              "friction coefficient between the grains"),
    "contact": Key(str, lambda value: value in CONTACTS, f"one of {', '.join(CONTACTS)}", "contacts of the grains"),
    "start": Key(str, _is_start, f"one of {', '.join(STARTS)}, or the table of steady shear that comes before, a .csv",
                 "where the law starts: in its own steady shear, or in the first row of the data"),
    "control": Key(str, lambda value: value in CONTROLS, f"one of {', '.join(CONTROLS)}", "what is held"),
    "phi": Key(float, lambda value: is_finite_number(value) and 0 < value < 1, "a number in (0, 1)",
               "constant volume fraction, where there is no column"),
    "positive": Key(str, lambda value: value in SIGNS, f"one of {', '.join(SIGNS)}", "sign of the columns sigma_xx ... sigma_yz"),
    "stiffness": Key(float, _is_positive, "a number above 0", "k/d in the unit of the stresses"),
    "skip": Key(float, lambda value: value == 0 or _is_positive(value), "a shear strain of at least 0",
                "accumulated shear strain that is left out at the start"),
}
# What files beside tables of the ensemble say too, and a table for what users want to say.
NOTED = ("script", "lammps", "seed", "seeds", "number", "rate", "normal_stress", "timestep", "tangential_stiffness", "damping",
         "step", "provenance")

STRESSES = tuple(f"sigma_{axis}" for axis in tensors.AXES)
FABRIC = tuple(f"A_{axis}" for axis in tensors.AXES)
SYMBOLS = {f"p{axis}": f"sigma_{axis}" for axis in tensors.AXES} | {f"A{axis}": f"A_{axis}" for axis in tensors.AXES}
PATH = ("gamma", "gamma_total", "phi", "step")             # must be known in every row
MEASURED = ("p", "stress_ratio", "Z2", "A_xz")             # at least one of these must be known
COLUMNS = (*PATH, "e_xz", "p", "stress_ratio", "Z2", *FABRIC, *STRESSES)
OF_ALL_RUNS = ("mu", "contact", "phi", "positive", "stiffness")       # keys that hold for the steady shear before a run too
ENDINGS = re.compile(r"(.+)_(s\d+|mean|scatter)")          # of names of one run's tables: of one seed, of all
SEED = re.compile(r".+_s\d+")

LARGEST_PRESSURE = 0.5      # k/d; contacts would overlap by about half a diameter: stresses must be in another unit
LARGEST_STRAIN = 0.5        # between two rows; the law forgets its start over less
CONSTANT_PHI = 1e-4         # variation of phi in what counts as constant volume
EQUAL_STRAIN = 1e-4         # difference of strains that count as the same, over the accumulated strain where that exceeds 1
MOST_CONTACTS = 20.0        # per grain; spheres have at most 12
LARGEST_TRACE = 0.01        # of a fabric that rounding has made
EQUAL_PRESSURE = 0.01       # difference of p and a third of the trace of the stress, over the largest p
NEGATIVE_PRESSURE = 0.05    # magnitude of a negative p that counts as noise, over the largest p
SETTLED = 0.5               # strain after a turn by which shear stress and fabric have the sign of steady shear
STEADY_STRAIN = 0.1         # over which p decorrelates in steady shear: the least of which a mean says something


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
    steady_pressure : float
        p in steady shear, which errors of p are relative to; NaN if p was not measured.
    """

    name: str
    mu: float
    contact: str
    start: str
    controls: tuple[str, ...]
    columns: Mapping[str, np.ndarray]
    scatter: Mapping[str, np.ndarray]
    seeds: int
    steady_pressure: float

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
        run = run_of(file)
        tables = [file]
        if match and not SEED.fullmatch(file.stem):
            tables = sorted(path for path in file.parent.glob(f"{match[1]}_s*{file.suffix}")
                            if SEED.fullmatch(path.stem) and path.stem.rpartition("_s")[0] == match[1]) or tables
        groups.setdefault(run, []).extend(table for table in tables if table not in groups[run])
    if not groups:
        faults.append("there are no tables: give at least one")
    refuse("the data cannot be read", faults)
    runs = [_read_run(run, tables, keys, faults) for run, tables in groups.items()]
    refuse("the data cannot be read", faults)
    return [replace(run, name=name) for run, name in zip(runs, _short_names(list(groups))) if run]


def run_of(table: Path) -> Path:
    """The path of a table without what tells seeds apart."""
    match = ENDINGS.fullmatch(table.stem)
    return table.with_name(match[1]) if match else table.with_suffix("")


def key_file(run: Path) -> Path:
    """The file of keys beside the tables of a run, from their `run_of`."""
    return run.with_name(run.name + ".toml")


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
        elif name in KEYS and not KEYS[name].holds(value):
            faults.append(f"{name} = {value!r}: must be {KEYS[name].must_be}")
    return faults


def _read_run(name: Path, tables: Sequence[Path], given: Mapping[str, Any], faults: list[str]) -> Run | None:
    """A run from the tables of its seeds and the file beside them; None, and its faults, if it has some."""
    known = len(faults)
    beside = key_file(name)
    said = attempt(faults, "", read_toml, beside) if beside.exists() else {}
    faults += [f"{beside}: {fault}" for fault in _faults_of_keys(said or {}, (*KEYS, *NOTED))]
    keys = {**(said or {}), **given}
    before = name.parent / str(keys.get("start", "steady"))
    keys["start"] = "steady" if before.suffix == ".csv" else STARTS_OF_ENSEMBLE.get(before.name, before.name)
    if "mu" not in keys:
        faults.append(f"{tables[0]}: mu, the {KEYS['mu'].words}, is not known: give the key mu, or write it into {beside}")
    if faults[known:]:
        keys = {key: value for key, value in keys.items() if key in KEYS and KEYS[key].holds(value)}
    seeds = [_read_table(table, keys, faults) for table in tables]
    if len(faults) == known:
        faults += _faults_of_seeds(tables, seeds)
    if len(faults) > known:
        return None
    means = with_ratios({name: np.mean([seed[name] for seed in seeds], axis=0) for name in seeds[0]})
    each = [with_ratios(seed) for seed in seeds]
    scatter = {name: np.std([seed[name] for seed in each], axis=0, ddof=1) for name in means} if len(seeds) > 1 else {}
    controls = _controls(f"{tables[0]}: ", means, keys, faults)
    p = _last_pressure(before, given, faults) if before.suffix == ".csv" else np.nan
    return Run(name.name, float(keys["mu"]), keys.get("contact", "hookean"), keys["start"], controls, means, scatter, len(seeds),
               _steady_pressure(means, keys["start"], p))


def _last_pressure(table: Path, given: Mapping[str, Any], faults: list[str]) -> float:
    """The mean p over the last SETTLED of strain of a run of steady shear that others start in; NaN if it is not there."""
    seeds = sorted(path for path in table.parent.glob(f"{table.stem}_s*.csv") if SEED.fullmatch(path.stem))
    tables = [table] if table.exists() else seeds
    keys = {name: given[name] for name in OF_ALL_RUNS if name in given}
    run = _read_run(table.with_suffix(""), tables, keys, faults) if tables else None
    if run is None:
        return np.nan
    total = run.columns["gamma_total"]
    return _mean_pressure(run.columns, total > total[-1] - SETTLED)


def _steady_pressure(columns: Mapping[str, np.ndarray], start: str, before: float) -> float:
    """p in steady shear: before the run; else in its steady rows; else in its first row, or of its settled rows, or of all."""
    since = _since_turn(np.diff(columns["gamma"]), start)
    total = columns["gamma_total"]
    if "p" not in columns or not np.isnan(before):
        return before
    steady = np.isinf(since) if start == "steady" else since > SETTLED
    if start == "steady" and np.ptp(total[steady]) < STEADY_STRAIN and not np.isnan(columns["p"][0]):
        return float(columns["p"][0])
    return _mean_pressure(columns, steady if steady.any() else np.full(len(total), True))


def _mean_pressure(columns: Mapping[str, np.ndarray], rows: np.ndarray) -> float:
    """The mean of p in rows, each with the strain of its increment; NaN where it is not known there."""
    strain = np.insert(np.abs(np.diff(columns["gamma"])), 0, 0)
    p = columns.get("p", np.full(len(strain), np.nan))
    rows = rows & ~np.isnan(p)
    return float(np.average(p[rows], weights=strain[rows])) if strain[rows].any() else np.nan


def _faults_of_seeds(tables: Sequence[Path], seeds: Sequence[Mapping[str, np.ndarray]]) -> list[str]:
    """Seeds of one run that do not have the same columns and strains."""
    faults = []
    for table, seed in zip(tables[1:], seeds[1:]):
        if list(seed) != list(seeds[0]):
            faults.append(f"{table}: has the columns {', '.join(seed)}, but {tables[0].name}, another seed of the run, has "
                          f"{', '.join(seeds[0])}")
        elif seed["gamma"].shape != seeds[0]["gamma"].shape or abs(seed["gamma"] - seeds[0]["gamma"]).max() > EQUAL_STRAIN:
            faults.append(f"{table}: has other strains gamma than {tables[0].name}, another seed of the run: must be alike row by "
                          "row; runs of different strains must not differ in the ending _s<number> only")
    return faults


def with_ratios(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns with those that follow from the stresses: p, the stress ratio, and N1/p, N2/p of the normal stress differences.

    N1 = sigma_xx - sigma_zz, N2 = sigma_zz - sigma_yy. Ratios are 0 where p is 0.
    """
    found = dict(columns)
    if all(name in columns for name in STRESSES[:3]):
        xx, yy, zz = (columns[name] for name in STRESSES[:3])
        found["p"] = (xx + yy + zz) / 3
        found |= {"N1/p": _ratio(xx - zz, found["p"]), "N2/p": _ratio(zz - yy, found["p"])}
    if "p" in found and "sigma_xz" in found:
        found["stress_ratio"] = _ratio(-found["sigma_xz"], found["p"])
    return found


def _ratio(numerator: np.ndarray, p: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):                          # infinite numbers are refused afterwards
        return np.divide(numerator, p, out=np.zeros_like(p), where=p != 0)


# ---- one table -----------------------------------------------------------------------------------------------------------

def _read_table(filename: Path, keys: Mapping[str, Any], faults: list[str]) -> dict[str, np.ndarray]:
    """Columns of a table in order, in the law's signs and units; its faults, if it has some, are added."""
    found: list[str] = []
    names, table = attempt(faults, "", read_lines, filename) or ([], np.zeros((0, 0)))
    if table.shape[1] != len(names):
        found.append(f"has {len(names)} names, but {table.shape[1]} numbers a row")
    elif names:
        names = [column_name(SYMBOLS.get(name, name)) for name in names]
        found += [f"names the column {name} twice" for name in dict.fromkeys(names) if names.count(name) > 1]
        columns = _in_units({name: column for name, column in zip(names, table.T) if name in COLUMNS}, keys)
        if "phi" not in columns and "phi" in keys:
            columns["phi"] = np.full(len(table), float(keys["phi"]))
        found += _faults_of_columns(names, columns) + _faults_of_state(columns)
        if not any(name in with_ratios(columns) for name in MEASURED):
            found.append(f"has nothing to compare: give at least one of {', '.join(MEASURED)}, or stresses, {', '.join(STRESSES)}")
        if "gamma" in columns and len(table) > 1 and np.isfinite([columns[name] for name in PATH if name in columns]).all():
            kept = attempt(found, "", _from, _in_order(filename, columns), keys.get("skip", 0.0))
            if kept:
                columns = kept
                found += _faults_of_path(columns)
        if not found and "start" in keys:
            found += _faults_of_signs(with_ratios(columns), keys["start"])
    faults += [f"{filename}: {fault}" for fault in found]
    if found or not names:
        return {}
    columns.pop("e_xz", None)
    missing = {name: int(np.isnan(column).sum()) for name, column in columns.items() if np.isnan(column).any()}
    if missing:
        warnings.warn(f"{filename}: rows that are not a number do not count: " + ", ".join(
            f"{count} of {name}" for name, count in missing.items()), RepairedDataWarning, stacklevel=2)
    return columns


def _faults_of_columns(names: Sequence[str], columns: Mapping[str, np.ndarray]) -> list[str]:
    """What is missing of the path, and where it is not a number."""
    faults = []
    if "gamma" not in columns:
        faults.append(f"the column gamma, the shear strain, is missing: the table has {', '.join(names)}")
    if "phi" not in columns:
        faults.append("the column phi is missing, and no key phi says the constant volume fraction")
    if "gamma" in columns and np.ptp(2 * columns.get("e_xz", columns["gamma"] / 2) - columns["gamma"]) > EQUAL_STRAIN:
        faults.append("is not simple shear: e_xz is not half of gamma")
    rows = len(next(iter(columns.values()), ()))
    if columns and rows < 2:
        faults.append(f"has {rows} row: must have a start and at least one row after it")
    return faults + [f"{name} is not a number {_rows(~np.isfinite(columns[name]))}" for name in PATH
                     if name in columns and not np.isfinite(columns[name]).all()]


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
    """Rows from an accumulated strain on, where shear begins, and the accumulated strain from there."""
    total = _accumulated(columns["gamma"])
    if not total[-1] > 0:
        raise ValueError("gamma does not change: there is no shear")
    first = np.searchsorted(total, skip - EQUAL_STRAIN * max(skip, 1) if skip else 0.0)
    begins = np.searchsorted(total, total[first], side="right") - 1 if first < len(total) else first
    kept = {name: column[begins:] for name, column in columns.items()}
    if len(kept["gamma"]) < 2:
        raise ValueError(f"skip = {skip:g} leaves {len(kept['gamma'])} rows with shear: the accumulated strain ends at "
                         f"{total[-1]:.6g}")
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
    faults = []
    gamma, phi = columns["gamma"], columns.get("phi", np.full(1, 0.5))
    increments = np.abs(np.diff(gamma))
    if (increments > LARGEST_STRAIN).any():
        faults.append(f"gamma changes by up to {increments.max():.4g} from row to row, by more than {LARGEST_STRAIN}: is it in per "
                      "cent? It must be a strain without a unit")
    apart = np.abs(np.diff(columns["gamma_total"]) - increments) > EQUAL_STRAIN * np.maximum(1, columns["gamma_total"][1:])
    if apart.any():
        faults.append(f"gamma_total does not grow by the change of gamma, first at gamma = {gamma[1:][apart][0]:.6g}: the rows are "
                      "not in order, or some at turns are missing")
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
    if "Z2" in columns and not (np.nanmin(columns["Z2"]) >= 0 and np.nanmax(columns["Z2"]) < MOST_CONTACTS):
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


def _controls(prefix: str, columns: Mapping[str, np.ndarray], keys: Mapping[str, Any], faults: list[str]) -> tuple[str, ...]:
    """What is held in each increment; faults where this is not known, or not among the columns, are added."""
    controls = ("volume",) * (len(columns["gamma"]) - 1)
    if "control" in keys:
        controls = (keys["control"],) * len(controls)
    elif "step" in keys and "step" in columns:
        controls = attempt(faults, prefix, _controls_of_steps, keys["step"], columns["step"][1:]) or controls
    drift = np.ptp(np.cumsum(np.where(np.array(("", *controls)) == "volume", np.diff(columns["phi"], prepend=0), 0)))
    if drift > CONSTANT_PHI:
        faults.append(f"{prefix}phi drifts by {drift:.4g} where the volume should be constant; give control, what is held instead, "
                      f"one of {', '.join(list(CONTROLS)[1:])}")
    faults += [f"{prefix}{name} is held (control {control}), but is not known {where}" for control in dict.fromkeys(controls)
               for name in CONTROLS[control][1] if (where := _unknown(columns.get(name)))]
    return controls


def _controls_of_steps(steps: Any, numbers: np.ndarray) -> tuple[str, ...]:
    """What is held in increments, from the numbers of their steps and the tables [[step]] of a run of demos/dem."""
    if not isinstance(steps, list) or not all(isinstance(entry, dict) for entry in steps):
        raise ValueError("step: must be tables [[step]]")
    of_steps = [entry.get("control", "pressure" if "pressure" in entry else "volume")
                for entry in steps for _ in range(2 * entry["cycles"] if "cycles" in entry else 1)]
    faults: list[str] = []
    for control in dict.fromkeys(of_steps):
        choose("control", control, tuple(CONTROLS), faults)
    if numbers.min() < 1 or numbers.max() > len(of_steps):
        faults.append(f"rows are of steps {numbers.min():g} to {numbers.max():g}, there are {len(of_steps)}, of cycles two each")
    refuse("the tables [[step]] beside it", faults)
    return tuple(of_steps[int(number) - 1] for number in numbers)


def _unknown(column: np.ndarray | None) -> str:
    """Where a column that is needed lacks numbers, in words; empty if nowhere."""
    if column is None:
        return "in any row"
    return f"in {np.isnan(column).sum()} rows" if np.isnan(column).any() else ""
