"""The runs of ensemble.toml: makes those that are missing, in its order, and goes on after a kill.

    python ensemble.py runs                 # makes them in the folder runs
    python ensemble.py runs --list          # says what is there
"""

import argparse
import sys
import time
import tomllib
from pathlib import Path

from run import Run

SETTINGS = Path(__file__).with_name("ensemble.toml")


def planned(folder, settings):
    """All runs of an ensemble, in order.

    Parameters
    ----------
    folder : path
        Where they are kept, in a folder for each packing.
    settings : dict
        As in ensemble.toml.

    Returns
    -------
    dict of str to Run
        By packing and programme.
    """
    runs = {}
    held = {(mu, phi): tuple(stress) for mu, phi, *stress in settings["normal_stress"]}
    for entry in settings["runs"]:
        name, programme = entry["programme"], settings["programme"][entry["programme"]]
        for seed in entry["seeds"]:
            for mu, phi in entry["states"]:
                place = Path(folder) / f"mu{mu:g}_phi{phi:.3f}_s{seed}"
                common = {"mu": mu, "phi": phi, "seed": seed, "number": settings["number"], "rate": settings["rate"],
                          "contact": entry.get("contact", "hookean")}
                start = programme.get("start") or Run(place / "steady.csv", settings["steady"], **common)
                stress = held.get((mu, phi), (0.0, 0.0, 0.0)) if _holds(programme["step"]) else (0.0, 0.0, 0.0)
                runs[f"{place.name}/{name}"] = Run(place / f"{name}.csv", programme["step"], start=start, normal_stress=stress,
                                                   **common)
    return runs


def _holds(steps):
    """Whether steps hold the normal stresses of a run."""
    return any(step.get("control", "volume") != "volume" or step.get("pressure") == "hold" for step in steps)


class Progress:
    """A line that says what runs, and how long all will take."""

    def __init__(self, rows):
        self.rows, self.done, self.began = rows, 0, time.monotonic()

    def __call__(self, run, row):
        self.done += 1
        spent = time.monotonic() - self.began
        left = spent / self.done * max(self.rows - self.done, 0)
        end = "\r" if sys.stderr.isatty() else "\n"
        if sys.stderr.isatty() or row == len(run.plan):
            print(f"{run.table.parent.name} {run.table.stem}: row {row} of {len(run.plan)}; all: {spent / 60:.1f} min, "
                  f"{left / 60:.0f} min left   ", end=end, file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--settings", type=Path, default=SETTINGS)
    parser.add_argument("--list", action="store_true", help="say what is there and what is missing")
    arguments = parser.parse_args()
    runs = planned(arguments.folder, tomllib.loads(arguments.settings.read_text()))
    if arguments.list:
        for name, run in runs.items():
            print(f"{name:45} {'complete' if run.complete else 'missing'}")
        return
    missing = [run for run in runs.values() if not run.complete]
    starts = {run.start.table: run.start for run in missing if isinstance(run.start, Run) and not run.start.complete}
    report = Progress(sum(len(run.plan) for run in missing + list(starts.values())))
    for run in missing:
        run.go(report)


if __name__ == "__main__":
    main()
