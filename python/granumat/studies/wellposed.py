"""Where each closure loses ellipticity after a reversal of shear at constant volume: curves, a table and a figure."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from .. import driver
from ..material import TURNING, Material
from .colours import BLUE, GREEN, GREY, ORANGE, PURPLE, RED

MUS = (0.0, 0.1, 0.3, 0.5, 1.0)
ELASTIC_STRAINS = (0.0, 0.01)
CLOSURES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {            # name -> arguments of Material, style of the line
    "basic": ({"closure": "basic"}, {"color": RED}),
    "n2": ({"closure": "n2"}, {"color": ORANGE, "linestyle": "--"}),
    "full figure-16": ({"closure": "full", "calibration": "figure-16"}, {"color": PURPLE}),
    "full table-1": ({"closure": "full"}, {"color": BLUE}),
    "full text": ({"closure": "full", "calibration": "text"}, {"color": GREY, "linestyle": "--"}),
    "kinematic": ({"closure": "kinematic"}, {"color": GREEN}),
    "mobilised": ({"closure": "mobilised"}, {"color": "black"}),
    "mobilised-pressure": ({"closure": "mobilised-pressure"}, {"color": "black", "linestyle": ":"}),
}
DISTANCE = 0.60 - Material(0.5)["phic"]      # phi - phic of all curves: the same for all mu, so that pressures are similar
FIRST_STRAIN = 1e-6                          # shear strain of the first increment: just after the reversal
STRAIN, INCREMENTS = 1.0, 500                # shear strain after the reversal
ROUND_OFF = 1e-10                            # size above which a negative value counts as negative
DEEP = 2e-3                                  # over three times the size in steady shear (e_r = 0); in p, or p/e_r for e_r > 0
ANGLES = np.linspace(0, np.pi, 361)          # of normals in the plane of shear
MEASURES = ("eta_t", "eigenvalue", "determinant", "in_plane")
CURVES = ("gamma", *MEASURES, "n_x", "n_y", "n_z")


class Curve(NamedTuple):
    """Measures of ellipticity of a closure against the strain after the reversal."""

    mu: float
    closure: str
    elastic_strain: float
    columns: dict[str, np.ndarray]      # CURVES -> array (n,)
    steady: dict[str, float]            # MEASURES -> value before the reversal

    def loss(self, measure: str) -> dict[str, float]:
        """How far and how long a measure is negative, by the names of LOSS."""
        gamma, values = self.columns["gamma"], self.columns[measure]
        scale = self.elastic_strain if self.elastic_strain and measure == "eigenvalue" else 1.0
        deep = values * scale < -DEEP
        negative = values < -ROUND_OFF
        return {"after_reversal": values[0], "least": np.fmin.reduce(values), "steady": self.steady[measure],
                "first": gamma[negative][0] if negative.any() else np.nan, "duration": _duration(gamma, negative),
                "duration_deep": _duration(gamma, deep) if measure != "determinant" else np.nan}


LOSS = ("after_reversal", "least", "steady", "first", "duration", "duration_deep")


def in_plane(material: Material, states: np.ndarray) -> np.ndarray:
    """Find the smallest (v n):C:(v n) with v and n in the plane of shear, which decides on ellipticity in plane strain.

    Parameters
    ----------
    material : Material
        With e_r = 0.
    states : record array (n,) of dtype STATE

    Returns
    -------
    array (n,)
        In units of p.
    """
    strain = np.zeros((len(ANGLES), 6))                         # engineering components of v n, v normal to n
    strain[:, 2] = np.sin(2 * ANGLES) / 2
    strain[:, 0] = -strain[:, 2]
    strain[:, 4] = np.cos(2 * ANGLES)
    return np.einsum("ai,nik,ak->na", strain, material.response(states), strain, optimize=True).min(1)


def _duration(gamma: np.ndarray, where: np.ndarray) -> float:
    """Strain over which a condition holds, by the trapezoidal rule."""
    return float((np.diff(gamma) * (where[1:] * 0.5 + where[:-1] * 0.5)).sum())


def curve(mu: float, closure: str, elastic_strain: float) -> Curve:
    """Follow the reversal with a closure of CLOSURES."""
    material = Material(mu, elastic_strain=elastic_strain, **CLOSURES[closure][0])
    steps = driver.shear(-FIRST_STRAIN, increments=1), driver.shear(-STRAIN, increments=INCREMENTS)
    history = driver.run(material, material.steady(material["phic"] + DISTANCE), steps)
    found = material.ellipticity(history.states)
    plane = in_plane(material, history.states) if elastic_strain == 0 else np.full(len(history), np.nan)
    values = history["gamma_total"], found.eta_t, found.eigenvalue, found.determinant, plane, *found.normal.T
    columns = dict(zip(CURVES, values))
    return Curve(mu, closure, elastic_strain, {name: column[1:] for name, column in columns.items()},
                 {name: columns[name][0] for name in MEASURES})


def study() -> list[Curve]:
    """The curves of all friction coefficients, closures and the elastic strains that these can have."""
    return [curve(mu, closure, elastic_strain) for mu in MUS for closure in CLOSURES for elastic_strain in ELASTIC_STRAINS
            if elastic_strain > 0 or closure not in TURNING]


# ---- files -----------------------------------------------------------------------------------------------------------

def write_curves(filename: Path, curves: Sequence[Curve]) -> None:
    """Write all curves under their mu, closure, elastic_strain and the names of CURVES."""
    with open(filename, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("mu", "closure", "elastic_strain", *CURVES))
        for c in curves:
            for row in zip(*(c.columns[name] for name in CURVES)):
                table.writerow((c.mu, c.closure, c.elastic_strain, *(f"{value:.7g}" for value in row)))


def write_losses(filename: Path, curves: Sequence[Curve]) -> None:
    """Write how far and how long each measure of each curve is negative."""
    with open(filename, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("mu", "closure", "elastic_strain", "measure", *LOSS))
        for c in curves:
            for measure in MEASURES:
                numbers = (f"{value:.6g}" for value in c.loss(measure).values())
                table.writerow((c.mu, c.closure, c.elastic_strain, measure, *numbers))


def losses_in_words(curves: Sequence[Curve]) -> str:
    """The table for the screen: eta_t and the smallest eigenvalue, one line for each curve."""
    lines = ["after a reversal at constant volume; eigenvalue in p (e_r = 0) or p/e_r; strains over which they are negative",
             f"{'mu':>4} {'closure':15} {'e_r':>5} {'eta_t':>8} {'strain':>7} {'eigenvalue':>11} {'least':>9} {'strain':>7}"
             f" {'deep':>6} {'in plane':>9} {'steady':>10}"]
    for c in curves:
        eta_t, least, scale = c.loss("eta_t"), c.loss("eigenvalue"), c.elastic_strain or 1.0
        lines.append(f"{c.mu:4g} {c.closure:15} {c.elastic_strain:5g} {eta_t['after_reversal']:8.4f} {eta_t['duration']:7.3f} "
                     f"{least['after_reversal'] * scale:11.5f} {least['least'] * scale:9.5f} {least['duration']:7.3f} "
                     f"{least['duration_deep']:6.3f} {c.loss('in_plane')['after_reversal']:9.5f} {least['steady'] * scale:10.6f}")
    return "\n".join(lines)


def draw(curves: Sequence[Curve]) -> Figure:
    """Draw eta_t and the smallest eigenvalues against the strain after the reversal, one column for each mu."""
    figure = Figure(figsize=(13, 8.2))
    figure.set_layout_engine("constrained", rect=(0, 0.04, 1, 0.96))
    figure.suptitle("Reversal of shear at constant volume: the law is not elliptic where a curve is below 0", fontsize=11)
    rows = (("eta_t", 0.0, r"transverse modulus $\eta_t$ (any $e_r$)"),
            ("eigenvalue", 0.0, "smallest eigenvalue of the acoustic\n" r"tensor $/\,p$, at $e_r=0$ (log scale)"),
            ("eigenvalue", 0.01, "smallest eigenvalue of the acoustic\n" r"tensor $\times\,e_r/p$, at $e_r=0.01$"))
    panels = figure.subplots(3, len(MUS), sharex=True, sharey="row")
    for (measure, elastic_strain, label), row in zip(rows, panels):
        row[0].set_ylabel(label, fontsize=9)
        for mu, axes in zip(MUS, row):
            axes.axhline(0, color="black", linewidth=0.8)
            axes.grid(linewidth=0.3)
            axes.tick_params(labelsize=8)
            for c in curves:
                if c.mu == mu and c.elastic_strain == elastic_strain:
                    values = c.columns[measure] * (elastic_strain or 1.0)
                    axes.plot(c.columns["gamma"], values, label=c.closure, linewidth=1.3, **CLOSURES[c.closure][1])
    panels[1, 0].set_yscale("symlog", linthresh=1e-4, linscale=0.5)
    panels[1, 0].set_ylim(-0.2, 2e-4)
    panels[2, 0].set_ylim(-0.1, 0.06)                  # over p, which vanishes in mobilised-pressure for a while
    for mu, axes in zip(MUS, panels[0]):
        axes.set_title(rf"$\mu$ = {mu:g}", fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("shear strain after the reversal", fontsize=9)
    handles, labels = panels[2, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=len(CLOSURES), fontsize=9, frameon=False)
    return figure


def write_study(out: str | Path) -> tuple[list[Curve], list[Path]]:
    """Compute all curves; write wellposed.csv (curves), wellposed-loss.csv (table) and wellposed.png into a directory.

    Parameters
    ----------
    out : path
        Directory; it is created if it does not exist.

    Returns
    -------
    curves : list of Curve
    files : list of pathlib.Path
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    curves = study()
    files = [out / "wellposed.csv", out / "wellposed-loss.csv", out / "wellposed.png"]
    write_curves(files[0], curves)
    write_losses(files[1], curves)
    draw(curves).savefig(files[2], dpi=110)
    return curves, files
