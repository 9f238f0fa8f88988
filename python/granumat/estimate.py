"""How far runs are from each other and from what they converge to, and from which sign follows why."""

import itertools
from collections.abc import Sequence

import numpy as np

from .quantities import Quantity, are_same_times
from .runs import Result

ORDERS = (0.5, 2.0)                 # in the size of the increment or cell that are believed
SAFETY = 1.25                       # on an extrapolated error
LEAST_RATIO, LARGEST_RATIO = 1.3, 8.0       # of a difference to the next where sizes are halved: orders 0.5 to 2 and a little
BISECTIONS = 30                     # for the order
TINY = 1e-300                       # instead of 0 where something is divided by it
ROUND_OFF = 1e-10                   # relative errors below are none


def errors(result: Result, reference: Result, quantities: Sequence[Quantity]) -> np.ndarray:
    """Largest errors of quantities at common times, relative to their scales; infinite where a run failed.

    Parameters
    ----------
    result, reference : Result
    quantities : sequence of Quantity

    Returns
    -------
    array (quantities,)
    """
    if result.failure or reference.failure:
        return np.full(len(quantities), np.inf)
    return np.array([_error(quantity, result, reference) for quantity in quantities])


def _error(quantity: Quantity, result: Result, reference: Result) -> float:
    of_reference = reference.table[quantity.name]
    times, values = quantity.pick(result.table["t"], result.table[quantity.name])
    wanted_times, wanted = quantity.pick(reference.table["t"], of_reference)
    if quantity.at == "range":
        rows, others = common_rows(times, wanted_times)
        values, wanted = values[rows], wanted[others]
    difference = float(np.abs(values - wanted).max(initial=0.0))
    scale = quantity.scale_of(of_reference[np.isfinite(of_reference)])
    if not np.isfinite(difference):
        return np.inf
    return difference / scale if scale > 0 else (np.inf if difference > 0 else 0.0)


def common_rows(times: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of two increasing arrays of times at which they are the same."""
    nearest = np.abs(others[None, :] - times[:, None]).argmin(axis=1)
    rows = np.flatnonzero(are_same_times(times, others[nearest]))
    return rows, nearest[rows]


def remainders(differences: Sequence[np.ndarray], sizes: Sequence[float]) -> np.ndarray:
    """Errors of the finest of runs with smaller and smaller cells or increments.

    It is Richardson's extrapolation with three cautions. The order is believed between 0.5 and 2. A difference that is smaller than
    order 2 allows after the ones before it agrees by accident and is replaced by what order 2 gives. Where the differences do not
    fall as orders 0.5 to 2 have it, or there is only one, the order is 0.5.

    Parameters
    ----------
    differences : sequence of array (quantities,)
        Between neighbours, from the coarsest to the finest.
    sizes : sequence of float
        Of the cells or increments, one more than the differences; each about half of the one before.

    Returns
    -------
    array (quantities,)
    """
    return np.array([_remainder([float(difference) for difference in of_one], sizes) for of_one in zip(*differences)])


def _remainder(differences: Sequence[float], sizes: Sequence[float]) -> float:
    if not np.isfinite(differences).all():
        return np.inf
    believed = differences[0]
    for number, difference in enumerate(differences[1:], 1):
        believed = max(difference, believed / _ratio_of_differences(sizes[number - 1:number + 2], ORDERS[1]))
    if believed <= ROUND_OFF:
        return believed
    order = ORDERS[0]
    if _fall_regularly(differences):
        order = _order(differences[-2] / differences[-1], sizes[-3:])
    return SAFETY * believed / ((sizes[-2] / sizes[-1]) ** order - 1)


def _ratio_of_differences(sizes: Sequence[float], order: float) -> float:
    """The ratio of the differences between three sizes that an order gives."""
    coarse, middle, fine = (size**order for size in sizes)
    return (coarse - middle) / (middle - fine)


def _order(ratio: float, sizes: Sequence[float]) -> float:
    """The order within ORDERS that comes next to a ratio of differences between three sizes."""
    low, high = ORDERS
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if _ratio_of_differences(sizes, middle) < ratio else (low, middle)
    return (low + high) / 2


def _fall_regularly(differences: Sequence[float]) -> bool:
    """Whether each difference is smaller than the one before as the orders that are believed have it.

    Only the last one may not be too small, since it may be so by accident; the first meshes may be too coarse for any order.
    """
    ratios = [before / after if after > 0 else np.inf for before, after in itertools.pairwise(differences)]
    return bool(ratios) and min(ratios) >= LEAST_RATIO and ratios[-1] <= LARGEST_RATIO


# ---- localisation -------------------------------------------------------------------------------------------------------

NARROWING = 1.15                    # of the sheared share from one mesh to the next, from which it may be that it has no end
STEADY_NARROWING = 0.6              # of a narrowing to the one before, in logarithms, from which it has none


def keeps_narrowing(shares: Sequence[float | None]) -> bool:
    """Whether the share of a body that does half of the shear goes on falling as cells are halved: shear that localises.

    Parameters
    ----------
    shares : sequence of float
        From the coarsest mesh to the finest.
    """
    found = [share for share in shares if share is not None and share > 0]
    if len(found) < 3:
        return False
    falls = -np.diff(np.log(found))
    return bool(falls[-1] > np.log(NARROWING) and falls[-1] > STEADY_NARROWING * falls[-2])


def converge_for_sure(differences: Sequence[np.ndarray], small: np.ndarray) -> bool:
    """Whether quantities converge beyond doubt, although the shear localises: on four meshes at least, none by accident.

    Parameters
    ----------
    differences : sequence of array (quantities,)
        Between neighbours, from the coarsest to the finest.
    small : array (quantities,)
        Errors that do not matter.
    """
    if len(differences) < 3:
        return False
    return all(_fall_regularly(of_one) or SAFETY * max(of_one) / (2**ORDERS[0] - 1) <= bound
               for of_one, bound in zip(zip(*differences), small))


# ---- why a run differs --------------------------------------------------------------------------------------------------

MOST = 0.6                          # of the largest error: with less than that elsewhere it is where the error lies
TRANSIENT_STRAIN = 1.0              # after a kink, over which the microstructure follows
ELASTIC_STRAINS = 3.0               # times e_r, over which the stress relaxes
CLEAR = 0.3                         # of one error to another that counts as none beside it


def reason(result: Result, reference: Result, kinks: Sequence[float], elastic_strain: float) -> str:
    """Why a run differs from the reference, in words.

    Parameters
    ----------
    result, reference : Result
    kinks : sequence of float
        Pseudo-times at which what is prescribed changes its direction.
    elastic_strain : float
        e_r of the reference.
    """
    if result.failure:
        return f"cannot be computed: {result.failure.splitlines()[0]}"
    one, other = result.signature, reference.signature
    if not one or not other:
        return "its values differ"
    rows, others = common_rows(one["t"], other["t"])
    differences = {name: np.abs(one[name][rows] - other[name][others]) for name in ("p", "shear", "normal")}
    scale = max(float(np.abs(other["p"]).max()), float(np.abs(other["shear"]).max()), TINY)
    p, shear, normal = (differences[name].max(initial=0.0) / scale for name in ("p", "shear", "normal"))
    since = _strain_since(kinks, other["t"], other["strain"])[others]
    words = f"off by {p:.1%} (p), {shear:.1%} (shear stress), {normal:.1%} (normal stress differences), over the largest stress"
    if max(p, shear, normal) <= ROUND_OFF:
        return "the body's mean stresses are the same: it matters locally"
    if normal > p and shear < CLEAR * normal:                    # with one normal stress held, p follows from the others
        return f"normal stress differences: {words}"
    if elastic_strain > 0 and shear >= max(p, CLEAR * normal) and _is_early(differences["shear"], since,
                                                                           ELASTIC_STRAINS * elastic_strain):
        return f"elastic strain: the shear stress is off within {ELASTIC_STRAINS:g} e_r after a change of direction; {words}"
    for name, size, held in (("p", p, "p"), ("shear", shear, "the shear stress")):
        if size >= max(p, shear, normal / CLEAR) and _is_early(differences[name], since, TRANSIENT_STRAIN):
            return f"no transient: {held} is off within a strain of {TRANSIENT_STRAIN:g} after a change of direction; {words}"
    return f"throughout: {words}"


def _strain_since(kinks: Sequence[float], times: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Shear strain since the last kink before each time."""
    before = np.searchsorted(np.asarray(kinks, float), times - 1e-9 * np.maximum(1, times), side="right") - 1
    starts = np.interp(np.asarray(kinks, float), times, strain)
    return strain - np.where(before >= 0, starts[np.maximum(before, 0)], 0.0)


def _is_early(difference: np.ndarray, since: np.ndarray, strain: float) -> bool:
    """Whether a difference is large only within a strain after kinks, or in the first increment after them if that is longer.

    Where all of it is within that strain, whether it is large only in the first half.
    """
    first = np.concatenate([[True], np.diff(since) < 0])
    late = (since > strain) & ~first
    if not late.any():
        late = since > since.max() / 2
    return bool(late.any() and difference[~late].max(initial=0.0) > 0
                and difference[late].max(initial=0.0) < MOST * difference[~late].max(initial=0.0))
