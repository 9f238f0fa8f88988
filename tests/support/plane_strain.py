"""A small finite-element solver, independent of CalculiX: plane strain, rectangles with 2 x 2 points, small displacements."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from granumat import Material
from granumat.tensors import to_matrix

CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
GAUSS = CORNERS / np.sqrt(3)
TOLERANCE, MAX_ITERATIONS = 1e-10, 30       # of forces, over the initial reaction


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


def block_reaction(problem, b_bar=False):
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

    def equilibrium(states, change):
        """New states, forces that are not balanced, and their derivative."""
        strain = np.einsum("pij,ej->epi", B, change[dofs])
        strain[..., 3:] /= 2
        new, C = material.update_with_tangent(states, to_matrix(strain))
        unbalanced = -force
        np.add.at(unbalanced, dofs, weight * np.einsum("pij,epi->ej", B, new.stress))
        K = weight * np.einsum("pki,epkl,plj->eij", B, C, B)
        K = coo_matrix((K.ravel(), (np.repeat(dofs, 8, axis=1).ravel(), np.tile(dofs, 8).ravel()))).tocsc()
        return new, unbalanced, K

    states = np.tile(material.isotropic(initial["phi"], initial["pressure"]), (len(dofs), 4)).view(np.recarray)
    change, reaction, iterations = np.zeros(force.size), [initial["pressure"] * block["width"]], []
    for _ in range(loading["increments"]):
        change[platen] = -loading["compression"] * block["height"] / loading["increments"]
        new, unbalanced, K = equilibrium(states, change)
        count = 0
        while np.abs(unbalanced[free]).max() > TOLERANCE * reaction[0]:
            count += 1
            if count > MAX_ITERATIONS:
                raise RuntimeError("Newton's method did not converge")
            change[free] -= spsolve(K[free][:, free], unbalanced[free])
            new, unbalanced, K = equilibrium(states, change)
        states = new
        reaction.append(-unbalanced[platen].sum())
        iterations.append(count)
    return np.array(reaction), iterations
