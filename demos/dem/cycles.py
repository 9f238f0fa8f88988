"""The law beside the ensemble's cycles, where each of its forms loses most: the pictures and tables of docs/compare.md.

    python demos/dem/cycles.py results/cycles

Draws volume-cycles.png, pressure-cycles.png and small-cycles.png, and leaves the scores in tables.md.
"""

import argparse
from pathlib import Path

from dem_2026 import CLOSURES, VOLUME, WHOLE, by_state, files, markdown, models, scores_table
from matplotlib.figure import Figure

from granumat.grains import compare, read_runs
from granumat.grains.comparison import PRINTED
from granumat.grains.pictures import draw_quantity

CALIBRATION = "dem-2026"
HELD = tuple(("all", name) for name in ("stress_ratio", "Z2", "A_xz")) + VOLUME
SCORED = {"volume-cycles": WHOLE, "pressure-cycles": HELD}              # programme and columns of a table
ENDS = (("volume-cycles", "p", "p over the first, cycles of 0.1"), ("pressure-cycles", "phi", "largest phi less the first"),
        ("small-cycles-0.03", "p", "p over the first, cycles of 0.03"), ("small-cycles-0.03", "A_xz", "A_xz over the first"))
PICTURES = {                                                            # panels: programme, mu, phi, quantity
    "volume-cycles": (("volume-cycles", 0.5, 0.600, "p"), ("volume-cycles", 0.5, 0.620, "p"),
                      ("volume-cycles", 0.5, 0.600, "stress_ratio")),
    "pressure-cycles": (("pressure-cycles", 0.5, 0.600, "phi"), ("pressure-cycles", 0.1, 0.635, "phi"),
                        ("pressure-cycles", 0.5, 0.600, "A_xz")),
    "small-cycles": tuple(("small-cycles-0.03", 0.5, 0.600, name) for name in ("p", "stress_ratio", "A_xz")),
}


def table(programme):
    """Scores of a programme's cycles at each state, as Markdown."""
    return scores_table(by_state(read_runs(files(programme))), CALIBRATION, SCORED[programme])


def ends():
    """What four cycles leave, of the grains and of each model, as Markdown: p and A_xz over their first values, phi gained."""
    rows = []
    for programme, quantity, words in ENDS:
        for runs in by_state(read_runs(files(programme))):
            found = compare(runs, models(CALIBRATION))
            columns = [runs[0].columns, *(of_runs[0].columns for of_runs in found.predictions.values())]
            series = [column[quantity] for column in columns]
            values = [one.max() - one[0] if quantity == "phi" else one[-1] / one[0] for one in series]
            state = f"{words}, mu {runs[0].mu:g}, phi {runs[0].columns['phi'][0]:.3f}"
            rows.append([state, *(f"{value:.3f}" if quantity == "phi" else f"{value:.2f}" for value in values)])
    return markdown(["after four cycles", "grains", PRINTED, *CLOSURES], rows)


def picture(name):
    """One of PICTURES."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    for axes, (programme, mu, phi, quantity) in zip(figure.subplots(1, len(PICTURES[name])), PICTURES[name]):
        tables = files(programme, place=f"mu{mu:g}_phi{phi:.3f}")
        found = compare(tables, models(CALIBRATION))
        draw_quantity(axes, found.yardsticks[0], {model: of_runs[0] for model, of_runs in found.predictions.items()}, quantity)
        packings = f"{len(tables)} packing{'s' * (len(tables) > 1)}"
        axes.set_title(f"$\\mu$ = {mu:g}, $\\phi$ = {phi:.3f}, {packings}", fontsize=10)
    figure.axes[0].legend(frameon=False, fontsize=8)
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for pictures and tables")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for name in PICTURES:
        picture(name).savefig(out / f"{name}.png", dpi=110)
    (out / "tables.md").write_text("\n\n".join([*map(table, SCORED), ends()]) + "\n")


if __name__ == "__main__":
    main()
