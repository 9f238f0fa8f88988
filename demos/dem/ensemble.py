"""The runs of ensemble.toml: makes those that are missing, in its order, and goes on after a kill.

    python ensemble.py runs                 # makes them in the folder runs
    python ensemble.py runs --list          # says what is there

Runs that collect.py has put into demos/data/ensemble are not made again.
"""

import argparse
import sys
import time
import tomllib
from itertools import product
from pathlib import Path

from shear_run import Run

SETTINGS = Path(__file__).with_name("ensemble.toml")
COLLECTED = Path(__file__).parents[1] / "data" / "ensemble"


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
        contact = entry.get("contact", "hookean")
        for seed, (mu, phi), name in product(entry["seeds"], entry["states"], entry["programmes"]):
            place = Path(folder) / f"{'hertzian_' * (contact == 'hertzian')}mu{mu:g}_phi{phi:.3f}_s{seed}"
            common = {"mu": mu, "phi": phi, "seed": seed, "contact": contact, "number": settings["number"],
                      "rate": entry.get("rate", settings["rate"])}
            steady = Run(place / "steady.csv", settings["steady"], **common)
            programme = settings["programme"][name] if name != "steady" else {}
            start = programme.get("start", steady)
            if start is steady:
                runs.setdefault(f"{place.name}/steady", steady)
            if programme:
                stress = held.get((mu, phi)) if _holds(programme["step"]) else (0.0, 0.0, 0.0)
                if stress is None:
                    raise ValueError(f"{name} at mu = {mu}, phi = {phi}: normal_stress says nothing of it")
                runs.setdefault(f"{place.name}/{name}", Run(place / f"{name}.csv", programme["step"], start=start,
                                                            normal_stress=stress, **common))
    return runs


def _holds(steps):
    """Whether steps hold the normal stresses of a run."""
    return any(step.get("control", "volume") != "volume" or step.get("pressure") == "hold" for step in steps)


class Progress:
    """A line that says what runs, and how long all will take by the time that the spheres have moved.

    Parameters
    ----------
    runs : list of Run
        What is to be run.
    """

    def __init__(self, runs):
        self.durations = {run.table: run.duration() for run in runs}
        self.moved, self.began = 0.0, time.monotonic()

    def __call__(self, run, row):
        """A row of a run is there."""
        self.moved += run.plan[row - 1].duration(run.rate)
        self.durations[run.table] = run.duration(row)
        spent = (time.monotonic() - self.began) / 60
        left = spent / self.moved * sum(self.durations.values())
        if sys.stderr.isatty() or row == len(run.plan):
            print(f"{run.table.parent.name} {run.table.stem}: row {row} of {len(run.plan)}; {spent:.1f} min, {left:.0f} min left",
                  end="   \r" if sys.stderr.isatty() else "\n", file=sys.stderr, flush=True)


def collected(run, folder):
    """The table of a run among collected data, which collect.py writes."""
    return folder / run.table.parent.name.rpartition("_s")[0] / f"{run.table.stem}_s{run.seed}.csv"


def main(description=__doc__, planned=planned, settings=SETTINGS, folder=COLLECTED):
    """The program that makes runs.

    Parameters
    ----------
    description : str
        Its first line says what the program does.
    planned : function of a folder and settings
        All runs.
    settings, folder : Path
        What is taken if the command line names no others.
    """
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where runs are kept")
    parser.add_argument("--settings", type=Path, default=settings)
    parser.add_argument("--collected", type=Path, default=folder, help="data of runs that need not be made again")
    parser.add_argument("--list", action="store_true", help="say what is there and what is missing")
    arguments = parser.parse_args()
    runs = planned(arguments.folder, tomllib.loads(arguments.settings.read_text()))
    there = {name: "complete" if run.complete else "collected" if collected(run, arguments.collected).exists() else "missing"
             for name, run in runs.items()}
    if arguments.list:
        for name, what in there.items():
            print(f"{name:45} {what}")
        return
    missing = [run for name, run in runs.items() if there[name] == "missing"]
    report = Progress(missing + [run.start for run in missing if isinstance(run.start, Run) and not run.start.complete])
    for run in missing:
        run.go(report)


if __name__ == "__main__":
    try:
        main()
    except ValueError as error:
        sys.exit(f"ensemble.py: {error}")
