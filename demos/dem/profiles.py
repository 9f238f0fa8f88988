"""Collects complete runs of gradient.toml: their histories with the slip of every layer, and what layers do in steady shear.

    python profiles.py runs

Runs that were collected before stay, and count in the means.
"""

import sys

import collect
import numpy as np
from collect import over_seeds, read, write
from ensemble import collected
from gradient import COLLECTED, SETTINGS, planned
from layers import LAYERS, QUANTITIES, column

SETTLING = 1 / 3            # part of the last step of steady shear that does not count: far from the band it is not steady yet


def of_layers(columns, quantity):
    """A quantity (rows, layers) of a table."""
    return np.array([columns[column(quantity, layer)] for layer in range(LAYERS)]).T


def slips_only(columns):
    """A table without what the layers do but for their slip."""
    dropped = {column(quantity, layer) for quantity in QUANTITIES if quantity != "slip" for layer in range(LAYERS)}
    return {name: values for name, values in columns.items() if name not in dropped}


def profile(columns):
    """What the layers do in the last step of a table that shears forward: means over its time, after SETTLING.

    Returns
    -------
    dict of str to array (layers)
        z, height of the layer's middle from that of the box; slip, displacement along the flow per slip of the box from end to end;
        phi and the stress, compression positive, as far as they are in the table.
    """
    forward = np.diff(columns["gamma"], prepend=0) > 0
    rows = forward & (columns["step"] == columns["step"][forward].max())
    rows &= columns["gamma"] > np.quantile(columns["gamma"][rows], SETTLING)
    height = columns["height"][rows].mean()
    strain = np.diff(columns["gamma"], prepend=0)[rows]
    slip = of_layers(columns, "slip")[rows].sum(axis=0) / (strain * columns["height"][rows]).sum()
    return {"z": ((np.arange(LAYERS) + 0.5) / LAYERS - 0.5) * height, "slip": slip,
            **{quantity: of_layers(columns, quantity)[rows].mean(axis=0) for quantity in QUANTITIES[1:]
               if column(quantity, 0) in columns}}


def collect_profiles(runs, folder):
    """Write the profiles of complete runs that shear forward, and the means and scatter over seeds of all that are collected."""
    for run in runs:
        if run.complete and any(part.shear > 0 for part in run.plan):
            table = collected(run, folder)
            write(table.with_name(f"{run.table.stem}-profile_s{run.seed}.csv"), profile(read(run.table)))
    for name in {table.with_name(table.name.rpartition("_s")[0]) for table in folder.glob("*/*-profile_s*.csv")}:
        tables = [read(table) for table in sorted(name.parent.glob(f"{name.name}_s[0-9]*.csv"))]
        if len(tables) > 1:
            for kind, columns in zip(("mean", "scatter"), over_seeds(tables)):
                write(name.with_name(f"{name.name}_{kind}.csv"), columns)


def collect_all(runs, folder):
    """Histories with the slip of every layer, and profiles."""
    collect.collect(runs, folder, slips_only)
    collect_profiles(runs, folder)


if __name__ == "__main__":
    try:
        collect.main(__doc__, planned, SETTINGS, COLLECTED, collect_all)
    except ValueError as error:
        sys.exit(f"profiles.py: {error}")
