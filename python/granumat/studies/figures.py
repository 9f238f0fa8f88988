"""The model's curves of the paper's figures, with this project's discrete-element (DEM) data where the conditions match.

Whatever is drawn, of the model or of the DEM, is a dict of columns with the names of a history and those that `_derived` adds.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import driver, tensors
from ..checks import refuse
from ..core import STATE
from ..material import CALIBRATIONS, Material
from .colours import BLUE, GREEN, GREY, ORANGE, PURPLE, RED

MU_COLOURS = {0.0: PURPLE, 0.1: GREEN, 0.3: ORANGE, 0.5: BLUE, 1.0: RED}
STRESSES = {"normal": ("xx", "yy", "zz"), "normal, two": ("13", "yy"), "shear": ("xz", "xy", "yz")}      # of a panel
DEM = "DEM (this project's runs, 2000 spheres, one realisation each)"
POINTS: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4.5, "markerfacecolor": "none", "markeredgewidth": 0.9}
DOTS = POINTS | {"markersize": 2.2, "markeredgewidth": 0.5, "markevery": 4}        # for the rows of a run

LABELS = {
    "mu": r"interparticle friction coefficient $\mu$", "strain": r"accumulated shear strain $\dot\gamma_0 t$",
    "time": r"strain $\dot\gamma_0 t$ (no shear from 1 to 2)", "p": r"pressure $p\,d/k$", "phi": r"volume fraction $\phi$",
    "stress_ratio": r"stress ratio $-\sigma_{xz}/p$", "Z2": r"coordination number $Z_2$", "A_xz": r"fabric $A_{xz}$",
    "eta": r"friction coefficient $\eta$", "Z2-Zc": r"$Z_2-Z_c$", "(Z2-Zc)^2": r"$(Z_2-Z_c)^2$",
    "(phi-phic)^1/2": r"$(\phi-\phi_c)^{1/2}$",
    "normal": r"normal stress $\sigma/p$", "normal, two": r"normal stress $\sigma/p$", "shear": r"shear stress $\sigma/p$",
    "Zc": r"critical coordination number $Z_c$", "a2": r"$a_2$ in (4.2)", "phic": r"critical volume fraction $\phi_c$",
    "b": r"$b_1$, $b_2$ in (4.5)", "a3": r"$a_3$ in (A 1)", "a4": r"$a_4$ in (A 4)",
}


# ---- columns ---------------------------------------------------------------------------------------------------------

Columns = dict[str, np.ndarray]


def _derived(columns: Columns, material: Material) -> Columns:
    """The columns, and those that only figures need: distances from jamming, stresses over the pressure."""
    scaled = {f"sigma_{axis}/p": columns[f"sigma_{axis}"] / columns["p"] for axis in tensors.AXES}
    return columns | scaled | {
        "sigma_13/p": (scaled["sigma_xx/p"] + scaled["sigma_zz/p"]) / 2,
        "Z2-Zc": columns["Z2"] - material["Zc"], "(Z2-Zc)^2": (columns["Z2"] - material["Zc"]) ** 2,
        "(phi-phic)^1/2": np.sqrt(np.maximum(columns["phi"] - material["phic"], 0))}


def _history(material: Material, state: np.record, *steps: driver.Step) -> Columns:
    """Columns along a load path."""
    columns = driver.run(material, state, steps).columns
    strain = columns["gamma_total"]
    return _derived(columns | {"strain": strain, "time": strain + (columns["step"] > 1)}, material)    # step 2 pauses


def _reversal(material: Material, control: str = "volume") -> Columns:
    """Columns from the steady state at phi 0.60 through a reversal after a shear strain of 1."""
    return _history(material, material.steady(0.60), driver.shear(1, control), driver.shear(-2, control, increments=400))


DISTANCES = tuple(np.linspace(0.02, 0.2, 46))


def _steady(material: Material, distances: Sequence[float] = DISTANCES) -> Columns:
    """Columns of steady simple shear at given values of (phi - phic)^(1/2)."""
    states = [material.steady(phi) for phi in material["phic"] + np.asarray(distances) ** 2]
    return _derived(driver.state_columns(material, np.array(states, STATE)), material)


def _constants(**definition: Any) -> Columns:
    """Columns of the constants against mu."""
    materials = [Material(mu, **definition) for mu in np.linspace(0, 1, 101).tolist()]
    return {name: np.array([material[name] for material in materials]) for name in materials[0].constants}


class Run(NamedTuple):
    """A DEM run of simple shear at constant volume with a reversal, at which the column `strain` is 1."""

    shear: Columns                  # all slow shear
    after: Columns                  # after the reversal
    steady: dict[str, float]        # means before the reversal


def dem_runs(*mus: float, phi: float | None = None) -> list[Run]:
    """Read DEM runs of the package.

    Parameters
    ----------
    *mus : float
        Friction coefficients.
    phi : float, optional
        Volume fraction; the default is any.

    Returns
    -------
    list of Run

    Raises
    ------
    FileNotFoundError
        If the DEM data are not in the package.
    """
    folder = resources.files("granumat") / "data"
    names = sorted(file.name for file in folder.iterdir()) if folder.is_dir() else []
    matches = [match for match in (re.fullmatch(r"cv_mu([\d.]+)_phi([\d.]+)_s\d+\.csv", name) for name in names) if match]
    if not matches:
        raise FileNotFoundError(f"no DEM data in {folder}: the build puts demos/data/cv_*.csv there")
    return [_read_run(folder / match[0], float(match[1])) for match in matches
            if float(match[1]) in mus and phi in (None, float(match[2]))]


def _read_run(source: Traversable, mu: float) -> Run:
    with source.open() as file:
        data = dict(zip(file.readline().strip().split(","), np.loadtxt(file, delimiter=",").T))
    columns = {"phi": data["phi"], "Z2": data["Z2"], "p": (data["pxx"] + data["pyy"] + data["pzz"]) / 3}
    columns["stress_ratio"] = -data["pxz"] / columns["p"]
    for axis in tensors.AXES:
        columns |= {f"sigma_{axis}": data[f"p{axis}"], f"A_{axis}": data[f"A{axis}"]}
    gamma, reversal = data["gamma"], data["gamma"].argmax()
    after = np.arange(len(gamma)) > reversal
    before = (gamma > gamma[reversal] - 1) & (data["gamma_acc"] > 0) & ~after      # gamma_acc < 0: faster shear to prepare
    columns["strain"] = 1 + np.abs(gamma - gamma[reversal]) * np.where(after, 1, -1)
    columns["time"] = columns["strain"] + after
    columns = _derived(columns, Material(mu))
    shear, later, earlier = ({name: column[rows] for name, column in columns.items()} for rows in (before | after, after, before))
    return Run(shear, later, {"mu": mu} | {name: column.mean() for name, column in earlier.items()})


def quadratic_friction(runs: Sequence[Run]) -> dict[str, Any]:
    """Fit b1, b2, b3 of (4.6) by least squares to the runs' rows after the reversal, where A:S^ = -2 A_xz and eta = sigma_xz/p."""
    x = np.concatenate([-2 * run.after["A_xz"] for run in runs])
    eta = np.concatenate([-run.after["stress_ratio"] for run in runs])
    return dict(zip(("b1", "b2", "b3"), np.polyfit(x, eta, 2)[::-1].tolist()))


# ---- panels ----------------------------------------------------------------------------------------------------------

class Panel(NamedTuple):
    """Axes and the names of the columns that they show."""

    axes: Axes
    x: str
    y: str

    def draw(self, columns: Any, y: str | None = None, **style: Any) -> None:
        """Draw the columns, or another one for y."""
        self.axes.plot(columns[self.x], columns[y or self.y], **style)

    def legend(self, place: Any, **options: Any) -> None:
        """Add a legend."""
        self.axes.legend(loc=place, fontsize=7.5, frameon=False, **options)

    def inset(self, bounds: tuple[float, float, float, float], label: str, limits: tuple[float, float]) -> Axes:
        """Add small axes for a constant against mu."""
        axes = self.axes.inset_axes(bounds, xlim=(0, 1), ylim=limits, xticks=(0, 0.5, 1))
        axes.set_xlabel(r"$\mu$", fontsize=8, labelpad=0)
        axes.set_ylabel(label, fontsize=8, labelpad=1)
        axes.tick_params(labelsize=6)
        return axes


def _sheet(number: int, title: str, notes: Sequence[str], names: Sequence[tuple[str, str]], columns: int = 2,
           colours: Sequence[str] = (GREY, GREY)) -> tuple[Figure, list[Panel]]:
    """A figure with a panel for each pair (x, y) of columns, and below a legend of model and DEM in their colours, and notes."""
    rows, foot = -(-len(names) // columns), 0.5 + 0.17 * len(notes)                 # inches
    height = 2.7 * rows + 0.4 + foot
    figure = Figure(figsize=(max((4.8 - 0.3 * columns) * columns, 6.4), height))
    figure.set_layout_engine("constrained", rect=(0, foot / height, 1, 1 - foot / height))
    figure.suptitle(f"Figure {number}: {title}", fontsize=11)
    figure.text(0.5, 0.1 / height, "\n".join(notes), fontsize=8, ha="center", va="bottom", linespacing=1.3)
    styles: tuple[dict[str, Any], ...] = ({}, POINTS)
    handles = [Line2D([], [], color=colour, label=label, **style) for colour, label, style in zip(colours, ("model", DEM), styles)]
    figure.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, (foot - 0.3) / height), ncol=2,
                  fontsize=8, frameon=False, borderaxespad=0)
    panels = []
    for i, (x, y) in enumerate(names):
        axes = figure.add_subplot(rows, columns, i + 1, xlabel=LABELS[x], ylabel=LABELS[y])
        axes.set_title(f"({'abcd'[i]})" if len(names) > 1 else "", loc="left", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(linewidth=0.3)
        panels.append(Panel(axes, x, y))
    return figure, panels


def _evolution(number: int, title: str, notes: Sequence[str], first: str, history: Columns, runs: Sequence[Run] = (),
               x: str = "strain") -> Figure:
    """A figure of the column `first`, stress ratio, coordination number and fabric against strain."""
    names = [(x, y) for y in (first, "stress_ratio", "Z2", "A_xz")]
    figure, panels = _sheet(number, title, notes, names, colours=(RED, BLUE) if runs else (RED,))
    for panel in panels:
        for run in runs:
            panel.draw(run.shear, color=BLUE, **DOTS)
        panel.draw(history, color=RED)
    return figure


def _steady_by_friction(panels: Sequence[Panel]) -> None:
    """Steady simple shear, one colour for each mu."""
    for mu, colour in MU_COLOURS.items():
        steady, runs = _steady(Material(mu)), dem_runs(mu)
        for panel in panels:
            panel.draw(steady, color=colour, label=rf"$\mu$ = {mu:g}")
            for run in runs:
                panel.draw(run.steady, color=colour, **POINTS)
            panel.legend("upper left")


def _stresses(panel: Panel, model: Columns, runs: Sequence[Any], points: dict[str, Any], line: str = "-") -> None:
    """The stresses of a panel over the pressure."""
    for axis, colour in zip(STRESSES[panel.y], (BLUE, RED, GREEN)):
        for run in runs:
            panel.draw(run, f"sigma_{axis}/p", color=colour, **points)
        label = rf"$\bar\sigma_{{{axis}}}$" if axis == "13" else rf"$\sigma_{{{axis}}}$"
        panel.draw(model, f"sigma_{axis}/p", color=colour, linestyle=line, label=label if line == "-" else None)
    panel.axes.set_ylim(None if panel.y == "shear" else (0.87, 1.13))
    panel.legend("center" if panel.y == "shear" else "upper center", ncol=3)


def _stress_figure(number: int, title: str, notes: Sequence[str], closure: str, *plots: tuple[str, Sequence[float]]) -> Figure:
    """A figure with a panel for each (y, mus): steady shear against phi for these mu, or without any the reversal at mu 0.5."""
    names = [("phi" if mus else "strain", y) for y, mus in plots]
    figure, panels = _sheet(number, title, notes, names, len(plots))
    for panel, (_, mus) in zip(panels, plots):
        for mu, line in zip(mus, ("-", "--")):
            _stresses(panel, _steady(Material(mu, closure)), [run.steady for run in dem_runs(mu)], POINTS, line)
        if not mus:
            _stresses(panel, _reversal(Material(0.5, closure)), [run.shear for run in dem_runs(0.5, phi=0.60)], DOTS)
    return figure


# ---- the figures -----------------------------------------------------------------------------------------------------

NO_DEM = "no DEM run of this project under constant pressure"
DEM_POINTS = r"DEM: means of steady shear at constant volume, ($\mu$, $\phi$) = (0.1, 0.63), (0.3, 0.61) and twice (0.5, 0.60)"
REVERSAL = r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, reversal at 1"


def figure_01() -> Figure:
    """Unsteady simple shear at constant volume."""
    material = Material(0.5)
    history = _history(material, material.steady(0.60), driver.shear(1), driver.pause(), driver.shear(-2, increments=400))
    notes = (r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, closure full: steady shear, pause, reversed shear; DEM: two runs",
             "the model's stress follows from its state at once: its stress ratio jumps at the reversal")
    return _evolution(1, "unsteady simple shear at constant volume", notes, "p", history, dem_runs(0.5, phi=0.60), "time")


def figure_02() -> Figure:
    """Shear reversal at constant pressure."""
    history = _reversal(Material(0.5), "pressure")
    notes = (r"$\mu$ = 0.5, closure full, constant pressure, reversal at 1; " + NO_DEM,
             rf"$p\,d/k$ = {history['p'][0]:.4f} is the model's steady pressure at $\phi$ = 0.60")
    return _evolution(2, "shear reversal at constant pressure", notes, "phi", history)


def figure_04() -> Figure:
    """Pressure against coordination number."""
    notes = ("closure full; (a) solid, (c), (d): steady simple shear; (a) dashed, (b): isotropic; colours as in (c)", DEM_POINTS)
    figure, panels = _sheet(4, "pressure against coordination number", notes, [("Z2", "p")] * 3 + [("(Z2-Zc)^2", "p")])
    for mu, colour in MU_COLOURS.items():
        material = Material(mu)
        states = [material.isotropic(0.6, coordination_number=material["Zc"] + x) for x in np.linspace(0, 1.8, 61)]   # any phi
        isotropic = driver.state_columns(material, np.array(states, STATE))
        if mu in (0.1, 0.5):
            panels[0].draw(isotropic, color=colour, linestyle="--")
            panels[0].draw(_steady(material), color=colour)
        panels[1].draw(isotropic, color=colour)
    _steady_by_friction(panels[2:])
    constants = _constants()
    panels[1].inset((0.15, 0.62, 0.22, 0.34), "$a_1$", (0, 0.015)).plot(constants["mu"], constants["a1"], color=GREY)
    return figure


def figure_05() -> Figure:
    """Constants of the pressure and of the coordination number."""
    notes = (r"the fits of table 1; $a_2$ is +0.1 $\mu$: the minus sign printed in the table is a misprint",)
    figure, panels = _sheet(5, "constants of the pressure and of the coordination number", notes,
                            [("mu", "Zc"), ("mu", "a2"), ("mu", "phic")], 3, (GREY,))
    for panel in panels:
        panel.draw(_constants(), color=GREY)
    return figure


def figure_07() -> Figure:
    """Stress ratio against fabric."""
    runs = dem_runs(0.5, phi=0.60)
    fit = quadratic_friction(runs)
    notes = (r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, closure full; model: reversed twice, DEM: reversed once",
             "(4.5) with table 1's constants; (4.6) with none printed, here a least-squares fit to the DEM after reversal:",
             ", ".join(rf"$\hat b_{name[1]} = {value:.3g}$" for name, value in fit.items()))
    figure, [panel] = _sheet(7, "stress ratio against fabric", notes, [("A_xz", "stress_ratio")], 1, (RED, BLUE))
    for run in runs:
        panel.draw(run.shear, color=BLUE, **DOTS | {"markevery": 2})
    quadratic = Material(0.5, friction="quadratic", **fit)
    for material, label, line in ((Material(0.5), "linear (4.5)", "--"), (quadratic, "quadratic (4.6)", "-")):
        steps = driver.shear(-2, increments=2000), driver.shear(2, increments=2000)
        panel.draw(_history(material, material.steady(0.60), *steps), color=RED, linestyle=line, label=label)
    panel.legend("upper right")
    return figure


def figure_08() -> Figure:
    """Friction coefficient of steady simple shear."""
    notes = (r"closure full, (4.5); $\eta$ does not depend on $\phi$", DEM_POINTS)
    figure, (friction, constants) = _sheet(8, "friction coefficient of steady simple shear", notes, [("mu", "eta"), ("mu", "b")])
    c = _constants()
    c["eta"] = np.array([_steady(Material(mu), [0.1])["eta"][0] for mu in c["mu"].tolist()])
    c |= {"b1 + b2 chi": c["b1"] + c["b2"] * c["chi"], "printed": 0.41 - 0.3 * np.exp(-6 * c["mu"])}
    friction.draw(c, color=GREY, label="steady shear")
    friction.draw(c, "b1 + b2 chi", color=RED, linestyle="--", label=r"$b_1+b_2\chi$ (A 12), which neglects the spin")
    friction.draw(c, "printed", color=BLUE, linestyle=":", linewidth=2, label=r"printed fit $0.41-0.3\,e^{-6\mu}$")
    for run in dem_runs(*MU_COLOURS):
        friction.draw(run.steady, "stress_ratio", color=GREY, **POINTS)
    for name, colour in (("b1", BLUE), ("b2", RED)):
        constants.draw(c, name, color=colour, label=f"$b_{name[1]}$")
    friction.legend("lower right")
    constants.legend("center right")
    return figure


def figure_09() -> Figure:
    """Coordination number of steady simple shear."""
    notes = (r"closure full; (b) all five lines coincide, slightly below $7.5\,(\phi-\phi_c)^{1/2}$ because of the spin",
             DEM_POINTS, r"$Z_c$ and $\phi_c$ of the DEM points in (b) and in the inset are the fits of table 1")
    figure, panels = _sheet(9, "coordination number of steady simple shear", notes, [("phi", "Z2"), ("(phi-phic)^1/2", "Z2-Zc")])
    _steady_by_friction(panels)
    inset = panels[0].inset((0.72, 0.17, 0.26, 0.30), r"$\beta_1$", (6, 10))
    inset.plot((0, 1), (Material()["beta1"],) * 2, color=GREY)
    for run in dem_runs(*MU_COLOURS):
        inset.plot(run.steady["mu"], run.steady["Z2-Zc"] / run.steady["(phi-phic)^1/2"], color=GREY, **POINTS)
    return figure


def figure_10() -> Figure:
    """Cyclic simple shear at constant pressure."""
    material = Material(0.5)
    history = _history(material, material.steady(0.60), *driver.cycles(0.5, 4, "pressure"))
    notes = (r"$\mu$ = 0.5, closure full, constant pressure, amplitude 0.5, from the steady state at $\phi$ = 0.60; " + NO_DEM,
             rf"$p\,d/k$ = {history['p'][0]:.4f} is the model's steady pressure (printed constants); the paper has about 0.01")
    return _evolution(10, "cyclic simple shear at constant pressure", notes, "phi", history)


def figure_11() -> Figure:
    """Reynolds dilatancy."""
    material = Material(0.5)
    start = material.isotropic(0.612, pressure=0.01)
    steady = driver.run(material, start, [driver.shear(40, "pressure", 2000)])["phi"][-1]
    notes = (r"$\mu$ = 0.5, closure full, constant pressure $p\,d/k$ = 0.01, isotropic start at $\phi$ = 0.612; " + NO_DEM,)
    figure = _evolution(11, "Reynolds dilatancy", notes, "phi", _history(material, start, driver.shear(4, "pressure", 800)))
    axes = figure.axes[0]
    for phi, text, colour in ((steady, f"model, steady: {steady:.4f}", RED), (0.602, "the paper's DEM, steady: 0.602", BLUE)):
        axes.axhline(phi, color=colour, linewidth=0.9, linestyle="--")
        axes.text(4, phi - 2e-4, text, fontsize=7.5, ha="right", va="top")
    axes.set_ylim(0.601, 0.613)
    return figure


def figure_13() -> Figure:
    """Stresses of steady simple shear."""
    notes = (r"$\mu$ = 0.5, closure full: the model's lines do not depend on $\phi$; DEM: constant volume, two runs",)
    return _stress_figure(13, "stresses of steady simple shear", notes, "full", ("normal", [0.5]), ("shear", [0.5]))


def figure_14() -> Figure:
    """Normal stresses without their first difference."""
    notes = (r"closure n2; $\bar\sigma_{13}=(\sigma_{xx}+\sigma_{zz})/2$; (a) steady shear, solid and DEM at $\phi$ = 0.60: "
             r"$\mu$ = 0.5, dashed and DEM at $\phi$ = 0.63: $\mu$ = 0.1", "(b) " + REVERSAL)
    return _stress_figure(14, "normal stresses without their first difference", notes, "n2",
                          ("normal, two", [0.5, 0.1]), ("normal, two", []))


def figure_15() -> Figure:
    """Normal stresses with both differences."""
    notes = (r"closure full; (a) steady shear, $\mu$ = 0.5; (b) steady shear, $\mu$ = 0.1; (c) " + REVERSAL,)
    return _stress_figure(15, "normal stresses with both differences", notes, "full",
                          ("normal", [0.5]), ("normal", [0.1]), ("normal", []))


def figure_16() -> Figure:
    """Constants of the normal stress differences."""
    notes = (r"$a_4$ is printed in three forms, each a calibration of its own; table-1 is the default",)
    figure, (third, fourth) = _sheet(16, "constants of the normal stress differences", notes, [("mu", "a3"), ("mu", "a4")],
                                     colours=(GREY,))
    third.draw(_constants(), color=GREY)
    for calibration, colour in zip(CALIBRATIONS, (GREY, RED, BLUE)):
        fourth.draw(_constants(calibration=calibration), color=colour, label=calibration)
    fourth.legend("lower right")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "1": figure_01, "2": figure_02, "4": figure_04, "5": figure_05, "7": figure_07, "8": figure_08, "9": figure_09, "10": figure_10,
    "11": figure_11, "13": figure_13, "14": figure_14, "15": figure_15, "16": figure_16}


def draw_figures(out: str | Path, names: Iterable[str | int] | None = None) -> list[Path]:
    """Draw figures of the paper as figure-<number>.png.

    Parameters
    ----------
    out : path
        Directory; it is created if it does not exist.
    names : iterable of str or int, optional
        Their numbers, keys of FIGURES; the default is all.

    Returns
    -------
    list of pathlib.Path

    Raises
    ------
    ValueError
        Names every number that has no figure.
    FileNotFoundError
        If the DEM data are not in the package.
    """
    chosen = list(FIGURES) if names is None else [str(name) for name in names]
    refuse("the figures cannot be drawn", [f"figure {name!r}: must be one of {', '.join(FIGURES)}"
                                           for name in chosen if name not in FIGURES])
    Path(out).mkdir(parents=True, exist_ok=True)
    files = [Path(out) / f"figure-{int(name):02d}.png" for name in chosen]
    for name, file in zip(chosen, files):
        FIGURES[name]().savefig(file, dpi=130)
    return files
