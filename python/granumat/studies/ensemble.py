"""The ensemble of discrete-element (DEM) runs that comes with the package: means over packings, and their scatter.

Its folder is demos/data/ensemble of the source; docs/grains.md says what was simulated.
"""

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..files import read_lines

FOLDER = Path(__file__).parents[1] / "data" / "ensemble"
SCATTER = " scatter"        # ending of the names of standard deviations in tables of steady shear
SLOW = 1e-3                 # inertial number below which shear counts as slow, as in the paper

Columns = dict[str, np.ndarray]


class Measured(NamedTuple):
    """What DEM runs of one programme gave.

    Attributes
    ----------
    columns : dict of str to array (n,)
        Means over packings, by the names of docs/grains.md.
    scatter : dict of str to array (n,)
        Standard deviations between packings; empty where there is one.
    packings : int
    """

    columns: Columns
    scatter: Columns
    packings: int

    def rows(self, chosen: np.ndarray) -> "Measured":
        """Those rows that an array of bool (n,), or of their numbers, chooses."""
        mean, scatter = ({name: column[chosen] for name, column in columns.items()} for columns in (self.columns, self.scatter))
        return self._replace(columns=mean, scatter=scatter)

    def having(self, **columns: np.ndarray) -> "Measured":
        """The same with more columns."""
        return self._replace(columns=self.columns | columns)


def programme(name: str, mu: float, phi: float) -> Measured | None:
    """What a programme with Hookean contacts gave at a friction coefficient and a volume fraction; None if it was not run.

    Parameters
    ----------
    name : str
        As in demos/dem/ensemble.toml.
    mu : float
    phi : float
        That of the packing; of an isotropic compression, that of its frictionless start.

    Raises
    ------
    FileNotFoundError
        The ensemble is not in the package.
    """
    _check_folder()
    record = FOLDER / f"mu{mu:g}_phi{phi:.3f}" / f"{name}.toml"
    return _read(record) if record.exists() else None


def compressions(mu: float | None = None) -> dict[tuple[float, float], Measured]:
    """Isotropic compressions by mu and the volume fraction of the frictionless start, in order; all, or those of one mu."""
    _check_folder()
    found = {}
    for record in FOLDER.glob("mu*/compression.toml"):
        made = tomllib.loads(record.read_text())
        found[made["mu"], made["phi"]] = _read(record)
    return {key: found[key] for key in sorted(found) if mu in (None, key[0])}


def steady(*mus: float, contact: str = "hookean", slow: float = SLOW) -> Measured:
    """Steady simple shear at constant volume, a row for each mu, phi and shear rate.

    Parameters
    ----------
    *mus : float
        Friction coefficients; all if none is given.
    contact : str
        "hookean" or "hertzian".
    slow : float
        Inertial number above which shear is left out.

    Returns
    -------
    Measured
        Its columns have mu, rate, `seeds` and the inertial number `I` too; scatter is 0 in rows of one packing.
    """
    _check_folder()
    columns = _table(FOLDER / ("steady.csv" if contact == "hookean" else f"{contact}_steady.csv"))
    means = {name: column for name, column in columns.items() if not name.endswith(SCATTER)}
    scatter = {name.removesuffix(SCATTER): column for name, column in columns.items() if name.endswith(SCATTER)}
    chosen = (means["I"] < slow) & (np.isin(means["mu"], mus) if mus else True)
    return Measured(means, scatter, int(means["seeds"].max())).rows(chosen)


def _check_folder() -> None:
    if not FOLDER.is_dir():
        raise FileNotFoundError(f"no DEM data in {FOLDER}: the build puts demos/data/ensemble there")


def _read(record: Path) -> Measured:
    """The means of the runs of which a file says how they were made."""
    seeds: list[Any] = tomllib.loads(record.read_text())["seeds"]
    mean, scatter = (record.with_name(f"{record.stem}_{kind}.csv") for kind in ("mean", "scatter"))
    if mean.exists():
        return Measured(_table(mean), _table(scatter), len(seeds))
    return Measured(_table(record.with_name(f"{record.stem}_s{seeds[0]}.csv")), {}, 1)


def _table(file: Path) -> Columns:
    names, rows = read_lines(file)
    return dict(zip(names, rows.T))
