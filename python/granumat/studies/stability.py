"""How large an increment each method stands: stability maps in pure shear at constant volume, measured with the core itself.

There the fabric equation (4.7) is one equation for x = A:S^, dx/ds = 2 c1 + c2 x + c3 x^2: steady state chi, no return above the
second root, the repeller. The shear increment is gamma = 2 s, as in simple shear. See `write_stability` for what comes out.
"""

from pathlib import Path

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from .. import tensors
from ..core import STATE
from ..errors import MaterialError
from ..material import METHODS, Material

S_HAT = np.array([0, 0, 0, 0, 1.0, 0])                # pure shear in x-z
TRANSVERSE = np.array([1.0, 0, -1, 0, 0, 0])          # a fabric across it: abs 1, no projection on S^
GAMMAS = np.geomspace(0.005, 10, 256)                 # shear increments looked at, 3 % apart
REPEATS = 200                                         # increments after which a perturbation must have decayed
PERTURBATION = 1e-3                                   # of the steady fabric
ELASTIC_STRAIN = 0.01                                 # e_r of the second limit: with it the stress can be unstable too
ACCURATE, ROUGH = 0.01, 0.1                           # errors, of kappa
ANGLES = np.linspace(0, np.pi, 33)                    # of a fabric to S^

# What an increment gives, from good to bad: what is wrong and returned is worse than what is reported.
OUTCOMES = ("error below 1 %", "error 1 to 10 %", "reported", "error above 10 %", "wrong sign")
COLOURS = ("#FFFFFF", "#CFE3F1", "#9A9A9A", "#F2B34C", "#C8371B")
LIMIT_COLUMNS = ("rough_above", "wrong_above", "wrong_sign_above", "reported_above")


# ---- measured --------------------------------------------------------------------------------------------------------

def advance(material, states, gammas):
    """States after increments `gammas` of pure shear, and the status of each: failing points keep their state."""
    gradient = np.asarray(gammas, float)[..., None, None] / 2 * tensors.to_matrix(S_HAT)
    try:
        return material.update(states, gradient), np.zeros(np.shape(states), int)
    except MaterialError as failure:
        return failure.states, failure.status


def states_of(material, fabrics):
    """States with given fabrics (..., 6), jammed at volume fraction 0.6; nothing but the fabric matters here."""
    states = np.zeros(np.shape(fabrics)[:-1], STATE)
    states["fabric"] = fabrics
    states["coordination_number"], states["volume_fraction"] = material["Zc"] + 1, 0.6
    return states.view(np.recarray)


def settles(material, gammas):
    """Whether a perturbation of the steady state decays in repeated increments, for each size of them."""
    phi = 0.6
    f = material["Zc"] + material["beta1"] * (phi - material["phic"]) ** material["beta2"]      # (4.9): Z2 as A:S^ = chi
    steady = material.state(phi, f, material["lambda"] * S_HAT, S_HAT)                         # (A 9)
    states = np.tile(np.array(steady, STATE), len(gammas)).view(np.recarray)
    states["fabric"] *= 1 - PERTURBATION
    reported = np.zeros(len(gammas), bool)
    for _ in range(REPEATS):
        states, status = advance(material, states, gammas)
        reported |= status != 0
    settled = [np.abs(states[name] - steady[name]).max(1) < PERTURBATION * np.abs(steady[name]).max()
               for name in ("fabric", "stress")]
    return ~reported & np.all(settled, 0)


def stability_limit(material):
    """The shear increment above which perturbations of the steady state grow; infinite if there is none up to 10."""
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


def outcomes(materials, fabrics, gammas):
    """What one increment gives, as positions in OUTCOMES (materials, fabrics, gammas), against the exact update.

    Materials that differ in their method only; fabrics (n, 6), gammas (m,). A method that leaves the realisable set, or gets
    where the fabric can blow up, counts as reported: the core returns neither.
    """
    pairs = len(fabrics), len(gammas)
    states = states_of(materials[0], np.broadcast_to(np.asarray(fabrics)[:, None], (*pairs, 6)))
    increments = np.broadcast_to(gammas, pairs)
    exact, gone = advance(Material(**(materials[0].definition | {"method": "exact"})), states, increments)
    x_exact = tensors.contract(exact.fabric, S_HAT)
    result = np.empty((len(materials), *pairs), int)
    for outcome, material in zip(result, materials):
        found, status = advance(material, states, increments)
        error = tensors.magnitude(found.fabric - exact.fabric) / material["kappa"]
        outcome[:] = np.select([error < ACCURATE, error < ROUGH], [0, 1], 3)
        outcome[(tensors.contract(found.fabric, S_HAT) * x_exact < 0) & (error >= ROUGH)] = 4
        outcome[gone != 0] = 3                              # returned where there is nothing to return
        outcome[status != 0] = 2
    return result


def limits(outcome, gammas):
    """The first shear increments (..., 4) at which outcomes (..., gammas) are as bad as LIMIT_COLUMNS; infinite where none is."""
    bad = [(outcome != 0) & (outcome != 2), (outcome == 3) | (outcome == 4), outcome == 4, outcome == 2]
    return np.stack([np.where(rows.any(-1), gammas[rows.argmax(-1)], np.inf) for rows in bad], -1)


# ---- written ---------------------------------------------------------------------------------------------------------

def write_stability(out):
    """Writes what each method stands as stability.png, and its numbers.

    stability.csv: per method, the shear increment above which perturbations of the steady state grow, also of its stress with an
    elastic strain scale. stability-projection.csv and stability-size.csv: per method and state, the first increments that are
    rough (1 %), wrong (10 %), of the wrong sign, or reported; the state is A = x/2 S^, or has abs(A) and the worst of all
    directions. `inf`: none up to 10.

    Parameters
    ----------
    out : path
        Directory; made if need be.

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
    paths = [out / name for name in ("stability.png", "stability.csv", "stability-projection.csv", "stability-size.csv")]
    _picture(materials, steady, elastic, (x, projected), (size, sized)).savefig(paths[0], dpi=130)
    _write(paths[1], ("method", "unstable_above", f"unstable_above_with_elastic_strain_{ELASTIC_STRAIN}"),
           [(method, both) for method, *both in zip(METHODS, steady, elastic)])
    for path, name, states, found in ((paths[2], "A:S^", x, projected), (paths[3], "abs(A)", size, sized)):
        rows = [(method, [state, *row]) for method, outcome in zip(METHODS, found)
                for state, row in zip(states, limits(outcome, GAMMAS))]
        _write(path, ("method", name, *LIMIT_COLUMNS), rows)
    return paths


def _projections(material):
    """x from the steady state to just below the repeller."""
    return np.linspace(material["chi"], 2 * material["fabric_limit"], 128, endpoint=False)


def _sizes(material):
    return np.linspace(0, 1.3 * material["fabric_limit"], 64)           # not the limit itself, where round-off decides


def _worst_of_directions(materials, sizes):
    directions = np.cos(ANGLES)[:, None] * S_HAT + np.sin(ANGLES)[:, None] * TRANSVERSE
    return np.max([outcomes(materials, np.outer(sizes, direction), GAMMAS) for direction in directions], 0)


def _write(path, names, rows):
    """A table, the first column text; the old file is replaced only by a complete one."""
    lines = [",".join(names), *(",".join([text, *(f"{value:.6g}" for value in values)]) for text, values in rows)]
    partial = path.with_name(path.name + ".part")
    partial.write_text("\n".join(lines) + "\n", encoding="utf-8")
    partial.replace(path)


def _picture(materials, steady, elastic, projection, size):
    chi, limit = materials[0]["chi"], materials[0]["fabric_limit"]
    marks = (((chi, "steady"), (0, "isotropic"), (-chi, "reversed"), (2 * limit, "\n\nno return")),
             ((0, "isotropic"), (materials[0]["kappa"], "steady"), (limit, "\n\ncan blow up")))
    figure = Figure(figsize=(16, 9.5), layout="constrained")
    figure.suptitle("What one increment of pure shear gives, by its size (up) and the state it starts from (right)", fontsize=15)
    *rows, below = figure.subfigures(3, 1, height_ratios=(1, 1, 0.13))
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


def _line(axes, gamma, style, words):
    if np.isfinite(gamma):
        axes.axhline(gamma, color="k", linestyle=style, linewidth=1.2)
        _say(axes, gamma, words)


def _say(axes, gamma, words):
    axes.text(0.5, gamma, words, transform=axes.get_yaxis_transform(), ha="center", va="bottom", fontsize=9,
              bbox={"facecolor": "w", "edgecolor": "none", "alpha": 0.7, "pad": 1})
