"""Runs of a path or a scene as the rungs of a ladder need them: what comes out of one, and a directory of runs that are kept."""

import hashlib
import json
import re
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TextIO, TypeVar

import numpy as np

from . import __version__, driver, tensors
from .coarsen import Content, bare, referred_files, relocated
from .errors import GranumatError, InterruptedRunError, PathError
from .files import replacing
from .paths import read_path_file
from .quantities import Quantity
from .toml import write_content

T = TypeVar("T")

RESULT = "result.json"
SHORT_SECONDS, REPETITIONS = 0.2, 25        # runs are repeated until they have taken so much time, or so often; the median counts
HASH_LENGTH = 9                             # characters of a hash that keep the names of directories apart


@dataclass(frozen=True)
class Result:
    """What comes out of a run.

    Attributes
    ----------
    table : dict of str to array (n,)
        Pseudo-times "t", and the quantities by name.
    seconds : float
        The run's own time.
    signature : dict of str to array (n,)
        "t", and as means where the body is sheared: "strain", the accumulated shear strain, "p", "shear" and "normal", the
        deviatoric stress along the direction of straining and across it. From them follows why another run differs.
    share : float or None
        The share of the body that does half of the shear; None at a point.
    unstable : bool
        Whether the transverse modulus became negative somewhere.
    failure : str
        Why the run did not come to its end; empty if it did.
    """

    table: dict[str, np.ndarray]
    seconds: float
    signature: dict[str, np.ndarray]
    share: float | None = None
    unstable: bool = False
    failure: str = ""

    def to_json(self) -> dict[str, Any]:
        """The result as JSON has it."""
        columns = {name: {key: values.tolist() for key, values in getattr(self, name).items()} for name in ("table", "signature")}
        return {**vars(self), **columns}

    @staticmethod
    def from_json(values: dict[str, Any]) -> "Result":
        """The result that `to_json` gave."""
        columns = {name: {key: np.array(column, float) for key, column in values[name].items()} for name in ("table", "signature")}
        return Result(**{**values, **columns})


class Runner(Protocol):
    """Runs contents; what it gives is the same on all ranks."""

    quantities: list[Quantity]          # of the file
    kinks: tuple[float, ...]            # pseudo-times at which what is prescribed changes its direction, the start included

    def run(self, content: Content, directory: Path) -> Result:
        """Runs a content in a directory, or goes on in it; ValueError if the content is wrong."""
        ...

    def on_one(self, function: Callable[[], T]) -> T:
        """What a function returns on one rank, on all of them."""
        ...


class BudgetSpent(Exception):
    """No more runs are allowed."""


class Runs:
    """The runs of a ladder, each in a directory of its own, and none of them twice.

    Parameters
    ----------
    runner : Runner
    directory : path
        Of the ladder; the runs are in its directory `runs`.
    source : path
        Directory of the file, where those that it refers to are looked for.
    budget : int, optional
        How many runs there may be, also counting those of an earlier climb in this directory that are needed again.
    progress : text stream, optional
        Receives a line for each run.

    Attributes
    ----------
    count : int
        How many there were.
    seconds : float
        Their time.
    """

    def __init__(self, runner: Runner, directory: str | Path, source: str | Path = Path(), budget: int | None = None,
                 progress: TextIO | None = None) -> None:
        self.runner, self.directory, self.source = runner, Path(directory), Path(source)
        self.budget, self.progress = budget, progress
        self.seconds = 0.0
        self.reserve = 0                # runs of the budget that are kept for the end
        self._results: dict[str, Result] = {}

    @property
    def count(self) -> int:
        return len(self._results)

    def get(self, content: Content, name: str) -> Result:
        """The result of a content, from memory, from the directory, or of a new run.

        Parameters
        ----------
        content : dict
        name : str
            Of the run, in words.

        Raises
        ------
        BudgetSpent
        """
        content = bare(content)
        key = self.runner.on_one(lambda: self._hash(content))
        if key not in self._results:
            if self.budget is not None and self.count >= self.budget - self.reserve:
                raise BudgetSpent
            directory = self.directory / "runs" / f"{re.sub('[^a-z0-9.]+', '-', name.lower()).strip('-')}-{key[:HASH_LENGTH]}"
            found = self.runner.on_one(lambda: self._read(directory, key))
            self._results[key] = found or self._run(content, directory, key, name)
            self.seconds += self._results[key].seconds
        return self._results[key]

    def _hash(self, content: Content) -> str:
        digest = hashlib.sha256(json.dumps([__version__, content], sort_keys=True).encode())
        for name in referred_files(content):
            digest.update((self.source / name).read_bytes())
        return digest.hexdigest()

    def _read(self, directory: Path, key: str) -> Result | None:
        try:
            values = json.loads((directory / RESULT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            values = {}
        return Result.from_json(values["result"]) if values.get("hash") == key else None

    def _run(self, content: Content, directory: Path, key: str, name: str) -> Result:
        start = time.monotonic()

        def prepare() -> None:
            mark = directory / "hash"                            # so that only a run of the same content is gone on with
            if not mark.exists() or mark.read_text() != key:
                shutil.rmtree(directory, ignore_errors=True)
                directory.mkdir(parents=True)
                mark.write_text(key)
        self.runner.on_one(prepare)
        try:
            result = self.runner.run(relocated(content, lambda file: (self.source / file).resolve()), directory)
        except InterruptedRunError as error:
            raise InterruptedRunError(f"{error}; the ladder goes on from there when it is called again") from None

        def keep() -> None:
            with replacing(directory / RESULT) as partial:
                partial.write_text(json.dumps({"hash": key, "result": result.to_json()}), encoding="utf-8")
            if self.progress is not None:
                words = "failed" if result.failure else f"{result.seconds:.3g} s"
                of = "" if self.budget is None else f" of at most {self.budget}"
                print(f"run {self.count + 1}{of}, {name}: {words} ({time.monotonic() - start:.3g} s of waiting)",
                      file=self.progress, flush=True)
        self.runner.on_one(keep)
        return result


class PointRunner:
    """Runs path files.

    Parameters
    ----------
    file : path
        The file that is to be made coarser.

    Attributes
    ----------
    quantities : list of Quantity
        Of the file.
    """

    def __init__(self, file: str | Path) -> None:
        path = read_path_file(file)
        self.quantities: list[Quantity] = list(path.quantities)
        self.kinks = tuple(float(number) for number in range(len(path.steps)))

    def run(self, content: Content, directory: Path) -> Result:
        """Runs a path; short ones several times."""
        write_content(directory / "path.toml", content)
        try:
            path = read_path_file(directory / "path.toml")
        except ValueError as error:
            return Result({}, 0.0, {}, failure=str(error))
        seconds: list[float] = []
        failure = ""
        while not seconds or (len(seconds) < REPETITIONS and sum(seconds) < SHORT_SECONDS and not failure):
            start = time.process_time()
            try:
                history = driver.run(path.material, path.state, path.steps, tolerance=path.tolerance, acoustic=path.acoustic)
            except PathError as error:
                history, failure = error.history, str(error)
            except InterruptedRunError:
                raise
            except GranumatError as error:
                return Result({}, 0.0, {}, failure=str(error))
            seconds.append(time.process_time() - start)
        table = {"t": history.times} | {quantity.name: history[quantity.of] for quantity in path.quantities}
        return Result(table, float(np.median(seconds)), signature_of_history(history), failure=failure)

    def on_one(self, function: Callable[[], T]) -> T:
        """There is one rank only."""
        return function()


def signature_of_history(history: driver.History) -> dict[str, np.ndarray]:
    """The signature of a point's history, as in Result."""
    shear, normal = split_stress(history.states["stress"], history.states["direction"])
    return {"t": history.times, "strain": history["gamma_total"], "p": history["p"], "shear": shear, "normal": normal}


def split_stress(stress: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The deviatoric stress along the direction of straining, and the magnitude of what is across it.

    Parameters
    ----------
    stress, direction : array (n, 6)
        Voigt components, tension positive.

    Returns
    -------
    shear, normal : array (n,)
        In the measure sqrt(X:X/2). The first is negative right after a reversal, where the stress still has the old direction.
    """
    deviator, along = tensors.deviator(stress), tensors.deviator(direction)
    size = tensors.magnitude(along)
    along = along / np.where(size > 0, size, 1.0)[..., None]
    shear = tensors.contract(deviator, along) / 2
    return shear, tensors.magnitude(deviator - shear[..., None] * along)
