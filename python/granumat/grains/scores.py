"""Errors of the law along measured runs, by quantity and by phase of the shear."""

from dataclasses import dataclass

import numpy as np

from ..material import Material
from .measured import Run
from .predicted import Prediction

QUANTITIES = ("p", "stress_ratio", "Z2", "A_xz", "N1/p", "N2/p", "phi")
# Phases: the shear strain since the last turn above which they begin, and up to which they last.
FINITE = float(np.finfo(float).max)
PHASES = {"all": (-1.0, np.inf), "steady": (FINITE, np.inf), "first 0.1": (-1.0, 0.1), "0.1 to 0.5": (0.1, 0.5),
          "later": (0.5, FINITE)}
ROUNDING = 1e-6             # of strains, at the ends of phases
# Share of the run's steady p that p must exceed where a quantity counts.
LEAST_PRESSURE = {"p": -np.inf, "stress_ratio": 0.2, "Z2": 0.05, "A_xz": 0.05, "N1/p": 0.2, "N2/p": 0.2, "phi": -np.inf}
# What a control prescribes does not count.
PRESCRIBED: dict[str, tuple[str, ...]] = {
    "volume": ("phi",), "pressure": ("p",), "normal-stresses": ("p", "N1/p", "N2/p"), "normal-load": ()}


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What errors along a run are measured by; made once for any number of predictions.

    Attributes
    ----------
    run : Run
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
        weights = np.array([strain * ((since > first + ROUNDING) & (since <= last + ROUNDING)) for first, last in PHASES.values()])
        unknown = np.full(len(run), np.nan)
        p = run.columns.get("p", unknown)
        counts = np.array([~(p <= LEAST_PRESSURE[name] * run.steady_pressure) & ~_prescribed(run, name) for name in QUANTITIES]).T
        measured, scatter = (np.column_stack([columns.get(name, unknown) for name in QUANTITIES])
                             for columns in (run.columns, run.scatter))
        scales = np.ones(len(QUANTITIES))
        scales[QUANTITIES.index("p")] = run.steady_pressure
        scales[QUANTITIES.index("A_xz")] = Material(run.mu, contact=run.contact)["kappa"]
        return cls(run, scales, np.where(counts, measured, np.nan), np.where(counts, scatter, np.nan), weights)

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
        counts, reached = ~np.isnan(errors), ~np.isinf(errors)
        strains = self.weights @ counts
        squares = self.weights @ np.where(counts & reached, np.nan_to_num(errors), 0) ** 2
        squares[self.weights @ ~reached > 0] = np.inf
        return np.sqrt(np.divide(squares, strains, out=np.full(squares.shape, np.nan), where=strains > 0))


def _prescribed(run: Run, name: str) -> np.ndarray:
    """The rows (n,) in which a quantity is prescribed."""
    return np.isin(run.held, [control for control, names in PRESCRIBED.items() if name in names])


def root_mean_square(scores: np.ndarray) -> np.ndarray:
    """Scores (5, 7) over those runs of (runs, 5, 7) that have one, which count alike; NaN where none has."""
    squares = np.square(scores)
    counts = (~np.isnan(squares)).sum(axis=0)
    return np.sqrt(np.divide(np.nansum(squares, axis=0), counts, out=np.full(counts.shape, np.nan), where=counts > 0))
