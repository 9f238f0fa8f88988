"""Checks of what a user gives, for errors that name every wrong thing at once, with what was given and what is allowed."""

import difflib
from collections.abc import Sequence
from typing import TypeGuard

import numpy as np


def refuse(what: str, faults: Sequence[str]) -> None:
    """Raises ValueError naming all faults, if there are any."""
    if faults:
        raise ValueError(f"{what}:\n  " + "\n  ".join(faults))


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a real number (not a bool)."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def choose(kind: str, name: object, allowed: Sequence[str], faults: list[str]) -> int:
    """The position of a name among those allowed; what is wrong is appended to faults."""
    if name in allowed:
        return allowed.index(name)
    near = difflib.get_close_matches(str(name), allowed, 1)
    faults.append(f"{kind} {name!r}: must be one of {', '.join(allowed)}" + (f" (did you mean {near[0]!r}?)" if near else ""))
    return 0
