"""A quasi-static boundary-value problem: one increment at a time, accepted or not."""

from dataclasses import dataclass, field

import dolfinx.mesh
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from .. import core, tensors
from ..checks import is_number, refuse
from ..core import STATE, status_message
from ..errors import MaterialError
from ._compat import ReferenceCell, cell_nodes, vector_space
from .conditions import Displacement, Periodic, Pressure, Tied, Traction
from .errors import in_words
from .numbering import GIVEN, Numbering
from .system import System

ELEMENT_FAILURES = ("", "the mesh is inverted", "the increment turns or strains a cell by too much")
LARGEST_CUT = 1 / 16                       # of a correction, by the line search
ROUND_OFF = 1e-12                          # of displacements, relative to what they add to
REST = 1e-5                                # k/d: stress that residuals are relative to where there is none
LOOSE = 1e-6                               # k/d: stiffness of points without pressure, in Newton's matrix only
SURE = 1e-3                                # part of the tolerance of forces that leaves nothing to correct
SUFFICIENT = 1e-4                          # part of the expected decrease that a correction must bring


@dataclass(frozen=True)
class Tolerances:
    """When an increment counts as solved: the forces are small, and the last correction or the forces before it.

    (Where a body of several layers shears steadily an increment is not unique, and corrections do not settle.)

    Attributes
    ----------
    force : float
        Norm of the residual forces, relative to that of all cells' nodal forces.
    correction : float
        Largest last correction of a displacement, relative to the largest displacement of the increment.
    iterations : int
        At most so many Newton iterations.
    """

    force: float = 1e-8
    correction: float = 1e-5
    iterations: int = 15


@dataclass
class Trial:
    """What an increment leads to: the problem itself is as it was until it accepts the trial.

    Attributes
    ----------
    t : float
        Pseudo-time at its end.
    u : array (nodes, d)
        Displacements of the increment.
    states : record array (points) of dtype STATE
    gradients : array (points, 3, 3)
        du_i/dx_j of the increment as the material got it.
    volumes : array (cells, points per cell)
    tangent : array or None
        The material's, until it is used.
    forces : array (cells, nodes per cell, d)
        What the cells' nodes need from outside: internal forces less loads.
    residuals : list of float
        Relative force residuals of Newton's iterations.
    failure : str
        Empty where the increment is solved, else why it is not.
    """

    t: float
    u: np.ndarray
    states: np.ndarray = None
    gradients: np.ndarray = None
    volumes: np.ndarray = None
    stress: np.ndarray = None
    tangent: np.ndarray = None
    forces: np.ndarray = None
    residual: float = np.inf
    residuals: list = field(default_factory=list)
    failure: str = ""


class Problem:
    """A body on a mesh, of one material, under conditions.

    Plane strain on meshes of the plane, three dimensions on others. Updated Lagrangian: the nodes move with the material, so that
    the state of a point needs no convection. Elements of degree 1 take the volume change as the mean of the cell (B-bar).

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
    material : granumat.Material
    state : record of dtype STATE, or function of x (points, d)
        Initial state; a function returns records (points).
    conditions : sequence of Displacement, Tied, Periodic, Pressure, Traction
    degree : 1 or 2
    gravity : sequence (d), optional
        Weight of the solid per volume of the solid, in units of stress per length.
    rate_term : float, optional
        alpha: the stress alpha p S, S the rate of deviatoric strain per unit of pseudo-time, is added to the material's. It
        regularises what the law leaves ill-posed, at an error of alpha p times the shear rate.
    facet_tags : dolfinx.mesh.MeshTags, optional
        What numbers in the conditions' `where` mean.
    tolerances : Tolerances, optional
    solver : dict, optional
        PETSc options of the linear solver, without prefix, such as {"ksp_type": "gmres"}.

    Attributes
    ----------
    t : float
        Pseudo-time, 0 at the start.
    positions : array (nodes, d)
        Of this rank's nodes (ghosts last) at the start.
    displacement : array (nodes, d)
    states : record array (points) of dtype STATE
        Of this rank's own cells, cell by cell.
    shear_strain, volume_strain : array (points)
        Accumulated 2 integral abs(S) ds, and integral of tr D.
    increments : int
        How many were accepted.
    last : Trial or None
        The increment accepted last.
    next_increment : float or None
        The increment of pseudo-time that is to be tried next, where the ones before say so.

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    """

    def __init__(self, mesh, material, state, conditions=(), *, degree=1, gravity=None, rate_term=0.0, facet_tags=None,
                 tolerances=Tolerances(), solver=None):
        d = mesh.geometry.dim
        faults = []
        if d not in (2, 3) or mesh.topology.dim != d:
            faults.append(f"the mesh has cells of dimension {mesh.topology.dim} in {d} dimensions: must be 2 in 2 or 3 in 3")
        if degree not in (1, 2):
            faults.append(f"degree = {degree!r}: must be 1 or 2")
        if not is_number(rate_term) or not 0 <= rate_term < np.inf:
            faults.append(f"rate_term = {rate_term!r}: must be a finite number, at least 0")
        if gravity is not None and (np.shape(gravity) != (d,) or not np.isfinite(gravity).all()):
            faults.append(f"gravity = {gravity!r}: must be {d} finite numbers")
        if material.method != "exact":
            faults.append(f"the material's method is {material.method!r}: must be 'exact', whose tangent this is")
        kinds = (Displacement, Tied, Periodic, Pressure, Traction)
        faults += [f"condition {number}: {condition!r} is none of {', '.join(kind.__name__ for kind in kinds)}"
                   for number, condition in enumerate(conditions) if not isinstance(condition, kinds)]
        refuse("the problem cannot be set up", faults)
        self.mesh, self.material, self.degree, self.conditions = mesh, material, degree, tuple(conditions)
        self.rate_term, self.gravity, self.initial, self.tolerances = rate_term, gravity, state, tolerances
        self.comm, self.d = mesh.comm, d
        self._facet_tags = facet_tags
        self.space = vector_space(mesh, degree)
        self._element = ReferenceCell(mesh, degree)
        self._mean = int(degree == 1)
        self.cells = mesh.topology.index_map(d).size_local
        self._all_nodes = cell_nodes(self.space)
        self._nodes = self._all_nodes[:self.cells]
        self.positions = np.ascontiguousarray(self.space.tabulate_dof_coordinates()[:, :d])
        self._size = self._largest(self.positions)
        self._numbering = Numbering(self.space, self.positions, self._size, self.nodes_at, self.conditions)
        cell_labels = self._numbering.labels[self._nodes].reshape(self.cells, -1)
        owned = self.space.dofmap.index_map.size_local * d
        self.system = System(self.comm, owned, d, cell_labels, self._numbering.labels, solver or {})
        self._given = self._numbering.labels == GIVEN
        self._turned_cells = np.flatnonzero(self._numbering.turned[self._nodes].any(axis=1))

        self.t, self.increments, self.last, self._last_duration, self.next_increment = 0.0, 0, None, None, None
        self.displacement = np.zeros_like(self.positions)
        points = self.cells * len(self._element.weights)
        self.states = np.empty(points, STATE).view(np.recarray)
        self.states[:] = state(self.point_positions()) if callable(state) else state
        self.shear_strain, self.volume_strain = np.zeros(points), np.zeros(points)
        self._loads = self._dead_loads(gravity)
        self._pressures = [(condition, self._facets(condition.where)) for condition in self.conditions
                           if isinstance(condition, Pressure)]

    # ---- the mesh --------------------------------------------------------------------------------------------------

    def nodes_at(self, where):
        """Local numbers of this rank's nodes, ghosts included, on a part of the boundary."""
        fdim = self.d - 1
        return np.asarray(fem.locate_dofs_topological(self.space, fdim, self._facets_at(where)), np.int32)

    def _facets_at(self, where):
        fdim = self.d - 1
        self.mesh.topology.create_connectivity(fdim, self.d)
        if callable(where):
            return dolfinx.mesh.locate_entities_boundary(self.mesh, fdim, where)
        if self._facet_tags is None:
            raise ValueError(f"a condition's where is {where!r}, but the problem was given no facet_tags")
        return np.unique(self._facet_tags.indices[np.isin(self._facet_tags.values, where)])

    def _facets(self, where):
        """(cells, local facets) on a part of the boundary, of this rank's own cells."""
        self.mesh.topology.create_connectivity(self.d - 1, self.d)
        self.mesh.topology.create_connectivity(self.d, self.d - 1)
        to_cell = self.mesh.topology.connectivity(self.d - 1, self.d)
        to_facet = self.mesh.topology.connectivity(self.d, self.d - 1)
        pairs = [(to_cell.links(facet)[0], facet) for facet in self._facets_at(where)]
        pairs = [(cell, np.flatnonzero(to_facet.links(cell) == facet)[0]) for cell, facet in pairs if cell < self.cells]
        return np.array(pairs, np.int32).reshape(-1, 2)

    def point_positions(self, at_start=False):
        """Positions (points, d) of the integration points now, or where they were at the start."""
        x = self._at_cells(self.positions if at_start else self.positions + self.displacement)
        return np.einsum("qa,cai->cqi", self._element.values, x).reshape(-1, self.d)

    def point_volumes(self):
        """Volumes (points) of the integration points now (areas in plane strain)."""
        x = self._at_cells(self.positions + self.displacement)
        return self._kinematics(x, np.zeros_like(x))[1].ravel()

    def _at_cells(self, nodal):
        return nodal[self._nodes]

    # ---- loads -----------------------------------------------------------------------------------------------------

    def _dead_loads(self, gravity):
        """Function of t: nodal forces (cells, nodes per cell, d) that do not follow the body."""
        weight = np.zeros((self.cells, self._nodes.shape[1], self.d))
        if gravity is not None:
            solid = (self.states.volume_fraction * self.point_volumes()).reshape(self.cells, -1)
            weight += np.einsum("cq,qa,i->cai", solid, self._element.values, np.asarray(gravity, float))
        tractions = []
        x = self._at_cells(self.positions)
        for condition in self.conditions:
            if isinstance(condition, Traction):
                areas = np.zeros(weight.shape[:2])
                for cells, (values, slopes, weights) in self._by_facet(self._facets(condition.where)):
                    area = np.linalg.norm(_normals(np.einsum("psa,cai->cpsi", slopes, x[cells])), axis=-1)
                    areas[cells] += np.einsum("cp,p,pa->ca", area, weights, values)
                tractions.append((areas, condition.value))
        return lambda t: weight + sum(areas[..., None] * np.asarray(value(t) if callable(value) else value, float)
                                      for areas, value in tractions)

    def _by_facet(self, pairs):
        """(cells, table) of each local facet, every cell once."""
        for local, table in enumerate(self._element.facets):
            cells = pairs[pairs[:, 1] == local, 0]
            if len(cells):
                yield cells, table

    def _pressure_loads(self, x, t, stiffness=None):
        """Nodal forces (cells, nodes per cell, d) of the pressures at positions x; stiffness loses their derivative."""
        forces = np.zeros_like(x)
        for condition, pairs in self._pressures:
            pressure = condition.value(t) if callable(condition.value) else condition.value
            for cells, (values, slopes, weights) in self._by_facet(pairs):
                tangents = np.einsum("psa,cai->cpsi", slopes, x[cells])
                normals = _normals(tangents)
                facet = np.einsum("qa,cai->ci", values, x[cells]) / len(weights)
                outward = np.sign(np.einsum("cpi,ci->c", normals, facet - x[cells].mean(axis=1)))
                factor = -pressure * outward[:, None] * weights
                forces[cells] += np.einsum("cp,pa,cpi->cai", factor, values, normals, optimize=True)
                if stiffness is not None:
                    by_tangent = _normal_slopes(tangents)                          # (c, p, s, i, j)
                    part = np.einsum("cp,pa,cpsij,psb->caibj", factor, values, by_tangent, slopes, optimize=True)
                    stiffness[cells] -= part.reshape(len(cells), *stiffness.shape[1:])
        return forces

    # ---- one increment ---------------------------------------------------------------------------------------------

    def solve_increment(self, duration):
        """Tries to bring the problem to t + duration.

        Returns
        -------
        Trial
            With an empty `failure` if the increment is solved, for `accept`.
        """
        t = self.t + duration
        target = self._numbering.given(t) - self._numbering.to_axes(self.displacement)
        trial = self._evaluate(self._guess(target, duration), duration, True)
        if trial.failure:
            trial = self._evaluate(np.zeros_like(self.displacement), duration, True)
        residuals = trial.residuals = [trial.residual]
        if trial.residual <= SURE * self.tolerances.force and self._largest(self._missing(target, trial)) <= ROUND_OFF * self._size:
            return trial
        for _ in range(self.tolerances.iterations):
            if trial.failure:
                return trial
            missing = self._missing(target, trial)
            correction = self._correction(trial, missing, duration)
            if correction is None:
                trial.failure = "the linear solver does not converge"
                return trial
            settled = self.tolerances.correction * self._largest(trial.u + correction) + ROUND_OFF * self._size
            last = trial.residual <= self.tolerances.force or self._largest(correction) <= settled
            trial, part = self._search(trial, correction, missing, duration, not last)
            residuals.append(trial.residual)
            trial.residuals = residuals
            if last and part == 1 and not trial.failure and trial.residual <= self.tolerances.force:
                return trial
        trial.failure = (f"Newton's iteration does not converge: relative residual {trial.residual:.1e} "
                         f"after {self.tolerances.iterations} iterations")
        return trial

    def accept(self, trial):
        """Takes a solved trial as the new state of the problem."""
        if trial.failure:
            raise ValueError(f"the trial was not solved: {trial.failure}")
        self._last_duration, trial.tangent = trial.t - self.t, None
        self.t, self.increments, self.last = trial.t, self.increments + 1, trial
        self.displacement = self.displacement + trial.u
        self.states = trial.states
        strain = tensors.symmetric(trial.gradients)
        self.shear_strain = self.shear_strain + 2 * tensors.magnitude(tensors.deviator(strain))
        self.volume_strain = self.volume_strain + tensors.trace(strain)

    def _guess(self, target, duration):
        """The last increment again, scaled as the given displacements are; at a reversal of all of them it is reversed."""
        if self.last is None:
            return np.zeros_like(self.displacement)
        before = np.where(self._given, self._numbering.to_axes(self.last.u), 0)
        owned = self.space.dofmap.index_map.size_local
        product, square = self.comm.allreduce(np.array([(target * before)[:owned].sum(), (before**2)[:owned].sum()]))
        return self.last.u * (product / square if square > 0 else duration / self._last_duration)

    def _missing(self, target, trial):
        """What the trial's displacements (nodes, d) along the nodes' axes lack of the given ones."""
        return np.where(self._given, target - self._numbering.to_axes(trial.u), 0)

    def _kinematics(self, x, u):
        return core.element_gradients(self._mean, self._element.gradients, self._element.weights, x, u)

    def _evaluate(self, u, duration, with_tangent=False):
        """The trial of displacements u (nodes, d): states, forces, residual, the tangent if a correction is expected to need it
        (together they cost less than one after the other); or why it cannot be."""
        trial = Trial(self.t + duration, u)
        x, du = self._at_cells(self.positions + self.displacement), self._at_cells(u)
        gradients, trial.volumes, status = self._kinematics(x, du)
        failed = []
        if status.any():
            first = int(np.flatnonzero(status)[0])
            failed = [f"{ELEMENT_FAILURES[status[first]]} in the cell at {in_words(x[first].mean(axis=0))}"]
        trial.gradients = gradients.reshape(-1, 3, 3)
        if not failed:
            try:
                if with_tangent:
                    trial.states, trial.tangent = self._update_with_tangent(trial.gradients)
                else:
                    trial.states = self.material.update(self.states, trial.gradients)
            except MaterialError as error:
                trial.states = error.states
                first = int(np.flatnonzero(error.status)[0])
                failed = [f"{status_message(error.status[first])} at {in_words(self.point_positions()[first])}"]
        failures = [reason for part in self.comm.allgather(failed) for reason in part]
        if failures:
            trial.failure = failures[0]
            return trial
        trial.stress = self._stress(trial.states.stress, trial.gradients, duration).reshape(*trial.volumes.shape, 6)
        inside = core.element_forces(self._mean, self._element.gradients, x + du, trial.volumes, trial.stress)
        trial.forces = inside - self._loads(trial.t) - self._pressure_loads(x + du, trial.t)
        scale = np.sqrt(self.comm.allreduce((inside**2).sum()))
        trial.residual = self.system.norm(self._forces_along_axes(trial.forces)) / max(scale, REST * self._size**(self.d - 1))
        return trial

    def _stress(self, stress, gradients, duration):
        """The material's stress and that of the rate term."""
        if self.rate_term == 0:
            return np.ascontiguousarray(stress)
        shear = tensors.deviator(tensors.symmetric(gradients))
        return stress - self.rate_term / duration * tensors.trace(stress)[:, None] / 3 * shear

    def _update_with_tangent(self, gradients):
        """The states and the material's tangent by (strain, spin), (points, 6, 9), or (points, 4, 4) in plane strain."""
        return self.material.update_with_tangent(self.states, gradients, spin=True, plane=self.d == 2)

    def _tangent(self, trial, duration):
        """d stress / d (strain, spin), which the trial then no longer has."""
        tangent = self._update_with_tangent(trial.gradients)[1] if trial.tangent is None else trial.tangent
        trial.tangent = None
        strain = np.eye(6, 9) * [1, 1, 1, 0.5, 0.5, 0.5, 0, 0, 0]
        if self.d == 2:
            strain = strain[:4, [0, 1, 3, 6]]
        loose = tensors.trace(trial.states.stress) > -LOOSE
        tangent[loose] += LOOSE * strain
        if self.rate_term > 0:
            factor = self.rate_term / duration
            pressure = -tensors.trace(trial.states.stress) / 3
            shear = tensors.deviator(tensors.symmetric(trial.gradients))
            slope = -tangent[:, :3].sum(axis=1) / 3
            rows = len(strain)
            by_strain = strain - np.outer(tensors.IDENTITY[:rows], strain[:3].sum(axis=0)) / 3
            tangent += factor * pressure[:, None, None] * by_strain
            tangent += factor * shear[:, :rows, None] * slope[:, None, :]
        return tangent

    def _stiffness(self, trial, duration):
        """Element matrices (cells, n, n) along the nodes' axes, in the system's array."""
        x = self._at_cells(self.positions + self.displacement + trial.u)
        points = trial.volumes.shape
        stiffness = self.system.matrices
        core.element_stiffness(
            self._mean, self._element.gradients, x, trial.volumes, trial.gradients.reshape(*points, 3, 3), trial.stress,
            self._tangent(trial, duration).reshape(*points, 2 * self.d, -1), stiffness)
        self._pressure_loads(x, trial.t, stiffness)
        turned = self._turned_cells
        if len(turned):
            axes = self._numbering.axes[self._nodes[turned]]
            blocks = stiffness[turned].reshape(len(turned), -1, self.d, axes.shape[1], self.d)
            blocks = np.einsum("caik,caibj,cbjl->cakbl", axes, blocks, axes, optimize=True)
            stiffness[turned] = blocks.reshape(len(turned), *stiffness.shape[1:])
        return stiffness

    def _forces_along_axes(self, forces):
        turned = self._turned_cells
        if len(turned):
            forces = forces.copy()
            forces[turned] = np.einsum("caij,cai->caj", self._numbering.axes[self._nodes[turned]], forces[turned])
        return forces.reshape(self.cells, -1)

    def _correction(self, trial, missing, duration):
        """Newton's correction (nodes, d) along x y (z); the given components make up for what is missing."""
        stiffness = self._stiffness(trial, duration)
        forces = self._forces_along_axes(trial.forces)
        if missing.any():
            forces = forces + np.einsum("crk,ck->cr", stiffness, missing[self._nodes].reshape(self.cells, -1))
        solution = self.system.solve(-forces)
        return None if solution is None else self._numbering.from_axes(solution + missing)

    def _search(self, trial, correction, missing, duration, with_tangent):
        """The whole correction or, where it fails or does not lower the residual, a part of it; the tangent with the whole one."""
        comparable = self._largest(missing) <= ROUND_OFF * self._largest(correction)
        part, best = 1.0, None
        while part >= LARGEST_CUT:
            candidate = self._evaluate(trial.u + part * correction, duration, with_tangent and part == 1)
            if not candidate.failure and (not comparable or candidate.residual <= (1 - SUFFICIENT * part) * trial.residual
                                          or candidate.residual <= self.tolerances.force):
                return candidate, part
            if best is None or candidate.residual < best[0].residual:
                best = candidate, part
            part /= 2
        return best

    def _largest(self, nodal):
        return self.comm.allreduce(np.abs(nodal).max(initial=0.0), MPI.MAX)

    # ---- what acts on it -------------------------------------------------------------------------------------------

    def reaction(self, where, center=None):
        """Force (d) that holds a part of the boundary, beyond the loads given on it, and its moment about a center.

        In plane strain per length along z; the moment is a number there, a vector (3) in three dimensions. Where parts meet,
        the force on a common node counts for each of them.
        """
        if self.last is None:
            raise ValueError("there is no reaction before the first increment")
        held = np.zeros(len(self.positions), bool)
        held[self.nodes_at(where)] = True
        chosen = held[self._nodes]
        forces = self.last.forces[chosen]
        x = self._at_cells(self.positions + self.displacement)[chosen] - (0 if center is None else np.asarray(center, float))
        moments = x[:, 0] * forces[:, 1] - x[:, 1] * forces[:, 0] if self.d == 2 else np.cross(x, forces)
        return self.comm.allreduce(forces.sum(axis=0)), self.comm.allreduce(moments.sum(axis=0))


def _normals(tangents):
    """Normals times area (..., d) of facets' tangents (..., d - 1, d)."""
    if tangents.shape[-1] == 2:
        return np.stack([tangents[..., 0, 1], -tangents[..., 0, 0]], axis=-1)
    return np.cross(tangents[..., 0, :], tangents[..., 1, :])


def _normal_slopes(tangents):
    """Derivatives (..., d - 1, d, d) of the normals' components by those of each tangent."""
    d = tangents.shape[-1]
    unit = np.eye(d)
    slopes = np.zeros((*tangents.shape, d))
    for j in range(d):
        for s in range(d - 1):
            if d == 2:
                slopes[..., s, :, j] = [unit[j, 1], -unit[j, 0]]
            elif s == 0:
                slopes[..., s, :, j] = np.cross(unit[j], tangents[..., 1, :])
            else:
                slopes[..., s, :, j] = np.cross(tangents[..., 0, :], unit[j])
    return slopes
