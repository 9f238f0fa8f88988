"""The annular shear cell of annulus.py, length.py, regularisation.py, where_it_fails.py: walls, measurements, pictures."""

import csv
from pathlib import Path

import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import fem

INNER, OUTER, PRESSURE = 1.0, 2.0, 0.01         # radii, and the pressure on the outer wall
HEIGHT = 0.2                                    # of meshes in three dimensions


def ring(material, rings, sectors, turn, *, wall="load", part=1.0, rotated=0.0, twist=0.0, cell="quadrilateral", start=None,
         **more):
    """The problem, and its inner wall. Pseudo-time is the wall's path in radians; the wall turns back after `turn`.

    The outer wall stays round and does not rotate; it is under PRESSURE (wall = "load") or held (wall = "volume"). `part` is the
    modelled part of the ring, whose two sides are periodic under rotation. `rotated` is an angle by which the whole mesh is
    rotated. `twist` rotates the nodes on the inner wall back, so that the first ring of cells, where the shear localises, is least
    distorted once the wall has turned by that angle. `more` are arguments of Problem.
    """
    flat = cell in ("quadrilateral", "triangle")
    mesh = fem.meshes.annulus(MPI.COMM_WORLD, (INNER, OUTER), (rings, sectors) if flat else (rings, sectors, 1),
                              None if flat else HEIGHT, cell, angle=2 * np.pi * part)
    x = mesh.geometry.x
    angle = rotated - twist * np.isclose(np.hypot(x[:, 0], x[:, 1]), INNER)
    x[:, 0], x[:, 1] = np.cos(angle) * x[:, 0] - np.sin(angle) * x[:, 1], np.sin(angle) * x[:, 0] + np.cos(angle) * x[:, 1]

    def inner(x):
        return np.isclose(np.hypot(x[0], x[1]), INNER)

    def outer(x):
        return np.isclose(np.hypot(x[0], x[1]), OUTER)

    axes = fem.polar()
    conditions = [fem.Displacement(inner, fem.rotation(lambda t: t if t <= turn else 2 * turn - t))]
    if wall == "load":
        conditions += [fem.Displacement(outer, components=[1], axes=axes), fem.Tied(outer, 0, axes), fem.Pressure(outer, PRESSURE)]
    else:
        conditions += [fem.Displacement(outer)]
    if not flat:
        conditions += [fem.Displacement(lambda x: np.isclose(x[2], 0) | np.isclose(x[2], HEIGHT), components=[2])]
    if part < 1:
        conditions += [fem.Periodic(lambda x: np.isclose(np.arctan2(x[1], x[0]), 2 * np.pi * part),
                                    lambda x: np.column_stack([np.hypot(x[:, 0], x[:, 1]), 0 * x[:, 1], x[:, 2:]]), axes)]
    start = material.isotropic(0.60, pressure=PRESSURE) if start is None else start
    return fem.Problem(mesh, material, start, conditions, **more), inner


def uneven(state, cells, errors):
    """A start for Problem: `state`, whose phi is off by a random part of it, at most `errors`, that differs from cell to cell."""
    def start(x):
        states = np.full(len(x), state)
        states["volume_fraction"] *= 1 + errors * np.repeat(np.random.default_rng(0).uniform(-1, 1, cells), len(x) // cells)
        return states
    return start


class Watch:
    """An observer: one row of COLUMNS for every increment, the same on all ranks.

    torque per thickness, of the wall on the whole ring; pressure and phi are means over the first ring of cells; scatter is that of
    the cells' mean pressures around this ring, (largest - smallest)/mean, and scatter_points that of the integration points at one
    distance from the wall.
    """

    COLUMNS = ("path", "torque", "pressure", "phi", "scatter", "scatter_points", "iterations")

    def __init__(self, problem, inner, rings, part=1.0):
        self.inner, self.part, self.rows, self.residuals = inner, part, [], []
        self.width = (OUTER - INNER) / rings
        r = np.hypot(*problem.point_positions()[:, :2].T).reshape(problem.cells, -1)
        self.first = r.mean(axis=1) < INNER + self.width
        self.distance = np.round(r[self.first] / self.width, 2)

    def __call__(self, problem):
        if problem.last is None:
            return
        comm = problem.comm
        _, torque = problem.reaction(self.inner)
        pressure = self.of_first(problem, -problem.states.stress[:, :3].sum(axis=1) / 3)
        volume = self.of_first(problem, problem.point_volumes())
        phi = self.of_first(problem, problem.states.volume_fraction)
        whole, mean, solid = comm.allreduce(np.array([volume.sum(), (pressure * volume).sum(), (phi * volume).sum()]))
        mean, distances = mean / whole, sorted(set().union(*comm.allgather(set(self.distance.ravel()))))
        self.rows.append((problem.t, np.ravel(torque)[-1] / self.part / (HEIGHT if problem.d == 3 else 1), mean, solid / whole,
                          spread(comm, (pressure * volume).sum(axis=1) / volume.sum(axis=1)) / mean,
                          max(spread(comm, pressure[self.distance == at]) for at in distances) / mean,
                          len(problem.last.residuals) - 1))
        self.residuals.append(problem.last.residuals)

    def of_first(self, problem, values):
        return values.reshape(problem.cells, -1)[self.first]

    def columns(self):
        return {name: np.array(column) for name, column in zip(self.COLUMNS, zip(*self.rows))}


def sheared_zone(problem):
    """Distance from the inner wall at which the last increment's rotation is a tenth of the wall's."""
    now = (problem.positions + problem.displacement)[:, :2]
    x = now - problem.last.u[:, :2]
    angle = np.arctan2(x[:, 0] * now[:, 1] - x[:, 1] * now[:, 0], (x * now).sum(axis=1))
    r, angle = np.concatenate(problem.comm.allgather(np.column_stack([np.hypot(*now.T), angle]))).T
    order = np.argsort(r)
    return np.interp(-0.1 * angle.max(), -angle[order], r[order]) - INNER


def spread(comm, values):
    return comm.allreduce(values.max(initial=-np.inf), MPI.MAX) - comm.allreduce(values.min(initial=np.inf), MPI.MIN)


def draw(runs, exact, found, turn, paths):
    """The picture of annulus.py: runs and radial solutions by wall, and what finer meshes found at two paths."""
    objective, localised = paths
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    panels = figure.subplots(2, 3)
    colours = {"load": "#0072B2", "volume": "#D55E00"}
    labels = {"torque": "torque per height, inner radius 1 [k/d]", "pressure": "pressure, first ring [k/d]",
              "phi": r"$\phi$, first ring"}
    for axes, (name, label) in zip(panels.flat, labels.items()):
        for wall, (columns, _, _) in runs.items():
            axes.plot(columns["path"], columns[name], color=colours[wall], label=f"constant {wall}")
            axes.plot(exact[wall]["path"], exact[wall][name], "k:", label="radial solution" if wall == "volume" else None)
        axes.axvline(turn, color="0.7", linewidth=0.8, zorder=0)
        axes.set(xlabel="path of the inner wall [rad]", ylabel=label)
    panels[0, 0].legend(frameon=False)
    axes, columns = panels[1, 0], runs["load"][0]
    axes.semilogy(columns["path"], columns["scatter_points"], label="integration points at one radius")
    axes.semilogy(columns["path"], columns["scatter"], label="cells' means")
    axes.set(xlabel="path of the inner wall [rad]", ylabel="scatter of p around the first ring")
    axes.legend(frameon=False)
    if found:
        rings = np.array(list(found))
        early, late, wide = np.abs(np.array(list(found.values()))).T
        axes = panels[1, 1]
        axes.loglog(rings, early, "o-", label=f"at {objective} rad, before localisation")
        axes.loglog(rings, late, "s-", label=f"at {localised} rad, localised")
        axes.loglog(rings, early[0] * (rings[0] / rings)**2, "k:", label="orders 2 and 1")
        axes.loglog(rings, late[0] * rings[0] / rings, "k:")
        axes.set(xlabel="rings of cells", ylabel="relative error of the torque", xticks=rings, xticklabels=rings)
        axes.legend(frameon=False)
        axes = panels[1, 2]
        axes.loglog(rings, wide, "o-", label="90 % of the turn is lost within")
        axes.loglog(rings, (OUTER - INNER) / rings, "k:", label="width of one ring")
        axes.set(xlabel="rings of cells", ylabel="width of the sheared zone", xticks=rings, xticklabels=rings)
        axes.legend(frameon=False)
        for axes in panels[1, 1:]:
            axes.minorticks_off()
    return figure


def save(out, name, columns, rows, figure):
    """Writes rows as a table and a figure into the directory `out`."""
    fields.save(figure, out, name)
    with open(Path(out) / f"{name}.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, columns)
        table.writeheader()
        table.writerows(rows)
