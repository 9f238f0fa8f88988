"""Checks of what a user gives. One ValueError names all mistakes together, with what was given and what is allowed."""

import difflib
from collections.abc import Callable, Sequence
from typing import Any, TypeGuard, TypeVar

import numpy as np

T = TypeVar("T")


def refuse(what: str, faults: Sequence[str]) -> None:
    """Raise a ValueError that names all faults; do nothing if there are none.

    Parameters
    ----------
    what : str
        First line of the message, such as "the material cannot be made".
    faults : sequence of str
        One line each.

    Raises
    ------
    ValueError
        If there is at least one fault.
    """
    if faults:
        raise ValueError(f"{what}:\n  " + "\n  ".join(faults))


def attempt(faults: list[str], prefix: str, function: Callable[..., T], *arguments: Any) -> T | None:
    """Call a function whose mistakes are to be reported together with others.

    Parameters
    ----------
    faults : list of str
        Receives the prefix and the message if the function raises ValueError or OSError.
    prefix : str
    function : callable
    *arguments
        Of the function.

    Returns
    -------
    object or None
        The function's result; None after an error.
    """
    try:
        return function(*arguments)
    except (ValueError, OSError) as error:
        faults.append(prefix + str(error).replace("\n", "\n  "))
        return None


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a real number (not a bool); it may be infinite or not a number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def is_finite_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite real number."""
    return is_number(value) and bool(np.isfinite(value))


def is_positive_integer(value: object) -> TypeGuard[int]:
    """Whether a value is an integer (not a bool) of at least 1."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and bool(value >= 1)


def repetitions(kind: str, names: Sequence[object]) -> list[str]:
    """A fault for each text that stands more than once among the names of things of a kind."""
    texts = [name for name in names if isinstance(name, str)]
    return [f"the {kind} {name!r} is given {texts.count(name)} times" for name in dict.fromkeys(texts) if texts.count(name) > 1]


def choose(kind: str, name: object, allowed: Sequence[str], faults: list[str]) -> int:
    """Find a name among those that are allowed.

    Parameters
    ----------
    kind : str
        What the name stands for, in the message.
    name : object
        What was given.
    allowed : sequence of str
    faults : list of str
        Receives a message, with the most similar allowed name, if the name is not allowed.

    Returns
    -------
    int
        Position of the name in `allowed`; 0 if it is not there.
    """
    if isinstance(name, str) and name in allowed:
        return allowed.index(name)
    near = difflib.get_close_matches(str(name), allowed, 1)
    faults.append(f"{kind} {name!r}: must be one of {', '.join(allowed)}" + (f" (did you mean {near[0]!r}?)" if near else ""))
    return 0
