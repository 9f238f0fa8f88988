"""Files: replaced at once by complete ones; directories of one run each; tables of numbers whose first line names the columns."""

import errno
import fcntl
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

LOCK = ".granumat.lock"             # in the directory of a run; that it is there says nothing, a process must hold it
LONGEST_HOLDER = 1000               # bytes in it
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)                       # of file systems without locks
RUN_FILES = re.compile(r"(history\.csv|history\.png|failing\.toml|quantities\.csv|reactions\.csv|probe-[\w-]+\.csv|fields\.xdmf"
                       r"|fields(\.\d+)?\.bin|checkpoint\.npz|[A-Za-z]\w*-\d{6}\.png)(\.part)?")
"""Names of what `granumat point` and `granumat solve` write into the directory of a run."""


@contextmanager
def naming(filename: str | Path) -> Iterator[None]:
    """Adds a file's name to errors of the system that lack it, as those of a full disk do."""
    try:
        yield
    except OSError as error:
        if error.filename is not None or error.errno is None:
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(filename)) from None


@contextmanager
def replacing(filename: str | Path) -> Iterator[Path]:
    """Give a name beside a file for its new content, which takes the file's place at the end unless there was an error."""
    filename = Path(filename)
    partial = filename.with_name(filename.name + ".part")
    try:
        with naming(filename):
            yield partial
            partial.replace(filename)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


@contextmanager
def appending(filename: str | Path) -> Iterator[None]:
    """Names a file that is appended to in errors, and cuts off what a write that fails, as on a full disk, has appended to it."""
    filename = Path(filename)
    size = filename.stat().st_size if filename.exists() else 0
    try:
        with naming(filename):
            yield
    except OSError:
        if filename.exists():
            os.truncate(filename, min(size, filename.stat().st_size))
        raise


@contextmanager
def locked(directory: str | Path) -> Iterator[None]:
    """Make a directory, and keep other runs out of it. The system ends the lock with the process, however it ends.

    Raises
    ------
    ValueError
        Another run holds the directory.
    OSError
        The directory cannot be made, or not be written into.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    lock = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(lock, LONGEST_HOLDER).decode(errors="replace").strip()
            raise ValueError(f"{directory}: another run is writing there ({holder or 'it begins now'}): "
                             "wait for its end, or take another directory") from None
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            warnings.warn(f"{directory} is on a file system without locks: see to it that no other run writes there", stacklevel=3)
        with naming(directory / LOCK):
            os.ftruncate(lock, 0)
            os.write(lock, f"process {os.getpid()} on {os.uname().nodename}\n".encode())
        yield
    finally:
        os.close(lock)


@contextmanager
def locked_by_one(on_one: Callable[[Callable[[], None]], object], directory: str | Path) -> Iterator[None]:
    """As locked, for all ranks by the one on which `on_one` calls a function; collective where it is entered."""
    with ExitStack() as stack:                                   # empty on the others
        on_one(lambda: stack.enter_context(locked(directory)))
        yield


def run_files(directory: str | Path) -> list[Path]:
    """What a run has left in a directory; nothing if there is no such directory."""
    directory = Path(directory)
    return sorted(file for file in directory.iterdir() if RUN_FILES.fullmatch(file.name)) if directory.is_dir() else []


def clear(directory: str | Path, overwrite: bool, ways_out: str) -> None:
    """Remove what an earlier run has left in a directory.

    Parameters
    ----------
    directory : path
    overwrite : bool
        Whether it may be removed.
    ways_out : str
        What to do if it may not be, for the message.

    Raises
    ------
    ValueError
        An earlier run has left something, and it may not be removed.
    """
    files = run_files(directory)
    if files and not overwrite:
        names = ", ".join(file.name for file in files[:4]) + (f" and {len(files) - 4} more" if len(files) > 4 else "")
        raise ValueError(f"{directory} holds a run already ({names}): {ways_out}")
    for file in files:
        file.unlink()


def check_writable(directory: str | Path) -> None:
    """Make a directory if it is not there; OSError if nothing can be written into it."""
    probe = Path(directory) / ".granumat.part"
    probe.parent.mkdir(parents=True, exist_ok=True)
    probe.touch()
    probe.unlink()


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
    with open(filename, encoding="utf-8-sig") as file:           # spreadsheets begin UTF-8 with a mark of it
        try:
            header, *lines = file.read().splitlines() or [""]
        except UnicodeDecodeError as error:
            raise ValueError(f"{filename}: is not text in UTF-8: {error}") from None
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header and "," not in header:
            raise ValueError(f"{filename}: its columns are separated by {word}: they must be by commas, and decimals by points")
    try:
        return [name.strip() for name in header.split(",")], np.loadtxt(lines or ["none"], delimiter=",", ndmin=2)
    except ValueError as error:
        raise ValueError(f"{filename}: not a table of numbers with one line of names: {error}") from None
