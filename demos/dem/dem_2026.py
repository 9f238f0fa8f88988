"""Makes the calibration dem-2026, and the tables that docs/calibrate.md has of it.

    python demos/dem/dem_2026.py results/dem-2026

Fits the constants, in two minutes, and leaves dem-2026.toml, tables.md, and scores.txt with the scores of each run in the folder.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from ensemble import COLLECTED

from granumat.calibrations import COMMON
from granumat.grains import PHASES, QUANTITIES, calibrate, compare, read_runs
from granumat.grains.comparison import HEADINGS, PRINTED, SCATTER
from granumat.grains.scores import root_mean_square
from granumat.toml import read_toml

OLDER = sorted(COLLECTED.parent.glob("cv_*_s*.csv"))         # runs that another program made, reversals too
CLOSURES = ("full", "mobilised", "mobilised-pressure")
FITTED = ("reversal", "pressure-reversal")                  # programmes
SMALL_CYCLES = ("small-cycles-0.006", "small-cycles-0.012", "small-cycles-0.03")
MEAN = 4                                                    # packings from which on a mean counts as one
SHOWN = ("p", "stress_ratio", "Z2", "A_xz", "N2/p")
WHOLE = tuple(("all", name) for name in SHOWN)              # columns of scores: phase and quantity
TURN = tuple(("first 0.1", name) for name in SHOWN)
VOLUME = (("all", "phi"),)
PACKINGS = "scatter of a packing"


def files(*programmes, place="mu*"):
    """Tables of the ensemble's runs of some programmes, with Hookean contacts, in the folders of a pattern."""
    return sorted(file for programme in programmes for file in COLLECTED.glob(f"{place}/{programme}_s[0-9]*.csv"))


def models(calibration):
    """The closures with a calibration, as granumat.grains.compare takes them."""
    return {closure: {"closure": closure, "calibration": str(calibration)} for closure in CLOSURES}


# ---- tables ----------------------------------------------------------------------------------------------------------------

def tables(calibration):
    """The tables of the page, as Markdown: constants of each closure, scores, p by run, means of packings, small cycles.

    Parameters
    ----------
    calibration : path
        A calibration file.
    """
    content = read_toml(calibration)
    means = [[run] for run in read_runs(files("reversal")) if run.seeds >= MEAN]
    small = by_state(read_runs(files(*SMALL_CYCLES)))
    return [*(constants_table(content, closure) for closure in CLOSURES), fitted_table(content["fitted"]),
            runs_table(content["fitted"]), scores_table(means, calibration, TURN), scores_table(small, calibration, WHOLE)]


def constants_table(content, closure):
    """Constants of a closure with their standard deviations, a column for each mu."""
    rows = content[COMMON if closure == "full" else closure]
    noted = [one for one in content["fitted"] if one["closure"] == closure]
    names = [name for name in rows[0] if any(name in one["deviations"] or name in one["on_bounds"] for one in noted)]
    return markdown([f"`{closure}`", *(f"mu = {row['mu']:g}" for row in rows)],
                    [[f"`{name}`", *(_with_deviation(name, row[name], one) for row, one in zip(rows, noted))] for name in names])


def _with_deviation(name, value, noted):
    if name in noted["on_bounds"]:
        return f"{value:.3g}, bound" if abs(value) > 1e-3 else "0, bound"
    deviation = noted["deviations"][name]
    digits = max(0, 1 - int(np.floor(np.log10(deviation))))                # two of the deviation
    return f"{value:.{digits}f} ± {deviation:.{digits}f}"


def fitted_table(sets):
    """Scores that stand in a calibration file: of the printed constants, of fits, and of fits without some of the runs."""
    rows = []
    for mu in sorted({one["mu"] for one in sets}):
        of_mu = [one for one in sets if one["mu"] == mu]
        scores = {"full, printed": of_mu[0]["scores start"]}
        scores |= {f"{one['closure']}, {key.removeprefix('scores ')}": value for one in of_mu for key, value in one.items()
                   if key.startswith("scores ") and key not in ("scores start", f"scores {SCATTER}")}
        scores[PACKINGS] = of_mu[0][f"scores {SCATTER}"]
        rows += [[f"{mu:g}", words, *(in_digits(of_phases[phase].get(name, np.nan)) for phase, name in WHOLE + VOLUME + TURN)]
                 for words, of_phases in scores.items()]
    return markdown(["mu", "closure, constants", *headings(WHOLE + VOLUME + TURN)], rows)


def runs_table(sets):
    """Scores of p by run that stand in a calibration file: of fits, of fits without the run, and of packings."""
    words = [f"{closure}, {model}" for closure in CLOSURES for model in ("fitted", "run left out")]
    rows = {}
    for one in sets:
        for run, packings in zip(one["runs"], one["seeds"]):
            if run in one["p fitted"]:
                row = rows.setdefault(run, {"packings": str(packings), PACKINGS: in_digits(one[f"p {SCATTER}"].get(run, np.nan))})
                row |= {f"{one['closure']}, {model}": in_digits(one[f"p {model}"][run]) for model in ("fitted", "run left out")}
    heads = ["packings", *words, PACKINGS]
    return markdown(["run", *heads], [[run.replace("data_", ""), *(row[head] for head in heads)] for run, row in rows.items()])


def scores_table(groups, calibration, columns):
    """Root mean squares of scores over groups of runs: of the printed constants, of the closures with a calibration, of packings.

    Parameters
    ----------
    groups : list of list of Run
        Those of a group have one mu and phi.
    calibration : path
        A calibration file.
    columns : tuple of (str, str)
        Phases and quantities.
    """
    words = {PRINTED: "full, printed", **{name: f"{name}, dem-2026" for name in CLOSURES}, SCATTER: PACKINGS}
    rows = []
    for runs in groups:
        comparison = compare(runs, models(calibration))
        for model in words:
            scores = root_mean_square(comparison.scores(model))
            shown = [scores[list(PHASES).index(phase), QUANTITIES.index(name)] for phase, name in columns]
            if not np.isnan(shown).all():
                rows.append([f"mu {runs[0].mu:g}, phi {runs[0].columns['phi'][0]:.3f}", words[model], *map(in_digits, shown)])
    return markdown(["state", "closure, constants", *headings(columns)], rows)


def by_state(runs):
    """Runs (...) as lists of those with one mu and phi, in order."""
    groups = {}
    for run in runs:
        groups.setdefault((run.mu, round(run.columns["phi"][0], 3)), []).append(run)
    return [groups[state] for state in sorted(groups)]


def headings(columns):
    """Of scores: the quantities, with the phase where it is not the one before, or all."""
    phases = ["all", *(phase for phase, _ in columns)]
    return [f"{phase}: {HEADINGS[name]}" if phase != before else HEADINGS[name] for before, (phase, name) in zip(phases, columns)]


def in_digits(score):
    """A score as the page has it."""
    return "-" if np.isnan(score) else f"{score:.3f}"


def markdown(heads, rows):
    """A table, as Markdown."""
    lines = [f"| {' | '.join(line)} |" for line in (heads, *rows)]
    return "\n".join([lines[0], "|---" * len(heads) + "|", *lines[1:]])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for the file and its tables")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    calibration = out / "dem-2026.toml"
    found = calibrate([*OLDER, *files(*FITTED)], closures=CLOSURES, progress=sys.stderr)
    found.write(calibration)
    (out / "tables.md").write_text("\n\n".join(tables(calibration)) + "\n")
    (out / "scores.txt").write_text("\n\n".join(f"closure {one.closure}\n\n{one.comparison}" for one in found.sets) + "\n")
    print(f"wrote {calibration}, tables.md and scores.txt")


if __name__ == "__main__":
    main()
