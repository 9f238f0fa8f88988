"""Checks of what a user gives. One ValueError names all mistakes together, with what was given and what is allowed."""

import difflib
from collections.abc import Callable, Sequence
from typing import Any, TypeGuard, TypeVar

import numpy as np

T = TypeVar("T")

LARGEST_COUNT = 2**31 - 1
COUNT = f"an integer from 1 to {LARGEST_COUNT}"
SHORT = 80                          # characters of a value in a message


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
    """Whether a value is COUNT, an integer (not a bool) from 1 to what 32 bits can count."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and bool(1 <= value <= LARGEST_COUNT)


def real_array(name: str, value: object) -> np.ndarray:
    """An array of real numbers, float and contiguous, of what was given for it, without a copy if it is one.

    Raises
    ------
    TypeError
        It holds something else, such as complex numbers, texts or None, or it is masked.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name}: is a masked array, whose masked values would count: give an array without a mask")
    try:
        array = np.asarray(value)
    except ValueError:                                           # rows of different lengths
        array = np.empty(0, object)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} = {short(value)}: must be an array of real numbers" + (
            f", is one of dtype {array.dtype}" if array.dtype.kind in "cbV" else ""))
    return np.ascontiguousarray(array, float).reshape(array.shape)


def short(value: object) -> str:
    """A value for a message, cut if it is long."""
    words = " ".join(repr(value).split())
    return words if len(words) <= SHORT else words[:SHORT] + " ..."


def check_type(name: str, value: object, kind: type | tuple[type, ...], words: str) -> None:
    """TypeError if a value is not of a type, `words` for which say what it must be."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} = {short(value)}: must be {words}")


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
    by_lower = {entry.lower(): entry for entry in allowed}
    near = difflib.get_close_matches(str(name).lower(), by_lower, 1)
    faults.append(f"{kind} {name!r}: must be one of {', '.join(allowed)}" + (
        f" (did you mean {by_lower[near[0]]!r}?)" if near else ""))
    return 0
