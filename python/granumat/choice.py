"""What is known of the rungs of a ladder, and the choice among them."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .coarsen import DIMENSION, MODEL, NUMERICS, Axis, Content, Rung
from .quantities import Quantity
from .runs import Result

LEAST_SAVING = 0.1                  # of the time, for which a cheaper rung is recommended


@dataclass(frozen=True)
class Finding:
    """What is known of a rung.

    Attributes
    ----------
    rung : Rung
    errors : array (quantities,)
        Of the rung alone, extrapolated.
    time : float
        Over that of the axis's first rung.
    reason : str
        Why it differs from the first rung.
    is_known : bool
        False if the budget ended before it was measured.
    """

    rung: Rung
    errors: np.ndarray
    time: float
    reason: str = ""
    is_known: bool = True


@dataclass(frozen=True)
class Study:
    """What is known of an axis.

    Attributes
    ----------
    axis : Axis
    findings : tuple of Finding
        The first is what the others are compared with.
    verdict : str
        Why none of the rungs can be recommended; empty if one can.
    is_complete : bool
        False if the budget ended before.
    remark : str
        What else is to be known of the axis.
    """

    axis: Axis
    findings: tuple[Finding, ...]
    verdict: str = ""
    is_complete: bool = True
    remark: str = ""


Choice = Mapping[str, Finding]                                   # by the axis's name


@dataclass
class Report:
    """What a climb has found.

    Attributes
    ----------
    quantities : list of Quantity
    tolerances : array (quantities,)
    studies : list of Study
        Of all axes but the constants.
    constants : list of Study
    choice : dict of str to Finding
        By axis, what is recommended.
    alone : dict of str to dict
        The choice for each quantity alone.
    top, recommended : Result
    file : Result or None
        Of the file as it is; None if the budget did not allow it.
    measured : array (quantities,)
        Errors of the recommendation against the top.
    of_top : array (quantities,)
        Extrapolated errors of the top itself, and those of the reduction of the dimension.
    of_file : array (quantities,)
        Errors of the file against the top.
    of_reduction : array (quantities,) or None
        The file against the same with its dimension reduced.
    content : dict
        What is recommended.
    runs, seconds : int, float
        The ladder's own cost.
    undecided : list of str
        What the budget did not allow.
    """

    quantities: list[Quantity]
    tolerances: np.ndarray
    studies: list[Study] = field(default_factory=list)
    constants: list[Study] = field(default_factory=list)
    choice: dict[str, Finding] = field(default_factory=dict)
    alone: dict[str, dict[str, Finding]] = field(default_factory=dict)
    top: Result | None = None
    recommended: Result | None = None
    file: Result | None = None
    measured: np.ndarray = field(default_factory=lambda: np.zeros(0))
    of_top: np.ndarray = field(default_factory=lambda: np.zeros(0))
    of_file: np.ndarray = field(default_factory=lambda: np.zeros(0))
    of_reduction: np.ndarray | None = None
    content: Content = field(default_factory=dict)
    runs: int = 0
    seconds: float = 0.0
    undecided: list[str] = field(default_factory=list)

    @property
    def predicted(self) -> np.ndarray:
        """Predicted errors (quantities,) of the recommendation."""
        return predicted(self.choice)

    @property
    def floor(self) -> np.ndarray:
        """Largest effect (quantities,) of the constants: a tolerance below it means nothing."""
        found = [finding.errors for study in self.constants for finding in study.findings[1:] if np.isfinite(finding.errors).all()]
        return np.max(found, axis=0) if found else np.zeros(len(self.quantities))

    @property
    def unknown(self) -> list[str]:
        """Numerical axes along which no rung can be recommended, or was looked at, so that their errors are not known."""
        return [study.axis.name for study in self.studies if study.axis.kind == NUMERICS
                and not self.choice.get(study.axis.name, study.findings[0]).is_known]

    @property
    def is_proved(self) -> bool:
        """Whether the recommendation's measured errors, with those of the top itself, are within the tolerances."""
        return bool((self.measured + self.of_top <= self.tolerances).all())


def predicted(choice: Choice) -> np.ndarray:
    """Errors of a choice: the sum of those of its rungs."""
    return np.sum([finding.errors for finding in choice.values()], axis=0)


def time_of(choice: Choice) -> float:
    """Time of a choice over that of all axes' first rungs: the product of those of its rungs."""
    return float(np.prod([finding.time for finding in choice.values()]))


def choose(studies: Sequence[Study], tolerances: np.ndarray, quantity: int | None = None) -> dict[str, Finding] | None:
    """The choice that takes the least time of those whose errors add up below the tolerances.

    A rung of the choice that saves less than 10 % against a better one gives way to it, if the sum still allows it. A symmetry that
    holds is used.

    Parameters
    ----------
    studies : sequence of Study
    tolerances : array (quantities,)
    quantity : int, optional
        The only one that matters.

    Returns
    -------
    dict of str to Finding, or None
        By axis; None if there is no such choice.
    """
    which = slice(None) if quantity is None else slice(quantity, quantity + 1)

    def allowed(choice: Choice) -> bool:
        return bool((predicted(choice)[which] <= tolerances[which]).all())

    names = [study.axis.name for study in studies]
    candidates = [study.findings[:1] if study.verdict else study.findings[-1:] if study.axis.kind == DIMENSION else study.findings
                  for study in studies]
    choices = [dict(zip(names, findings)) for findings in itertools.product(*candidates)]
    choices = [choice for choice in choices if allowed(choice)]
    if not choices:
        return None
    best = min(choices, key=time_of)
    for study, findings in sorted(zip(studies, candidates), key=lambda pair: pair[0].axis.kind != MODEL):
        for finding in findings:                                 # from the best
            if finding is best[study.axis.name]:
                break
            better = {**best, study.axis.name: finding}
            if best[study.axis.name].time > (1 - LEAST_SAVING) * finding.time and allowed(better):
                best = better
                break
    return best
