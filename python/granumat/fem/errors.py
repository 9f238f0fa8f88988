"""What can go wrong in a boundary-value problem."""

from collections.abc import Iterable

from ..errors import GranumatError


class SolveError(GranumatError):
    """An increment cannot be solved. The message says where and why; the problem is as the last accepted increment left it."""


def format_position(x: Iterable[float]) -> str:
    """A position for a message, such as (0.5, 1)."""
    return "(" + ", ".join(f"{value:.4g}" for value in x) + ")"
