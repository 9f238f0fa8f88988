"""What all observers have in common that write files as a run goes on, and can continue them from a checkpoint.

Rank 0 writes. What is written is in the files at once, so that a run that is killed loses nothing of it.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ..files import naming
from .cellwise import on_rank_0
from .problem import Problem


class Output:
    """An observer that writes every so many increments and at given times; after each increment if nothing is said.

    Parameters
    ----------
    path : path
    every : int, optional
        Increments from one record to the next.
    times : sequence of float, optional
        Pseudo-times at which there are records too.

    Attributes
    ----------
    path : Path
        Its name is the key under which a checkpoint keeps the bookmark.
    written : float or None
        Pseudo-time of what was written last.
    """

    def __init__(self, path: str | Path, every: int | None = None, times: Sequence[float] = ()) -> None:
        self.path, self.times = Path(path), frozenset(times)
        self.written: float | None = None
        self.every = every if every or times else 1

    def __call__(self, problem: Problem) -> None:
        if (self.every is not None and problem.increments % self.every == 0) or problem.t in self.times:
            self.write(problem)

    def write(self, problem: Problem) -> None:
        """Writes the problem as it is, unless that has been written already; collective."""
        if self.written is None or problem.t > self.written:
            self._write(problem)
            self.written = problem.t

    def _write(self, problem: Problem) -> None:
        raise NotImplementedError

    def growing_files(self) -> Sequence[Path]:
        """Files that records are appended to."""
        return ()

    def bookmark(self) -> dict[str, Any]:
        """How far the files are written, for `restore`. To be called on rank 0; everything is on disk when it returns."""
        sizes = []
        for file in self.growing_files() if self.written is not None else ():
            with naming(file), open(file, "rb+") as stream:
                os.fsync(stream.fileno())
                sizes.append(stream.seek(0, os.SEEK_END))
        return {"written": self.written, "sizes": sizes, "content": self.content()}

    def content(self) -> Any:
        """What the records are of, as JSON has it: a file goes on with records of the same only."""
        return None

    def restore(self, bookmark: dict[str, Any], comm: MPI.Comm) -> None:
        """Cuts off what was written after a bookmark; collective.

        Raises
        ------
        ValueError
            A file is missing or shorter than at the bookmark, or its records are of something else.
        """
        if bookmark.get("content") != self.content():
            raise ValueError(f"{self.path} cannot be continued: its rows are of {bookmark.get('content')}, now asked for are "
                             f"{self.content()}")
        self.written = bookmark["written"]
        if self.written is not None:
            on_rank_0(comm, lambda: self._truncate(bookmark["sizes"]))

    def _truncate(self, sizes: Sequence[int]) -> None:
        for file, size in zip(self.growing_files(), sizes):
            if not file.exists() or file.stat().st_size < size:
                raise ValueError(f"{file} cannot be continued: it is missing or shorter than at the checkpoint")
            os.truncate(file, size)
