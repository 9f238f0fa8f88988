# %% [markdown]
# # A block between rough platens, and what regularises its shear bands
#
# Plane-strain compression under a constant side pressure. The rough platens hold dead wedges; between them shear concentrates into
# crossing bands. Without a length every refinement makes the bands thinner and the block weaker, and the elastic strain, which
# changes how the force rises, does not change this. With a length the bands have a width of their own, which the mesh no longer
# changes once its cells are smaller than the length. The rate term does it at the price of a higher force.

# %%
import fields
import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from granumat import Material, fem

HEIGHT, PHI, PRESSURE = 2.0, 0.60, 0.003            # the width is 1
CASES = {                                           # name -> e_r, alpha (pseudo-time is the compression), l
    "e_r = 0.001": (0.001, 0.0, 0.0),
    "e_r = 0.01": (0.01, 0.0, 0.0),
    "e_r = 0.01, alpha = 0.02": (0.01, 0.02, 0.0),
    "e_r = 0.01, l = 0.05": (0.01, 0.0, 0.05),
}
RANK = MPI.COMM_WORLD.rank
SHORT = {"meshes": (4,), "compression": 0.04, "increments": 6,
         "cases": {"e_r = 0.01": (0.01, 0.0, 0.0), "alpha = 0.02": (0.01, 0.02, 0.0), "l = 0.3": (0.01, 0.0, 0.3)}}


def bottom(x):
    return np.isclose(x[1], 0)


def top(x):
    return np.isclose(x[1], HEIGHT)


def sides(x):
    return np.isclose(x[0], 0) | np.isclose(x[0], 1)


def block(columns, elastic_strain, rate_term, length):
    sand = Material(mu=0.5, elastic_strain=elastic_strain)
    mesh = fem.meshes.box(MPI.COMM_WORLD, (1.0, HEIGHT), (columns, 2 * columns))
    return fem.Problem(mesh, sand, sand.isotropic(PHI, pressure=PRESSURE), [
        fem.Displacement(bottom), fem.Displacement(top, lambda x, t: np.array([0.0, -t * HEIGHT])),
        fem.Pressure(sides, PRESSURE)], rate_term=rate_term, length=length)


# %%
def share_of_bands(problem):
    """The smallest share of the block that does half of the increment's shear: 0.5 where it is uniform."""
    L = problem.last.gradients
    shear = np.hypot(L[:, 0, 0] - L[:, 1, 1], L[:, 0, 1] + L[:, 1, 0])
    parts = problem.comm.allgather((shear, problem.point_volumes()))
    shear, volume = (np.concatenate(part) for part in zip(*parts))
    order = np.argsort(-shear)
    done, taken = np.cumsum((shear * volume)[order]), np.cumsum(volume[order])
    return np.interp(done[-1] / 2, done, taken) / taken[-1]


def compress(columns, case, compression, increments):
    """Compression, force on the platen over side pressure, share of the bands; Newton's iterations; the field of shear strain."""
    problem, rows, iterations = block(columns, *case), [], []

    def watch(problem):
        if problem.last is not None:
            rows.append((problem.t, -problem.reaction(top)[0][1] / PRESSURE, share_of_bands(problem)))
            iterations.append(len(problem.last.residuals) - 1)

    fem.run(problem, compression, compression / increments, observers=[watch])
    return np.array(rows), iterations, fields.on_rank_0(problem, "shear_strain")


def main(meshes=(8, 16, 32), compression=0.21, increments=42, cases=CASES, out=None):
    data, pictures = {}, {}
    for name, case in cases.items():
        for columns in meshes:
            rows, iterations, pictures[name, columns] = compress(columns, case, compression, increments)
            data[f"{name}: {columns}"] = rows
            if RANK == 0:
                print(f"{name:24} {columns:2} x {2 * columns:2} cells: force over side pressure {rows[-1, 1]:.4f}, half of the "
                      f"shear in {rows[-1, 2]:.3f} of the block; {len(rows)} increments of {np.mean(iterations):.2f} iterations",
                      flush=True)
        if len(meshes) > 1:                             # of the two finest meshes: the bands keep their width, or follow the mesh
            coarse, fine = (data[f"{name}: {columns}"][-1, 2] for columns in meshes[-2:])
            _, rate_term, length = case
            assert abs(fine / coarse - 1) < (0.05 if length else 0.1) if length or rate_term else fine < 0.7 * coarse
    if out and RANK == 0:
        fields.save(picture(data, pictures), out, "biaxial-block")
    return data


def picture(data, pictures):
    """Force against compression, share of the bands against compression, and fields of shear strain."""
    meshes = sorted({columns for _, columns in pictures})
    names = list(dict.fromkeys(name for name, _ in pictures))
    labels = {name: name.replace("e_r", "$e_r$").replace("alpha", "$\\alpha$").replace("l =", "$l$ =") for name in names}
    figure = Figure(figsize=(11, 8), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(2, 3))
    force, share = left.subplots(2, 1)
    for color, name in enumerate(names):
        for columns, style in zip(meshes, (":", "--", "-")):
            rows = data[f"{name}: {columns}"]
            force.plot(rows[:, 0], rows[:, 1], style, color=f"C{color}", label=labels[name] if columns == meshes[-1] else None)
            share.plot(rows[:, 0], rows[:, 2], style, color=f"C{color}")
    force.set(ylabel="force over side pressure", title=f"dotted, dashed, full: {', '.join(map(str, meshes))} columns of cells")
    force.title.set_fontsize(9)
    force.legend(frameon=False, fontsize=8)
    share.set(xlabel="compression over height", ylabel="share of the block with half of the shear")
    for row, name in zip(right.subplots(3, len(meshes), squeeze=False), names[-3:]):
        for axes, columns in zip(row, meshes):
            fields.draw(axes, pictures[name, columns], "shear strain" if columns == meshes[-1] else "")
        row[len(meshes) // 2].set_title(labels[name], fontsize=9)
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
