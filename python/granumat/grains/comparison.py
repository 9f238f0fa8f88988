"""The law beside measured runs: scores of several sets of constants or closures, as words, tables and pictures."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import attempt, refuse
from ..files import replacing, write_table
from ..material import Material
from ..paths import material_table
from ..toml import read_toml
from .measured import Run, read_runs
from .predicted import Prediction, predict
from .scores import PHASES, QUANTITIES, Yardstick, root_mean_square

PRINTED = "printed"         # name of the law with the paper's constants and the default closure
SCATTER = "scatter"         # of the seeds, beside the names of models
HEADINGS = dict(zip(QUANTITIES, ("p", "ratio", "Z2", "A_xz", "N1/p", "N2/p", "phi")))
DIGITS = 3


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs, and what models of them give.

    Attributes
    ----------
    yardsticks : list of Yardstick
        One for each run.
    predictions : dict of str to list of Prediction
        Of each model, by its name, one for each run.
    """

    yardsticks: Sequence[Yardstick]
    predictions: Mapping[str, Sequence[Prediction]]

    @property
    def runs(self) -> list[Run]:
        """The runs."""
        return [yardstick.run for yardstick in self.yardsticks]

    def scores(self, model: str) -> np.ndarray:
        """Scores (runs, 5, 7) of a model by its name, by PHASES and QUANTITIES; those of the seeds' scatter by "scatter"."""
        if model == SCATTER:
            return np.array([yardstick.scatter_scores for yardstick in self.yardsticks])
        return np.array([yardstick.scores(prediction)
                         for yardstick, prediction in zip(self.yardsticks, self.predictions[model])])

    def rows(self) -> list[tuple[str, str, str, np.ndarray]]:
        """Rows of the table of scores: run, phase, model or "scatter", scores (7,); with several runs, all of them at the end."""
        models = [*self.predictions, SCATTER]
        scores = {model: self.scores(model) for model in models}
        names = [run.name for run in self.runs]
        if len(names) > 1:
            names.append(f"all {len(names)} runs")
            scores = {model: np.concatenate([of_runs, root_mean_square(of_runs)[None]]) for model, of_runs in scores.items()}
        return [(name, phase, model, scores[model][i, j]) for i, name in enumerate(names) for j, phase in enumerate(PHASES)
                for model in models if not np.isnan(scores[model][i, j]).all()]

    def __str__(self) -> str:
        """The scores as a table in words."""
        return self._in_words(self.rows())

    def total(self) -> str:
        """The scores over all runs as a table in words."""
        rows = self.rows()
        return self._in_words([row for row in rows if row[0] == rows[-1][0]])

    def _in_words(self, rows: Iterable[tuple[str, str, str, np.ndarray]]) -> str:
        about = dict(zip([run.name for run in self.runs], map(self._about, range(len(self.runs)))))
        width = max(len(model) for model in (*self.predictions, SCATTER))
        lines: list[str] = []
        last_run = last_phase = ""
        for run, phase, model, scores in rows:
            if run != last_run:
                lines += ["", *about.get(run, [f"{run}: root mean squares over the runs"]),
                          f"  {'':12}{'':{width}}" + "".join(f"{HEADINGS[name]:>8}" for name in QUANTITIES)]
            shown = "" if (run, phase) == (last_run, last_phase) else phase
            lines.append(f"  {shown:12}{model:{width}}" + "".join(f"{_in_digits(score):>8}" for score in scores))
            last_run, last_phase = run, phase
        return "\n".join(lines[1:])

    def _about(self, number: int) -> list[str]:
        """What is said above a run's scores."""
        run = self.runs[number]
        held = ", ".join(dict.fromkeys(run.controls))
        start = "its own steady shear" if run.start == "steady" else "the first row"
        lines = [f"{run.name}: mu {run.mu:g}, {run.contact}, phi {run.columns['phi'][0]:.4g}, held: {held}, "
                 f"{run.seeds} {'seed' if run.seeds == 1 else 'seeds'}, steady p {run.steady_pressure:.4g}; "
                 f"the law starts in {start}"]
        return lines + [f"  {model} {predictions[number].message}" for model, predictions in self.predictions.items()
                        if predictions[number].message]

    def write(self, directory: str | Path) -> list[Path]:
        """Write scores.csv, and for each run a table and a picture; return their names.

        Parameters
        ----------
        directory : path
            Is made if it is not there; files of these names in it are replaced.
        """
        from .pictures import run_figure
        directory = Path(directory)
        directory.mkdir(parents=True, exist_ok=True)
        written = [directory / "scores.csv"]
        with replacing(written[0]) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["run", "phase", "model", *QUANTITIES])
            table.writerows([run, phase, model, *(f"{score:.6g}" for score in scores)] for run, phase, model, scores in self.rows())
        for number, run in enumerate(self.runs):
            predictions = {model: of_runs[number] for model, of_runs in self.predictions.items()}
            written += [directory / f"{run.name}.csv", directory / f"{run.name}.png"]
            write_table(written[-2], _overlay(run, predictions), "%.8g")
            with replacing(written[-1]) as picture:
                run_figure(self.yardsticks[number], predictions).savefig(picture, dpi=130, format="png")
        return written


def _in_digits(score: float) -> str:
    return "-" if np.isnan(score) else f"{score:.{DIGITS}f}"


def _overlay(run: Run, predictions: Mapping[str, Prediction]) -> dict[str, np.ndarray]:
    """Columns of a run's table: strains, and each quantity as measured, its scatter, and as each model has it."""
    columns = {name: run.columns[name] for name in ("gamma", "gamma_total")}
    for name in QUANTITIES:
        if name in run.columns:
            columns[name] = run.columns[name]
            columns |= {f"{name} {SCATTER}": run.scatter[name]} if run.scatter else {}
        columns |= {f"{name} {model}": prediction.columns[name] for model, prediction in predictions.items()}
    return columns


def read_model(filename: str | Path) -> dict[str, Any]:
    """The table [material] of a TOML file, such as a path file: arguments of Material. mu and contact may be left to the runs."""
    content = read_toml(filename)
    if "material" not in content:
        raise ValueError(f"{filename}: has no table [material]")
    return material_table(content, Path(filename).parent)


def compare(runs: Iterable[Run | str | Path], models: Mapping[str, Mapping[str, Any]] | None = None, **keys: Any) -> Comparison:
    """Set models beside measured runs.

    Parameters
    ----------
    runs : iterable of Run, or of path
        What `read_runs` gives, or files for it.
    models : dict of str to dict, optional
        Arguments of Material by a name for them. mu and contact are those of each run: where they are given, they must be the same.
        The law with the paper's constants, "printed", is there in any case.
    **keys
        As in `read_runs`, for files.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        Names every fault of the data, or every model that cannot be made for a run or not start there.
    """
    given = list(runs)
    found = [run for run in given if isinstance(run, Run)]
    if len(found) < len(given) or not given:
        found += read_runs([run for run in given if not isinstance(run, Run)], **keys)
    beside = dict(models or {})
    faults = [f"a model cannot have the name {name!r}, which is taken" for name in (PRINTED, SCATTER) if name in beside]
    every: dict[str, Mapping[str, Any]] = {PRINTED: {}} | beside
    predictions = {name: [attempt(faults, f"{name}, {run.name}: ", _predict, run, options) for run in found]
                   for name, options in every.items()}
    refuse("the law cannot be compared", faults)
    return Comparison([Yardstick.of(run) for run in found],
                      {name: [prediction for prediction in of_runs if prediction] for name, of_runs in predictions.items()})


def _predict(run: Run, options: Mapping[str, Any]) -> Prediction:
    of_run = {"mu": run.mu, "contact": run.contact}
    refuse("the model is of other grains", [f"{name} = {options[name]!r}, but the run has {value!r}"
                                            for name, value in of_run.items() if options.get(name, value) != value])
    return predict(run, Material(**{**options, **of_run}))
