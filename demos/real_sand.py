# %% [markdown]
# # Real sand: the law beside undrained triaxial cycles of Karlsruhe fine sand
#
# A packing at rest is compressed and extended by 1 %, to and fro, at constant volume, as the sand was. Compared are the pressure,
# over its first value, and q/p at the reversals; and how the loss of pressure depends on the stiffness of the grains and on the
# density. Nothing is fitted. `docs/real-sand.md` discusses what comes out.

# %%
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from granumat import Material, driver
from granumat.material import RANGES
from granumat.paths import read_path_file

PATH = read_path_file(Path(__file__).parent / "paths/triaxial-strain-cycles.toml")
PRESSURE, AMPLITUDE = -PATH.state.stress[0], PATH.steps[0].strain           # p0 d/k and axial strain of the path
CONFINEMENT = 200                                                           # kPa, where quartz has this p0 d/k
REVERSALS = np.cumsum([step.increments for step in PATH.steps])             # rows of a history

FITTED = Material(mu=0.5, calibration="dem-2026")                           # to Hookean spheres
MATERIALS = {                       # what is drawn, all with mu = 0.5
    "printed": {"closure": "full", "elastic_strain": 0.001},
    "mobilised": {"closure": "mobilised", "elastic_strain": 0.01},
    "dem-2026": {name: FITTED[name] for name in RANGES if name not in ("mu", "b3")},    # for Hertzian contacts too
}
DENSITIES = (0.585, 0.59, 0.60)     # phi; phic is 0.5868
STYLES = ("-", "--", ":")           # of the materials
MEASURABLE = 0.01                   # p/p0 below which q/p is not looked at


class Measured(NamedTuple):
    """A test on the sand (Wichtmann & Triantafyllidis 2016)."""

    density_index: float
    pressure: float                 # kPa
    amplitude: float                # axial strain
    p: tuple                        # over its first value, at the first four reversals


TESTS = (
    Measured(0.29, 200, 0.010, (0.41, 0.03, 0.010, 0.007)),
    Measured(0.66, 200, 0.010, (0.64, 0.25, 0.13, 0.06)),
    Measured(0.64, 100, 0.010, (0.59, 0.17, 0.10, 0.06)),
    Measured(0.63, 200, 0.005, (0.59, 0.25, 0.14, 0.07)),
)
RATIOS = (0.8, 1.4)                 # q/p of the sand at reversals
LOOSEST, DENSEST = 1.054, 0.677     # its void ratios at density indices of 0 and 1


def volume_fraction(density_index):
    return 1 / (1 + LOOSEST - density_index * (LOOSEST - DENSEST))


def overlap(kilopascal):
    """p d/k of quartz sand: by Hertz k goes with p^(1/3)."""
    return PRESSURE * (kilopascal / CONFINEMENT)**(2 / 3)


# %%
def follow(settings, phi, pressure=PRESSURE, amplitude=AMPLITUDE, contact="hookean"):
    """p over its first value, and q/p, positive in compression, in all rows of the path, with another material and start."""
    material = Material(mu=0.5, contact=contact, **settings)
    steps = [replace(step, strain=step.strain * amplitude / AMPLITUDE) for step in PATH.steps]
    history = driver.run(material, material.isotropic(phi, pressure), steps)
    return history["p"] / pressure, np.sign(history["sigma_zz"] - history["sigma_xx"]) * history["q_over_p"]


def rows():
    """Of the table: what, p/p0 at four reversals, and the range of abs(q/p) at those where there is a pressure."""
    cases = [(phi, CONFINEMENT, AMPLITUDE) for phi in DENSITIES]
    cases += [(DENSITIES[1], test.pressure, test.amplitude) for test in TESTS[2:]]
    found = [(f"sand, density index {test.density_index}", test.pressure, test.amplitude, test.p, RATIOS) for test in TESTS]
    for name, settings in MATERIALS.items():
        for phi, kilopascal, amplitude in cases:
            p, ratio = follow(settings, phi, overlap(kilopascal), amplitude)
            borne = np.abs(ratio[REVERSALS][p[REVERSALS] > MEASURABLE])
            found.append((f"{name}, phi = {phi}", kilopascal, amplitude, p[REVERSALS], (borne.min(), borne.max())))
    return found


def table():
    """The rows as the page has them."""
    lines = []
    for what, kilopascal, amplitude, pressures, (least, most) in rows():
        shown = " | ".join(f"{p:.2f}" if p > 0.095 else f"{p:.3f}" for p in pressures)
        lines.append(f"| {what} | {kilopascal} kPa, {100 * amplitude:g} % | {shown} | {least:.2g} to {most:.2g} |")
    return lines


# %%
def draw():
    figure = Figure(figsize=(12.5, 7.6), layout="constrained")
    (path, cycles), (density, stiffness) = figure.subplots(2, 2)
    draw_paths(path)
    draw_cycles(cycles)
    draw_density(density)
    draw_stiffness(stiffness)
    for axes in (path, density):
        axes.legend(frameon=False, fontsize=8, loc="upper left" if axes is path else "center right")
    for axes in (cycles, stiffness):
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
        axes.set_ylim(0, 1.6)
    return figure


def draw_paths(axes):
    p = np.array([0, 1.1])
    for sign, label in ((1, "sand at reversals"), (-1, None)):
        axes.fill_between(p, sign * RATIOS[0] * p, sign * RATIOS[1] * p, color="0.85", label=label)
    for (name, settings), style in zip(MATERIALS.items(), STYLES):
        p, ratio = follow(settings, DENSITIES[1])
        axes.plot(p, ratio * p, style, color="C1", label=f"{name}, $\\phi$ = {DENSITIES[1]}")
        axes.plot(p[REVERSALS], (ratio * p)[REVERSALS], "o", color="C1", markersize=3)
    axes.set(title="stress paths: q/p is too low", xlabel="$p/p_0$", ylabel="$q/p_0$, extension negative",
             xlim=(0, 1.1), ylim=(-1, 1))


def draw_cycles(axes):
    for test, marker in zip(TESTS, "vo^s"):
        axes.plot(range(5), (1, *test.p), "k" + marker, fillstyle="none" if test.density_index < 0.5 else "full", markersize=5,
                  label=f"sand, $I_D$ = {test.density_index}, {test.pressure} kPa, {100 * test.amplitude:g} %")
    for (name, settings), style in zip(MATERIALS.items(), STYLES):
        for k, phi in enumerate(DENSITIES):
            axes.plot(range(5), follow(settings, phi)[0][[0, *REVERSALS]], style, color=f"C{k}", label=f"{name}, $\\phi$ = {phi}")
    axes.set(title=f"cycles of 1 % at {CONFINEMENT} kPa: dense packings lose too little", xlabel="reversal", ylabel="$p/p_0$",
             xticks=range(5))


def draw_density(axes):
    fractions, critical = np.linspace(0.58, 0.63, 51), Material(mu=0.5)["phic"]
    for (name, settings), style in zip(MATERIALS.items(), STYLES):
        axes.plot(fractions, [follow(settings, phi)[0][REVERSALS[3]] for phi in fractions], "k" + style, label=name)
    sand = volume_fraction(np.array([test.density_index for test in TESTS]))
    axes.plot(critical + sand - sand[0], [test.p[3] for test in TESTS], "ko", markersize=4,
              label=f"sand, if $I_D$ = {TESTS[0].density_index} is critical")
    axes.axvline(critical, color="0.6", linewidth=0.8)
    axes.annotate(r" $\phi_c$", (critical, 1.55), va="top")
    axes.set(title="density: the law loses pressure near $\\phi_c$ only", xlabel=r"$\phi$",
             ylabel="$p/p_0$ at the fourth reversal", xlim=fractions[[0, -1]], ylim=(0, 1.6))


def draw_stiffness(axes):
    overlaps, second = np.geomspace(1e-5, 1e-1, 25), [test.p[1] for test in TESTS]
    axes.axhspan(min(second), max(second), color="0.85", label="sand, all tests")
    for (name, settings), style in zip(MATERIALS.items(), STYLES):
        for k, phi in list(enumerate(DENSITIES))[::2]:
            for contact, power, width in (("hookean", 1, 1.5), ("hertzian", 1.5, 0.7)):
                p = [follow(settings, phi, x**power, contact=contact)[0][REVERSALS[1]] for x in overlaps]
                axes.semilogx(overlaps, p, style, color=f"C{k}", linewidth=width, label=f"{name}, {contact}, $\\phi$ = {phi}")
    for kilopascal, text in ((10, "10 kPa"), (CONFINEMENT, f"{CONFINEMENT} kPa"), (40_000, "40 MPa")):
        axes.axvline(overlap(kilopascal), color="0.6", linewidth=0.8)
        axes.annotate(f" {text}", (overlap(kilopascal), 1.55), fontsize=8, va="top")
    axes.set(title="stiffness: it helps if loose, hinders if dense", ylabel="$p/p_0$ at the second reversal",
             xlabel="$p_0d/k$, or $(p_0/k_{Hz})^{2/3}$; vertical lines: quartz", xlim=overlaps[[0, -1]])


# %%
def main(out):
    """Writes the picture into a folder; returns the rows of the page's table."""
    Path(out).mkdir(parents=True, exist_ok=True)
    draw().savefig(Path(out) / "real-sand.png", dpi=110)
    return table()


if __name__ == "__main__":
    print("\n".join(main(sys.argv[1] if len(sys.argv) > 1 else "results/sand")))
