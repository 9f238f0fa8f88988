"""The element tests of docs/validation-report.md: its table, and its picture."""

import sys
import warnings
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from granumat import ConstrainedDeformationWarning, Material, driver

SAND = Material(mu=0.5, elastic_strain=0.001)
PRESSURE = 2e-4                                     # k/d: 100 kPa where k/d is 500 MPa
DENSITIES = (0.59, 0.60)                            # phi; phic is 0.5868
TESTS = {                                           # name -> steps
    "isotropic compression to 2 p0": [driver.isotropic_compression(pressure=2 * PRESSURE)],
    "oedometric compression by 0.2 %": [driver.deform(np.diag([0.0, 0.0, -1.0]), 0.002)],
    "drained triaxial compression by 30 %": [driver.triaxial(0.3)],
    "undrained triaxial compression by 10 %": [driver.triaxial(0.1, drained=False)],
    "drained biaxial compression by 30 %": [driver.biaxial(0.3)],
    "simple shear by 1, constant normal stress": [driver.shear(1.0, control="normal-load")],
    "simple shear by 0.5, constant volume": [driver.shear(0.5)],
    "10 cycles of simple shear by 0.01, constant volume": driver.cycles(0.01, 10),
}


def invariants(states):
    """Mean pressure p and q = (3 J2)^(1/2) of states (n,), in units of the initial pressure."""
    p = -states.stress[:, :3].mean(axis=1)
    deviator = states.stress + p[:, None] * [1, 1, 1, 0, 0, 0]
    q = np.sqrt(1.5 * (deviator[:, :3] ** 2).sum(axis=1) + 3 * (deviator[:, 3:] ** 2).sum(axis=1))
    return p / PRESSURE, q / PRESSURE


def run_all():
    """Histories by test and phi."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConstrainedDeformationWarning)
        return {(name, phi): driver.run(SAND, SAND.isotropic(phi, PRESSURE), steps)
                for name, steps in TESTS.items() for phi in DENSITIES}


def table(histories):
    """Rows of the report: test, then p/p0, q/p and phi at the end of each density."""
    rows = []
    for name in TESTS:
        row = f"| {name} |"
        for phi in DENSITIES:
            states = histories[name, phi].states[-1:]
            (p,), (q,) = invariants(states)
            friction = f"{q / p:.2f}" if p > 0.01 else "-"             # it bears nothing any more
            row += f" {abs(p):.2f} | {friction} | {states.volume_fraction[0]:.4f} |"
        rows.append(row)
    return rows


def picture(histories):
    """Friction and volume in drained tests, stress paths without drainage, pressure in cycles; full lines: dense."""
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    (friction, volume), (path, cycles) = figure.subplots(2, 2)
    for phi, style in zip(DENSITIES, (":", "-")):
        for k, name in enumerate(list(TESTS)[2:8]):
            history = histories[name, phi]
            p, q = invariants(history.states)
            strain, label = np.asarray(history["gamma"]), name.split(" by ")[0] if style == "-" else None
            if "cycles" in name:
                cycles.plot(np.arange(len(p)) / 200, p, style, color=f"C{k}", label=f"$\\phi$ = {phi:.2f}")
            elif "drained" in name.split() or "normal" in name:
                friction.plot(strain, q / p, style, color=f"C{k}", label=label)
                volume.plot(strain, history["phi"], style, color=f"C{k}")
            else:
                path.plot(p, q, style, color=f"C{k}", label=label)
    friction.set(xlabel="shear strain $2\\int|D|$", ylabel="q/p", title="drained: friction")
    volume.set(xlabel="shear strain $2\\int|D|$", ylabel="$\\phi$", title="drained: both densities go to the same one")
    path.set(xlabel="$p/p_0$", ylabel="$q/p_0$", title="constant volume: stress paths", xlim=(0, 4), ylim=(0, 3))
    cycles.set(xlabel="cycles of simple shear by 0.01", ylabel="$p/p_0$", title="constant volume: loose sand liquefies")
    for axes in (friction, path, cycles):
        axes.legend(frameon=False, fontsize=8)
    return figure


def main(place):
    """Writes the picture into a folder; returns the rows of the table."""
    histories = run_all()
    Path(place).mkdir(parents=True, exist_ok=True)
    picture(histories).savefig(Path(place) / "element-tests.png", dpi=110)
    return table(histories)


if __name__ == "__main__":
    print("\n".join(main(sys.argv[1])))
