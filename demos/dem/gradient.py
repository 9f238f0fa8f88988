"""The runs of gradient.toml: grains whose pressure varies over the height; makes those that are missing, and goes on after a kill.

    python gradient.py runs                 # makes them in the folder runs
    python gradient.py runs --list          # says what is there

Runs that are in demos/data/gradient are not made again.
"""

import sys
from itertools import product
from pathlib import Path

import ensemble
from layers import LayeredRun

SETTINGS = Path(__file__).with_name("gradient.toml")
COLLECTED = ensemble.COLLECTED.with_name("gradient")
COMMON = ("mu", "phi", "number", "edges", "diameters", "rate", "pressure")     # settings of all runs, which an entry may change


def planned(folder, settings):
    """All runs, in order.

    Parameters
    ----------
    folder : path
        Where they are kept, in a folder for each packing.
    settings : dict
        As in gradient.toml.

    Returns
    -------
    dict of str to LayeredRun
        By packing and programme.
    """
    runs = {}
    for entry in settings["runs"]:
        common = {name: entry.get(name, settings[name]) for name in COMMON}
        common["normal_stress"] = (0.0, 0.0, common.pop("pressure"))
        for seed, gradient, name in product(entry["seeds"], entry["gradients"], entry["programmes"]):
            place = Path(folder) / f"gradient{gradient:g}_s{seed}"
            common |= {"seed": seed, "gradient": gradient}
            programme = settings["programme"][name]
            start = programme.get("start")
            if start is None:
                start = runs.setdefault(f"{place.name}/steady", LayeredRun(place / "steady.csv", settings["steady"], **common))
            runs[f"{place.name}/{name}"] = LayeredRun(place / f"{name}.csv", programme["step"], start=start, **common)
    return runs


if __name__ == "__main__":
    try:
        ensemble.main(__doc__, planned, SETTINGS, COLLECTED)
    except ValueError as error:
        sys.exit(f"gradient.py: {error}")
