"""Files: replaced at once by complete ones, and tables of numbers whose first line names the columns."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def replacing(filename: str | Path) -> Iterator[Path]:
    """Give a name beside a file for its new content, which takes the file's place at the end unless there was an error."""
    filename = Path(filename)
    partial = filename.with_name(filename.name + ".part")
    yield partial
    partial.replace(filename)


def write_table(filename: str | Path, columns: Mapping[str, np.ndarray], formats: str | Sequence[str] = "%.15g") -> None:
    """Write columns (n,) by name as a table; an old file is replaced at once.

    Parameters
    ----------
    filename : path
    columns : dict of str to array (n,)
    formats : str, or sequence of str
        Of the numbers, in all columns or in each, as "%.15g".
    """
    with replacing(filename) as partial:
        np.savetxt(partial, np.column_stack(list(columns.values())), formats, ",", header=",".join(columns), comments="")


def read_lines(filename: str | Path) -> tuple[list[str], np.ndarray]:
    """Read the names of a table's columns and its lines of numbers, which may be as many or not.

    Parameters
    ----------
    filename : path

    Returns
    -------
    names : list of str
    numbers : array (n, m)
        One row a line.

    Raises
    ------
    ValueError
        If the file has no line of numbers, or lines of other things.
    OSError
        If the file cannot be read.
    """
    with open(filename, encoding="utf-8") as file:
        names = [name.strip() for name in file.readline().split(",")]
        try:
            return names, np.loadtxt(file.readlines() or ["none"], delimiter=",", ndmin=2)
        except ValueError as error:
            raise ValueError(f"{filename}: not a table of numbers with one line of names: {error}") from None
