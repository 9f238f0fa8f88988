"""A small finite-element solver, independent of CalculiX: plane strain, rectangles with 2 x 2 points, small displacements."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from granumat import Material
from granumat.tensors import full

CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
GAUSS = CORNERS / np.sqrt(3)


def strain_matrices(size, b_bar):
    """B (4, 6, 8) at the points of a rectangle: strains 11 22 33 12 13 23, engineering shears, of u_x, u_z of each corner.

    With B-bar the volume strain is its mean over the element, shared by all three normal strains.
    """
    B = np.zeros((4, 6, 8))
    for point, (xi, zeta) in enumerate(GAUSS):
        by_x = CORNERS[:, 0] * (1 + CORNERS[:, 1] * zeta) / 4 * 2 / size[0]
        by_z = CORNERS[:, 1] * (1 + CORNERS[:, 0] * xi) / 4 * 2 / size[1]
        B[point, 0, 0::2], B[point, 2, 1::2] = by_x, by_z
        B[point, 4, 0::2], B[point, 4, 1::2] = by_z, by_x
    volume = B[:, :3].sum(axis=1)
    B[:, :3] += b_bar * (volume.mean(axis=0) - volume)[:, None] / 3
    return B


def block_reaction(problem, b_bar=False, tolerance=1e-10):
    """Reaction (n + 1,) of the upper platen of demos/linking/calculix/block.toml, and Newton's iterations in each increment."""
    block, initial, loading = problem["block"], problem["initial"], problem["loading"]
    material = Material(**problem["material"])
    nx, nz = block["elements"]
    size = np.array([block["width"] / nx, block["height"] / nz])
    node = np.arange((nx + 1) * (nz + 1)).reshape(nz + 1, nx + 1)
    corners = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], axis=-1).reshape(-1, 4)
    dofs = np.stack([2 * corners, 2 * corners + 1], axis=-1).reshape(-1, 8)
    B, weight = strain_matrices(size, b_bar), size.prod() / 4

    force = np.zeros(2 * node.size)                              # the pressure on the sides
    for side, sign in ((node[:, 0], 1), (node[:, -1], -1)):
        for edge in (side[:-1], side[1:]):
            force[2 * edge] += sign * initial["pressure"] * size[1] / 2
    platen = 2 * node[-1] + 1
    fixed = np.concatenate([2 * node[0], 2 * node[0] + 1, 2 * node[-1], platen])
    free = np.setdiff1d(np.arange(force.size), fixed)

    states = np.tile(material.isotropic(initial["phi"], initial["pressure"]), (len(dofs), 4)).view(np.recarray)
    change, iterations = np.zeros(force.size), []
    reaction = [initial["pressure"] * block["width"]]
    for _ in range(loading["increments"]):
        change[platen] = -loading["compression"] * block["height"] / loading["increments"]
        residual, count = np.inf, 0
        while np.abs(residual).max() > tolerance * reaction[0]:
            count += 1
            if count > 30:
                raise RuntimeError("Newton's method did not converge")
            if count > 1:
                K = weight * np.einsum("pki,epkl,plj->eij", B, C, B)
                rows, columns = np.repeat(dofs, 8, axis=1), np.tile(dofs, 8)
                K = coo_matrix((K.ravel(), (rows.ravel(), columns.ravel()))).tocsc()
                change[free] -= spsolve(K[free][:, free], residual)
            strain = np.einsum("pij,ej->epi", B, change[dofs])
            strain[..., 3:] /= 2
            trial, C = material.update_with_tangent(states, full(strain))
            inner = np.zeros(force.size)
            np.add.at(inner, dofs, weight * np.einsum("pij,epi->ej", B, trial.stress))
            residual = (inner - force)[free]
        states = trial
        reaction.append(-inner[platen].sum())
        iterations.append(count)
    return np.array(reaction), iterations
