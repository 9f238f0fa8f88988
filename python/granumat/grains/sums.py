"""The errors of the law along measured runs as a fit counts them: means over bins of equal strain, over the scatter of packings."""

from collections.abc import Sequence

import numpy as np

from .fitting import Sample
from .measured import Run
from .predicted import Prediction
from .scores import QUANTITIES, ROUNDING, Yardstick

# The scatter of one run of 2000 spheres, over the scales of scores, where no run has several seeds.
SCATTER = dict(zip(QUANTITIES, (0.1, 0.017, 0.08, 0.08, 0.04, 0.03, 0.002)))
LEAST_SCATTER = 1e-4
# Phases since the last turn, and the widths of their bins: 20 in each of the first two, and all phases count alike.
PHASE_ENDS = (0.1, 0.5)
BIN_WIDTHS = (0.005, 0.02, 0.05)
UNREACHED = 30.0            # error over the scatter where the law does not come; no other counts more, such as a ratio at p = 0


class Sums:
    """Means of errors over bins, (m,) for all runs one after the other.

    Parameters
    ----------
    yardsticks : list of Yardstick
        Of the runs.

    Attributes
    ----------
    scatter : array (7,)
        Standard deviation that one packing has, by QUANTITIES over the scales of scores: the median over runs of several seeds. A
        run whose own is larger, such as one that liquefies, has that.
    quantities : array (m,) of int
        Which of QUANTITIES a mean is of.
    sample : Sample
        Errors of a quantity in a phase of a run are of one kind.
    """

    def __init__(self, yardsticks: Sequence[Yardstick]) -> None:
        self.yardsticks = yardsticks
        self._scatter = np.array([yardstick.scatter_scores[0] for yardstick in yardsticks])
        self.scatter = np.array([np.median(known) if (known := of_runs[~np.isnan(of_runs)]).size else SCATTER[name]
                                 for name, of_runs in zip(QUANTITIES, self._scatter.T)]).clip(LEAST_SCATTER)
        self._means: list[list[np.ndarray]] = []                 # of each run and quantity: shares (bins, n) of rows
        parts, weights = [], []
        for number, yardstick in enumerate(yardsticks):
            phases, bins = bins_of(yardstick.run)
            means = []
            for kind, measured in enumerate(yardstick.measured.T):
                shares = (bins == np.unique(bins)[:, None]) * yardstick.weights[0] * ~np.isnan(measured)
                counts = shares.sum(axis=1) > 0
                shares, phase = shares[counts], np.array([phases[bins == number][0] for number in np.unique(bins)[counts]], int)
                means.append(shares / shares.sum(axis=1, keepdims=True))
                alike = (phase == phase[:, None]).sum(axis=1) * len(np.unique(phase))
                weights.append(1 / alike)
                parts.append(np.stack([np.full_like(phase, number), np.full_like(phase, kind), phase]))
            self._means.append(means)
        self._runs, self.quantities, phases = np.hstack(parts)
        kinds = np.unique([self._runs, self.quantities, phases], axis=1, return_inverse=True)[1].reshape(-1)
        self.sample = Sample(np.hstack(weights), kinds)

    def rows(self, runs: Sequence[int]) -> np.ndarray:
        """Which (m,) of all means are of some runs."""
        return np.isin(self._runs, runs)

    def errors(self, number: int, prediction: Prediction | None) -> np.ndarray:
        """Means for a run of the errors of a prediction, over the scatter that they have; None for a law that cannot start."""
        yardstick, means = self.yardsticks[number], self._means[number]
        if prediction is None:
            return np.full(sum(map(len, means)), UNREACHED)
        scatter = np.fmax(self.scatter, self._scatter[number]) * np.sqrt((1 + 1 / yardstick.run.seeds) / 2)
        errors = yardstick.errors(prediction) / scatter
        errors = np.clip(np.nan_to_num(errors), -UNREACHED, UNREACHED)
        return np.concatenate([shares @ column for shares, column in zip(means, errors.T)])


def bins_of(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Phases (n,) and bins (n,) of the rows of a run, both numbered; a bin has no turn inside."""
    since, total = run.since_turn, run.columns["gamma_total"]
    turns = np.cumsum(np.append(False, since[1:] < since[:-1] - ROUNDING))
    place = np.where(np.isinf(since), total, since) - ROUNDING
    phases = np.where(np.isinf(since), len(PHASE_ENDS), np.digitize(place, PHASE_ENDS))
    begins = np.where(np.isinf(since), 0, np.append(0, PHASE_ENDS)[phases])
    numbers = np.maximum((place - begins) // np.array(BIN_WIDTHS)[phases], 0)
    bins = np.unique(np.column_stack([turns, phases, numbers]), axis=0, return_inverse=True)[1].reshape(-1)
    return phases, bins
