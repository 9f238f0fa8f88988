"""A quasi-static boundary-value problem: Newton's method for one increment at a time, which is accepted or not."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from types import NoneType
from typing import Any

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from .. import tensors
from ..checks import attempt, check_type, is_number, real_array, refuse
from ..core import STATE, STATE_NUMBERS, numbers, status_message
from ..errors import MaterialError
from ..material import Material
from ._compat import FacetTags
from .body import ELEMENT_FAILURES, Body
from .cellwise import together
from .conditions import Displacement, Inflow, NonlocalStrain, Outflow, Periodic, Pressure, Tied, Traction, Where
from .errors import format_position
from .loads import Loads
from .motion import Motion, MovingMesh, motion_faults
from .nonlocal_field import NonlocalField
from .numbering import Numbering
from .system import System
from .trial import Snapshot, Trial

SHORTEST_STEP = 1 / 16              # fraction of Newton's correction at which the line search ends
SUFFICIENT_DECREASE = 1e-4          # fraction of the residual that a full step must take off it, a shorter one in proportion
LEAST_NONLOCAL_SHARE = 0.1          # of m that a step leaves: m is positive, and falls by orders of magnitude beside zones of shear
NONLOCAL_SLACK = 0.1                # residual up to which a step may lead that decreases that of the forces only
PREDICTOR_TOLERANCE = 1e-3          # of tolerances.force: a first guess with a residual below needs no correction
DISPLACEMENT_ROUND_OFF = 1e-12      # over the size of what displacements are added to, or corrections
STRESS_FLOOR = 1e-5                 # in k/d: residuals are relative to at least this stress times size^(d - 1)
KINDS = (Displacement, Tied, Periodic, Pressure, Traction, NonlocalStrain, Inflow, Outflow)
STOPPED = "it was given up"
NONLOCAL_ROUND_OFF = 1e-12          # of m, a strain
UNJAMMED_STIFFNESS = 1e-6           # in k/d: where -tr(stress) is less, it is added to the tangent alone, against singular matrices


@dataclass(frozen=True)
class Tolerances:
    """When an increment counts as solved: the residual is small, and so is the last correction or the residual before it.

    The second way is for bodies whose layers shear steadily: there the increment is not unique, and corrections stay large.

    Attributes
    ----------
    force : float
        Norm of the residual forces, relative to that of all cells' internal forces; with a length also of the equations of m.
    correction : float
        Largest displacement of the last correction, relative to the largest one of the increment; with a length also of m.
    iterations : int
        Largest number of Newton iterations.
    """

    force: float = 1e-8
    correction: float = 1e-5
    iterations: int = 15


class Problem:
    """A body on a mesh, of one material, under conditions.

    Plane strain on meshes of the plane, three dimensions on others. Updated Lagrangian: within an increment the nodes move with the
    material. With motion = "lagrangian" they stay with it, so that the state of a point needs no convection; else they go their own
    way after each accepted increment, and the state is convected to where the points are then. Elements of degree 1 take the volume
    change as the mean of the cell (B-bar).

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
    material : granumat.Material
    state : record of dtype STATE, or function of x (points, d)
        Initial state; a function returns records (points).
    conditions : sequence of Displacement, Tied, Periodic, Pressure, Traction, NonlocalStrain, Inflow, Outflow
    degree : 1 or 2
    gravity : sequence (d), optional
        Weight of the solid per volume of the solid, in units of stress per length.
    rate_term : float, optional
        alpha: the stress alpha p S, S the rate of deviatoric strain per unit of pseudo-time, is added to the material's. It
        regularises what the law leaves ill-posed, at an error of alpha p times the shear rate.
    length : float, optional
        l, in the units of the mesh: the nonlocal strain m, with m - l^2 div grad m = abs(D), is solved for beside the
        displacements, and takes the place of abs(D) in the material's update. Bodies then shear in zones some l wide, whatever the
        cells. 0: no length.
    motion : "lagrangian", "fixed", "boundary", or function, optional
        How the mesh moves: with the material; not at all; with the normal motion of the material on its boundary, the inside by
        Laplace's equation; or as a function says, of the nodes' positions (nodes, d), of where the material has taken them
        (nodes, d), and of the pseudo-time, which returns where they go. All but the first need quadrilaterals or hexahedra of
        degree 1.
    origin : bool, optional
        Whether it is kept where the material has come from. Where the mesh does not follow it, the convection costs twice as much.
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
        Of the mesh since the start.
    moving_mesh : MovingMesh or None
        How the mesh goes its own way; None where it stays with the material.
    is_ahead : bool
        Whether the material has taken the mesh with it in the last increment, and the mesh has still to go its own way, as it does
        when the next increment begins.
    states : record array (points) of dtype STATE
        Of this rank's own cells, cell by cell.
    shear_strain, volume_strain : array (points)
        Accumulated 2 integral abs(S) ds, and integral of tr D.
    origin : array (points, d) or None
        Where the material that is at the points now was at the start, or where it has flowed in. What has come across a periodic
        side is thought to come from beyond it. None unless it is asked for.
    increments : int
        How many were accepted.
    last : Trial or None
        The increment accepted last.
    next_increment : float or None
        Largest increment of pseudo-time that `run` tries next, from how easily those before were solved; None: no limit.
    mesh, space, comm, d, cells
        Those of the body.
    body : Body
        Mesh, elements, parts of the boundary.
    numbering : Numbering
        Which equation each displacement component belongs to.
    nonlocal_field : NonlocalField or None
        What the nonlocal strain obeys; None without a length.
    loads : Loads
    system : System
        The linear equations; system.size is the number of unknowns of all ranks.

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    TypeError
        An argument is of another type.
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh, material: Material, state: np.void | Callable, conditions: Sequence[object] = (), *,
                 degree: int = 1, gravity: Sequence[float] | None = None, rate_term: float = 0.0, length: float = 0.0,
                 motion: Motion = "lagrangian", origin: bool = False, facet_tags: FacetTags | None = None,
                 tolerances: Tolerances = Tolerances(), solver: dict[str, object] | None = None) -> None:
        check_type("mesh", mesh, dolfinx.mesh.Mesh, "a dolfinx.mesh.Mesh")
        check_type("material", material, Material, "a Material")
        check_type("origin", origin, bool, "True or False")
        check_type("tolerances", tolerances, Tolerances, "a Tolerances")
        check_type("solver", solver, (dict, NoneType), "a dict of PETSc options")
        refuse("the problem cannot be set up", _faults(mesh, material, conditions, degree, gravity, rate_term, length, motion))
        self.material, self.degree, self.conditions = material, degree, tuple(conditions)
        self.rate_term, self.gravity, self.initial, self.tolerances = rate_term, gravity, state, tolerances
        self.length, self.motion = length, motion
        self.body = Body(mesh, degree, facet_tags)
        self.mesh, self.space, self.comm, self.d = mesh, self.body.space, self.body.comm, self.body.d
        self.cells, self.positions = self.body.cells, self.body.positions
        self.numbering = Numbering(self.body, self.conditions, length > 0)
        unknowns = self.numbering.labels.shape[1]
        self.system = System(self.comm, self.body.owned_nodes * unknowns, self.d, self.numbering.cell_labels,
                             self.numbering.labels, solver or {})
        self.nonlocal_field = NonlocalField(self.body, length, self.numbering) if length > 0 else None
        fault = material.length_fault(self.d) if length > 0 else None
        if fault:
            warnings.warn(fault, stacklevel=2)

        self.moving_mesh = None if motion == "lagrangian" else MovingMesh(motion, self.body, self.conditions, self.numbering,
                                                                          material["kappa"])
        self.is_ahead = False
        self.t, self.increments = 0.0, 0
        self.last: Trial | None = None
        self.next_increment: float | None = None
        self.displacement = np.zeros_like(self.positions)
        points = self.cells * len(self.body.element.weights)
        self.states: np.ndarray = np.empty(points, STATE).view(np.recarray)
        self.states[:] = together(self.comm, self._initial_states)
        self.shear_strain, self.volume_strain = np.zeros(points), np.zeros(points)
        self.origin = self.point_positions() if origin else None
        self.loads = Loads(self.body, self.conditions, gravity, self.states["volume_fraction"] * self.point_volumes())

    def _initial_states(self) -> Any:
        x = self.point_positions()
        states = self.initial(x) if callable(self.initial) else self.initial
        self.material.check_start(states)
        if callable(self.initial) and np.shape(states) != (len(x),):
            raise ValueError(f"the initial state returns shape {np.shape(states)} for {len(x)} points: must be {(len(x),)}")
        return states

    # ---- where it is -----------------------------------------------------------------------------------------------

    def nodes_at(self, where: Where) -> np.ndarray:
        """Local numbers of this rank's nodes, ghosts included, on a part of the boundary; collective."""
        return self.body.nodes_at(where)

    def point_positions(self, at_start: bool = False) -> np.ndarray:
        """Positions (points, d) of the integration points now, or where they were at the start."""
        return self.body.point_positions(self.body.at_cells(self.positions) if at_start else self._cell_positions())

    def point_volumes(self) -> np.ndarray:
        """Volumes (points) of the integration points now (areas in plane strain)."""
        x = self._cell_positions()
        return self.body.kinematics(x, np.zeros_like(x))[1].ravel()

    def unjammed_share(self) -> float:
        """The part of the body's volume where p = 0; collective."""
        volumes = self.point_volumes()
        unjammed = tensors.trace(self.states["stress"]) >= 0
        part, whole = self.comm.allreduce(np.array([volumes[unjammed].sum(), volumes.sum()]))
        return part / whole

    def _cell_positions(self) -> np.ndarray:
        """Positions (cells, nodes per cell, d) of the cells' nodes now."""
        return self.body.at_cells(self.positions + self.displacement)

    def _target(self, t: float, duration: float, u: np.ndarray | float = 0.0) -> np.ndarray:
        """Unknowns (nodes, unknowns) along the nodes' axes that conditions prescribe for an increment that ends at t.

        Where the mesh does not follow the material, these become the axes in the middle of displacements u (nodes, d): what slips
        along a curved wall moves along a chord.
        """
        if self.moving_mesh is None:
            return self.numbering.prescribed(t, duration) - self._in_axes(self.displacement)
        x = self.positions + self.displacement
        self.numbering.move_axes(x + u / 2)
        return self.numbering.prescribed_motion(self.t, t, x)

    def lag_of_prescribed(self) -> tuple[float, np.ndarray]:
        """How far the displacements are from those prescribed now at most, and the position at the start where; collective."""
        if self.moving_mesh is None or self.last is None:
            lag = self._target(self.t, 0.0)
        else:                                                    # of the last increment
            start = self.positions + self.displacement - (self.last.u if self.is_ahead else 0)
            lag = (self.numbering.prescribed_motion(self.last.t - self.last.duration, self.t, start)
                   - self._in_axes(self.last.u)) * ~self.numbering.has_placed_axes[:, None]
        lag = abs(lag)
        lag = np.where(self.numbering.is_prescribed, lag, 0).max(axis=1, initial=0.0)
        node = int(np.argmax(lag)) if len(lag) else None
        own = (0.0, []) if node is None else (float(lag[node]), self.positions[node].tolist())
        largest, position = max(self.comm.allgather(own))
        return largest, np.array(position)

    def snapshot(self) -> Snapshot:
        """What the problem has come to, for `restore`."""
        return Snapshot(**{entry.name: getattr(self, entry.name) for entry in fields(Snapshot)})

    def restore(self, snapshot: Snapshot) -> None:
        """Brings the problem to where it, or another problem set up in the same way, was at a snapshot."""
        for entry in fields(Snapshot):
            setattr(self, entry.name, getattr(snapshot, entry.name))
        if self.moving_mesh is not None and self.last is not None:
            x = self.positions + self.displacement
            self.numbering.move_axes(x - self.last.u if self.is_ahead else x)
            self.loads.weigh(self.states["volume_fraction"] * self.point_volumes())

    # ---- one increment ---------------------------------------------------------------------------------------------

    def solve_increment(self, duration: float, stop: Callable[[], object] = lambda: False) -> Trial:
        """Tries to bring the problem to t + duration.

        Parameters
        ----------
        duration : float
        stop : function, optional
            Whether the increment shall be given up; called in each iteration on all ranks, of which one may want it.

        Returns
        -------
        Trial
            For `accept` if its `failure` is empty.
        """
        self.move_mesh()
        residuals: list[float] = []
        trial = self._newton(duration, residuals, stop)
        if self.nonlocal_field is not None and self.last is not None and trial.failure not in ("", STOPPED):
            trial = self._newton(duration, residuals, stop, from_rest=True)
        if self.moving_mesh is not None and not trial.failure:
            x = self.positions + self.displacement
            trial = replace(trial, failure=self.moving_mesh.fault(x + trial.u, self.moving_mesh.target(x, x + trial.u, trial.t)))
        return replace(trial, residuals=tuple(residuals))

    def move_mesh(self) -> None:
        """Lets the mesh go its own way after the last increment, and convects the state; the next increment begins so."""
        if not self.is_ahead:
            return
        assert self.moving_mesh is not None and self.last is not None
        material = self.positions + self.displacement
        new = self.moving_mesh.target(material - self.last.u, material, self.t)
        convection = self.moving_mesh.convection
        if self.origin is not None:
            self.origin = convection.convect_positions(self.origin, self.states["volume_fraction"], material, new)
        values = np.column_stack([numbers(self.states), self.shear_strain, self.volume_strain])
        values = convection.convect(values, material, new)
        self.states = np.ascontiguousarray(values[:, :STATE_NUMBERS]).view(STATE).reshape(-1).view(np.recarray)
        self.shear_strain, self.volume_strain = values[:, STATE_NUMBERS:].T.copy()
        self.displacement, self.is_ahead = new - self.positions, False
        self.numbering.move_axes(new)
        self.loads.weigh(self.states["volume_fraction"] * self.point_volumes())

    def accept(self, trial: Trial, t: float | None = None) -> None:
        """Makes a solved trial the state of the problem.

        Parameters
        ----------
        trial : Trial
        t : float, optional
            Pseudo-time at its end where trial.t has it with a round-off.

        Raises
        ------
        ValueError
            The trial was not solved.
        """
        if trial.failure:
            raise ValueError(f"the trial was not solved: {trial.failure}")
        self.t, self.increments, self.last = trial.t if t is None else t, self.increments + 1, trial
        self.displacement = self.displacement + trial.u
        self.states, self.is_ahead = trial.states, self.moving_mesh is not None
        strain = tensors.symmetric(trial.gradients)
        self.shear_strain = self.shear_strain + 2 * tensors.magnitude(tensors.deviator(strain))
        self.volume_strain = self.volume_strain + tensors.trace(strain)

    def _newton(self, duration: float, residuals: list[float], stop: Callable[[], object], from_rest: bool = False) -> Trial:
        """Newton's method with a line search; appends the residual of the first guess and of every iteration to residuals.

        From rest the first guess is no displacement. It takes more iterations, but m is then that of the displacements found first,
        and not that of the last increment, which misleads where the body shears elsewhere than before, as after a reversal.
        """
        target = self._target(self.t + duration, duration)
        if self.moving_mesh is not None:
            target = self._target(self.t + duration, duration, self._predictor(target, duration)[:, :self.d])
        guess = np.zeros(self.numbering.labels.shape) if from_rest else self._predictor(target, duration)
        trial, tangent = self.evaluate(guess, duration, with_tangent=True)
        if trial.failure:
            trial, tangent = self.evaluate(np.zeros(self.numbering.labels.shape), duration, with_tangent=True)
        residuals.append(trial.residual)
        if (trial.residual <= PREDICTOR_TOLERANCE * self.tolerances.force
                and self.body.largest(self._prescribed_correction(target, trial)) <= self._round_off):
            return trial
        for _ in range(self.tolerances.iterations):
            if trial.failure:
                return trial
            if self.comm.allreduce(bool(stop()), MPI.LOR):
                return replace(trial, failure=STOPPED)
            if self.moving_mesh is not None:
                target = self._target(self.t + duration, duration, trial.u)
            prescribed = self._prescribed_correction(target, trial)
            stiffness = self.stiffness(trial, tangent)
            tangent = None                                       # its memory is needed by the linear solver
            correction = self._correction(trial, stiffness, prescribed)
            if correction is None:
                return replace(trial, failure="the linear solver does not converge")
            expect_last = trial.residual <= self.tolerances.force or self._is_small(correction, trial)
            trial, tangent, step = self._line_search(trial, correction, prescribed, with_tangent=not expect_last)
            residuals.append(trial.residual)
            if expect_last and step == 1 and not trial.failure and trial.residual <= self.tolerances.force:
                return trial
        return replace(trial, failure=f"Newton's iteration does not converge: relative residual {trial.residual:.1e} "
                                      f"after {self.tolerances.iterations} iterations")

    def _predictor(self, target: np.ndarray, duration: float) -> np.ndarray:
        """First guess (nodes, unknowns): the last increment, scaled as the prescribed displacements are by least squares.

        The factor is negative where all of them reverse, but m keeps its sign. Without prescribed displacements it is the ratio of
        the durations.
        """
        if self.last is None:
            return np.zeros(self.numbering.labels.shape)
        before = np.where(self.numbering.is_prescribed, self.numbering.to_axes(self.last.unknowns), 0)[:, :self.d]
        target, owned = target[:, :self.d], self.body.owned_nodes
        product, square = self.comm.allreduce(np.array([(target * before)[:owned].sum(), (before**2)[:owned].sum()]))
        guess = self.last.unknowns * (product / square if square > 0 else duration / self.last.duration)
        guess[:, self.d:] = abs(guess[:, self.d:])
        return guess

    @property
    def _round_off(self) -> float:
        """Of displacements."""
        return DISPLACEMENT_ROUND_OFF * self.body.size

    def _in_axes(self, displacement: np.ndarray) -> np.ndarray:
        """A displacement (nodes, d) along the nodes' axes, with as many columns as a node has unknowns."""
        unknowns = self.numbering.labels.shape[1]
        return self.numbering.to_axes(np.pad(displacement, ((0, 0), (0, unknowns - self.d))))

    def _prescribed_correction(self, target: np.ndarray, trial: Trial) -> np.ndarray:
        """What a trial's unknowns lack of the prescribed ones (nodes, unknowns), along the nodes' axes, 0 where free."""
        return np.where(self.numbering.is_prescribed, target - self.numbering.to_axes(trial.unknowns), 0)

    def _is_small(self, correction: np.ndarray, trial: Trial) -> bool:
        """Whether a correction (nodes, unknowns) of a trial is within the tolerance; collective."""
        def is_small(change: np.ndarray, before: np.ndarray, round_off: float) -> bool:
            return self.body.largest(change) <= self.tolerances.correction * self.body.largest(before + change) + round_off

        return is_small(correction[:, :self.d], trial.u, self._round_off) and (
            self.nonlocal_field is None or is_small(correction[:, self.d], trial.m, NONLOCAL_ROUND_OFF))

    def _correction(self, trial: Trial, stiffness: np.ndarray, prescribed: np.ndarray) -> np.ndarray | None:
        """Newton's correction (nodes, unknowns) along x y (z), with its prescribed part; None if the linear solver fails."""
        forces = self._rows(trial.forces)
        if self.nonlocal_field is not None:
            forces = self._rows(trial.forces, self.nonlocal_field.scale(trial.m, self.states["stress"]) * trial.nonlocal_residuals)
        if prescribed.any():
            forces = forces + np.einsum("crk,ck->cr", stiffness, self.body.at_cells(prescribed).reshape(self.cells, -1))
        solution = self.system.solve(-forces)
        if solution is None:
            return None
        correction = self.numbering.from_axes(solution + prescribed)
        if self.nonlocal_field is not None and self.body.largest(trial.m) == 0:         # from rest, where m has no derivative
            u = trial.u + correction[:, :self.d]
            gradients = self.body.kinematics(self._cell_positions(), self.body.at_cells(u))[0].reshape(-1, 3, 3)
            correction[:, self.d] = self.nonlocal_field.solve(self.displacement, gradients, prescribed[:, self.d])
        return correction

    def _rows(self, forces: np.ndarray, of_m: np.ndarray | float = 0.0) -> np.ndarray:
        """Cells' forces (cells, nodes per cell, d), and what belongs to m (cells, nodes per cell), as rows of their matrices."""
        if self.nonlocal_field is not None:
            forces = np.concatenate([forces, np.broadcast_to(of_m, forces.shape[:2])[..., None]], axis=2)
        return self.numbering.forces_to_axes(forces)

    def _line_search(self, trial: Trial, correction: np.ndarray, prescribed: np.ndarray,
                     with_tangent: bool) -> tuple[Trial, tuple[np.ndarray, ...] | None, float]:
        """The longest of the steps 1, 1/2, ... of a correction that decreases the residual, or the best of them.

        While prescribed displacements change, any step that can be evaluated will do: the residual before belongs to other ones.
        With a length a step will do too that decreases the residual of the forces alone. That of m is then the square of what
        abs(D) changed by, and the next correction takes it away.

        Returns
        -------
        trial : Trial
        tangent : tuple of arrays or None
            The material's, if it was asked for and the full step is taken.
        step : float
        """
        residuals_compare = self.body.largest(prescribed) <= DISPLACEMENT_ROUND_OFF * self.body.largest(correction)
        step, best = 1.0, None
        while step >= SHORTEST_STEP:
            unknowns = trial.unknowns + step * correction
            least = np.where(self.numbering.is_prescribed, 0, LEAST_NONLOCAL_SHARE * trial.unknowns)
            unknowns[:, self.d:] = np.maximum(unknowns, least)[:, self.d:]
            candidate, tangent = self.evaluate(unknowns, trial.duration, with_tangent and step == 1)
            left = 1 - SUFFICIENT_DECREASE * step
            decreases = candidate.residual <= max(left * trial.residual, self.tolerances.force)
            decreases_forces = candidate.residual <= NONLOCAL_SLACK and candidate.force_residual <= left * trial.force_residual
            if not candidate.failure and (not residuals_compare or decreases or decreases_forces):
                return candidate, tangent, step
            if best is None or candidate.residual < best[0].residual:
                best = candidate, tangent, step
            step /= 2
        assert best is not None
        return best

    # ---- residual and stiffness of given displacements -------------------------------------------------------------

    def evaluate(self, unknowns: np.ndarray, duration: float,
                 with_tangent: bool = False) -> tuple[Trial, tuple[np.ndarray, ...] | None]:
        """States, forces and residual of displacements, and with a length of nonlocal strains, in an increment.

        Parameters
        ----------
        unknowns : array (nodes, d), with a length (nodes, d + 1)
        duration : float
            Of the increment, in pseudo-time.
        with_tangent : bool
            Whether the material's tangent is wanted too: state and tangent together cost less than one after the other.

        Returns
        -------
        trial : Trial
            With a failure, the same on all ranks, if the displacements cannot be evaluated on one of them.
        tangent : tuple of arrays, or None
            d stress / d (strain, spin) of the increment, (points, 6, 9), or (points, 4, 4) in plane strain, without the rate term;
            with a length also d stress / d m, (points, 6) or (points, 4). For `stiffness`.
        """
        t = self.t + duration
        u, m = unknowns[:, :self.d], unknowns[:, self.d:].ravel()
        x, du = self._cell_positions(), self.body.at_cells(u)
        gradients, volumes, status = self.body.kinematics(x, du)
        gradients = gradients.reshape(-1, 3, 3)
        if status.any():
            first = int(np.flatnonzero(status)[0])
            failures = [f"{ELEMENT_FAILURES[status[first]]} in the cell at {format_position(x[first].mean(axis=0))}"]
        else:
            states, tangent, failures = self._update(gradients, m, with_tangent)
        failures = [failure for of_rank in self.comm.allgather(failures) for failure in of_rank]
        if failures:
            return Trial(t, duration, u, m, failure=failures[0]), None
        stress = self._stress(states["stress"], gradients, duration).reshape(*volumes.shape, 6)
        internal = self.body.internal_forces(x + du, volumes, stress)
        forces = internal - self.loads.dead(t) - self.loads.pressures(x + du, t)
        scale = max(np.sqrt(self.comm.allreduce((internal**2).sum())), STRESS_FLOOR * self.body.size**(self.d - 1))
        residual = force_residual = self.system.norm(self._rows(forces)) / scale
        nonlocal_residuals = np.empty(0)
        if self.nonlocal_field is not None:
            nonlocal_residuals, scale = self.nonlocal_field.residuals(self.displacement, m, gradients)
            residual = float(np.hypot(residual, self.system.norm(self._rows(np.zeros_like(forces), nonlocal_residuals)) / scale))
        return Trial(t, duration, u, m, states, gradients, volumes, stress, forces, nonlocal_residuals, residual,
                     force_residual), tangent

    def stiffness(self, trial: Trial, tangent: tuple[np.ndarray, ...] | None = None) -> np.ndarray:
        """Derivatives of a trial's forces, and with a length of the scaled equations of m, by its unknowns, along the nodes' axes.

        Parameters
        ----------
        trial : Trial
        tangent : tuple of arrays, optional
            The one that `evaluate` gave with the trial; it is overwritten. Without it the material is evaluated once more.

        Returns
        -------
        array (cells, n, n)
            n = nodes per cell times their unknowns; the system's own array, which the next call overwrites.
        """
        if tangent is None:
            tangent = self._update_with_tangent(trial.gradients, trial.m)[1]
        by_gradient, *by_nonlocal = tangent
        self._complete_tangent(by_gradient, trial)
        x = self.body.at_cells(self.positions + self.displacement + trial.u)
        points = trial.volumes.shape
        stiffness = self.system.cell_matrices
        self.body.internal_stiffness(x, trial.volumes, trial.gradients.reshape(*points, 3, 3), trial.stress,
                                     by_gradient.reshape(*points, 2 * self.d, -1), stiffness)
        if self.nonlocal_field is not None:
            self._complete_nonlocal_tangent(by_nonlocal[0], trial)
            self.nonlocal_field.add_stiffness(self.displacement, trial.u, trial.volumes, trial.gradients.reshape(*points, 3, 3),
                                              by_nonlocal[0], self.nonlocal_field.scale(trial.m, self.states["stress"]), stiffness)
        self.loads.pressures(x, trial.t, stiffness)
        self.numbering.rotate_stiffness(stiffness)
        return stiffness

    def _update(self, gradients: np.ndarray, m: np.ndarray,
                with_tangent: bool) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None, list[str]]:
        """The states after an increment, their tangent if it is wanted, and what has failed."""
        try:
            if with_tangent:
                return *self._update_with_tangent(gradients, m), []
            return self.material.update(self.states, gradients, nonlocal_strain=self._nonlocal_strain(m)), None, []
        except MaterialError as error:
            first = int(np.flatnonzero(error.status)[0])
            place = format_position(self.point_positions()[first])
            return error.states, None, [f"{status_message(error.status[first])} at {place}"]

    def _update_with_tangent(self, gradients: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """The states and the material's tangent, as in `evaluate`."""
        states, *tangent = self.material.update_with_tangent(self.states, gradients, spin=True, plane=self.d == 2,
                                                             nonlocal_strain=self._nonlocal_strain(m))
        return states, tuple(tangent)

    def _nonlocal_strain(self, m: np.ndarray) -> np.ndarray | None:
        """The nonlocal strain of the points that m (nodes) gives; None without a length."""
        return None if self.nonlocal_field is None else self.nonlocal_field.at_points(m)

    def _stress(self, stress: np.ndarray, gradients: np.ndarray, duration: float) -> np.ndarray:
        """The material's stress (points, 6) and that of the rate term."""
        if self.rate_term == 0:
            return np.ascontiguousarray(stress)
        shear = tensors.deviator(tensors.symmetric(gradients))
        return stress - self.rate_term / duration * tensors.trace(stress)[:, None] / 3 * shear

    def _complete_tangent(self, tangent: np.ndarray, trial: Trial) -> None:
        """Adds the stiffness of points without pressure and the derivative of the rate term to the material's tangent."""
        identity = np.eye(6, 9) * [1, 1, 1, 0.5, 0.5, 0.5, 0, 0, 0]           # d strain / d (engineering strain, spin)
        if self.d == 2:
            identity = identity[:4, [0, 1, 3, 6]]                             # xx yy zz xy by xx yy xy and the spin in the plane
        unjammed = tensors.trace(trial.states["stress"]) > -UNJAMMED_STIFFNESS
        tangent[unjammed] += UNJAMMED_STIFFNESS * identity
        if self.rate_term > 0:
            factor = self.rate_term / trial.duration
            pressure = -tensors.trace(trial.states["stress"]) / 3
            shear = tensors.deviator(tensors.symmetric(trial.gradients))
            pressure_derivative = -tangent[:, :3].sum(axis=1) / 3
            rows = len(identity)
            deviator = identity - np.outer(tensors.IDENTITY[:rows], identity[:3].sum(axis=0)) / 3
            tangent += factor * pressure[:, None, None] * deviator
            tangent += factor * shear[:, :rows, None] * pressure_derivative[:, None, :]

    def _complete_nonlocal_tangent(self, by_nonlocal: np.ndarray, trial: Trial) -> None:
        """Adds the rate term to the material's derivatives by m, which are those of another m, and left out, where m = 0."""
        by_nonlocal[self._nonlocal_strain(trial.m) == 0] = 0
        if self.rate_term > 0:
            shear = tensors.deviator(tensors.symmetric(trial.gradients))[:, :by_nonlocal.shape[1]]
            by_nonlocal -= self.rate_term / trial.duration * by_nonlocal[:, :3].sum(axis=1)[:, None] / 3 * shear

    # ---- what acts on it -------------------------------------------------------------------------------------------

    def reaction(self, where: Where, center: Sequence[float] | None = None) -> tuple[np.ndarray, Any]:
        """Force (d) that holds a part of the boundary, beyond the loads given on it, and its moment about a center; collective.

        In plane strain per length along z; the moment is a number there, a vector (3) in three dimensions. Where parts meet,
        the force on a common node counts for each of them.

        Parameters
        ----------
        where : function or tags
        center : sequence (d), optional
            The origin if not given.

        Raises
        ------
        ValueError
            No increment has been accepted yet.
        """
        if self.last is None:
            raise ValueError("there is no reaction before the first increment")
        held = np.zeros(len(self.positions), bool)
        held[self.nodes_at(where)] = True
        chosen = self.body.at_cells(held)
        forces = self.last.forces[chosen]
        x = self._cell_positions()[chosen] - (0 if center is None else np.asarray(center, float))
        moments = x[:, 0] * forces[:, 1] - x[:, 1] * forces[:, 0] if self.d == 2 else np.cross(x, forces)
        return self.comm.allreduce(forces.sum(axis=0)), self.comm.allreduce(moments.sum(axis=0))


def _faults(mesh: dolfinx.mesh.Mesh, material: Material, conditions: Sequence[object], degree: object, gravity: Any,
            rate_term: object, length: object, motion: object) -> list[str]:
    """What is wrong with the arguments of Problem."""
    d = mesh.geometry.dim
    faults = []
    cells = mesh.comm.allgather(mesh.topology.index_map(mesh.topology.dim).size_local)
    if not all(cells):
        faults.append(f"the mesh has {sum(cells)} cells, and {cells.count(0)} of the {len(cells)} processes got none of them: take "
                      "fewer processes")
    if d not in (2, 3) or mesh.topology.dim != d:
        faults.append(f"the mesh has cells of dimension {mesh.topology.dim} in {d} dimensions: must be 2 in 2 or 3 in 3")
    if degree not in (1, 2):
        faults.append(f"degree = {degree!r}: must be 1 or 2")
    faults += motion_faults(motion, mesh.topology.cell_type.name, degree,
                            any(isinstance(condition, (Inflow, Outflow)) for condition in conditions))
    faults += [f"{name} = {value!r}: must be a finite number, at least 0" for name, value in (("rate_term", rate_term),
               ("length", length)) if not is_number(value) or not 0 <= value < np.inf]
    if gravity is not None and not _are_numbers(gravity, d):
        faults.append(f"gravity = {gravity!r}: must be {d} finite numbers")
    if material.method != "exact":
        faults.append(f"the material's method is {material.method!r}: must be 'exact', whose tangent this is")
    for number, condition in enumerate(conditions):
        if isinstance(condition, NonlocalStrain) and length == 0:
            faults.append(f"condition {number} (NonlocalStrain): the problem has no length")
        if isinstance(condition, KINDS):
            name = f"condition {number} ({type(condition).__name__})"
            faults += [f"{name}: {fault}" for fault in _condition_faults(condition, d)]
            if isinstance(condition, Inflow) and not callable(condition.state):
                attempt(faults, f"{name}: state: ", material.check_start, condition.state)
        else:
            faults.append(f"condition {number}: {condition!r} is none of {', '.join(kind.__name__ for kind in KINDS)}")
    return faults


def _condition_faults(condition: Any, d: int) -> list[str]:
    """What is wrong with a condition on a body in d dimensions, apart from what functions return."""
    faults = []
    where = condition.where
    if not callable(where) and not _are_integers(where):
        faults.append(f"where = {where!r}: must be a function of positions x (3, n), or one or more facet tags")
    if isinstance(condition, (Displacement, Traction, Pressure, NonlocalStrain)) and not callable(condition.value):
        shapes = {Displacement: ((), (d,)), Traction: ((d,),), Pressure: ((),), NonlocalStrain: ((),)}[type(condition)]
        words = " or ".join("a finite number" if shape == () else f"{d} finite numbers" for shape in shapes)
        try:
            value = real_array("value", condition.value)
        except TypeError:
            value = np.full(1, np.nan)
        if value.shape not in shapes or not np.isfinite(value).all():
            faults.append(f"value = {condition.value!r}: must be {words}, or a function")
    components = getattr(condition, "components", None)
    if components is not None and not (_are_integers(components) and np.ndim(components) == 1
                                       and set(components) <= set(range(d)) and len(set(components)) == len(components)):
        faults.append(f"components = {components!r}: must be different ones of {', '.join(map(str, range(d)))}")
    if isinstance(condition, Tied) and not (_are_integers(condition.component) and condition.component in range(d)):
        faults.append(f"component = {condition.component!r}: must be one of {', '.join(map(str, range(d)))}")
    if isinstance(condition, Periodic) and not callable(condition.partner):
        faults.append(f"partner = {condition.partner!r}: must be a function of positions (n, d)")
    axes = getattr(condition, "axes", None)
    if axes is not None and not callable(axes):
        faults.append(f"axes = {axes!r}: must be a function of positions (n, d), such as polar()")
    return faults


def _are_numbers(value: object, count: int) -> bool:
    """Whether a value is a sequence of so many finite real numbers."""
    try:
        array = real_array("", value)
    except TypeError:
        return False
    return array.shape == (count,) and bool(np.isfinite(array).all())


def _are_integers(value: object) -> bool:
    """Whether a value is an integer or a sequence of some."""
    try:
        array = np.asarray(value)
    except ValueError:
        return False
    return array.dtype.kind in "iu" and array.ndim < 2 and array.size > 0
