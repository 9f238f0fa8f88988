"""Weighted, bounded, robust least squares for constants that the data need not determine, and what is then known of them.

Constants x are counted from where they start in units of their sizes, y = (x - start)/size. Least is

    sum_i w_i rho(r_i^2) + k |y|^2,    rho(z) = 2 (sqrt(1 + z) - 1),

with errors r over their noise. The second sum takes the start as a measurement whose standard deviation is PRIOR sizes. It settles
what the data do not, and next to what they do determine it is nothing: k is the variance of the errors' sum per unit of its
curvature, over PRIOR^2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

PRIOR = 1.0                 # standard deviation of the start, in sizes
FIRST_WEIGHT = 1e-3         # k as long as the noise is not known
STEP = 1e-3                 # of differences, in sizes
LEAST_NOISE = 1e-3          # of errors that the law follows as exactly as its path is computed
TOLERANCE = 1e-5            # relative change of the sum or of y at which a search ends,
ROUGH = 1e-2                # or one that is for the noise only
MOST_ROUNDS = 40            # iterations of a search
CORRELATED = 0.95           # correlation coefficients from which two constants count as one for the data


@dataclass(frozen=True)
class Constants:
    """Constants to be fitted, n of them.

    Attributes
    ----------
    names : tuple of str
    start, lower, upper, sizes : array (n,)
        Values at the start, bounds, and the sizes of changes that matter.
    """

    names: tuple[str, ...]
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sizes: np.ndarray

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest y (n,)."""
        return (self.lower - self.start) / self.sizes, (self.upper - self.start) / self.sizes

    def values(self, y: np.ndarray) -> dict[str, float]:
        """Constants by name."""
        inside = np.clip(self.start + self.sizes * y, self.lower, self.upper)
        return dict(zip(self.names, inside.tolist()))

    def among(self, names: Sequence[str]) -> np.ndarray:
        """Which (n,) of them have one of some names."""
        return np.isin(self.names, names)

    def part(self, which: np.ndarray) -> "Constants":
        """Those which (n,) are wanted."""
        return Constants(tuple(np.array(self.names)[which].tolist()), self.start[which], self.lower[which], self.upper[which],
                         self.sizes[which])


@dataclass(frozen=True)
class Sample:
    """What errors r (m,) are to a sum.

    Attributes
    ----------
    weights : array (m,)
    kinds : array (m,) of int
        Errors of a kind have the same noise and follow one another.
    """

    weights: np.ndarray
    kinds: np.ndarray


@dataclass(frozen=True)
class Fit:
    """The constants at the least sum, and what is known of them.

    Attributes
    ----------
    y : array (n,)
    jacobian : array (m, n)
        dr/dy.
    weight : float
        k.
    covariance : array (n, n)
        Of y; NaN for constants on their bounds.
    unseen : array (n, d)
        Directions of y that the data do not see: changes by which no error changes beyond its noise. Each has its largest
        component, 1, where the others have none.
    on_bounds : array (n,) of bool
    """

    y: np.ndarray
    jacobian: np.ndarray
    weight: float
    covariance: np.ndarray
    unseen: np.ndarray
    on_bounds: np.ndarray

    def correlated(self, names: Sequence[str]) -> list[tuple[str, str, float]]:
        """Pairs of constants that the data do not tell apart, with their correlation coefficients."""
        deviations = np.sqrt(np.diag(self.covariance))
        coefficients = self.covariance / np.multiply.outer(deviations, deviations)
        return [(names[i], names[j], float(coefficients[i, j])) for i in range(len(names)) for j in range(i + 1, len(names))
                if abs(coefficients[i, j]) > CORRELATED]


Errors = Callable[[np.ndarray], np.ndarray]       # errors r (m,) at y (n,)
Slopes = Callable[[np.ndarray], np.ndarray]       # dr/dy (m, n) at y (n,)


def remembered(function: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """A function of y (n,) that is not called again where it was called last."""
    latest = lru_cache(maxsize=1)(lambda y: function(np.array(y)))
    return lambda y: latest(tuple(y))


def fit(errors: Errors, sample: Sample, constants: Constants, y: np.ndarray) -> Fit:
    """Find the constants at which the sum is least: first roughly, with a weak hold on the start, then with the noise's.

    Parameters
    ----------
    errors : callable
        Finite errors (m,) over their noise at y (n,).
    sample : Sample
    constants : Constants
    y : array (n,)
        Where the search begins.

    Returns
    -------
    Fit
    """
    errors = remembered(errors)
    slopes = remembered(lambda y: differences(errors, y, constants))
    y = search(errors, slopes, sample, constants, FIRST_WEIGHT, y, ROUGH)
    weight = examine(errors(y), slopes(y), sample, constants, y).weight
    y = search(errors, slopes, sample, constants, weight, y)
    return examine(errors(y), (slopes(y) + differences(errors, y, constants, ahead=False)) / 2, sample, constants, y)


def robust(squares: np.ndarray) -> np.ndarray:
    """rho, rho', rho'' (3, m) of squared errors (m,)."""
    root = np.sqrt(1 + squares)
    return np.array([2 * (root - 1), 1 / root, -0.5 / root**3])


def search(errors: Errors, slopes: Slopes, sample: Sample, constants: Constants, weight: float, y: np.ndarray,
           tolerance: float = TOLERANCE) -> np.ndarray:
    """The y (n,) of the least sum, from another."""
    from scipy.optimize import least_squares
    n = len(constants.names)
    lower, upper = constants.bounds

    def of_data(z: np.ndarray) -> np.ndarray:
        """rho, rho', rho'' of the squares of all errors; the last n are y itself."""
        m = len(z) - n
        of_errors = sample.weights * robust(z[:m])
        return np.hstack([of_errors, weight * np.array([z[m:], np.ones(n), np.zeros(n)])])
    found = least_squares(
        lambda y: np.append(errors(y), y), np.clip(y, lower + STEP * 1e-3, upper - STEP * 1e-3),
        lambda y: np.vstack([slopes(y), np.eye(n)]), (lower, upper),
        loss=of_data, ftol=tolerance, xtol=tolerance, gtol=None, max_nfev=MOST_ROUNDS)
    return found.x


def differences(errors: Errors, y: np.ndarray, constants: Constants, ahead: bool = True) -> np.ndarray:
    """dr/dy (m, n), by differences ahead or behind that stay between the bounds."""
    lower, upper = constants.bounds
    steps = np.where(y + STEP > upper, -STEP, STEP) if ahead else np.where(y - STEP < lower, STEP, -STEP)
    here = errors(y)
    return np.column_stack([(errors(y + step) - here) / step.sum() for step in np.diag(steps)])


def examine(r: np.ndarray, jacobian: np.ndarray, sample: Sample, constants: Constants, y: np.ndarray) -> Fit:
    """What is known of constants at a least sum, by the errors (m,) and their slopes (m, n) there."""
    lower, upper = constants.bounds
    on_bounds = (y - lower < STEP) | (upper - y < STEP)
    n, free = len(y), ~on_bounds
    slopes = 1 / np.sqrt(1 + r**2)                               # rho'
    J = jacobian[:, free]
    curvature = (J.T * (sample.weights * slopes)) @ J
    scores = (J.T * (sample.weights**2 * _variances(slopes * r, sample, int(free.sum())))) @ J
    noise = float(np.trace(scores) / np.trace(curvature)) if curvature.any() else 1.0
    weight = noise / PRIOR**2
    inverse = np.linalg.inv(curvature + weight * np.eye(len(J.T)))
    covariance = np.full((n, n), np.nan)
    covariance[np.ix_(free, free)] = inverse @ (scores + weight * noise * np.eye(len(J.T))) @ inverse
    seen, directions = np.linalg.eigh(curvature)
    unseen = np.zeros((n, int((seen < weight).sum())))
    unseen[free] = _one_constant_each(directions[:, seen < weight])
    return Fit(y, jacobian, weight, covariance, unseen, on_bounds)


def _variances(r: np.ndarray, sample: Sample, n: int) -> np.ndarray:
    """Variances (m,) of errors r (m,), by kind; those of sums of errors that follow one another and are alike are larger."""
    variances = np.zeros(len(r))
    for kind in np.unique(sample.kinds):
        of_kind = r[sample.kinds == kind]
        square, inflation = of_kind @ of_kind, 1.0
        for lag in range(1, len(of_kind)):
            product = of_kind[lag:] @ of_kind[:-lag]
            if product <= 0:
                break
            inflation += 2 * product / square
        variances[sample.kinds == kind] = inflation * max(square / len(of_kind), LEAST_NOISE**2)
    return variances * (len(r) / max(len(r) - n, 1))


def _one_constant_each(directions: np.ndarray) -> np.ndarray:
    """A basis (n, d) of the space of directions (n, d), in which d constants stand in one of them only, with 1."""
    if not directions.size:
        return directions
    from scipy.linalg import qr
    pivots = qr(directions.T, pivoting=True, mode="r")[1][:directions.shape[1]]
    return directions @ np.linalg.inv(directions[pivots])
