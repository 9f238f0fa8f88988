"""Runs all jobs, compares them with the single-point driver, prints a table and draws a picture."""

import sys
from itertools import groupby
from pathlib import Path

import block
import numpy as np
from ccx import run
from jobs import JOBS, UNIT, errors
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

BLOCKS = {                  # element, and whether the mesh moves
    "C3D8": ("C3D8", False),
    "C3D8I": ("C3D8I", False),
    "C3D20R": ("C3D20R", False),
    "C3D20R moving": ("C3D20R", True),
}


def counts(iterations):
    """Iterations increment by increment, "5 2 2 2" as "5 3x2"."""
    runs = [(number, len(list(group))) for number, group in groupby(iterations)]
    return " ".join(f"{length}x{number}" if length > 1 else str(number) for number, length in runs)


def main(place):
    """Jobs, outputs and errors by name, and the reactions of the block by name."""
    jobs = {name: make() for name, make in JOBS.items()}
    outputs = {name: run(place, name, job.deck) for name, job in jobs.items()}
    found = {name: errors(job, outputs[name]) for name, job in jobs.items()}
    print(f"{'largest difference to the driver':45} {'stress':>8} {'A/kappa':>8} {'Z2':>8} {'phi':>8}  iterations per increment")
    for name, job in jobs.items():
        values = " ".join(f"{found[name][key]:8.1e}" for key in ("stress", "fabric", "Z2", "phi"))
        print(f"{job.title:45} {values}  {counts(outputs[name].iterations)}")
    threads = run(Path(place) / "two-threads", "platen", jobs["platen"].deck, threads=2)
    print(f"constant normal load with two threads: stress differs by {difference(threads.stress, outputs['platen'].stress):.0e}")
    spin = difference(outputs["log-u"].stress[-1], outputs["rotation"].stress[-1])
    print(f"after the quarter turn, log U only differs by {spin:.3f} of the stress from the true spin")
    print(f"cutbacks that the UMAT asked for: {outputs['cutback'].cutbacks}")
    reactions = {name: block.reaction(place, *choice) for name, choice in BLOCKS.items()}
    for name, (_, force, output) in reactions.items():
        print(f"block, {name:13} reaction {force[-1]:.6f}  {counts(output.iterations)}")
    picture(outputs, jobs, reactions).savefig(Path(place) / "calculix.png", dpi=120)
    return {"jobs": jobs, "outputs": outputs, "errors": found, "threads": threads, "reactions": reactions}


def picture(outputs, jobs, reactions):
    """Stress ratio of the shear jobs beside the driver's; reaction of the block, and the pressure in it."""
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    shear, curve, field = figure.subplots(1, 3)
    for name, label in (("volume", "constant volume"), ("pressure", "constant pressure"), ("platen", "constant load")):
        job, found = jobs[name], outputs[name].stress[jobs[name].every - 1::jobs[name].every, 0]
        n = len(job.states) // 3
        gamma = np.concatenate([np.linspace(0, 0.2, n + 1)[1:], np.linspace(0.2, -0.2, 2 * n + 1)[1:]])
        line, = shear.plot(np.append(0, gamma), np.append(0, ratio(job.states.stress)), linewidth=0.8)
        shear.plot(gamma[::2], ratio(found)[::2], "o", color=line.get_color(), markersize=3, label=label)
    shear.set(xlabel="shear strain $\\gamma$", ylabel="stress ratio $-\\sigma_{xz}/p$", title="CalculiX (dots), driver (lines)")
    for name, (compression, force, _) in reactions.items():
        curve.plot(100 * compression, force, "--" if "moving" in name else "-", label=name)
    curve.set(xlabel="compression (%)", ylabel="reaction $F\\,d/k$", title="block between rough platens")
    for axes in (shear, curve):
        axes.legend(frameon=False)
        axes.grid(linewidth=0.3)
    box = block.brick(block.PROBLEM, "C3D20R")
    output = reactions["C3D20R"][2]
    corners = box.elements[:, [0, 1, 5, 4]] - 1                     # of the face y = 0, counter-clockwise
    moved = (box.nodes + output.displacement[-1])[:, [0, 2]]
    p = -output.stress[-1, :, :3].mean(axis=1).reshape(len(corners), -1).mean(axis=1) / UNIT
    patches = PolyCollection(moved[corners], array=p, edgecolor="white", linewidth=0.4)
    field.add_collection(patches)
    field.set(xlabel="x", ylabel="z", title="C3D20R: mean pressure of elements", aspect="equal")
    field.autoscale_view()
    figure.colorbar(patches, ax=field, label="$p\\,d/k$", shrink=0.7)
    return figure


def difference(a, b):
    """Largest difference over the largest value."""
    return np.abs(a - b).max() / np.abs(b).max()


def ratio(stress):
    return -3 * stress[:, 4] / stress[:, :3].sum(axis=1)


if __name__ == "__main__":
    main(sys.argv[1])
