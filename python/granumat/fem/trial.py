"""Where an increment would lead, and what a problem has come to."""

from dataclasses import dataclass, field

import numpy as np


def _no_values() -> np.ndarray:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Trial:
    """Where displacements of an increment lead. It changes nothing of the problem, which may accept it.

    Attributes
    ----------
    t : float
        Pseudo-time at the end of the increment.
    duration : float
        Of the increment, in pseudo-time.
    u : array (nodes, d)
        Displacements in the increment.
    m : array (nodes)
        Nonlocal strain of the increment, empty without a length.
    states : record array (points) of dtype STATE
        This and the arrays below are empty if the displacements could not be evaluated.
    gradients : array (points, 3, 3)
        du_i/dx_j of the increment as the material takes it.
    volumes : array (cells, points per cell)
    stress : array (cells, points per cell, 6)
        The material's and that of the rate term.
    forces : array (cells, nodes per cell, d)
        What the cells' nodes need from outside: internal forces less loads.
    nonlocal_residuals : array (cells, nodes per cell)
        Of the equations of m.
    residual : float
        Norm of the residual forces, relative to that of the internal forces; with a length the root of the sum of its square and
        that of the equations of m, relative to the integrals of abs(D).
    force_residual : float
        The part of the forces in it.
    residuals : tuple of float
        Those of the Newton iterations that have led here, the first guess's first. Those of a second guess follow, where the first
        one has led nowhere.
    failure : str
        Empty if the increment is solved, else why it is not.
    """

    t: float
    duration: float
    u: np.ndarray
    m: np.ndarray = field(default_factory=_no_values)
    states: np.ndarray = field(default_factory=_no_values)
    gradients: np.ndarray = field(default_factory=_no_values)
    volumes: np.ndarray = field(default_factory=_no_values)
    stress: np.ndarray = field(default_factory=_no_values)
    forces: np.ndarray = field(default_factory=_no_values)
    nonlocal_residuals: np.ndarray = field(default_factory=_no_values)
    residual: float = np.inf
    force_residual: float = np.inf
    residuals: tuple[float, ...] = ()
    failure: str = ""

    @property
    def unknowns(self) -> np.ndarray:
        """u (nodes, d), with a length u and m (nodes, d + 1)."""
        return np.column_stack([self.u, self.m]) if len(self.m) else self.u


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What a problem has come to: everything that its continuation depends on besides what it was made of.

    Attributes are those of Problem. Arrays are shared with the problem, which replaces them and does not write into them.
    """

    t: float
    increments: int
    next_increment: float | None
    displacement: np.ndarray
    states: np.ndarray
    shear_strain: np.ndarray
    volume_strain: np.ndarray
    origin: np.ndarray | None
    last: Trial | None
    is_ahead: bool
