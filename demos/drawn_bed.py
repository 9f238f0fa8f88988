# %% [markdown]
# # A bed drawn past a wall that holds it back
#
# Sand goes down between two rough walls. The right one goes with it at the speed 1; of the left one, the middle is slower, by up
# to a half. Sand enters at the top in a given state, under a pressure, and leaves at the bottom at the speed 1; there is no
# weight. The mesh stays and the state is convected, from rest to the steady flow, which passes the mesh several times. A length
# regularises: without it, waves across the flow grow and it does not become steady. The drag is the force on the left wall without
# its lowest node, which carries half a cell of what the outlet bears too.

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

SAND = Material(mu=0.5, elastic_strain=0.01)
PRESSURE, LENGTH = 0.01, 0.2
ENTERING = SAND.isotropic(0.60, pressure=PRESSURE)
WIDTH, HEIGHT = 1.0, 2.0
HELD, SLOWER = (0.4, 1.6), 0.5                  # heights between which the left wall is slower, and by how much at most
SHORT = {"meshes": (4, 6), "until": 1.0}


def left(x):
    return np.isclose(x[0], 0)


def above_outlet(x):
    return left(x) & (x[1] > 0)


def right(x):
    return np.isclose(x[0], WIDTH)


def top(x):
    return np.isclose(x[1], HEIGHT)


def bottom(x):
    return np.isclose(x[1], 0)


def down(x, t):
    return [0, -t]


def slower(x, t):
    """Displacement of the left wall, whose slower part begins and ends smoothly."""
    inside = (x[:, 1] > HELD[0]) & (x[:, 1] < HELD[1])
    bump = np.where(inside, np.sin(np.pi * (x[:, 1] - HELD[0]) / (HELD[1] - HELD[0]))**2, 0)
    return np.column_stack([0 * bump, -t * (1 - SLOWER * bump)])


# %%
def drawn(cells, until):
    """The problem, and rows of time and drag on the left wall; on `cells` cells across."""
    problem = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, (WIDTH, HEIGHT), (cells, 2 * cells)), SAND, ENTERING, [
        fem.Displacement(left, slower), fem.Displacement(right, down), fem.Pressure(top, PRESSURE), fem.Inflow(top, ENTERING),
        fem.Displacement(bottom, down), fem.Outflow(bottom)], motion="fixed", length=LENGTH)
    rows = []

    def watch(problem):
        if problem.last is not None:
            rows.append((problem.t, problem.reaction(above_outlet)[0][1]))
    fem.run(problem, until, 0.2 / cells, observers=[watch])
    return problem, np.array(rows)


def main(meshes=(8, 16, 32), until="steady", out=None):
    runs = {cells: drawn(cells, until) for cells in meshes}
    shown = [fields.on_rank_0(runs[meshes[-1]][0], name) for name in ("p", "phi")]
    drags = np.array([rows[-1, 1] for _, rows in runs.values()])
    if MPI.COMM_WORLD.rank == 0:
        for (cells, (problem, rows)), drag in zip(runs.items(), drags):
            print(f"{cells} cells across: drag {drag:.6f} at t = {rows[-1, 0]:.2f}, after {len(rows)} increments, residual of the "
                  f"first guess {problem.last.residuals[0]:.0e}")
        if out:
            fields.save(draw(runs, shown), out, "drawn-bed")
    assert all(problem.increments == round(problem.t * cells / 0.2) for cells, (problem, _) in runs.items())      # none was cut
    assert abs(drags[-1] / drags[-2] - 1) < 0.2 / meshes[-1]
    return {"drag": drags}


def draw(runs, shown):
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1.3, 1, 1))
    for cells, (_, rows) in runs.items():
        axes[0].plot(*rows.T, label=f"{cells} cells across")
    axes[0].set(xlabel="way of the right wall, over the width", ylabel="drag on the left wall [k/d times the width]")
    axes[0].legend(frameon=False)
    for panel, field, label in zip(axes[1:], shown, ("pressure $p\\,d/k$", r"volume fraction $\phi$")):
        fields.draw(panel, field, label)
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
