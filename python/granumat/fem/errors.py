"""What can go wrong in a boundary-value problem."""

from ..errors import GranumatError


class SolveError(GranumatError):
    """A problem cannot be brought further; its message says where and why, the problem holds the last accepted increment."""
