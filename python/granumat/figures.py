"""The model's curves of the paper's figures, with this project's discrete-element (DEM) data where the conditions match.

Everything that is plotted is a dict of columns named as in granumat.driver, plus those of `_derived`; DEM runs too.
"""

import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from . import driver, tensors
from .material import CALIBRATIONS, STATE, Material, refuse

MUS = (0.0, 0.1, 0.3, 0.5, 1.0)
BLUE, RED, GREEN, PURPLE, ORANGE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "0.25"     # Okabe & Ito
MU_COLOURS = dict(zip(MUS, (PURPLE, GREEN, ORANGE, BLUE, RED)))
STRESS_COLOURS = {"sigma_xx": BLUE, "sigma_yy": RED, "sigma_zz": GREEN, "sigma_13": BLUE,
                  "sigma_xz": BLUE, "sigma_xy": RED, "sigma_yz": GREEN}
DEM = "DEM (this project's runs, 2000 spheres, one realisation each)"
POINTS = {"linestyle": "none", "marker": "o", "markersize": 4.5, "markerfacecolor": "none", "markeredgewidth": 0.9}
DOTS = POINTS | {"markersize": 2.2, "markeredgewidth": 0.5}
THINNING = 4            # one row in so many of a DEM run is drawn against strain

MU = r"interparticle friction coefficient $\mu$"
STRAIN = r"accumulated shear strain $\dot\gamma_0 t$"
NORMAL = r"normal stress $\sigma/p$"
LABELS = {
    "mu": MU, "strain": STRAIN, "time": STRAIN + r" (paused for $1<\dot\gamma_0 t<2$)",
    "p": r"pressure $p\,d/k$", "phi": r"volume fraction $\phi$", "stress_ratio": r"stress ratio $-\sigma_{xz}/p$",
    "Z2": r"coordination number $Z_2$", "A_xz": r"fabric $A_{xz}$", "eta": r"friction coefficient $\eta$",
    "Z2-Zc": r"$Z_2-Z_c$", "(Z2-Zc)^2": r"$(Z_2-Z_c)^2$", "(phi-phic)^1/2": r"$(\phi-\phi_c)^{1/2}$",
    "normal/p": NORMAL, "shear/p": r"shear stress $\sigma/p$",
    "Zc": r"critical coordination number $Z_c$", "a2": r"$a_2$ in (4.2)", "phic": r"critical volume fraction $\phi_c$",
    "b1, b2": r"constants of (4.5)", "a3": r"$a_3$ in (A 1)", "a4": r"$a_4$ in (A 4)",
}


# ---- columns ---------------------------------------------------------------------------------------------------------

def _derived(columns, material):
    """The columns with those that only figures use: scaled stresses, distances from jamming."""
    more = {"sigma_13/p": (columns["sigma_xx"] + columns["sigma_zz"]) / 2 / columns["p"],
            "Z2-Zc": columns["Z2"] - material["Zc"], "(Z2-Zc)^2": (columns["Z2"] - material["Zc"]) ** 2,
            "(phi-phic)^1/2": np.sqrt(np.maximum(columns["phi"] - material["phic"], 0))}
    return columns | more | {f"sigma_{axis}/p": columns[f"sigma_{axis}"] / columns["p"] for axis in tensors.AXES}


def _history(material, state, steps):
    """Columns along a path; `time` goes on through its second step, a pause of 1 (figure 1)."""
    columns = driver.run(material, state, steps).columns
    strain = columns["gamma_total"]
    return _derived(columns | {"strain": strain, "time": strain + (columns["step"] > 1)}, material)


def _steady(material):
    """Columns of steady simple shear at volume fractions above phic."""
    states = [material.steady(phi) for phi in material["phic"] + np.linspace(0.02, 0.21, 58) ** 2]
    return _derived(driver.state_columns(material, np.array(states, STATE)), material)


def _isotropic(material):
    """Columns of isotropic states from Zc up; the pressure does not depend on phi."""
    states = [material.isotropic(0.6, coordination_number=material["Zc"] + x) for x in np.linspace(0, 2, 61)]
    return driver.state_columns(material, np.array(states, STATE))


def _constants(**definition):
    """Columns of the constants against mu."""
    mus = np.linspace(0, 1, 101)
    materials = [Material(mu, **definition) for mu in mus.tolist()]
    return {"mu": mus} | {name: np.array([material[name] for material in materials]) for name in materials[0].constants
                          if name != "mu"}


@dataclass(frozen=True)
class Run:
    """A DEM run: rows (n,) of columns, those of slow steady shear and those after its reversal."""

    mu: float
    columns: dict
    forward: np.ndarray
    after: np.ndarray

    def rows(self, which):
        return {name: column[which] for name, column in self.columns.items()}

    @property
    def mean(self):
        """Means over the slow steady shear."""
        return {name: column[self.forward].mean() for name, column in self.columns.items()}


def dem_runs(*mus):
    """The DEM runs of these interparticle friction coefficients, from the package's data.

    Raises
    ------
    FileNotFoundError
        If the package was built without them.
    """
    folder = resources.files(__package__) / "data"
    matches = [re.fullmatch(r"cv_mu([0-9.]+)_phi[0-9.]+_s\d+\.csv", file.name) for file in folder.iterdir()] if folder.is_dir() else []
    matches = sorted((match for match in matches if match), key=lambda match: match[0])
    if not matches:
        raise FileNotFoundError(f"no DEM data in {folder}: the build puts demos/data/cv_mu*_phi*_s*.csv there")
    return [_read_run(folder / match[0], float(match[1])) for match in matches if float(match[1]) in mus]


def _read_run(path, mu):
    with path.open() as file:
        names = file.readline().strip().split(",")
        data = dict(zip(names, np.loadtxt(file, delimiter=",").T))
    rename = {f"{letter}{axis}": f"{word}_{axis}" for letter, word in (("p", "sigma"), ("A", "A")) for axis in tensors.AXES}
    columns = {rename.get(name, name): column for name, column in data.items()}
    columns["p"] = (data["pxx"] + data["pyy"] + data["pzz"]) / 3
    columns["stress_ratio"] = -data["pxz"] / columns["p"]
    last = data["gamma"].argmax()
    row = np.arange(len(data["gamma"]))
    after = row > last
    forward = (data["gamma_acc"] > 0) & ~after             # gamma_acc is negative in the first, faster shear
    start, end = data["gamma"][forward][0], data["gamma"][last]
    columns["strain"] = np.where(after, 2 * end - data["gamma"], data["gamma"]) - start
    columns["time"] = columns["strain"] + after
    columns["mu"] = np.full(len(row), mu)
    columns["eta"] = np.abs(columns["stress_ratio"])         # in steady shear
    return Run(mu, _derived(columns, Material(mu)), forward, after)


# ---- panels ----------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Panel:
    """Axes with the names of the columns they show."""

    axes: Axes
    x: str
    y: str

    def draw(self, columns, y=None, **style):
        self.axes.plot(columns[self.x], columns[y or self.y], **style)

    def legend(self, **options):
        self.axes.legend(fontsize=7.5, frameon=False, **options)


def _sheet(number, title, notes, names, columns=2, dem=True, colours=(GREY, GREY)):
    """A figure with lettered panels of the columns named (x, y), its conditions and a legend below."""
    rows, foot = -(-len(names) // columns), 0.45 + 0.17 * notes.count("\n") + 0.17
    width, height = max(4.4 * columns, 6.4), 2.7 * rows + 0.4 + foot
    figure = Figure(figsize=(width, height))
    figure.set_layout_engine("constrained", rect=(0, foot / height, 1, 1 - foot / height))
    figure.suptitle(f"Figure {number}: {title}", fontsize=11)
    figure.text(0.5, 0.08 / height, notes, fontsize=8, ha="center", va="bottom", linespacing=1.3)
    handles = [Line2D([], [], color=colours[0], label="model"), Line2D([], [], color=colours[1], label=DEM, **POINTS)]
    figure.legend(handles=handles[:1 + dem], loc="lower center", bbox_to_anchor=(0.5, (foot - 0.3) / height), ncol=2,
                  fontsize=8, frameon=False, borderaxespad=0)
    panels = []
    for i, (x, y) in enumerate(names):
        axes = figure.add_subplot(rows, columns, i + 1)
        axes.set_xlabel(LABELS[x], fontsize=9)
        axes.set_ylabel(LABELS[y], fontsize=9)
        if len(names) > 1:
            axes.set_title(f"({'abcd'[i]})", loc="left", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(linewidth=0.3)
        panels.append(Panel(axes, x, y))
    return figure, panels


def _evolution(number, title, notes, first, history, runs=(), x="strain"):
    """Four panels against strain: `first`, stress ratio, coordination number and fabric."""
    names = [(x, y) for y in (first, "stress_ratio", "Z2", "A_xz")]
    figure, panels = _sheet(number, title, notes, names, dem=bool(runs), colours=(RED, BLUE))
    for panel in panels:
        for run in runs:
            panel.draw(run.rows(run.forward | run.after), color=BLUE, markevery=THINNING, **DOTS)
        panel.draw(history, color=RED)
    return figure, panels


def _stresses(panel, columns, components, **style):
    """Scaled stress components, each in its colour."""
    for name in components:
        label = rf"$\bar\sigma_{{13}}$" if name == "sigma_13" else rf"$\sigma_{{{name[-2:]}}}$"
        panel.draw(columns, f"{name}/p", color=STRESS_COLOURS[name], **{"label": label} | style)


def _steady_stresses(panel, mu, closure, components, **style):
    """Stress components of steady shear against phi, model and DEM."""
    _stresses(panel, _steady(Material(mu, closure)), components, **style)
    for run in dem_runs(mu):
        _stresses(panel, run.mean, components, label=None, **POINTS)


def _reversal_stresses(panel, closure, components):
    """Stress components before and after a reversal at mu 0.5, phi 0.60, model and DEM."""
    material = Material(0.5, closure)
    for run in dem_runs(0.5):
        _stresses(panel, run.rows(run.forward | run.after), components, label=None, markevery=THINNING, alpha=0.7, **DOTS)
    _stresses(panel, _history(material, material.steady(0.60), [driver.shear(1), driver.shear(-2, increments=400)]), components)
    panel.legend(loc="lower right", ncol=len(components))


def _inset(panel, bounds, columns, label, limits):
    """A small plot of a constant against mu."""
    axes = panel.axes.inset_axes(bounds)
    axes.plot(*columns, color=GREY)
    axes.set(ylim=limits, xlim=(0, 1))
    axes.set_xlabel(r"$\mu$", fontsize=7, labelpad=0)
    axes.set_ylabel(label, fontsize=7, labelpad=1)
    axes.tick_params(labelsize=6)
    return axes


def _level(panel, height, text, **style):
    """A labelled horizontal line."""
    panel.axes.axhline(height, linewidth=0.9, **style)
    panel.axes.text(0.98, height, text, transform=panel.axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=7.5)


# ---- the figures -----------------------------------------------------------------------------------------------------

def figure_01():
    material = Material(0.5)
    history = _history(material, material.steady(0.60), [driver.shear(1), driver.pause(), driver.shear(-2, increments=400)])
    return _evolution(1, "unsteady simple shear at constant volume", r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, closure full; "
                      "shear 1, pause, reversed shear 2; DEM: two runs", "p", history, dem_runs(0.5), "time")[0]


def figure_02():
    material = Material(0.5)
    state = material.steady(0.60)
    history = _history(material, state, [driver.shear(1, "pressure"), driver.shear(-2, "pressure", 400)])
    return _evolution(2, "shear reversal at constant pressure", r"$\mu$ = 0.5, $p\,d/k$ = " f"{history['p'][0]:.4f}, the model's steady "
                      r"pressure at $\phi$ = 0.60, closure full; reversal at 1; no DEM run of this project", "phi", history)[0]


def figure_04():
    figure, panels = _sheet(4, "pressure against coordination number", "closure full; (a) solid: steady simple shear, dashed: isotropic; "
                            "(b) isotropic; (c, d) steady simple shear\nDEM: steady means at constant volume "
                            r"($\mu$, $\phi$) = (0.1, 0.63), (0.3, 0.61), (0.5, 0.60) twice",
                            [("Z2", "p")] * 3 + [("(Z2-Zc)^2", "p")])
    for mu, colour in MU_COLOURS.items():
        material = Material(mu)
        isotropic, steady = _isotropic(material), _steady(material)
        style = {"color": colour, "label": rf"$\mu$ = {mu:g}"}
        if mu in (0.1, 0.5):
            panels[0].draw(isotropic, color=colour, linestyle="--")
            panels[0].draw(steady, **style)
        panels[1].draw(isotropic, **style)
        for panel in panels[2:]:
            panel.draw(steady, **style)
            for run in dem_runs(mu):
                panel.draw(run.mean, color=colour, **POINTS)
    for panel in panels:
        panel.axes.set_ylim(0, 0.035)
        panel.legend(loc="upper left")
    constants = _constants()
    _inset(panels[1], (0.30, 0.62, 0.28, 0.32), (constants["mu"], constants["a1"]), "$a_1$", (0, 0.015))
    return figure


def figure_05():
    figure, panels = _sheet(5, "constants of the pressure and of the coordination number", "fits of table 1; its sign of $a_2$ is a "
                            r"misprint: +0.1$\mu$ here", [("mu", y) for y in ("Zc", "a2", "phic")], 3, dem=False)
    for panel in panels:
        panel.draw(_constants(), color=GREY)
    return figure


def quadratic_friction(runs):
    """b1, b2, b3 of (4.6) by least squares over all rows after the reversals, where A:S^ = -2 A_xz and eta = sigma_xz/p."""
    x = np.concatenate([-2 * run.columns["A_xz"][run.after] for run in runs])
    eta = np.concatenate([-run.columns["stress_ratio"][run.after] for run in runs])
    return dict(zip(("b3", "b2", "b1"), np.polyfit(x, eta, 2).tolist()))


def figure_07():
    runs = dem_runs(0.5)
    fit = quadratic_friction(runs)
    notes = (r"$\mu$ = 0.5, $\phi$ = 0.60, constant volume, closure full; model: reversed and reversed again, DEM: reversed once"
             "\n(4.5) with table 1's constants; (4.6) with constants fitted here to the DEM rows after the reversal:\n" + ", ".join(
                 rf"$\hat b_{name[1]}$ = {value:.4g}" for name, value in sorted(fit.items())))
    figure, [panel] = _sheet(7, "stress ratio against fabric during reversal", notes, [("A_xz", "stress_ratio")], 1)
    for run in runs:
        panel.draw(run.rows(run.forward | run.after), color=BLUE, markevery=2, **DOTS)
    for label, style, definition in (("linear (4.5)", "--", {}), ("quadratic (4.6)", "-", {"friction": "quadratic"} | fit)):
        material = Material(0.5, **definition)
        history = _history(material, material.steady(0.60), [driver.shear(-2, increments=400), driver.shear(2, increments=400)])
        panel.draw(history, color=RED, linestyle=style, label=label)
    panel.legend(loc="upper right")
    return figure


def figure_08():
    figure, (steady, constants) = _sheet(8, "macroscopic friction coefficient of steady simple shear", r"closure full; $\eta$ does not "
                                         r"depend on $\phi$; DEM at ($\mu$, $\phi$) = (0.1, 0.63), (0.3, 0.61), (0.5, 0.60) twice",
                                         [("mu", "eta"), ("mu", "b1, b2")])
    c = _constants()
    c["eta"] = np.array([Material(mu).evaluate(Material(mu).steady(0.66))[1] for mu in c["mu"].tolist()])
    c["closed"], c["fit"] = c["b1"] + c["b2"] * c["chi"], -0.3 * np.exp(-6 * c["mu"]) + 0.41
    steady.draw(c, color=GREY, label="steady shear, with spin")
    steady.draw(c, "closed", color=RED, linestyle="--", label=r"$b_1+b_2\chi$, spin neglected (A 12)")
    steady.draw(c, "fit", color=BLUE, linestyle=":", linewidth=2, label=r"printed fit $-0.3\,e^{-6\mu}+0.41$")
    for run in dem_runs(*MUS):
        steady.draw(run.mean, color=GREY, **POINTS)
    for name, colour in (("b1", BLUE), ("b2", RED)):
        constants.draw(c, name, color=colour, label=f"${name[0]}_{name[1]}$")
    for panel in (steady, constants):
        panel.legend(loc="lower right" if panel is steady else "center right")
    return figure


def figure_09():
    figure, panels = _sheet(9, "coordination number of steady simple shear", r"closure full; (b) the model's lines coincide, 0.012 below "
                            r"7.5 $(\phi-\phi_c)^{1/2}$ because of the spin" "\n" r"$Z_c$ and $\phi_c$ of the DEM points: table 1's fits",
                            [("phi", "Z2"), ("(phi-phic)^1/2", "Z2-Zc")])
    for mu, colour in MU_COLOURS.items():
        for panel in panels:
            panel.draw(_steady(Material(mu)), color=colour, label=rf"$\mu$ = {mu:g}")
            for run in dem_runs(mu):
                panel.draw(run.mean, color=colour, **POINTS)
    inset = _inset(panels[0], (0.70, 0.16, 0.28, 0.30), ((0, 1), (Material()["beta1"],) * 2), r"$\beta_1$", (6, 10))
    for run in dem_runs(*MUS):
        inset.plot(run.mu, run.mean["Z2-Zc"] / run.mean["(phi-phic)^1/2"], color=MU_COLOURS[run.mu], **POINTS)
    for panel in panels:
        panel.legend(loc="upper left")
    return figure


def figure_10():
    material = Material(0.5)
    history = _history(material, material.steady(0.60), driver.cycles(0.5, 4, "pressure"))
    return _evolution(10, "cyclic shear at constant pressure", r"$\mu$ = 0.5, amplitude 0.5, from the steady state at $\phi$ = 0.60, closure "
                      r"full; no DEM run of this project" "\n" r"$p\,d/k$ = " f"{history['p'][0]:.4f}, the model's with the printed "
                      r"constants; the paper says about 0.01", "phi", history)[0]


def figure_11():
    material = Material(0.5)
    state = material.isotropic(0.612, pressure=0.01)
    history = _history(material, state, [driver.shear(4, "pressure", 800)])
    end = driver.run(material, state, [driver.shear(40, "pressure", 4000)])["phi"][-1]
    figure, panels = _evolution(11, "Reynolds dilatancy", r"$\mu$ = 0.5, isotropic at $\phi$ = 0.612, sheared at constant pressure "
                                r"$p\,d/k$ = 0.01, closure full; no DEM run of this project", "phi", history)
    _level(panels[0], end, f"model, steady: {end:.4f}", color=RED, linestyle="--")
    _level(panels[0], 0.602, "the paper's DEM, steady: about 0.602", color=BLUE, linestyle=":")
    panels[0].axes.set_ylim(0.6010, 0.6135)
    return figure


def figure_13():
    figure, panels = _sheet(13, "stress components of steady simple shear", r"$\mu$ = 0.5, closure full: the model's do not depend on "
                            r"$\phi$; DEM: constant volume, $\phi$ = 0.60, two runs", [("phi", "normal/p"), ("phi", "shear/p")])
    for panel, components in zip(panels, (("sigma_xx", "sigma_yy", "sigma_zz"), ("sigma_xz", "sigma_xy", "sigma_yz"))):
        _steady_stresses(panel, 0.5, "full", components)
        panel.legend(loc="center right")
    panels[0].axes.set_ylim(0.85, 1.15)
    return figure


def figure_14():
    notes = (r"closure n2, $\bar\sigma_{13}=(\sigma_{xx}+\sigma_{zz})/2$; (a) steady shear, solid: $\mu$ = 0.5, dashed: $\mu$ = 0.1, "
             r"DEM: $\phi$ = 0.60 for $\mu$ = 0.5, 0.63 for 0.1" "\n" r"(b) $\mu$ = 0.5, $\phi$ = 0.60, constant volume, reversal at 1")
    figure, (steady, reversal) = _sheet(14, "normal stresses, second difference only", notes,
                                        [("phi", "normal/p"), ("strain", "normal/p")])
    components = ("sigma_13", "sigma_yy")
    _steady_stresses(steady, 0.5, "n2", components)
    _steady_stresses(steady, 0.1, "n2", components, linestyle="--", label=None)
    steady.legend(loc="lower right")
    _reversal_stresses(reversal, "n2", components)
    return figure


def figure_15():
    components = ("sigma_xx", "sigma_yy", "sigma_zz")
    differences = [f"{name} {(c['sigma_xx'] - c['sigma_zz']) / c['p']:+.3f} and {(c['sigma_zz'] - c['sigma_yy']) / c['p']:+.3f}"
                   for name, c in [("model", {k: v[0] for k, v in _steady(Material(0.5)).items()})]
                   + [("DEM", run.mean) for run in dem_runs(0.5)]]
    notes = (r"closure full; (a, b) steady shear, $\mu$ = 0.5 and 0.1; (c) $\mu$ = 0.5, $\phi$ = 0.60, constant volume, reversal at 1" "\n"
             r"$N_1/p$ and $N_2/p$ at $\mu$ = 0.5: " + ", ".join(differences))
    figure, panels = _sheet(15, "normal stresses, both differences", notes, [("phi", "normal/p")] * 2 + [("strain", "normal/p")], 3)
    for panel, mu in zip(panels, (0.5, 0.1)):
        _steady_stresses(panel, mu, "full", components)
        panel.legend(loc="center right")
    _reversal_stresses(panels[2], "full", components)
    return figure


def figure_16():
    figure, (third, fourth) = _sheet(16, "constants of the normal stress differences", r"$a_3$: table 1 and the caption agree; $a_4$: three "
                                     "printed forms, each a named calibration", [("mu", "a3"), ("mu", "a4")], dem=False)
    third.draw(_constants(), color=GREY)
    for calibration, colour in zip(CALIBRATIONS, (GREY, RED, BLUE)):
        fourth.draw(_constants(calibration=calibration), color=colour, label=calibration)
    fourth.legend(loc="lower right")
    return figure


FIGURES = {
    "1": figure_01, "2": figure_02, "4": figure_04, "5": figure_05, "7": figure_07, "8": figure_08, "9": figure_09,
    "10": figure_10, "11": figure_11, "13": figure_13, "14": figure_14, "15": figure_15, "16": figure_16,
}


def draw_figures(out, names=None):
    """Draws figures of the paper as figure-<number>.png.

    Parameters
    ----------
    out : path
        Directory, made if it is not there.
    names : iterable of str or int, optional
        Numbers of figures, keys of FIGURES; the default is all.

    Returns
    -------
    list of pathlib.Path

    Raises
    ------
    ValueError
        For numbers without a figure, all at once.
    FileNotFoundError
        If the package was built without the DEM data.
    """
    names = [str(name) for name in (FIGURES if names is None else names)]
    refuse("the figures cannot be drawn", [f"figure {name!r}: must be one of {', '.join(FIGURES)}"
                                           for name in names if name not in FIGURES])
    Path(out).mkdir(parents=True, exist_ok=True)
    paths = [Path(out) / f"figure-{int(name):02d}.png" for name in names]
    for name, path in zip(names, paths):
        FIGURES[name]().savefig(path, dpi=130)
    return paths
