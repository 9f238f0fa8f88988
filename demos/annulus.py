# %% [markdown]
# # Annular shear cell: the inner wall turns, then turns back
#
# The cell of Toiya, Stambaugh & Losert (Phys. Rev. Lett. 93, 088001, 2004), without its bottom: grains between a rough inner wall,
# which turns, and a rough outer wall, which is pressed inwards by a constant normal stress or, in a second run, held (constant
# volume). Plane strain. After the reversal the torque falls, changes sign and comes back, and the pressure at the wall and the
# packing there pass through a transient. The solution depends on the radius alone; `radial.py` finds it without finite elements.
# All shear ends in the first ring of cells, as there is no length here; `length.py` is the same cell with one.

# %%
import fields
import numpy as np
from annular_cell import INNER, OUTER, PRESSURE, Watch, draw, ring, sheared_zone
from mpi4py import MPI
from radial import Annulus

from granumat import Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
SHORT = {"rings": 8, "sectors": 36, "turn": 0.1, "back": 0.05, "increment": 0.005, "twist": 0.05, "meshes": (4,), "fine": 16}
OBJECTIVE, LOCALISED = 0.04, 0.1                # radians turned: before and after the shear localises at the wall


# %% Turn and turn back.
def turn_and_back(wall, rings, sectors, turn, back, increment=0.004, **more):
    """Columns of Watch, Newton's residuals, and the width of the sheared zone just before `turn`."""
    problem, inner = ring(SAND, rings, sectors, turn, wall=wall, **more)
    watch, zone = Watch(problem, inner, rings, more.get("part", 1.0)), []
    fem.run(problem, turn + back, increment, events=[turn],
            observers=[watch, lambda problem: zone.append(sheared_zone(problem)) if problem.t == turn else None])
    return watch.columns(), watch.residuals, zone[0]


def radial(wall, rings, turn, back, increment=0.004):
    """The same columns, as far as they are in the radius alone, by radial.py."""
    cell = Annulus(SAND, SAND.isotropic(0.60, pressure=PRESSURE), rings, (INNER, OUTER), PRESSURE if wall == "load" else None)
    rows = []
    for step in range(1, round((turn + back) / increment) + 1):
        cell.turn(increment if step * increment < turn + increment / 2 else -increment)
        first = cell.states[0]
        rows.append((step * increment, cell.torque(), -first["stress"][:3].sum() / 3, first["volume_fraction"]))
    return dict(zip(("path", "torque", "pressure", "phi"), np.array(rows).T))


# %% Finer and finer meshes, of one sector tied to itself, against a fine radial solution.
def refine(meshes, fine):
    """{rings: (relative error of the torque at OBJECTIVE, at LOCALISED, width of the sheared zone)}."""
    exact = radial("load", fine, LOCALISED, 0.0)
    found = {}
    for rings in meshes:
        columns, _, zone = turn_and_back("load", rings, 1, LOCALISED, 0.0, part=1 / (6 * rings))
        errors = [np.interp(path, columns["path"], columns["torque"]) / np.interp(path, exact["path"], exact["torque"]) - 1
                  for path in (OBJECTIVE, LOCALISED)]
        found[rings] = (*errors, zone)
    return found


# %%
def main(rings=10, sectors=96, turn=0.5, back=0.25, increment=0.005, twist=0.24, meshes=(8, 16, 32, 64), fine=256,
         out=None):
    runs = {"load": turn_and_back("load", rings, sectors, turn, back, increment, twist=twist),
            "volume": turn_and_back("volume", rings, 1, turn, back, increment, part=1 / sectors, twist=twist)}
    exact = {wall: radial(wall, rings, turn, back, increment) for wall in runs}
    found = refine(meshes, fine)
    if MPI.COMM_WORLD.rank == 0:
        report(runs, exact, found, turn)
        if out:
            fields.save(draw(runs, exact, found, turn, (OBJECTIVE, LOCALISED)), out, "annulus")
    check(runs, exact, turn)
    return {"runs": runs, "radial": exact, "refinement": found}


def report(runs, exact, found, turn):
    for wall, (columns, residuals, zone) in runs.items():
        before = columns["path"] <= turn
        torque, pressure, phi, steps = (columns[name] for name in ("torque", "pressure", "phi", "iterations"))
        off = abs(torque - exact[wall]["torque"]).max() / max(torque)
        print(f"constant {wall}: torque {torque[before][-1]:.5f} at the reversal, {torque[-1]:.5f} at the end, off the radial one "
              f"by at most {off:.2%}")
        print(f"  first ring: p {pressure[before][-1]:.5f}, then {min(pressure[~before]):.5f} to {max(pressure[~before]):.5f}; "
              f"phi {phi[before][-1]:.4f}, then up to {max(phi):.4f}; sheared zone {zone:.3f} wide")
        print(f"  Newton iterations a step: {steps[before].mean():.2f} before, {steps[~before].mean():.2f} after the reversal, "
              f"{max(steps)} at most; residuals of step 5: " + " ".join(f"{value:.0e}" for value in residuals[4]))
        if max(columns["scatter"]) > 0:
            print("  scatter of p around the first ring, before and after: cells' means "
                  + ", ".join(f"{columns['scatter'][part].max():.0e}" for part in (before, ~before)) + "; points "
                  + ", ".join(f"{columns['scatter_points'][part].max():.2%}" for part in (before, ~before)))
    for rings, (early, late, wide) in found.items():
        print(f"{rings:4d} rings: torque off by {early:+.2e} at {OBJECTIVE} rad, {late:+.2e} at {LOCALISED} rad; "
              f"zone {wide:.4f} wide")


def check(runs, exact, turn):
    for wall, (columns, _, _) in runs.items():
        after = columns["path"] > turn
        assert max(abs(columns["torque"] - exact[wall]["torque"])) < 0.01 * max(columns["torque"])
        assert columns["iterations"][after].mean() < 5 and len(columns["path"]) == len(exact[wall]["path"])
        assert max(columns["scatter"]) < 1e-6
        assert max(columns["scatter_points"][~after]) < 0.02 and max(columns["scatter_points"]) < 0.1


if __name__ == "__main__":
    main(out=fields.directory())
