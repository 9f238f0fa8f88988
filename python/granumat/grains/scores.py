"""Errors of the law along measured runs, by quantity and by phase of the shear."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..material import Material
from .measured import Run
from .predicted import Prediction

QUANTITIES = ("p", "stress_ratio", "Z2", "A_xz", "N1/p", "N2/p", "phi")
# Phases: the shear strain since the last turn above which they begin, and up to which they last.
PHASES = {"all": (-1.0, np.inf), "steady": (np.finfo(float).max, np.inf), "first 0.1": (-1.0, 0.1), "0.1 to 0.5": (0.1, 0.5),
          "later": (0.5, np.finfo(float).max)}
# Share of the run's steady p that p must exceed where a quantity counts.
LEAST_PRESSURE = {"p": -np.inf, "stress_ratio": 0.2, "Z2": 0.05, "A_xz": 0.05, "N1/p": 0.2, "N2/p": 0.2, "phi": -np.inf}
# What a control prescribes does not count.
PRESCRIBED: dict[str, tuple[str, ...]] = {
    "volume": ("phi",), "pressure": ("p",), "normal-stresses": ("p", "N1/p", "N2/p"), "normal-load": ()}
STEADY_STRAIN = 0.1         # of steady rows over which p decorrelates, so that their mean is one of steady shear


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What errors along a run are measured by; made once for any number of predictions.

    Attributes
    ----------
    run : Run
    steady_pressure : float
        The run's p in steady shear, in k/d; NaN if p was not measured.
    scales : array (7,)
        Of the QUANTITIES: the steady p for p, kappa of the printed constants for A_xz, 1 for the others.
    measured : array (n, 7)
        What was measured, NaN where it does not count.
    scatter : array (n, 7)
        Standard deviations between seeds, NaN where they are not known.
    weights : array (5, n)
        Shear strain of each row in the PHASES.
    """

    run: Run
    steady_pressure: float
    scales: np.ndarray
    measured: np.ndarray
    scatter: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, run: Run) -> "Yardstick":
        """Make that of a run."""
        increments = np.abs(np.diff(run.columns["gamma"]))
        strain = (np.append(increments, 0) + np.insert(increments, 0, 0)) / 2
        since = run.since_turn
        weights = np.array([strain * ((since > first) & (since <= last)) for first, last in PHASES.values()])
        steady = _steady_pressure(run, weights)
        unknown = np.full(len(run), np.nan)
        p = run.columns.get("p", unknown)
        counts = np.array([~(p <= LEAST_PRESSURE[name] * steady) & ~_prescribed(run, name) for name in QUANTITIES]).T
        measured, scatter = (np.column_stack([columns.get(name, unknown) for name in QUANTITIES])
                             for columns in (run.columns, run.scatter))
        scales = np.ones(len(QUANTITIES))
        scales[QUANTITIES.index("p")] = steady
        scales[QUANTITIES.index("A_xz")] = Material(run.mu, contact=run.contact)["kappa"]
        return cls(run, steady, scales, np.where(counts, measured, np.nan), np.where(counts, scatter, np.nan), weights)

    def errors(self, prediction: Prediction) -> np.ndarray:
        """Errors (n, 7) of a prediction over the scales: NaN where they do not count, infinite where the law does not reach."""
        predicted = np.column_stack([prediction.columns[name] for name in QUANTITIES])
        return (np.where(np.isnan(predicted), np.inf, predicted) - self.measured) / self.scales

    def scores(self, prediction: Prediction) -> np.ndarray:
        """Root mean squares (5, 7) of the errors over the strain of the PHASES; NaN where nothing counts."""
        return self._mean_squares(self.errors(prediction))

    @property
    def scatter_scores(self) -> np.ndarray:
        """Root mean squares (5, 7) of the deviations of one seed from the mean, over the scales; NaN for a single seed."""
        return self._mean_squares(self.scatter / self.scales)

    def _mean_squares(self, errors: np.ndarray) -> np.ndarray:
        counts = ~np.isnan(errors)
        strains = self.weights @ counts
        with np.errstate(invalid="ignore"):                       # an infinite error where a phase has no strain
            squares = np.array([np.sum(np.where(counts & (weight[:, None] > 0), errors**2 * weight[:, None], 0), axis=0)
                                for weight in self.weights])
        return np.sqrt(np.divide(squares, strains, out=np.full(squares.shape, np.nan), where=strains > 0))


def _prescribed(run: Run, name: str) -> np.ndarray:
    """The rows (n,) in which a quantity is prescribed."""
    return np.isin(run.held, [control for control, names in PRESCRIBED.items() if name in names])


def _steady_pressure(run: Run, weights: np.ndarray) -> float:
    """The mean of p in steady shear and long after turns; without enough of these, that of a steady start, or of the whole run."""
    p = run.columns.get("p", np.full(len(run), np.nan))
    strain = dict(zip(PHASES, weights))
    settled = (strain["steady"] + strain["later"]) * ~np.isnan(p)
    if settled.sum() < STEADY_STRAIN and run.start == "steady" and not np.isnan(p[0]):
        return float(p[0])
    if settled.sum() < STEADY_STRAIN:
        settled = strain["all"] * ~np.isnan(p)
    return float(np.nansum(settled * np.nan_to_num(p)) / settled.sum()) if settled.any() else np.nan


def root_mean_square(scores: Sequence[np.ndarray]) -> np.ndarray:
    """Scores (5, 7) over several runs, which count alike; NaN where none of them has one."""
    squares = np.square(np.array(scores))
    counts = (~np.isnan(squares)).sum(axis=0)
    return np.sqrt(np.divide(np.nansum(squares, axis=0), counts, out=np.full(counts.shape, np.nan), where=counts > 0))
