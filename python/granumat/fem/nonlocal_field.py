"""The nonlocal strain of a body with a length, which is solved for together with the displacements."""

import numpy as np

from .. import tensors
from .body import Body
from .numbering import Numbering
from .system import System

STRAIN_FLOOR = 1e-10                # residuals are relative to at least this strain everywhere
PRESSURE_FLOOR = 1e-6               # in k/d, of the scale of the equations of m
STRAIN_AT_REST = 1e-4               # takes the place of m in that scale where m = 0 everywhere
# For the first guess. The matrix is that of mass and diffusion: its condition grows as (length over the cells' size)^2.
SMOOTHING_SOLVER = {"ksp_type": "cg", "pc_type": "jacobi", "ksp_rtol": 1e-10}


class NonlocalField:
    """The nonlocal strain m of an increment: m - length^2 div grad m = abs(D), with n . grad m = 0 where no condition gives m.

    m is of degree 1 between the cells' vertices, which come first among the nodes; other nodes have m = 0. Gradients and volumes
    are those at the start of the increment, so that the equation is linear in m. Arrays are as in Body.

    Parameters
    ----------
    body : Body
    length : float
        Above 0, in the units of the mesh.
    numbering : Numbering
        Of d + 1 unknowns a node, m the last of them.
    """

    def __init__(self, body: Body, length: float, numbering: Numbering) -> None:
        self._body, self.length, self._numbering = body, length, numbering
        self._start: np.ndarray | None = None                    # the displacement that the two below belong to
        self._matrices = self._volumes = np.empty(0)
        self._system: System | None = None

    def at_points(self, m: np.ndarray) -> np.ndarray:
        """m (points) of m (nodes)."""
        return (self._at_vertices(m) @ self._body.element.vertex_values.T).ravel()

    def residuals(self, start: np.ndarray, m: np.ndarray, gradients: np.ndarray) -> tuple[np.ndarray, float]:
        """What is wrong with m, and the size that it is relative to; collective.

        Parameters
        ----------
        start : array (nodes, d)
            Displacement at the start of the increment; it must not be written into later.
        m : array (nodes)
        gradients : array (points, 3, 3)
            Of the increment.

        Returns
        -------
        residuals : array (cells, nodes per cell)
            Of the equations of m.
        scale : float
            Norm of the cells' integrals of abs(D).
        """
        matrices, _ = self._operator(start)
        residuals = np.zeros(self._body.cell_nodes.shape)
        vertices = matrices.shape[1]
        residuals[:, :vertices] = (matrices @ self._at_vertices(m)[..., None])[..., 0] - self._sources(start, gradients)
        scale = self._sources(start, gradients, STRAIN_FLOOR)
        return residuals, float(np.sqrt(self._body.comm.allreduce((scale**2).sum())))

    def add_stiffness(self, start: np.ndarray, u: np.ndarray, volumes: np.ndarray, gradients: np.ndarray, by_nonlocal: np.ndarray,
                      scale: float, stiffness: np.ndarray) -> None:
        """Writes all that has to do with m into the cells' matrices.

        Parameters
        ----------
        start, u : array (nodes, d)
            Displacement at the start of the increment, and in it.
        volumes : array (cells, points per cell)
            After the increment.
        gradients : array (cells, points per cell, 3, 3)
        by_nonlocal : array (points, 6), or (points, 4) in plane strain
            d stress / d m.
        scale : float
            Factor of the equations of m.
        stiffness : array (cells, n, n)
            n = nodes per cell times d + 1.
        """
        body, (matrices, old_volumes) = self._body, self._operator(start)
        body.coupling(body.at_cells(body.positions + start + u), volumes, old_volumes, gradients,
                      by_nonlocal.reshape(*volumes.shape, -1), matrices, scale, stiffness)

    def scale(self, m: np.ndarray, stress: np.ndarray) -> float:
        """Factor of the equations of m that makes them as large as those of forces: mean p over geometric mean of m; collective.

        Parameters
        ----------
        m : array (nodes)
        stress : array (points, 6)
        """
        of_points = self.at_points(m)
        logarithms = np.log(of_points[of_points > 0])
        sums = self._body.comm.allreduce(np.array([tensors.trace(stress).sum(), len(stress), logarithms.sum(), len(logarithms)]))
        pressure = max(-sums[0] / 3 / sums[1], PRESSURE_FLOOR)
        return float(pressure / (np.exp(sums[2] / sums[3]) if sums[3] else STRAIN_AT_REST))

    def solve(self, start: np.ndarray, gradients: np.ndarray, prescribed: np.ndarray) -> np.ndarray:
        """m (nodes) that an increment's gradients (points, 3, 3) have; prescribed (nodes), 0 where m is free; collective."""
        if self._system is None:
            labels = self._numbering.labels[:, -1:] // self._numbering.labels.shape[1]
            cell_labels = self._at_vertices(labels)[..., 0]
            self._system = System(self._body.comm, self._body.owned_nodes, self._body.d, cell_labels, labels, SMOOTHING_SOLVER)
        matrices, _ = self._operator(start)
        self._system.cell_matrices[:] = matrices
        forces = self._sources(start, gradients) - (matrices @ self._at_vertices(prescribed)[..., None])[..., 0]
        solution = self._system.solve(forces)
        return prescribed + (0 if solution is None else solution[:, 0])

    def _operator(self, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrices (cells, vertices per cell, vertices per cell) and volumes (cells, points per cell) at a displacement."""
        if start is not self._start:
            x = self._body.at_cells(self._body.positions + start)
            self._matrices, self._volumes = self._body.helmholtz(x, self.length)
            self._start = start
        return self._matrices, self._volumes

    def _sources(self, start: np.ndarray, gradients: np.ndarray, more: float = 0.0) -> np.ndarray:
        """Integrals (cells, vertices per cell) of abs(D) + more over the shape functions."""
        strain = tensors.magnitude(tensors.symmetric(gradients)) + more
        _, volumes = self._operator(start)
        return (strain.reshape(volumes.shape) * volumes) @ self._body.element.vertex_values

    def _at_vertices(self, nodal: np.ndarray) -> np.ndarray:
        """Values (cells, vertices per cell, ...) from those (nodes, ...)."""
        return nodal[self._body.cell_nodes[:, :self._body.element.vertex_values.shape[1]]]
