"""What can go wrong while granumat computes. A ValueError is the caller's mistake; these errors are the material's."""

from typing import Any

import numpy as np


class GranumatError(Exception):
    """Base of the errors that granumat raises while it computes."""


class MaterialError(GranumatError):
    """At least one point cannot follow its increment of deformation.

    Attributes
    ----------
    status : int array (...)
        Status of every point; 0 for the points that could follow.
    states : record array (...) of dtype STATE
        The new states; where the status is not 0, the old one.
    """

    def __init__(self, message: str, status: np.ndarray, states: np.recarray) -> None:
        super().__init__(message)
        self.status = status
        self.states = states


class PathError(GranumatError):
    """A step of a load path cannot be completed.

    Attributes
    ----------
    history : granumat.driver.History
        Everything up to the last increment that was completed.
    """

    def __init__(self, message: str, history: Any) -> None:
        super().__init__(message)
        self.history = history


class InterruptedRunError(GranumatError):
    """SIGINT (Ctrl-C) or SIGTERM has ended a run; what was computed until then is kept."""


class UnmetConditionWarning(UserWarning):
    """The condition that was to end a step early was not met."""


class ConstrainedDeformationWarning(UserWarning):
    """The volume changes about as fast as the shape, but the paper's law is meant for abs(tr D^) << 1."""


class RepairedDataWarning(UserWarning):
    """Measured data were not as they should be, and could be used all the same."""
