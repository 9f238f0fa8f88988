"""Calibrations beside the paper's: constants of the law as a table over mu, in files, of which granumat ships some by name.

    contact = "hookean"         # of the grains that they were fitted to

    [[constants]]
    mu = 0.3
    a1 = 0.0091
    phic = 0.590

    [[constants]]
    mu = 0.5
    a1 = 0.0088
    phic = 0.577

Between two mu constants are linear. Tables of the name of a closure, such as `[[mobilised]]`, hold for that one in place of
`[[constants]]`. Tables `[[fitted]]` and `[provenance]` say where constants are from and how well they are known.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from .checks import choose, is_finite_number, is_number, refuse
from .toml import parse_toml, tables_of

COMMON = "constants"        # table of the closures that have none of their own
NOTES = ("fitted", "provenance")
SUFFIX = ".toml"
SHIPPED = {file.stem: file for file in sorted((Path(__file__).parent / "constants").glob(f"*{SUFFIX}"))}
EQUAL_MU = 1e-9             # difference of friction coefficients that count as the same


def is_calibration_file(calibration: object) -> bool:
    """Whether what is given for a calibration is the name of a file."""
    return isinstance(calibration, str) and calibration.endswith(SUFFIX)


def read_constants(filename: str | Path, mu: float, contact: str, closure: str, closures: Sequence[str],
                   allowed: Sequence[str]) -> dict[str, float]:
    """Read the constants that a calibration file has for a friction coefficient and a closure.

    Parameters
    ----------
    filename : path
    mu : float
        Within the range of the file.
    contact : str
        That of the file, if it says one.
    closure : str
    closures : sequence of str
        Names that tables may have.
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
    content = _content(filename, Path(filename).read_bytes())
    faults: list[str] = []
    for name in content:
        if name not in (tables := ("contact", COMMON, *closures, *NOTES)):
            choose("unknown table or key", name, tables, faults)
    of_closures = {name: tables_of(content, name) for name in (COMMON, *closures) if name in content}
    if not any(of_closures.values()):
        faults.append(f"has no [[{COMMON}]]")
    for name, rows in of_closures.items():
        for number, row in enumerate(rows, 1):
            faults += [f"{name} {number}: {fault}" for fault in _faults_of_row(row, rows[0], allowed)]
    refuse(f"{filename} is no calibration", faults)
    rows = sorted(of_closures.get(closure) or of_closures.get(COMMON, []), key=lambda row: row["mu"])
    known = np.array([row["mu"] for row in rows], float)
    if (np.diff(known) <= EQUAL_MU).any():
        faults.append(f"has constants for one mu twice: {', '.join(f'{value:g}' for value in known)}")
    if not rows:
        faults.append(f"has constants for the closure {' and '.join(of_closures)}, not for {closure}")
    elif not is_number(mu) or not known[0] - EQUAL_MU <= mu <= known[-1] + EQUAL_MU:
        covered = f"{known[0]:g}" if len(rows) == 1 else f"{known[0]:g} to {known[-1]:g}"
        faults.append(f"has constants for mu = {covered}, not for {mu!r}")
    if content.get("contact", contact) != contact:
        faults.append(f"has constants for contact = {content['contact']!r}, not for {contact!r}")
    refuse(f"{filename} cannot be used", faults)
    return {name: float(np.interp(mu, known, [row[name] for row in rows])) for name in rows[0] if name != "mu"}


@lru_cache(maxsize=8)
def _content(filename: str | Path, text: bytes) -> dict[str, Any]:
    """What a file says, for reading only: a file that still says the same, as for many materials in a row, is parsed once."""
    return parse_toml(filename, text)


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
