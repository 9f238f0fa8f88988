"""Normal stress differences of the ensemble's steady shear against the inertial number: do they vanish in slow shear?

    python normal_stresses.py pictures

Draws normal-stresses.png, and prints how much each difference changes per factor of ten in the inertial number.
"""

import argparse
from pathlib import Path

import numpy as np
from collect import read
from ensemble import COLLECTED
from matplotlib.figure import Figure

COLOURS = {0.1: "#009E73", 0.3: "#E69F00", 0.5: "#0072B2", 1.0: "#D55E00"}      # of mu, as in the paper's figures
DIFFERENCES = {"N1/p": "s", "N2/p": "o"}


def trend(steady, name, mu, phi):
    """A difference over p as a line of log10 I: its slope with its standard error, and its value at I = 0.001.

    Packings of one rate count as many times as there are.
    """
    rows = (steady["mu"] == mu) & (steady["phi"] == phi)
    x, y, count = np.log10(steady["I"][rows]) + 3, steady[name][rows], steady["seeds"][rows]
    (slope, value), covariance = np.polyfit(x, y, 1, w=np.sqrt(count), cov=True)
    return slope, np.sqrt(covariance[0, 0]), value


def draw(steady):
    """The figure."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot(xscale="log", xlabel="inertial number $I$", ylabel="normal stress difference over $p$")
    for mu, colour in COLOURS.items():
        rows = steady["mu"] == mu
        for name, marker in DIFFERENCES.items():
            axes.errorbar(steady["I"][rows], steady[name][rows], steady[f"{name} scatter"][rows], fmt=marker, color=colour,
                          markersize=5, markerfacecolor="none", elinewidth=0.8,
                          label=rf"$N_{name[1]}/p$, $\mu$ = {mu:g}" if rows.any() else None)
    axes.axhline(0, color="0.25", linewidth=0.8)
    axes.legend(fontsize=7.5, ncol=4, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    axes.grid(linewidth=0.3)
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the picture")
    out = parser.parse_args().out
    steady = read(COLLECTED / "steady.csv")
    out.mkdir(parents=True, exist_ok=True)
    draw(steady).savefig(out / "normal-stresses.png", dpi=130)
    for name in DIFFERENCES:
        slope, error, value = trend(steady, name, 0.5, 0.6)
        print(f"{name} at mu 0.5, phi 0.600: {value:.3f} at I = 0.001, {slope:+.3f} +- {error:.3f} per factor of ten")


if __name__ == "__main__":
    main()
