"""The model's curves of the paper's figures, beside this project's discrete-element (DEM) runs.

Whatever is drawn, of the model or of the DEM, is a dict of columns with the names of a history and those that `_derived` adds.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
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
from .ensemble import SLOW, Columns, Measured, compressions, programme, steady

SHOWN = ["table-1", "dem-2026"]        # calibrations that are drawn beside the DEM
LAW_STYLES = ((RED, "-"), (GREEN, "--"), (PURPLE, ":"))             # colour where the figure has no colours of its own, and line
MU_COLOURS = {0.0: PURPLE, 0.1: GREEN, 0.3: ORANGE, 0.5: BLUE, 1.0: RED}
PHI_COLOURS = (PURPLE, BLUE, GREEN, ORANGE, RED, GREY)
MARKERS = "osd^v<>p*"
STRESSES = {"normal": ("xx", "yy", "zz"), "normal, two": ("13", "yy"), "shear": ("xz", "xy", "yz")}      # of a panel
DEM = "DEM (this project's runs, 2000 spheres)"
POINTS: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4.5, "markerfacecolor": "none", "markeredgewidth": 0.9}
DOTS = POINTS | {"markersize": 2.2, "markeredgewidth": 0.5}         # for the rows of a run
PRESSURE = 0.01             # p d/k of the paper's tests under constant pressure, where there is no DEM run
PAUSED = 0.01               # strain that one row of the DEM's pause would be

LABELS = {
    "mu": r"interparticle friction coefficient $\mu$", "strain": r"accumulated shear strain $\dot\gamma_0 t$",
    "time": r"strain $\dot\gamma_0 t$ (no shear from 1 to 2)", "p": r"pressure $p\,d/k$", "phi": r"volume fraction $\phi$",
    "stress_ratio": r"stress ratio $-\sigma_{xz}/p$", "Z2": r"coordination number $Z_2$", "A_xz": r"fabric $A_{xz}$",
    "eta": r"friction coefficient $\eta$", "Z2-Zc": r"$Z_2-Z_c$", "(Z2-Zc)^2": r"$(Z_2-Z_c)^2$",
    "(phi-phic)^1/2": r"$(\phi-\phi_c)^{1/2}$", "p_Hz": r"$p/k_{Hz}$, and $(p\,d/k)^{3/2}$",
    "phi_ci": r"jamming volume fraction $\phi_{ci}$", "a1*": r"$a_1^*$ in (B 1)",
    "normal": r"normal stress $\sigma/p$", "normal, two": r"normal stress $\sigma/p$", "shear": r"shear stress $\sigma/p$",
    "Zc": r"critical coordination number $Z_c$", "a2": r"$a_2$ in (4.2)", "phic": r"critical volume fraction $\phi_c$",
    "b": r"$b_1$, $b_2$ in (4.5)", "a3": r"$a_3$ in (A 1)", "a4": r"$a_4$ in (A 4)",
}


# ---- columns of the model --------------------------------------------------------------------------------------------

class Law(NamedTuple):
    """A calibration that is drawn, and how."""

    calibration: str
    colour: str
    line: str

    @property
    def label(self) -> str:
        """What the legend says."""
        return "model, printed constants" if self.calibration == "table-1" else f"model, {self.calibration}"

    def once(self, label: str) -> str | None:
        """A label for what all laws have: that of the first one."""
        return label if self.calibration == SHOWN[0] else None

    def material(self, mu: float, **definition: Any) -> Material | None:
        """The material; None where the calibration has no constants for a friction coefficient or contact."""
        with suppress(ValueError):
            return Material(mu, calibration=self.calibration, **definition)
        return None

    def constants(self) -> Columns:
        """Columns of the constants against mu, over the range that the calibration has."""
        materials = [material for mu in np.linspace(0, 1, 101).tolist() if (material := self.material(mu))]
        return {name: np.array([material[name] for material in materials]) for name in ("mu", *materials[0].constants)}


def _laws() -> list[Law]:
    return [Law(calibration, *style) for calibration, style in zip(SHOWN, LAW_STYLES)]


def _materials(mu: float, **definition: Any) -> list[tuple[Law, Material]]:
    """The laws that have constants for a friction coefficient, with their material."""
    return [(law, material) for law in _laws() if (material := law.material(mu, **definition))]


def _derived(columns: Columns, constants: Any) -> Columns:
    """The columns, and those that only figures need: distances from jamming, by constants Zc and phic, and stresses over p."""
    scaled = {f"sigma_{axis}/p": columns[f"sigma_{axis}"] / columns["p"] for axis in tensors.AXES}
    return columns | scaled | {
        "sigma_13/p": (scaled["sigma_xx/p"] + scaled["sigma_zz/p"]) / 2,
        "Z2-Zc": columns["Z2"] - constants["Zc"], "(Z2-Zc)^2": (columns["Z2"] - constants["Zc"]) ** 2,
        "(phi-phic)^1/2": np.sqrt(np.maximum(columns["phi"] - constants["phic"], 0))}


def _history(material: Material, state: np.record, *steps: driver.Step) -> Columns:
    """Columns along a load path."""
    columns = driver.run(material, state, steps).columns
    strain = columns["gamma_total"]
    return _derived(columns | {"strain": strain, "time": strain + (columns["step"] > 1)}, material)    # step 2 pauses


def _reversal(material: Material, start: np.record, control: str = "volume") -> Columns:
    """Columns from a steady state through a reversal after a shear strain of 1."""
    return _history(material, start, driver.shear(1, control), driver.shear(-2, control, increments=400))


DISTANCES = tuple(np.linspace(0.02, 0.2, 46))


def _steady(material: Material, distances: Sequence[float] = DISTANCES) -> Columns:
    """Columns of steady simple shear at given values of (phi - phic)^(1/2)."""
    states = [material.steady(phi) for phi in material["phic"] + np.asarray(distances) ** 2]
    return _derived(driver.state_columns(material, np.array(states, STATE)), material)


def steady_at(material: Material, pressure: float) -> np.record:
    """The state of steady simple shear at a pressure of Hookean contacts: sqrt(p) is linear in (phi - phic)^beta2 (4.2), (4.9)."""
    known = np.array([0.1, 0.2])
    roots = [np.sqrt(-material.steady(phi)["stress"][:3].mean()) for phi in material["phic"] + known ** (1 / material["beta2"])]
    found = np.polyval(np.polyfit(roots, known, 1), np.sqrt(pressure))
    return material.steady(float(material["phic"] + found ** (1 / material["beta2"])))


def _isotropic(material: Material) -> Columns:
    """Columns of isotropic states; they do not depend on phi."""
    states = [material.isotropic(0.6, coordination_number=material["Zc"] + x) for x in np.linspace(0.001, 1.8, 61)]
    return _derived(driver.state_columns(material, np.array(states, STATE)), material)


# ---- columns of the DEM ----------------------------------------------------------------------------------------------

def _run(name: str, mu: float = 0.5, phi: float = 0.60, turn: int = 0, at: float = 1.0, first: int = 0) -> list[Measured]:
    """A programme of the DEM as a list: of its steps from the first one on, so that step `turn` ends at a strain; empty if not run.

    The strain is `time` too.
    """
    data = programme(name, mu, phi)
    if data is None:
        return []
    step, total = data.columns["step"], data.columns["gamma_total"]
    strain = total - total[step <= turn][-1] + at
    return [_with_derived(data.having(strain=strain, time=strain).rows(step >= first), Material(mu))]


def _with_derived(data: Measured, constants: Any) -> Measured:
    return data.having(**_derived(data.columns, constants))


def _steady_dem(*mus: float) -> Measured:
    """Steady shear of the DEM with Hookean contacts."""
    data = steady(*mus)
    materials = [Material(mu) for mu in data.columns["mu"].tolist()]
    return _with_derived(data, {name: np.array([material[name] for material in materials]) for name in ("Zc", "phic")})


def _dem_reversal() -> list[Measured]:
    """Shear of the DEM at mu 0.5, phi 0.60 and constant volume, reversed at a strain of 1."""
    return _run("steady", turn=2, first=2) + _run("reversal")


def _said(*runs: Sequence[Measured]) -> str:
    """Of how many packings the DEM's points are, in words; a word for what is not there yet."""
    counts = sorted({run.packings for some in runs for run in some})
    if not counts:
        return "no DEM run of this project yet"
    number = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"DEM: {number} packing{'s, mean' if counts != [1] else ''}" + (
        "; bands: one standard deviation between them" if counts[-1] > 1 else "")


def quadratic_friction(runs: Sequence[Columns]) -> dict[str, Any]:
    """Fit b1, b2, b3 of (4.6) by least squares to rows of reversed shear, where A:S^ = -2 A_xz and eta = sigma_xz/p."""
    x = np.concatenate([-2 * run["A_xz"] for run in runs])
    eta = np.concatenate([-run["stress_ratio"] for run in runs])
    return dict(zip(("b1", "b2", "b3"), np.polyfit(x, eta, 2)[::-1].tolist()))


class Jamming(NamedTuple):
    """What an isotropic compression tends to as its pressure vanishes: p = a1 (Z2 - Zc)^2, and p linear in phi - phi_ci."""

    a1: float
    Zc: float
    phi_ci: float


def jamming(columns: Columns) -> Jamming:
    """Fit an isotropic compression: sqrt(p) as a line of Z2, and phi as a line of p over the lower half of the rows."""
    slope, offset = np.polyfit(columns["Z2"], np.sqrt(columns["p"]), 1)
    lower = columns["p"] <= np.median(columns["p"])
    return Jamming(slope**2, -offset / slope, np.polyfit(columns["p"][lower], columns["phi"][lower], 1)[1])


def _compressed(mu: float | None = None) -> dict[tuple[float, float], Measured]:
    """Isotropic compressions under pressure: without the frictionless start."""
    return {key: _with_derived(data.rows(data.columns["step"] > 0), Material(key[0])) for key, data in compressions(mu).items()}


# ---- panels ----------------------------------------------------------------------------------------------------------

class Panel(NamedTuple):
    """Axes and the names of the columns that they show."""

    axes: Axes
    x: str
    y: str

    def draw(self, columns: Any, y: str | None = None, **style: Any) -> None:
        """Draw the columns, or another one for y."""
        self.axes.plot(columns[self.x], columns[y or self.y], **style)

    def measured(self, data: Measured, color: str = BLUE, **style: Any) -> None:
        """Draw the DEM as points with a band of one standard deviation between packings to each side."""
        self.draw(data.columns, color=color, **DOTS | style)
        if self.y in data.scatter:
            mean, scatter = data.columns[self.y], data.scatter[self.y]
            self.axes.fill_between(data.columns[self.x], mean - scatter, mean + scatter, color=color, alpha=0.25, linewidth=0)

    def points(self, data: Measured, color: str = GREY, y: str | None = None, **style: Any) -> None:
        """Draw steady states of the DEM as points with bars of one standard deviation between packings to each side."""
        y = y or self.y
        self.draw(data.columns, y, color=color, **POINTS | style)
        bars = {f"{axis}err": data.scatter[name] for axis, name in (("x", self.x), ("y", y)) if name in data.scatter}
        if bars:
            self.axes.errorbar(data.columns[self.x], data.columns[y], **bars, fmt="none", ecolor=color, elinewidth=0.8)

    def legend(self, place: Any, **options: Any) -> None:
        """Add a legend."""
        self.axes.legend(loc=place, fontsize=7.5, frameon=False, **options)

    def inset(self, bounds: tuple[float, float, float, float], label: str, limits: tuple[float, float]) -> Axes:
        """Add small axes for a constant against mu."""
        axes = self.axes.inset_axes(bounds, xlim=(-0.05, 1.05), ylim=limits, xticks=(0, 0.5, 1))
        axes.set_xlabel(r"$\mu$", fontsize=8, labelpad=0)
        axes.set_ylabel(label, fontsize=8, labelpad=1)
        axes.tick_params(labelsize=6)
        return axes


def _sheet(number: int, title: str, notes: Sequence[str], names: Sequence[tuple[str, str]], columns: int = 2,
           law_colours: bool = False, dem: str | None = GREY) -> tuple[Figure, list[Panel]]:
    """A figure with a panel for each pair (x, y) of columns, and below a legend of the laws and the DEM, and notes.

    The laws have colours of their own, or grey lines in the legend; the DEM's points have a colour, or are not there.
    """
    rows, foot = -(-len(names) // columns), 0.5 + 0.17 * len(notes)                 # inches
    height = 2.7 * rows + 0.4 + foot
    figure = Figure(figsize=(max((4.8 - 0.3 * columns) * columns, 6.4), height))
    figure.set_layout_engine("constrained", rect=(0, foot / height, 1, 1 - foot / height))
    figure.suptitle(f"Figure {number}: {title}", fontsize=11)
    figure.text(0.5, 0.1 / height, "\n".join(notes), fontsize=8, ha="center", va="bottom", linespacing=1.3)
    handles = [Line2D([], [], color=law.colour if law_colours else GREY, linestyle=law.line, label=law.label) for law in _laws()]
    if dem:
        handles.append(Line2D([], [], color=dem, label=DEM, **POINTS))
    figure.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, (foot - 0.3) / height), ncol=len(handles),
                  fontsize=8, frameon=False, borderaxespad=0)
    panels = []
    for i, (x, y) in enumerate(names):
        axes = figure.add_subplot(rows, columns, i + 1, xlabel=LABELS[x], ylabel=LABELS[y])
        axes.set_title(f"({'abcd'[i]})" if len(names) > 1 else "", loc="left", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(linewidth=0.3)
        panels.append(Panel(axes, x, y))
    return figure, panels


def _evolution(number: int, title: str, notes: Sequence[str], first: str, histories: Sequence[tuple[Law, Columns]],
               runs: Sequence[Measured], x: str = "strain") -> Figure:
    """A figure of the column `first`, stress ratio, coordination number and fabric against strain."""
    names = [(x, y) for y in (first, "stress_ratio", "Z2", "A_xz")]
    figure, panels = _sheet(number, title, notes, names, law_colours=True, dem=BLUE if runs else None)
    for panel in panels:
        for run in runs:
            panel.measured(run)
        for law, history in histories:
            panel.draw(history, color=law.colour, linestyle=law.line)
    return figure


def _steady_by_friction(panels: Sequence[Panel]) -> None:
    """Steady simple shear, one colour for each mu."""
    for mu, colour in MU_COLOURS.items():
        for panel in panels:
            for law, material in _materials(mu):
                panel.draw(_steady(material), color=colour, linestyle=law.line, label=law.once(rf"$\mu$ = {mu:g}"))
            panel.points(_steady_dem(mu), colour)
            panel.legend("upper left")


def _stress_figure(number: int, title: str, notes: Sequence[str], closure: str, *plots: tuple[str, Sequence[float]]) -> Figure:
    """A figure with a panel for each (y, mus): steady shear against phi for these mu, or without any the reversal at mu 0.5."""
    names = [("phi" if mus else "strain", y) for y, mus in plots]
    figure, panels = _sheet(number, title, notes, names, len(plots))
    for panel, (_, mus) in zip(panels, plots):
        for axis, colour in zip(STRESSES[panel.y], (BLUE, RED, GREEN)):
            name = f"sigma_{axis}/p"
            for mu, width, filled in zip(mus, (1.5, 0.7), ("none", colour)):
                for law, material in _materials(mu, closure=closure):
                    panel.draw(_steady(material), name, color=colour, linestyle=law.line, linewidth=width)
                panel.points(_steady_dem(mu), colour, name, markerfacecolor=filled)
            for law, material in [] if mus else _materials(0.5, closure=closure):
                panel.draw(_reversal(material, material.steady(0.60)), name, color=colour, linestyle=law.line)
            for run in [] if mus else _dem_reversal():
                panel.draw(run.columns, name, color=colour, **DOTS)
            panel.axes.plot([], color=colour, label=r"$\bar\sigma_{13}$" if axis == "13" else rf"$\sigma_{{{axis}}}$")
        panel.axes.set_ylim(None if panel.y == "shear" else (0.85, 1.15))
        panel.legend("center" if panel.y == "shear" else "upper center", ncol=3)
    return figure


# ---- the figures -----------------------------------------------------------------------------------------------------

STEADY_POINTS = "DEM: steady shear at constant volume, inertial number below 0.001; bars: one standard deviation between packings"
REVERSAL = r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, reversal at 1"


def figure_01() -> Figure:
    """Unsteady simple shear at constant volume."""
    steps = driver.shear(1), driver.pause(), driver.shear(-2, increments=400)
    histories = [(law, _history(material, material.steady(0.60), *steps)) for law, material in _materials(0.5)]
    before, pause, after = _run("steady", turn=2, first=2), _run("pause", at=1), _run("reversal", at=2)
    pause = [run.having(time=1 + PAUSED * np.arange(len(run.columns["step"]))) for run in pause]
    notes = (r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, closure full: steady shear, pause, reversed shear",
             _said(before, pause, after) + "; it rests for 0.06",
             "the model's stress follows from its state at once: its stress ratio jumps at the reversal")
    return _evolution(1, "unsteady simple shear at constant volume", notes, "p", histories, before + pause + after, "time")


def figure_02() -> Figure:
    """Shear reversal at constant pressure."""
    runs = _run("pressure-reversal", turn=1)
    p = _held(runs)
    histories = [(law, _reversal(material, steady_at(material, p), "pressure")) for law, material in _materials(0.5)]
    notes = (rf"$\mu$ = 0.5, closure full, reversal at 1; the model: constant pressure $p\,d/k$ = {p:.4f}, from its steady state",
             "the DEM: each normal stress is held at what it was in steady shear; " + _said(runs))
    return _evolution(2, "shear reversal at constant pressure", notes, "phi", histories, runs)


def _held(runs: Sequence[Measured]) -> float:
    """The pressure that runs hold."""
    return float(np.mean([run.columns["p"][1:].mean() for run in runs])) if runs else PRESSURE


def figure_03() -> Figure:
    """Pressure against coordination number, steady and unsteady."""
    reversals = {phi: _run("reversal", phi=phi) for phi in (0.592, 0.600, 0.610, 0.620)}
    pressure = _run("pressure-reversal", turn=1)
    notes = (r"$\mu$ = 0.5, closure full; reversals at constant volume from steady shear at $\phi$ = 0.592, 0.600, 0.610, 0.620",
             r"and at constant pressure from $\phi$ = 0.600; thick lines: the model's steady shear, thin ones: its reversals",
             _said(*reversals.values(), pressure).partition(";")[0] + "; liquefied grains, whose Z2 falls to 0, are left out")
    figure, [panel] = _sheet(3, "pressure against coordination number", notes, [("Z2", "p")], 1, law_colours=True)
    for law, material in _materials(0.5):
        panel.draw(_steady(material), color=law.colour, linestyle=law.line, linewidth=2)
        for phi in reversals:
            panel.draw(_reversal(material, material.steady(phi)), color=law.colour, linestyle=law.line, linewidth=0.6)
    for (phi, runs), colour in zip(reversals.items(), PHI_COLOURS):
        for run in runs:
            panel.draw(run.columns, color=colour, label=rf"DEM, reversal at $\phi$ = {phi:.3f}", **DOTS)
    for run in pressure:
        panel.draw(run.columns, color=GREY, label="DEM, reversal at constant pressure", **DOTS | {"marker": "s"})
    panel.points(_steady_dem(0.5), GREY, label="DEM, steady shear", markerfacecolor=GREY)
    panel.axes.set_xlim(4.3, 6.1)
    panel.legend("upper left")
    return figure


def figure_04() -> Figure:
    """Pressure against coordination number, isotropic and in steady shear."""
    loosest = {mu: min(phi for other, phi in compressions(mu)) for mu in dict.fromkeys(mu for mu, _ in compressions())}
    notes = ("closure full; steady shear: (c), (d), in (a) upper lines and filled points; isotropic compression: (b), in (a)",
             r"lower lines and open points, of the DEM from the loosest start, $\phi_i$ = 0.3; colours as in (c)", STEADY_POINTS)
    figure, panels = _sheet(4, "pressure against coordination number", notes, [("Z2", "p")] * 3 + [("(Z2-Zc)^2", "p")])
    inset = panels[1].inset((0.15, 0.62, 0.22, 0.34), "$a_1$", (0, 0.015))
    for mu, colour in MU_COLOURS.items():
        compressed = _compressed(mu)[mu, loosest[mu]] if mu in loosest else None
        for law, material in _materials(mu):
            if mu in (0.1, 0.5):
                panels[0].draw(_isotropic(material), color=colour, linestyle=law.line)
                panels[0].draw(_steady(material), color=colour, linestyle=law.line)
            panels[1].draw(_isotropic(material), color=colour, linestyle=law.line)
        if mu in (0.1, 0.5):
            panels[0].points(_steady_dem(mu), colour, markerfacecolor=colour)
        if compressed:
            for panel in panels[:2] if mu in (0.1, 0.5) else panels[1:2]:
                panel.points(compressed, colour)
            inset.plot(mu, jamming(compressed.columns).a1, color=colour, **POINTS)
    _steady_by_friction(panels[2:])
    for law in _laws():
        inset.plot(law.constants()["mu"], law.constants()["a1"], color=GREY, linestyle=law.line)
    for panel in panels[:3]:
        panel.axes.set_xlim(3.9, 7.6)
    for panel in panels:
        panel.axes.set_ylim(-0.001, 0.036)
    panels[3].axes.set_xlim(-0.1, 3.2)
    return figure


def figure_05() -> Figure:
    """Constants of the pressure and of the coordination number."""
    notes = (r"printed: the fits of table 1; $a_2$ is +0.1 $\mu$: the minus sign printed in the table is a misprint",)
    figure, panels = _sheet(5, "constants of the pressure and of the coordination number", notes,
                            [("mu", "Zc"), ("mu", "a2"), ("mu", "phic")], 3, dem=None)
    for panel in panels:
        for law in _laws():
            panel.draw(law.constants(), color=GREY, linestyle=law.line)
    return figure


def figure_06() -> Figure:
    """Hookean and Hertzian contacts."""
    notes = (r"$\mu$ = 0.5, closure full, steady simple shear; of Hookean contacts $(p\,d/k)^{3/2}$ is drawn (4.4)",
             "DEM: constant volume, inertial number below 0.002; bars: one standard deviation between packings",
             "dem-2026 has no constants for Hertzian contacts")
    figure, [panel] = _sheet(6, "Hookean and Hertzian contacts", notes, [("Z2", "p_Hz")], 1)
    for law, material in _materials(0.5, contact="hertzian"):
        columns = _steady(material)
        panel.draw(columns, "p", color=GREY, linestyle=law.line)
    for contact, power, style in (("hookean", 1.5, {"color": BLUE}), ("hertzian", 1, {"color": RED, "marker": "s"})):
        data = steady(0.5, contact=contact, slow=2 * SLOW)
        scaled = data.columns["p"] ** power
        scatter = {"p_Hz": power * scaled * data.scatter["p"] / data.columns["p"]}
        panel.points(data.having(p_Hz=scaled)._replace(scatter=data.scatter | scatter), label=contact.capitalize(), **style)
    panel.legend("upper left")
    return figure


def figure_07() -> Figure:
    """Stress ratio against fabric."""
    runs = _run("reversal")
    fit = quadratic_friction([run.columns for run in _run("reversal", first=1)])
    notes = (r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, closure full; model: reversed twice, DEM: reversed once",
             "(4.6), dotted, has no printed constants; here a least-squares fit to the DEM after reversal:",
             ", ".join(rf"$\hat b_{name[1]} = {value:.3g}$" for name, value in fit.items()), _said(runs))
    figure, [panel] = _sheet(7, "stress ratio against fabric", notes, [("A_xz", "stress_ratio")], 1, law_colours=True, dem=BLUE)
    for run in runs:
        panel.measured(run)
    linear = [(material, law.colour, law.line, law.once("linear (4.5)")) for law, material in _materials(0.5)]
    for material, colour, line, label in [*linear, (Material(0.5, friction="quadratic", **fit), GREY, ":", "quadratic (4.6)")]:
        steps = driver.shear(-2, increments=2000), driver.shear(2, increments=2000)
        panel.draw(_history(material, material.steady(0.60), *steps), color=colour, linestyle=line, label=label)
    panel.legend("upper right")
    return figure


def figure_08() -> Figure:
    """Friction coefficient of steady simple shear."""
    notes = (r"closure full, (4.5); $\eta$ does not depend on $\phi$", STEADY_POINTS)
    figure, (friction, constants) = _sheet(8, "friction coefficient of steady simple shear", notes, [("mu", "eta"), ("mu", "b")])
    for law in _laws():
        c = law.constants()
        c["eta"] = np.array([_steady(material, [0.1])["eta"][0] for mu in c["mu"].tolist() if (material := law.material(mu))])
        friction.draw(c, color=GREY, linestyle=law.line, label=law.once("steady shear"))
        if law.calibration == "table-1":
            c |= {"b1 + b2 chi": c["b1"] + c["b2"] * c["chi"], "printed": 0.41 - 0.3 * np.exp(-6 * c["mu"])}
            friction.draw(c, "b1 + b2 chi", color=RED, linestyle="--", label=r"$b_1+b_2\chi$ (A 12), which neglects the spin")
            friction.draw(c, "printed", color=BLUE, linestyle=":", linewidth=2, label=r"printed fit $0.41-0.3\,e^{-6\mu}$")
        for name, colour in (("b1", BLUE), ("b2", RED)):
            constants.draw(c, name, color=colour, linestyle=law.line, label=law.once(f"$b_{name[1]}$"))
    friction.points(_steady_dem(), y="stress_ratio")
    friction.legend("lower right")
    constants.legend("center right")
    return figure


def figure_09() -> Figure:
    """Coordination number of steady simple shear."""
    notes = (r"closure full; (b) the printed lines coincide, slightly below $7.5\,(\phi-\phi_c)^{1/2}$ because of the spin",
             STEADY_POINTS, r"$Z_c$ and $\phi_c$ of the DEM points in (b) and in the inset are the fits of table 1")
    figure, panels = _sheet(9, "coordination number of steady simple shear", notes, [("phi", "Z2"), ("(phi-phic)^1/2", "Z2-Zc")])
    _steady_by_friction(panels)
    inset = panels[0].inset((0.72, 0.17, 0.26, 0.30), r"$\beta_1$", (6, 16))
    for law in _laws():
        inset.plot(law.constants()["mu"], law.constants()["beta1"], color=GREY, linestyle=law.line)
    for mu, colour in MU_COLOURS.items():
        columns = _steady_dem(mu).columns
        if len(columns["phi"]):
            inset.plot(columns["mu"], columns["Z2-Zc"] / columns["(phi-phic)^1/2"], color=colour, **POINTS | {"markersize": 3})
    return figure


def figure_10() -> Figure:
    """Cyclic simple shear at constant pressure."""
    runs = _run("pressure-cycles", at=0.5)
    p = _held(runs)
    histories = [(law, _history(material, steady_at(material, p), driver.shear(0.5, "pressure", 100),
                                *driver.cycles(-0.5, 4, "pressure"))) for law, material in _materials(0.5)]
    notes = (rf"$\mu$ = 0.5, closure full, amplitude 0.5; the model: constant pressure $p\,d/k$ = {p:.4f}, from its steady state",
             "the DEM: each normal stress is held at what it was in steady shear; " + _said(runs))
    return _evolution(10, "cyclic simple shear at constant pressure", notes, "phi", histories, runs)


def figure_11() -> Figure:
    """Reynolds dilatancy."""
    runs = _run("reynolds", phi=0.470, turn=1, at=0, first=1)
    p, phi = _held(runs), np.mean([run.columns["phi"][0] for run in runs]) if runs else 0.612
    materials = _materials(0.5)
    histories = [(law, _history(material, material.isotropic(float(phi), pressure=p), driver.shear(4, "pressure", 800)))
                 for law, material in materials]
    notes = (rf"$\mu$ = 0.5, closure full, constant pressure $p\,d/k$ = {p:.4f}, isotropic start at $\phi$ = {phi:.4f}",
             _said(runs))
    figure = _evolution(11, "Reynolds dilatancy", notes, "phi", histories, runs)
    axes = figure.axes[0]
    for law, material in materials:
        level = float(steady_at(material, p)["volume_fraction"])
        axes.axhline(level, color=law.colour, linewidth=0.9, linestyle=":")
        axes.text(0, level, f"steady: {level:.4f}", fontsize=7.5, va="bottom", color=law.colour)
    return figure


def figure_12() -> Figure:
    """Isotropic compression from different starts."""
    compressed = {phi: data for (_, phi), data in _compressed(0.5).items()}
    notes = (r"$\mu$ = 0.5; $\phi_i$: volume fraction of frictionless spheres in motion, before friction and compression",
             "lines: the model, (4.2) without fabric; it has no line in (a), where no steady shear fixes the volume fraction",
             _said(list(compressed.values())).replace("bands", "bars"))
    figure, panels = _sheet(12, "isotropic compression", notes, [("phi", "p"), ("Z2", "p"), ("(Z2-Zc)^2", "p"), ("phi_ci", "a1*")])
    for law, material in _materials(0.5):
        for panel in panels[1:3]:
            panel.draw(_isotropic(material), color=GREY, linestyle=law.line)
        panels[3].axes.axhline(material["a1"], color=GREY, linestyle=law.line)
    for number, (phi, data) in enumerate(compressed.items()):
        style = {"color": PHI_COLOURS[number % len(PHI_COLOURS)], "marker": MARKERS[number % len(MARKERS)]}
        for panel in panels[:3]:
            panel.points(data, label=rf"$\phi_i$ = {phi:g}", **style)
        found = jamming(data.columns)
        panels[3].axes.plot(found.phi_ci, found.a1, **POINTS | style)
    for panel in panels[:3]:
        panel.axes.set_ylim(-0.001, 0.033)
    panels[0].legend("upper left")
    panels[3].axes.set_ylim(0, None)
    return figure


def figure_13() -> Figure:
    """Stresses of steady simple shear."""
    notes = (r"$\mu$ = 0.5, closure full: the model's lines do not depend on $\phi$", STEADY_POINTS.partition(";")[0])
    return _stress_figure(13, "stresses of steady simple shear", notes, "full", ("normal", [0.5]), ("shear", [0.5]))


def figure_14() -> Figure:
    """Normal stresses without their first difference."""
    notes = (r"closure n2; $\bar\sigma_{13}=(\sigma_{xx}+\sigma_{zz})/2$; (a) steady shear, thick lines and open points: "
             r"$\mu$ = 0.5, thin lines and filled points: $\mu$ = 0.1",
             "(b) " + REVERSAL + "; " + _said(_dem_reversal()).partition(";")[0])
    return _stress_figure(14, "normal stresses without their first difference", notes, "n2",
                          ("normal, two", [0.5, 0.1]), ("normal, two", []))


def figure_15() -> Figure:
    """Normal stresses with both differences."""
    notes = (r"closure full; (a) steady shear, $\mu$ = 0.5; (b) steady shear, $\mu$ = 0.1; (c) " + REVERSAL,
             _said(_dem_reversal()).partition(";")[0])
    return _stress_figure(15, "normal stresses with both differences", notes, "full",
                          ("normal", [0.5]), ("normal", [0.1]), ("normal", []))


def figure_16() -> Figure:
    """Constants of the normal stress differences."""
    notes = (r"$a_4$ is printed in three forms, each a calibration of its own; table-1 is the default",)
    names = [("mu", "a3"), ("mu", "a4")]
    figure, (third, fourth) = _sheet(16, "constants of the normal stress differences", notes, names, dem=None)
    for law in _laws():
        third.draw(law.constants(), color=GREY, linestyle=law.line)
    for calibration, colour in zip(dict.fromkeys((*CALIBRATIONS, *SHOWN)), (GREY, RED, BLUE, GREEN)):
        fourth.draw(Law(calibration, colour, "-").constants(), color=colour, label=calibration)
    fourth.legend("lower right")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "1": figure_01, "2": figure_02, "3": figure_03, "4": figure_04, "5": figure_05, "6": figure_06, "7": figure_07, "8": figure_08,
    "9": figure_09, "10": figure_10, "11": figure_11, "12": figure_12, "13": figure_13, "14": figure_14, "15": figure_15,
    "16": figure_16}


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
