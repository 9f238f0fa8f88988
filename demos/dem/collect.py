"""Collects complete runs of the ensemble: thinned tables, their means and scatter over seeds, and a table of steady shear.

    python collect.py runs

Runs that were collected before stay, and count in the means.
"""

import argparse
import math
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
from ensemble import COLLECTED, SETTINGS, collected, planned
from grains import AXES

ROWS = 75                   # of a step in a thinned table, at most
DENSITY = 6 / math.pi       # of the spheres
SETTLING = 0.25             # part of a step of steady shear that does not count, since it has just begun
SEEDS = re.compile(r"(?m)^seeds? = .*$")        # in the file that says how a run was made


def read(table):
    """The columns of a table by name."""
    with table.open() as file:
        names = file.readline().strip().split(",")
        return dict(zip(names, np.loadtxt(file, delimiter=",", ndmin=2).T))


def write(table, columns):
    """Write columns as a table with five digits."""
    table.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(table, np.column_stack(list(columns.values())), "%.5g", ",", header=",".join(columns), comments="")


def thinned(columns):
    """Columns with at most ROWS rows of each step, evenly spaced; the last of each stays."""
    step, keep = columns["step"], []
    for number in np.unique(step):
        rows = np.flatnonzero(step == number)
        keep += list(rows[::-1][::math.ceil(len(rows) / ROWS)][::-1])
    return {name: column[keep] for name, column in columns.items()}


def over_seeds(tables):
    """Means of tables over seeds, and their standard deviations.

    Parameters
    ----------
    tables : list of dict of str to array
        Two or more, with the same steps and strains.

    Returns
    -------
    tuple of 2 dicts of str to array
        The means; the steps and strains, and the standard deviations of the other columns.
    """
    means = {name: np.mean([table[name] for table in tables], axis=0) for name in tables[0]}
    path = ("step", "gamma", "gamma_total")
    scatter = {name: means[name] if name in path else np.std([table[name] for table in tables], axis=0, ddof=1)
               for name in means}
    return means, scatter


# ---- steady shear ----------------------------------------------------------------------------------------------------------

def steady_measures(columns, step, rate):
    """Means over a step of steady shear, by name.

    Parameters
    ----------
    columns : dict of str to array
    step : int
    rate : float
        Shear rate, in sqrt(k/m).
    """
    rows = columns["step"] == step
    rows &= columns["gamma_total"] > np.quantile(columns["gamma_total"][rows], SETTLING)
    mean = {name: column[rows].mean() for name, column in columns.items()}
    fabric = math.sqrt(sum(mean[f"A_{axis}"] ** 2 * weight for axis, weight in
                           (("xx", 0.5), ("yy", 0.5), ("zz", 0.5), ("xy", 1), ("xz", 1), ("yz", 1))))
    return {"I": rate / math.sqrt(mean["p"] / (DENSITY * mean["phi"])),
            "p": mean["p"], "stress_ratio": -mean["sigma_xz"] / mean["p"],
            "Z2": mean["Z2"], "A_xz": mean["A_xz"], "A": fabric, "N1/p": (mean["sigma_xx"] - mean["sigma_zz"]) / mean["p"],
            "N2/p": (mean["sigma_zz"] - mean["sigma_yy"]) / mean["p"],
            **{name: mean[name] for name in (*(f"sigma_{axis}" for axis in AXES), "A_xx", "A_yy", "A_zz")}}


def steady_table(records):
    """Steady shear of collected runs at constant volume: a row for each mu, phi and rate, with means and scatter over seeds.

    Parameters
    ----------
    records : iterable of Path
        Files that say how the runs were made; those of other programmes are passed over.
    """
    found = {}
    for record in sorted(records):
        made = tomllib.loads(record.read_text())
        if record.stem != "steady" and not record.stem.startswith("speed-"):
            continue
        for seed in made["seeds"]:
            columns = read(record.with_name(f"{record.stem}_s{seed}.csv"))
            for number, step in enumerate(made["step"], 1):
                rate = made["rate"] * step.get("speed", 1)
                key = (made["mu"], made["phi"], rate)
                found.setdefault(key, []).append(steady_measures(columns, number, rate))
    rows = []
    for (mu, phi, rate), seeds in sorted(found.items()):
        row = {"mu": mu, "phi": phi, "rate": rate, "seeds": len(seeds)}
        for name in seeds[0]:
            values = [measures[name] for measures in seeds]
            row |= {name: np.mean(values), f"{name} scatter": np.std(values, ddof=len(values) > 1)}
        rows.append(row)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}


# ---- all -------------------------------------------------------------------------------------------------------------------

def collect(runs, folder, reduce=thinned):
    """Add complete runs to a folder of collected ones, and write its means, scatter and table of steady shear anew.

    Parameters
    ----------
    runs : iterable of Run
    folder : Path
    reduce : function of a run's columns
        What is kept of them.

    Raises
    ------
    ValueError
        If a run was made with other settings than the collected ones of its programme; nothing is collected then.
    """
    tables = {collected(run, folder): run for run in runs if run.complete}
    new = {table: run for table, run in tables.items() if not table.exists()}
    records = {}
    for table, run in new.items():
        record = table.with_name(f"{run.table.stem}.toml")
        records.setdefault(record, [record] if record.exists() else []).append(run.record)
    mixed = [", ".join(map(str, made)) for made in records.values() if len({_settings(file) for file in made}) > 1]
    if mixed:
        raise ValueError("runs of one programme may differ in their seeds only:\n  " + "\n  ".join(mixed))
    for table, run in new.items():
        write(table, reduce(read(run.table)))
    for record, made in records.items():
        name = record.stem
        seeds = sorted(int(file.stem.rpartition("_s")[2]) for file in record.parent.glob(f"{name}_s*[0-9].csv"))
        record.write_text(SEEDS.sub(f"seeds = {seeds}", made[0].read_text()))
        if len(seeds) > 1:                                       # one seed is its own mean, and its scatter is not known
            columns = over_seeds([read(record.with_name(f"{name}_s{seed}.csv")) for seed in seeds])
            for kind, means_or_scatter in zip(("mean", "scatter"), columns):
                write(record.with_name(f"{name}_{kind}.csv"), means_or_scatter)
    for contact in ("", "hertzian_"):
        steady = steady_table(folder.glob(f"{contact}mu*/*.toml"))
        if new and steady:
            write(folder / f"{contact}steady.csv", steady)


def _settings(record):
    """What a run was made with, without its seed."""
    return SEEDS.sub("", record.read_text())


def main(description=__doc__, planned=planned, settings=SETTINGS, folder=COLLECTED, collect=collect):
    """The program that collects runs.

    Parameters
    ----------
    description : str
        Its first line says what the program does.
    planned : function of a folder and settings
        All runs.
    settings, folder : Path
        What is taken if the command line names no others.
    collect : function of a list of Run and a folder
    """
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("runs", type=Path, help="folder of the runs")
    parser.add_argument("--folder", type=Path, default=folder, help="folder of the collected data")
    parser.add_argument("--settings", type=Path, default=settings)
    arguments = parser.parse_args()
    collect(list(planned(arguments.runs, tomllib.loads(arguments.settings.read_text())).values()), arguments.folder)


if __name__ == "__main__":
    try:
        main()
    except ValueError as error:
        sys.exit(f"collect.py: {error}")
