"""The law along the path of a measured run: the run's shear strains, and the stresses that it holds."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from .. import tensors
from ..core import STATE, status_message
from ..material import Material
from ..steps import CONTROLS, SHEAR, TOLERANCE, Step, controlled
from .measured import FABRIC, STRESSES, Run, with_ratios

SHEARED = 0.05              # stress ratio above which a packing counts as sheared before its first row


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the law gives along a run's path.

    Attributes
    ----------
    columns : dict of str to array (n,)
        phi, Z2, p, stress_ratio, N1/p, N2/p, A_xx ... A_yz and sigma_xx ... sigma_yz, compression positive, in the run's rows; NaN
        in rows that the law does not reach.
    message : str
        Why it does not reach the last row; empty if it does.
    """

    columns: Mapping[str, np.ndarray]
    message: str = ""


def predict(run: Run, material: Material, tolerance: float = TOLERANCE, start: np.record | None = None) -> Prediction:
    """Drive the law along the path of a run.

    The shear strains are those of the rows. Where stresses are held, they go from row to row as in the run, in the first increment
    from the law's own at its start.

    Parameters
    ----------
    run : Run
    material : Material
        Of the run's mu and contact.
    tolerance : float
        As in driver.run, where stresses are held.
    start : record of dtype STATE, optional
        The default is `first_state(run, material)`.

    Returns
    -------
    Prediction

    Raises
    ------
    ValueError
        The law cannot start at the run's first row.
    """
    states = np.zeros(len(run), STATE)
    state: np.record | np.void = first_state(run, material) if start is None else start
    states[0] = state
    reached, message = 1, ""
    for control, part in _parts(run):
        gradients = np.multiply.outer(np.diff(run.columns["gamma"])[part], SHEAR)
        step = Step(control, **controlled(control))
        values = np.column_stack([np.zeros((len(gradients), 0)), *(run.columns[name][1:][part] for name in CONTROLS[control][1])])
        targets = np.vstack([step.functionals @ state["stress"], values])
        found, _, status = material.follow(state, gradients, step.modes, step.functionals, targets, tolerance)
        states[reached:reached + len(found)] = found
        reached += len(found)
        if status:
            message = f"ends at gamma_total = {run.columns['gamma_total'][reached - 1]:.4g}: {status_message(status)}"
            break
        state = states[reached - 1]
    columns = columns_of(states)
    for column in columns.values():
        column[reached:] = np.nan
    return Prediction(columns, message)


def _parts(run: Run) -> list[tuple[str, slice]]:
    """The controls one after the other, and the increments during which each holds."""
    parts, first = [], 0
    for control, increments in groupby(run.controls):
        last = first + len(list(increments))
        parts.append((control, slice(first, last)))
        first = last
    return parts


def first_state(run: Run, material: Material) -> np.void | np.record:
    """The state in which the law starts: its own steady shear at the run's phi, or that of the run's first row.

    Of what the first row does not have, Z2 follows from p by (4.2), (4.4), and the fabric is 0. A row with a stress ratio is taken
    as one of simple shear in the sense of its shear stress, one without as an isotropic packing.
    """
    phi = float(run.columns["phi"][0])
    if run.start == "steady":
        return material.steady(phi)
    first = {name: float(column[0]) for name, column in run.columns.items()}
    fabric = tensors.deviator(np.array([first.get(name, 0.0) for name in FABRIC]))
    ratio = first.get("stress_ratio", 0.0)
    direction = np.sign(ratio) * (abs(ratio) > SHEARED) * tensors.symmetric(2 * SHEAR)
    Z2 = first.get("Z2", np.nan)
    if np.isnan(Z2):
        Z2 = _coordination_number(material, first.get("p", np.nan), fabric)
    return material.state(phi, Z2, fabric, direction)


def _coordination_number(material: Material, p: float, fabric: np.ndarray) -> float:
    """Z2 of a packing with a fabric (6,) under a pressure: the inverse of (4.2), (4.4)."""
    if material.closure == "critical":
        return float(material.coordination_number(p))
    hookean = max(p, 0.0) ** (2 / 3) if material.contact == "hertzian" else max(p, 0.0)
    return float(material["Zc"] + np.sqrt(hookean / (material["a1"] + material["a2"] * tensors.magnitude(fabric))))


def columns_of(states: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of states (n,) by their names in runs."""
    columns = {"phi": states["volume_fraction"], "Z2": states["coordination_number"]}
    columns |= dict(zip(FABRIC, states["fabric"].T)) | dict(zip(STRESSES, -states["stress"].T))
    return with_ratios({name: np.array(column) for name, column in columns.items()})
