"""How plane waves about homogeneous shear grow, against wave number and angle, with and without a length.

The momentum balance and the law are linearised about simple shear, its state frozen, in plane strain; perturbations are
exp(growth t + i k n.x). Rates of the state are differences of the update itself over a vanishing strain, so all closures are
treated alike. docs/theory.md, section 12.6, has the equations.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from .. import tensors
from ..core import STATE
from ..material import TURNING, Material

MU, VOLUME_FRACTION = 0.5, 0.60
CLOSURES = ("basic", "full", "kinematic", "mobilised")
CASES = (("steady", 0.0), ("steady", 0.01), ("just reversed", 0.001))      # the flow, and e_r
LENGTH = 0.8                                 # l, in grain diameters
INERTIAL_NUMBER = 1e-3                       # shear rate times d sqrt(density of the grains/p): of quasi-static flow
WAVE_NUMBERS = np.geomspace(0.1, 1000, 17)   # k d
ANGLES = np.linspace(0, np.pi, 181)[:-1]     # of the wave vector, from the flow to the gradient direction
ZOOM, ZOOMS = 10, 3                          # the spacing of the angles is divided by so much, so many times, about the worst one
TIME = 1e-6                                  # over which rates are taken, in units of the shear rate's inverse
STEP = 1e-5                                  # of the differences, in all unknowns
RISE = 2.0                                   # of the worst growth over the last decade of wave numbers from which it is unbounded

BASIS = np.array([[2**-0.5, -2**-0.5, 0, 0, 0, 0], [-6**-0.5, -6**-0.5, 2 * 6**-0.5, 0, 0, 0],
                  *(2**-0.5 * np.eye(6)[k] for k in (3, 4, 5))])            # of deviators, orthonormal
UNKNOWNS = 12                                # five components of A, Z2, phi, five of the stress deviator, or of M
IN_PLANE = [0, 2]                            # of the velocity: flow and gradient direction


@dataclass(frozen=True)
class Linear:
    """A state under a velocity gradient: rates of the unknowns, and the stress (tension positive), by what they depend on."""

    gradient: np.ndarray                     # (3, 3)
    pressure: float
    rate_by_unknowns: np.ndarray             # (12, 12)
    rate_by_gradient: np.ndarray             # (12, 9)
    rate_by_nonlocal: np.ndarray             # (12,)
    stress_by_unknowns: np.ndarray           # (3, 3, 12)
    stress_by_gradient: np.ndarray           # (3, 3, 9)
    stress_by_nonlocal: np.ndarray           # (3, 3)


def linearise(material: Material, state: np.record, gradient: np.ndarray, has_length: bool) -> Linear:
    """Linearise the law at a state by central differences of updates.

    Parameters
    ----------
    material : Material
    state : record of dtype STATE
    gradient : array (3, 3)
        The velocity gradient, whose nonlocal rate of strain is its own.
    has_length : bool
        Whether the nonlocal strain is an argument of its own; without a length it is |D|.

    Returns
    -------
    Linear
    """
    followed = "direction" if material.closure in TURNING else "stress"
    unknowns = _unknowns(np.array([state]), followed)[0]
    magnitude = tensors.magnitude(tensors.to_voigt((gradient + gradient.T) / 2))

    def ends(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates and stresses at the unknowns, the gradient and m changed along directions (n, 12 + 9 + 1)."""
        y = unknowns + directions[:, :UNKNOWNS]
        states = np.zeros(len(y), STATE)
        states["fabric"], states[followed] = y[:, :5] @ BASIS, y[:, 7:] @ BASIS
        states["coordination_number"], states["volume_fraction"] = y[:, 5], y[:, 6]
        L = gradient + directions[:, UNKNOWNS:-1].reshape(-1, 3, 3)
        m = TIME * (magnitude + directions[:, -1]) if has_length else None
        new = material.update(states, TIME * L, nonlocal_strain=m)
        return (_unknowns(new, followed) - y) / TIME, tensors.to_matrix(new["stress"])

    directions = np.eye(UNKNOWNS + 10)
    plus, minus = ends(STEP * directions), ends(-STEP * directions)
    rates, stresses = ((one - other) / (2 * STEP) for one, other in zip(plus, minus))
    parts = [slice(0, UNKNOWNS), slice(UNKNOWNS, -1), -1]
    return Linear(gradient, float(-tensors.trace(ends(0 * directions)[1][0][[0, 1, 2], [0, 1, 2]]) / 3),
                  *(rates[part].T for part in parts), *(np.moveaxis(stresses[part], 0, -1) if part != -1 else stresses[-1]
                                                        for part in parts))


def _unknowns(states: np.ndarray, followed: str) -> np.ndarray:
    double = np.array([1, 1, 1, 2, 2, 2])
    return np.column_stack([states["fabric"] * double @ BASIS.T, states["coordination_number"], states["volume_fraction"],
                            states[followed] * double @ BASIS.T])


def growth(linear: Linear, wave_numbers: np.ndarray, angles: np.ndarray, length: float) -> np.ndarray:
    """Find the growth of the worst perturbation for each wave vector in the plane of shear.

    Parameters
    ----------
    linear : Linear
    wave_numbers : array (n,)
        k d.
    angles : array (m,)
        Of the wave vector, from the flow direction.
    length : float
        l/d; 0 for a state that was linearised without a length.

    Returns
    -------
    array (n, m)
        Per unit of the shear rate.
    """
    k, angle = np.meshgrid(wave_numbers, angles, indexing="ij")
    n = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    D = (linear.gradient + linear.gradient.T) / 2
    magnitude = np.sqrt((D * D).sum() / 2)
    density = INERTIAL_NUMBER**2 * linear.pressure
    change = np.zeros((*k.shape, 3, 3, len(IN_PLANE)), complex)             # of the velocity gradient by the velocity, i k v n
    for j, i in enumerate(IN_PLANE):
        change[..., i, :, j] = 1j * k[..., None] * n
    nonlocal_change = np.einsum("ij,...ijv->...v", D, change) / (2 * magnitude * (1 + (length * k)**2))[..., None]
    change = change.reshape(*k.shape, 9, -1)
    stress = np.einsum("ijg,...gv->...ijv", linear.stress_by_gradient, change) \
        + linear.stress_by_nonlocal[:, :, None] * nonlocal_change[..., None, None, :]
    matrix = np.zeros((*k.shape, UNKNOWNS + len(IN_PLANE), UNKNOWNS + len(IN_PLANE)), complex)
    matrix[..., :UNKNOWNS, :UNKNOWNS] = linear.rate_by_unknowns
    matrix[..., :UNKNOWNS, UNKNOWNS:] = linear.rate_by_gradient @ change \
        + linear.rate_by_nonlocal[:, None] * nonlocal_change[..., None, :]
    divergence = 1j * (k / density)[..., None, None]
    matrix[..., UNKNOWNS:, :UNKNOWNS] = divergence * np.einsum("...j,ijy->...iy", n, linear.stress_by_unknowns)[..., IN_PLANE, :]
    matrix[..., UNKNOWNS:, UNKNOWNS:] = divergence * np.einsum("...j,...ijv->...iv", n, stress)[..., IN_PLANE, :] \
        - linear.gradient[np.ix_(IN_PLANE, IN_PLANE)]
    return np.linalg.eigvals(matrix).real.max(-1)


def worst_growth(linear: Linear, found: np.ndarray, length: float) -> np.ndarray:
    """Find the growth of the worst wave vector in the plane of shear for each of WAVE_NUMBERS.

    Short waves may grow in a range of angles much narrower than the spacing of ANGLES: the search goes on about the worst of them,
    and about the worst found there.

    Parameters
    ----------
    linear : Linear
    found : array (wave numbers, angles)
        Of WAVE_NUMBERS and ANGLES.
    length : float
        As in `growth`.

    Returns
    -------
    array (wave numbers,)
    """
    worst = found.max(1)
    for i, k in enumerate(WAVE_NUMBERS):
        angle, spacing = ANGLES[found[i].argmax()], ANGLES[1]
        for _ in range(ZOOMS):
            angles = angle + spacing * np.linspace(-1, 1, 2 * ZOOM + 1)
            values = growth(linear, np.array([k]), angles, length)[0]
            angle, spacing = angles[values.argmax()], spacing / ZOOM
            worst[i] = max(worst[i], values.max())
    return worst


class Map(NamedTuple):
    """The growth of a closure in a flow, with and without a length."""

    closure: str
    flow: str
    elastic_strain: float
    length: float
    growth: np.ndarray                       # (wave numbers, angles)
    worst: np.ndarray                        # (wave numbers,), over all angles

    @property
    def is_bounded(self) -> bool:
        """Whether short waves grow no faster than longer ones."""
        decade = int(np.searchsorted(WAVE_NUMBERS, WAVE_NUMBERS[-1] / 10 * 0.999))
        return bool(self.worst[-1] < RISE * max(self.worst[decade], 1.0))


def growth_map(closure: str, flow: str, elastic_strain: float, length: float, mu: float = MU) -> Map:
    """Compute the growth about steady shear, or just after its reversal."""
    material = Material(mu, closure, elastic_strain=elastic_strain)
    gradient = np.zeros((3, 3))
    gradient[0, 2] = -1 if flow == "just reversed" else 1
    state = material.steady(material["phic"] + VOLUME_FRACTION - Material(MU)["phic"])
    linear = linearise(material, state, gradient, length > 0)
    found = growth(linear, WAVE_NUMBERS, ANGLES, length)
    return Map(closure, flow, elastic_strain, length, found, worst_growth(linear, found, length))


def study() -> list[Map]:
    """The maps of all closures and cases, without a length and with one."""
    return [growth_map(closure, flow, elastic_strain, length) for closure in CLOSURES for flow, elastic_strain in CASES
            for length in (0.0, LENGTH) if elastic_strain > 0 or closure not in TURNING]


# ---- files -----------------------------------------------------------------------------------------------------------

def write_maps(filename: Path, maps: Sequence[Map]) -> None:
    """Write the growth at every wave number and angle (in degrees)."""
    with open(filename, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("closure", "flow", "elastic_strain", "length", "wave_number", "angle", "growth"))
        for one in maps:
            for k, row in zip(WAVE_NUMBERS, one.growth):
                for angle, value in zip(np.degrees(ANGLES), row):
                    table.writerow((*one[:4], f"{k:.6g}", f"{angle:.4g}", f"{value:.5g}"))


def growth_in_words(maps: Sequence[Map]) -> str:
    """The table for the screen: the worst growth at wave numbers a decade apart."""
    decades = [int(np.argmin(abs(np.log(WAVE_NUMBERS / k)))) for k in (0.1, 1, 10, 100, 1000)]
    lines = [f"growth per unit of the shear rate at mu {MU:g}, worst over angles, by wave number k d",
             f"{'closure':10} {'flow':14} {'e_r':>6} {'l/d':>4} " + " ".join(f"{WAVE_NUMBERS[i]:9.3g}" for i in decades)]
    for one in maps:
        values = " ".join(f"{one.worst[i]:9.3g}" for i in decades)
        lines.append(f"{one.closure:10} {one.flow:14} {one.elastic_strain:6g} {one.length:4g} {values}  "
                     + ("bounded" if one.is_bounded else "UNBOUNDED"))
    return "\n".join(lines)


def draw(maps: Sequence[Map]) -> Figure:
    """Draw the growth over wave number and angle: a row for each closure, for each case without and with a length."""
    figure = Figure(figsize=(15, 10))
    figure.subplots_adjust(left=0.06, right=0.91, top=0.91, bottom=0.05, wspace=0.06, hspace=0.06)
    figure.suptitle(f"Growth of plane waves about simple shear, per unit of the shear rate ($\\mu$ = {MU:g}, l = {LENGTH:g} d)",
                    fontsize=11)
    columns = [(flow, elastic_strain, length) for flow, elastic_strain in CASES for length in (0.0, LENGTH)]
    panels = figure.subplots(len(CLOSURES), len(columns), sharex=True, sharey=True)
    for closure, row in zip(CLOSURES, panels):
        for (flow, elastic_strain, length), axes in zip(columns, row):
            found = [one for one in maps if one[:4] == (closure, flow, elastic_strain, length)]
            if closure == CLOSURES[0]:
                axes.set_title(f"{flow}, $e_r$ = {elastic_strain:g},\n{f'l = {length:g} d' if length else 'no length'}", fontsize=9)
            if not found:
                axes.text(0.5, 0.5, "needs $e_r > 0$", transform=axes.transAxes, ha="center", fontsize=8)
                continue
            image = axes.pcolormesh(WAVE_NUMBERS, np.degrees(ANGLES), found[0].growth.T, cmap="RdBu_r", shading="nearest",
                                    norm=SymLogNorm(1.0, vmin=-1e4, vmax=1e4), rasterized=True)
            axes.text(0.04, 0.9, "bounded" if found[0].is_bounded else "unbounded", transform=axes.transAxes, fontsize=8,
                      bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1})
        row[0].set_ylabel(f"{closure}\nangle of the wave vector\nto the flow (degrees)", fontsize=8)
    for axes in panels[-1]:
        axes.set_xscale("log")
        axes.set_xlabel("wave number k d", fontsize=8)
    figure.colorbar(image, cax=figure.add_axes((0.93, 0.2, 0.012, 0.6)), label="growth")
    return figure


def write_study(out: Path) -> tuple[list[Map], list[Path]]:
    """Compute all maps; write growth.csv and growth.png into a directory that exists.

    Parameters
    ----------
    out : path

    Returns
    -------
    maps : list of Map
    files : list of pathlib.Path
    """
    maps = study()
    files = [out / "growth.csv", out / "growth.png"]
    write_maps(files[0], maps)
    draw(maps).savefig(files[1], dpi=100)
    return maps, files
