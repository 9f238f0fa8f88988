"""What loads a body: gravity and tractions, which do not follow its motion, and pressures, which do."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..checks import real_array
from .body import Body
from .conditions import Pressure, Traction


class Loads:
    """Nodal forces of gravity and of the Pressure and Traction conditions.

    Parameters
    ----------
    body : Body
    conditions : sequence
        Those of other types are left to Numbering.
    gravity : sequence (d) or None
        Weight of the solid per volume of the solid, in units of stress per length.
    solid_volumes : array (points)
        Volume of the solid that belongs to each point, which an increment conserves.
    """

    def __init__(self, body: Body, conditions: Sequence[object], gravity: Sequence[float] | None,
                 solid_volumes: np.ndarray) -> None:
        self._body, self._gravity = body, gravity
        self.weigh(solid_volumes)
        self._tractions = [(self._nodal_areas(condition), condition.value) for condition in conditions
                           if isinstance(condition, Traction)]
        self._pressures = [(condition, body.cell_facets_at(condition.where)) for condition in conditions
                           if isinstance(condition, Pressure)]

    def _nodal_areas(self, traction: Traction) -> np.ndarray:
        """Area (cells, nodes per cell) of a traction's part at the start, shared out to the nodes by the shape functions."""
        x = self._body.at_cells(self._body.positions)
        areas = np.zeros(x.shape[:2])
        for cells, (values, derivatives, weights) in self._body.facet_groups(self._body.cell_facets_at(traction.where)):
            area = np.linalg.norm(_normals(np.einsum("psa,cai->cpsi", derivatives, x[cells])), axis=-1)
            areas[cells] += np.einsum("cp,p,pa->ca", area, weights, values)
        return areas

    def weigh(self, solid_volumes: np.ndarray) -> None:
        """Takes another volume of the solid (points) for the weight."""
        self._weight = np.zeros((self._body.cells, self._body.cell_nodes.shape[1], self._body.d))
        if self._gravity is not None:
            self._weight += np.einsum("cq,qa,i->cai", solid_volumes.reshape(self._body.cells, -1), self._body.element.values,
                                      np.asarray(self._gravity, float))

    def dead(self, t: float) -> np.ndarray:
        """Nodal forces (cells, nodes per cell, d) of gravity and tractions at pseudo-time t."""
        return self._weight + sum(areas[..., None] * _value_at(value, t, "Traction", (self._body.d,))
                                  for areas, value in self._tractions)

    def pressures(self, x: np.ndarray, t: float, stiffness: np.ndarray | None = None) -> np.ndarray:
        """Nodal forces (cells, nodes per cell, d) of the pressures at pseudo-time t on the cells' nodes at x.

        If a stiffness (cells, n, n) is given, the forces' derivative by x is subtracted from it.
        """
        forces = np.zeros_like(x)
        for condition, cell_facets in self._pressures:
            pressure = _value_at(condition.value, t, "Pressure", ())
            for cells, (values, derivatives, weights) in self._body.facet_groups(cell_facets):
                tangents = np.einsum("psa,cai->cpsi", derivatives, x[cells])
                normals = _normals(tangents)
                facet_center = np.einsum("qa,cai->ci", values, x[cells]) / len(weights)
                outward = np.sign(np.einsum("cpi,ci->c", normals, facet_center - x[cells].mean(axis=1)))
                factor = -pressure * outward[:, None] * weights
                forces[cells] += np.einsum("cp,pa,cpi->cai", factor, values, normals, optimize=True)
                if stiffness is not None:
                    nodes = x.shape[1]
                    of_nodes = stiffness.reshape(len(stiffness), nodes, -1, nodes, stiffness.shape[1] // nodes)
                    block = np.einsum("cp,pa,cpsij,psb->caibj", factor, values, _normal_derivatives(tangents), derivatives,
                                      optimize=True)
                    of_nodes[cells, :, :self._body.d, :, :self._body.d] -= block
        return forces


def _value_at(value: Any, t: float, kind: str, shape: tuple[int, ...]) -> np.ndarray:
    """A load's value at pseudo-time t; ValueError, the same on all ranks, if it is not finite or of another shape."""
    found = real_array(f"a {kind}'s value", value(t) if callable(value) else value)
    if found.shape != shape or not np.isfinite(found).all():
        words = f"{shape[0]} finite numbers" if shape else "a finite number"
        raise ValueError(f"a {kind}'s value at t = {t:g} is {found.tolist()}: must be {words}")
    return found


def _normals(tangents: np.ndarray) -> np.ndarray:
    """Normals (..., d), as long as the area is large, from a facet's tangent vectors (..., d - 1, d)."""
    if tangents.shape[-1] == 2:
        return np.stack([tangents[..., 0, 1], -tangents[..., 0, 0]], axis=-1)
    return np.cross(tangents[..., 0, :], tangents[..., 1, :])


def _normal_derivatives(tangents: np.ndarray) -> np.ndarray:
    """Derivatives (..., s, i, j) of component i of the normals by component j of tangent vector s."""
    d = tangents.shape[-1]
    axis = np.eye(d)
    derivatives = np.zeros((*tangents.shape, d))
    for j in range(d):
        for s in range(d - 1):
            if d == 2:
                derivatives[..., s, :, j] = [axis[j, 1], -axis[j, 0]]
            elif s == 0:
                derivatives[..., s, :, j] = np.cross(axis[j], tangents[..., 1, :])
            else:
                derivatives[..., s, :, j] = np.cross(tangents[..., 0, :], axis[j])
    return derivatives
