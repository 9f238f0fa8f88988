"""What can go wrong in a boundary-value problem."""

from ..errors import GranumatError


class SolveError(GranumatError):
    """A problem cannot be brought further; its message says where and why, the problem holds the last accepted increment."""


def in_words(x):
    """A position, such as (0.5, 1)."""
    return "(" + ", ".join(f"{value:.4g}" for value in x) + ")"
