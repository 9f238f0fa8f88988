"""Calibration files: constants of the law as a table over mu, which take the place of the paper's.

    contact = "hookean"         # of the grains that they were fitted to

    [[constants]]
    mu = 0.3
    a1 = 0.0091
    phic = 0.590

    [[constants]]
    mu = 0.5
    a1 = 0.0088
    phic = 0.577

Between two mu constants are linear. A table `[provenance]` says where they are from.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .checks import choose, is_finite_number, is_number, refuse
from .toml import read_toml, tables_of

TABLES = ("contact", "constants", "provenance")
SUFFIX = ".toml"
EQUAL_MU = 1e-9             # difference of friction coefficients that count as the same


def is_calibration_file(calibration: object) -> bool:
    """Whether what is given for a calibration is the name of a file."""
    return isinstance(calibration, str) and calibration.endswith(SUFFIX)


def read_constants(filename: str | Path, mu: float, contact: str, allowed: Sequence[str]) -> dict[str, float]:
    """Read the constants that a calibration file has for a friction coefficient.

    Parameters
    ----------
    filename : path
    mu : float
        Within the range of the file.
    contact : str
        That of the file, if it says one.
    allowed : sequence of str
        Names that constants may have.

    Returns
    -------
    dict of str to float

    Raises
    ------
    ValueError
        Names every mistake in the file, or says for which grains its constants are.
    OSError
        If the file cannot be read.
    """
    content = read_toml(filename)
    faults: list[str] = []
    for name in content:
        if name not in TABLES:
            choose("unknown table or key", name, TABLES, faults)
    rows = tables_of(content, "constants")
    if not rows:
        faults.append("has no [[constants]]")
    for number, row in enumerate(rows, 1):
        faults += [f"constants {number}: {fault}" for fault in _faults_of_row(row, rows[0], allowed)]
    refuse(f"{filename} is no calibration", faults)
    rows = sorted(rows, key=lambda row: row["mu"])
    known = np.array([row["mu"] for row in rows], float)
    if (np.diff(known) <= EQUAL_MU).any():
        faults.append(f"has constants for one mu twice: {', '.join(f'{value:g}' for value in known)}")
    if not is_number(mu) or not known[0] - EQUAL_MU <= mu <= known[-1] + EQUAL_MU:
        covered = f"{known[0]:g}" if len(rows) == 1 else f"{known[0]:g} to {known[-1]:g}"
        faults.append(f"has constants for mu = {covered}, not for {mu!r}")
    if content.get("contact", contact) != contact:
        faults.append(f"has constants for contact = {content['contact']!r}, not for {contact!r}")
    refuse(f"{filename} cannot be used", faults)
    return {name: float(np.interp(mu, known, [row[name] for row in rows])) for name in rows[0] if name != "mu"}


def _faults_of_row(row: dict[str, Any], first: dict[str, Any], allowed: Sequence[str]) -> list[str]:
    faults: list[str] = []
    for name, value in row.items():
        if name not in ("mu", *allowed):
            choose("unknown name", name, ("mu", *allowed), faults)
        elif not is_finite_number(value):
            faults.append(f"{name} = {value!r}: must be a finite number")
    if "mu" not in row:
        faults.append("mu is missing")
    if row.keys() != first.keys():
        faults.append(f"has {', '.join(row)}, but the first has {', '.join(first)}: must be the same names")
    return faults
