"""What can go wrong, for `except`: ValueError is the caller's mistake, these are the material's."""


class GranumatError(Exception):
    """Base of the errors that granumat raises while it computes."""


class MaterialError(GranumatError):
    """A state cannot be brought over its increment.

    Attributes
    ----------
    status : int array
        Status of every point, 0 where all is well.
    states : record array
        The new states; where status is not 0, the old one.
    """

    def __init__(self, message, status, states):
        super().__init__(message)
        self.status = status
        self.states = states


class PathError(GranumatError):
    """A step of a path cannot be completed.

    Attributes
    ----------
    history : History
        Everything up to the last increment that was completed.
    """

    def __init__(self, message, history):
        super().__init__(message)
        self.history = history


class ConstrainedDeformationWarning(UserWarning):
    """The volume changes about as fast as the shape: the paper's law is meant for abs(tr D^) << 1."""
