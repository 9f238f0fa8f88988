"""What data determine: standard deviations of the constants at mu = 0.5 from more and more runs, a table of docs/calibrate.md.

    python demos/dem/identifiable.py

Fits the closure "full" to each set of runs and prints the table, as Markdown, in a few minutes.
"""

import sys
from dataclasses import replace

from dem_2026 import files, markdown
from ensemble import COLLECTED

from granumat.grains import calibrate, read_runs

MU = 0.5
OLDER = sorted(COLLECTED.parent.glob(f"cv_mu{MU:g}_phi0.600_s*.csv"))
CELL = ("gamma", "gamma_total", "phi", "p", "stress_ratio")             # what a shear cell measures, and what the runs hold
HELD = ("sigma_xx", "sigma_yy", "sigma_zz")
ABSOLUTE = ("phic", "Zc", "elastic_strain")                             # whose deviations are not relative
NOT_SEEN = "not seen"


def runs_of(*programmes, phi="*"):
    """The ensemble's runs of some programmes at mu = 0.5."""
    return read_runs(files(*programmes, place=f"mu{MU:g}_phi{phi}"))


def data():
    """Sets of runs by name, each with more than the one before; the last has those of the third as a shear cell would have them."""
    older = read_runs(OLDER)
    one, several = older + runs_of("reversal", phi="0.600"), older + runs_of("reversal")
    pressure = several + runs_of("pressure-reversal")
    every = pressure + runs_of("pressure-cycles", "volume-cycles", "small-cycles-0.03", "reynolds")
    cell = [replace(run, columns={name: run.columns[name] for name in CELL + HELD}, scatter={}) for run in pressure]
    return {"one phi, constant volume": one, "four phi": several, "and held normal stresses": pressure,
            "and cycles, Reynolds": every, "shear cell": cell}


def in_words(found):
    """Deviations of a fit by constant, and the directions that its data do not see."""
    shares = {name: 100 * value / abs(found.constants[name]) for name, value in found.deviations.items()}
    words = {name: f"{value:.2g}" if name in ABSOLUTE else f"{shares[name]:.{1 if shares[name] < 10 else 0}f} %"
             for name, value in found.deviations.items()}
    words |= dict.fromkeys(found.on_bounds, "bound") | dict.fromkeys(found.held, "held")
    return words | {NOT_SEEN: "; ".join(found.unseen_in_words()) or "-"}


def main():
    columns = {name: in_words(calibrate(runs, progress=sys.stderr).sets[0]) for name, runs in data().items()}
    rows = [[name if name == NOT_SEEN else f"`{name}`", *(of_set[name] for of_set in columns.values())]
            for name in next(iter(columns.values()))]
    print(markdown(["constant", *columns], rows))


if __name__ == "__main__":
    main()
