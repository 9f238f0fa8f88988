"""The annular shear cell as a problem in the radius alone: finite volumes over the rings, sharing no code with granumat.fem.

Equilibrium d(r s_rr)/dr = s_tt and d(r^2 s_rt)/dr = 0 over the control volumes between the middles of neighbouring rings; a ring
that moves from radii R to r while its sides turn by w has the deformation gradient F = (dr/dR, 0; r dw/dR, r/R) along the polar
axes. The material is updated ring by ring, with log F in plane strain. Newton's method takes its matrix from central differences;
unknowns of nodes that are three apart have no equation in common, so that they are changed together.
"""

import numpy as np
from scipy.linalg import solve_banded

from granumat import Material, MaterialError

SMALL = 1e-11               # steps of the central differences, for radii and angles of about 1
CONVERGED = 1e-9            # residual, in units of stress times radius
ITERATIONS = 30


class Annulus:
    """Rings between two walls, the inner one of fixed radius, the outer one fixed (pressure None) or under a pressure.

    The unknowns are the radii r and angles w of the nodes between the rings.
    """

    def __init__(self, material: Material, state, rings, radii=(1.0, 2.0), pressure=0.01):
        self.material, self.pressure = material, pressure
        self.r = np.linspace(*radii, rings + 1)
        self.states = np.repeat(np.atleast_1d(state), rings)
        self.moved = np.zeros((rings + 1, 2))                       # the last increment of (r, w)
        self.angle = np.zeros(rings + 1)

    def middle(self):
        return (self.r[1:] + self.r[:-1]) / 2

    def _states(self, step):
        """Trial states along the new polar axes, for increments (nodes, 2)."""
        r, width = self.r + step[:, 0], np.diff(self.r)
        turn = (step[1:, 1] + step[:-1, 1]) / 2
        deformation = np.zeros((len(turn), 2, 2))
        deformation[:, 0, 0] = np.diff(r) / width
        deformation[:, 1, 1] = (r[1:] + r[:-1]) / (self.r[1:] + self.r[:-1])
        deformation[:, 1, 0] = (r[1:] + r[:-1]) / 2 * np.diff(step[:, 1]) / width
        gradient = np.zeros((len(turn), 3, 3))
        gradient[:, :2, :2] = logarithm(np.einsum("nij,njk->nik", rotation(turn), deformation))
        states = self.material.update(self.states, gradient)
        back = np.tile(np.eye(3), (len(turn), 1, 1))
        back[:, :2, :2] = rotation(-turn)
        for name in ("stress", "fabric", "direction"):
            states[name] = rotate(states[name], back)
        return states

    def _residual(self, step, angle):
        stress = self._states(step)["stress"]
        r = self.r + step[:, 0]
        m = (r[1:] + r[:-1]) / 2
        residual = np.empty_like(step)
        residual[0] = step[0, 0], step[0, 1] - angle
        s_rr, s_tt, s_rt = stress[:, 0], stress[:, 1], stress[:, 3]
        residual[1:-1, 0] = np.diff(m * s_rr) - s_tt[1:] * (m[1:] - r[1:-1]) - s_tt[:-1] * (r[1:-1] - m[:-1])
        residual[1:-1, 1] = np.diff(m**2 * s_rt)
        residual[-1, 1] = step[-1, 1]
        residual[-1, 0] = (step[-1, 0] if self.pressure is None
                           else -r[-1] * self.pressure - m[-1] * s_rr[-1] - s_tt[-1] * (r[-1] - m[-1]))
        return residual

    def _jacobian(self, step, angle):
        """Derivatives of the residual, in the form of scipy.linalg.solve_banded with three diagonals on each side."""
        size = step.size
        banded = np.zeros((7, size))
        for color in range(6):
            columns = np.arange(color, size, 6)
            change = np.zeros(size)
            change[columns] = SMALL
            change = change.reshape(step.shape)
            slope = (self._residual(step + change, angle) - self._residual(step - change, angle)).ravel() / (2 * SMALL)
            for column in columns:
                rows = np.arange(max(0, column // 2 * 2 - 2), min(size, column // 2 * 2 + 4))
                rows = rows[abs(rows - column) <= 3]
                banded[3 + rows - column, column] = slope[rows]
        return banded

    def turn(self, angle):
        """Turns the inner wall by an angle."""
        before = self.moved[0, 1]
        step = self.moved * (angle / before if before else 0)
        residual = self._residual(step, angle)
        for _ in range(ITERATIONS):
            size = abs(residual).max()
            if size < CONVERGED:
                self.states, self.r, self.angle = self._states(step), self.r + step[:, 0], self.angle + step[:, 1]
                self.moved = step
                return
            correction = solve_banded((3, 3), self._jacobian(step, angle), residual.ravel()).reshape(step.shape)
            step, residual = self._search(step, correction, size, angle)
        raise ArithmeticError(f"no convergence: residual {size:.1e}")

    def _search(self, step, correction, size, angle):
        """The longest step 1, 1/2, 1/4, ... of a correction that the material can be updated with and that lowers the residual."""
        for part in 0.5**np.arange(12):
            try:
                residual = self._residual(step - part * correction, angle)
            except MaterialError:
                continue
            if abs(residual).max() < size:
                break
        return step - part * correction, residual

    def torque(self):
        """Per thickness, of the inner wall on the body."""
        return -2 * np.pi * self.middle()[0]**2 * self.states["stress"][0, 3]


def rotation(angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)


def logarithm(f):
    """Of matrices (n, 2, 2) near 1: log f = (1/2) log(det f) 1 + q (f - (tr f / 2) 1)."""
    half = np.trace(f, axis1=1, axis2=2) / 2
    determinant = np.linalg.det(f)
    square = (half**2 - determinant).astype(complex)
    root = np.where(square == 0, 1e-30, np.sqrt(square))
    factor = (np.arctanh(root / half) / root).real
    deviator = f - half[:, None, None] * np.eye(2)
    with np.errstate(invalid="ignore"):                  # an inverted ring: the material refuses gradients that are not finite
        return factor[:, None, None] * deviator + np.log(determinant)[:, None, None] / 2 * np.eye(2)


def rotate(voigt, q):
    """Symmetric tensors (n, 6), components xx yy zz xy xz yz, rotated by q (n, 3, 3)."""
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    matrix = np.empty((len(voigt), 3, 3))
    matrix[:, i, j] = matrix[:, j, i] = voigt
    return np.einsum("nik,nkl,njl->nij", q, matrix, q)[:, i, j]
