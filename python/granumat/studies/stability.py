"""How large an increment each integration method bears: stability maps in pure shear at constant volume, measured with the core.

In pure shear (4.7) is one equation for x = A:S^, dx/ds = 2 c1 + c2 x + c3 x^2. Its stable root chi is the steady state; from above
the other root, the repeller, x grows without bound. The shear increment is gamma = 2 s, as in simple shear. `write_stability` tells
what is written.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from .. import tensors
from ..core import STATE
from ..errors import MaterialError
from ..files import replacing
from ..material import METHODS, Material
from .rate_form import steady_coordination

PHI = 0.6                                             # volume fraction of all states
S_HAT = np.array([0, 0, 0, 0, 1.0, 0])                # S^ of pure shear in x-z
TRANSVERSE = np.array([1.0, 0, -1, 0, 0, 0])          # a fabric of magnitude 1 with A:S^ = 0
GAMMAS = np.geomspace(0.005, 10, 256)                 # shear increments of the maps, 3 % apart
REPEATS = 200                                         # increments after which a perturbation must have decayed
PERTURBATION = 1e-3                                   # of the steady fabric
ELASTIC_STRAIN = 0.01                                 # e_r of the second limit, in which the stress can be unstable too
ACCURATE, ROUGH = 0.01, 0.1                           # errors of the fabric over kappa
ANGLES = np.linspace(0, np.pi, 33)                    # between a fabric and S^

# Outcomes of an increment, from good to bad: a wrong result is worse than an error that is reported.
OUTCOMES = ("error below 1 %", "error 1 to 10 %", "reported", "error above 10 %", "wrong sign")
COLOURS = ("#FFFFFF", "#CFE3F1", "#9A9A9A", "#F2B34C", "#C8371B")
LIMIT_COLUMNS = ("rough_above", "wrong_above", "wrong_sign_above", "reported_above")


# ---- measured --------------------------------------------------------------------------------------------------------

def advance(material: Material, states: np.ndarray, gammas: Any) -> tuple[np.recarray, np.ndarray]:
    """Advance states by increments of pure shear.

    Parameters
    ----------
    material : Material
    states : array (...) of dtype STATE
    gammas : array (...)
        Shear increments.

    Returns
    -------
    states : record array (...) of dtype STATE
        Points whose status is not 0 keep their old state.
    status : int array (...)
    """
    gradient = np.asarray(gammas, float)[..., None, None] / 2 * tensors.to_matrix(S_HAT)
    try:
        return material.update(states, gradient).view(np.recarray), np.zeros(np.shape(states), int)
    except MaterialError as failure:
        return failure.states, failure.status


def states_of(material: Material, fabrics: np.ndarray) -> np.recarray:
    """Jammed states (...) with given fabrics (..., 6)."""
    states = np.zeros(np.shape(fabrics)[:-1], STATE)
    states["fabric"] = fabrics
    states["coordination_number"], states["volume_fraction"] = material["Zc"] + 1, PHI
    return states.view(np.recarray)


def settles(material: Material, gammas: np.ndarray) -> np.ndarray:
    """Whether a perturbation of the steady state decays in repeated increments, for each size of increment (n,)."""
    z2 = steady_coordination(material.constants, PHI)
    steady = material.state(PHI, z2, material["lambda"] * S_HAT, S_HAT)                        # (A 9)
    states = np.tile(np.array(steady, STATE), len(gammas)).view(np.recarray)
    states["fabric"] *= 1 - PERTURBATION
    reported = np.zeros(len(gammas), bool)
    for _ in range(REPEATS):
        states, status = advance(material, states, gammas)
        reported |= status != 0
    settled = [np.abs(states[name] - steady[name]).max(1) < PERTURBATION * np.abs(steady[name]).max()
               for name in ("fabric", "stress")]
    return ~reported & np.all(settled, 0)


def stability_limit(material: Material) -> float:
    """The shear increment above which perturbations of the steady state grow; infinite if they decay up to 10."""
    gammas = np.geomspace(GAMMAS[0], GAMMAS[-1], 200)
    unstable = np.flatnonzero(~settles(material, gammas))
    if not unstable.size:
        return np.inf
    low, high = (gammas[unstable[0] - 1] if unstable[0] else 0.0), gammas[unstable[0]]
    while high - low > 1e-4 * high:
        trials = np.linspace(low, high, 12)[1:-1]
        stable = settles(material, trials)
        first = len(trials) if stable.all() else int(np.argmin(stable))
        low, high = ([low, *trials][first], [*trials, high][first])
    return high


def outcomes(materials: Sequence[Material], fabrics: np.ndarray, gammas: np.ndarray) -> np.ndarray:
    """Compare one increment of pure shear by each method with the exact update.

    Parameters
    ----------
    materials : list of Material
        They differ in their method only.
    fabrics : array (n, 6)
        At the start.
    gammas : array (m,)
        Shear increments.

    Returns
    -------
    int array (materials, n, m)
        Positions in OUTCOMES. A result that is not realisable, or from where the fabric can grow without bound, is never returned
        by the core; it counts as reported.
    """
    pairs = len(fabrics), len(gammas)
    states = states_of(materials[0], np.broadcast_to(np.asarray(fabrics)[:, None], (*pairs, 6)))
    increments = np.broadcast_to(gammas, pairs)
    exact, exact_status = advance(Material(**(materials[0].definition | {"method": "exact"})), states, increments)
    x_exact = tensors.contract(exact.fabric, S_HAT)
    result = np.empty((len(materials), *pairs), int)
    for outcome, material in zip(result, materials):
        found, status = advance(material, states, increments)
        error = tensors.magnitude(found.fabric - exact.fabric) / material["kappa"]
        outcome[:] = np.select([error < ACCURATE, error < ROUGH], [0, 1], 3)
        outcome[(tensors.contract(found.fabric, S_HAT) * x_exact < 0) & (error >= ROUGH)] = 4
        outcome[exact_status != 0] = 3                      # the exact update has no result, so any is wrong
        outcome[status != 0] = 2
    return result


def limits(outcome: np.ndarray, gammas: np.ndarray) -> np.ndarray:
    """The smallest increments at which outcomes are as LIMIT_COLUMNS say.

    Parameters
    ----------
    outcome : int array (..., m)
        Positions in OUTCOMES.
    gammas : array (m,)
        Shear increments.

    Returns
    -------
    array (..., 4)
        Infinite where there is none.
    """
    bad = [(outcome != 0) & (outcome != 2), (outcome == 3) | (outcome == 4), outcome == 4, outcome == 2]
    return np.stack([np.where(rows.any(-1), gammas[rows.argmax(-1)], np.inf) for rows in bad], -1)


# ---- files -----------------------------------------------------------------------------------------------------------

def write_stability(out: str | Path) -> list[Path]:
    """Measure how large an increment each method bears; write a figure and tables.

    stability.png shows everything. stability.csv has, for each method, the shear increment above which perturbations of the steady
    state grow, with e_r = 0 and with e_r = 0.01. stability-projection.csv and stability-size.csv have, for each method and state,
    the smallest increments whose result is rough (an error above 1 %), wrong (above 10 %), of the wrong sign, or reported as an
    error; the state is A = x/2 S^, or has a given abs(A) in the worst of all directions. `inf` stands for none up to 10.

    Parameters
    ----------
    out : path
        Directory; it is created if it does not exist.

    Returns
    -------
    list of pathlib.Path
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    materials = [Material(method=method) for method in METHODS]
    x, size = _projections(materials[0]), _sizes(materials[0])
    steady, elastic = ([stability_limit(Material(method=method, elastic_strain=value)) for method in METHODS]
                       for value in (0.0, ELASTIC_STRAIN))
    projected, sized = outcomes(materials, np.outer(x / 2, S_HAT), GAMMAS), _worst_of_directions(materials, size)
    files = [out / name for name in ("stability.png", "stability.csv", "stability-projection.csv", "stability-size.csv")]
    _figure(materials, steady, elastic, (x, projected), (size, sized)).savefig(files[0], dpi=130)
    _write(files[1], ("method", "unstable_above", f"unstable_above_with_elastic_strain_{ELASTIC_STRAIN}"),
           [(method, both) for method, *both in zip(METHODS, steady, elastic)])
    for file, name, states, found in ((files[2], "A:S^", x, projected), (files[3], "abs(A)", size, sized)):
        rows = [(method, [state, *row]) for method, outcome in zip(METHODS, found)
                for state, row in zip(states, limits(outcome, GAMMAS))]
        _write(file, ("method", name, *LIMIT_COLUMNS), rows)
    return files


def _projections(material: Material) -> np.ndarray:
    """Values of x = A:S^ from the steady state to just below the repeller."""
    return np.linspace(material["chi"], 2 * material["fabric_limit"], 128, endpoint=False)


def _sizes(material: Material) -> np.ndarray:
    return np.linspace(0, 1.3 * material["fabric_limit"], 64)           # without the limit itself, at which round-off decides


def _worst_of_directions(materials: Sequence[Material], sizes: np.ndarray) -> np.ndarray:
    directions = np.cos(ANGLES)[:, None] * S_HAT + np.sin(ANGLES)[:, None] * TRANSVERSE
    return np.max([outcomes(materials, np.outer(sizes, direction), GAMMAS) for direction in directions], 0)


def _write(file: Path, names: Sequence[str], rows: Sequence[tuple[str, Sequence[float]]]) -> None:
    """A table whose first column is text; an old file is replaced only once the new one is complete."""
    lines = [",".join(names), *(",".join([text, *(f"{value:.6g}" for value in values)]) for text, values in rows)]
    with replacing(file) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


Map = tuple[np.ndarray, np.ndarray]     # states along an axis, and outcomes (materials, states, gammas)


def _figure(materials: Sequence[Material], steady: Sequence[float], elastic: Sequence[float], projection: Map, size: Map) -> Figure:
    chi, limit = materials[0]["chi"], materials[0]["fabric_limit"]
    marks = (((chi, "steady"), (0, "isotropic"), (-chi, "reversed"), (2 * limit, "\n\nno return")),
             ((0, "isotropic"), (materials[0]["kappa"], "steady"), (limit, "\n\ncan blow up")))
    figure = Figure(figsize=(16, 9.5), layout="constrained")
    figure.suptitle("What one increment of pure shear gives, by its size (up) and the state it starts from (right)", fontsize=15)
    *rows, below = np.asarray(figure.subfigures(3, 1, height_ratios=(1, 1, 0.13))).tolist()
    axes = np.array([row.subplots(1, len(materials), sharey=True) for row in rows])
    for row, (states, found), ticks in zip(axes, (projection, size), marks):
        for column, material, outcome, stable, elastic_stable in zip(row, materials, found, steady, elastic):
            column.pcolormesh(states, GAMMAS, outcome.T, cmap=ListedColormap(COLOURS),
                              norm=BoundaryNorm(np.arange(len(COLOURS) + 1) - 0.5, len(COLOURS)), rasterized=True)
            column.set_yscale("log")
            column.set_xticks([place for place, _ in ticks], [f"{text}\n{place:.3g}" for place, text in ticks], fontsize=8)
            column.set_title(material.method, fontsize=12)
            column.grid(linewidth=0.3, color="0.5")
            _line(column, stable, "--", f"unstable above {stable:.3f}")
            _line(column, elastic_stable, ":", f"with $e_r$ = {ELASTIC_STRAIN}: {elastic_stable:.3f}")
            if not np.isfinite([stable, elastic_stable]).any():
                _say(column, 6.0, "stable at every increment")
        row[0].set_ylabel("shear increment $\\gamma$")
    rows[0].supxlabel("fabric along the flow, $A:\\hat S$", fontsize=11)
    rows[1].supxlabel("size of the fabric, $|A|$; the worst of all directions", fontsize=11)
    handles = [Patch(facecolor=colour, edgecolor="0.5", label=name) for colour, name in zip(COLOURS, OUTCOMES)]
    below.legend(handles=handles, loc="center", ncols=len(handles), frameon=False, fontsize=12,
                 title="error of the fabric after one increment, of its steady size $\\kappa$; dashed, dotted: above it the "
                       "steady state itself is unstable under repeated increments")
    return figure


def _line(axes: Axes, gamma: float, style: str, words: str) -> None:
    if np.isfinite(gamma):
        axes.axhline(gamma, color="k", linestyle=style, linewidth=1.2)
        _say(axes, gamma, words)


def _say(axes: Axes, gamma: float, words: str) -> None:
    axes.text(0.5, gamma, words, transform=axes.get_yaxis_transform(), ha="center", va="bottom", fontsize=9,
              bbox={"facecolor": "w", "edgecolor": "none", "alpha": 0.7, "pad": 1})
