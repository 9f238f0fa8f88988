# %% [markdown]
# # Radial hopper: flow through a mesh that stays, beside a march along the streamline
#
# Material flows towards the tip of a wedge with smooth walls: it enters at the outer radius in a given state, under a pressure,
# and leaves at the inner one, where its velocity is given; there is no weight. The mesh stays where it is and the state is
# convected, from rest to the steady state. There v_r = -Q(r)/r, and a grain meets everything that happens along the radius:
# `march` takes one material point inward, with the one dilation in each step that keeps the radial balance d(r s_rr)/dr = s_tt.
# It shares only the law with the finite elements.

# %%
from itertools import pairwise

import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
INNER, OUTER, PRESSURE, SPEED = 1.0, 2.0, 0.01, 1.0
ENTERING = SAND.isotropic(0.60, pressure=PRESSURE)
QUANTITIES = {"p": "pressure $p\\,d/k$", "phi": r"volume fraction $\phi$", "Z2": "coordination number $Z_2$"}
SHORT = {"meshes": (6, 12), "steps": 500}


# %% Along the streamline.
def march(steps):
    """Radii and QUANTITIES of a grain that moves from the outer to the inner radius, in steps of equal ln r."""
    hoop = -np.log(OUTER / INNER) / steps
    state, dilation, rows = np.atleast_1d(ENTERING), 0.0, [quantities(np.atleast_1d(ENTERING))]

    def moved(dilation):
        """The next state, and what the radial balance lacks."""
        gradient = np.zeros((1, 3, 3))
        gradient[0, 0, 0], gradient[0, 1, 1] = dilation - hoop, hoop
        new = SAND.update(state, gradient)
        difference = sum(of["stress"][0, 1] - of["stress"][0, 0] for of in (state, new)) / 2
        return new, new["stress"][0, 0] - state["stress"][0, 0] - hoop * difference

    for _ in range(steps):
        first, second = dilation, dilation + 1e-3 * hoop
        lacks = moved(first)[1]
        new, still = moved(second)
        while abs(still) > 1e-14:                        # by the secant method
            first, second, lacks = second, second - still * (second - first) / (still - lacks), still
            new, still = moved(second)
        state, dilation = new, second
        rows.append(quantities(state))
    return OUTER * np.exp(hoop * np.arange(steps + 1)), {name: np.concatenate([row[name] for row in rows]) for name in QUANTITIES}


def quantities(states):
    return {"p": -states["stress"][:, :3].sum(axis=1) / 3, "phi": states["volume_fraction"], "Z2": states["coordination_number"]}


# %% Through the mesh.
def inner(x):
    return np.isclose(np.hypot(x[0], x[1]), INNER)


def outer(x):
    return np.isclose(np.hypot(x[0], x[1]), OUTER)


def hopper(rings):
    """The steady problem on a sector of `rings` cells, whose two sides are periodic under rotation."""
    angle, polar = np.pi / (3 * rings), fem.polar()
    mesh = fem.meshes.annulus(MPI.COMM_WORLD, (INNER, OUTER), (rings, 1), angle=angle)
    problem = fem.Problem(mesh, SAND, ENTERING, [
        fem.Pressure(outer, PRESSURE), fem.Inflow(outer, ENTERING),
        fem.Displacement(inner, lambda x, t: -SPEED * t * x / np.hypot(*x.T)[:, None], axes=polar), fem.Outflow(inner),
        fem.Periodic(lambda x: np.isclose(np.arctan2(x[1], x[0]), angle),
                     lambda x: np.column_stack([np.hypot(*x.T), 0 * x[:, 1]]), polar)],
        motion="fixed", tolerances=fem.Tolerances(force=1e-10))
    fem.run(problem, "steady", 0.4 / rings)
    return problem


def flow(problem, where):
    """Solid that passes a part of the boundary in the last increment, per radian and unit of pseudo-time."""
    body, passed = problem.body, 0.0
    phi = problem.states.volume_fraction.reshape(problem.cells, -1)
    x = body.at_cells(problem.positions + problem.last.u / 2)
    u = body.at_cells(problem.last.u)
    for cells, (values, derivatives, weights) in body.facet_groups(body.cell_facets_at(where)):
        tangent = np.einsum("psa,cai->cpi", derivatives, x[cells])
        through = np.einsum("pa,cai->cpi", values, u[cells])
        at_points = np.linalg.solve(body.element.values.T @ body.element.values, body.element.values.T @ phi[cells].T).T
        crossed = abs(through[..., 0] * tangent[..., 1] - through[..., 1] * tangent[..., 0])
        passed += np.einsum("cp,p,cp->", crossed, weights, at_points @ values.T)
    return problem.comm.allreduce(passed) / problem.last.duration / (np.pi / 3) * problem.comm.allreduce(problem.cells)


# %%
def main(meshes=(10, 20, 40), steps=4000, out=None):
    r, exact = march(steps)
    runs, rows = {}, []
    for rings in meshes:
        problem = hopper(rings)
        through = flow(problem, outer), flow(problem, inner)
        comm, own = problem.comm, {"r": np.hypot(*problem.point_positions().T)} | quantities(problem.states)
        found = {name: np.concatenate(comm.allgather(values)) for name, values in own.items()}
        errors = {name: np.sqrt(np.mean((found[name] - np.interp(found["r"], r[::-1], exact[name][::-1]))**2)) / np.ptp(exact[name])
                  for name in QUANTITIES}
        runs[rings] = found
        rows.append({"rings": rings, "residual": problem.last.residuals[0], "in": through[0], "out": through[1], **errors})
    if MPI.COMM_WORLD.rank == 0:
        for row in rows:
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()))
        if out:
            fields.save(draw(r, exact, runs), out, "radial-hopper")
    for coarse, fine in pairwise(rows):
        assert all(coarse[name] > 2 * fine[name] for name in QUANTITIES)
    assert all(row["residual"] < 1e-8 and abs(row["in"] / row["out"] - 1) < 2e-3 for row in rows)
    return {name: np.array([row[name] for row in rows]) for name in ("in", "out", *QUANTITIES)}


def draw(r, exact, runs):
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    for axes, (name, label) in zip(figure.subplots(1, 3), QUANTITIES.items()):
        axes.plot(r, exact[name], "k-", linewidth=1, label="march along the streamline")
        for rings, found in runs.items():
            axes.plot(found["r"], found[name], ".", markersize=3, label=f"{rings} rings")
        axes.set(xlabel="radius", ylabel=label)
    axes.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
