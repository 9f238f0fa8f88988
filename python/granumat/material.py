"""The material: its constants, the states of its points, and what the law gives for them."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from . import core, tensors
from .calibrations import SHIPPED, is_calibration_file, read_constants
from .checks import attempt, check_type, choose, is_finite_number, is_number, is_positive_integer, real_array, refuse, short
from .core import STATE, status_message
from .errors import MaterialError

States = TypeVar("States", np.record, np.recarray, np.ndarray)     # of dtype STATE: one point's, or an array of any shape

# Positions in these lists are the core's codes.
CLOSURES = ("critical", "basic", "n2", "full", "kinematic", "mobilised", "mobilised-pressure")
TURNING = ("mobilised", "mobilised-pressure")       # closures in which friction has a direction of its own
CONTACTS = ("hookean", "hertzian")
CALIBRATIONS = ("table-1", "text", "figure-16")
FRICTIONS = ("linear", "quadratic")
METHODS = ("exact", "forward-euler", "midpoint", "rk4", "bogacki-shampine", "backward-euler")
SPINS = ("inside", "before")

# Constants that have no role in a closure.
UNUSED = {
    "critical": ("a4", "d1", "d2", "d3"), "basic": ("a3", "a4"), "n2": ("a4",), "full": (), "kinematic": ("a4",),
    "mobilised": ("a4", "b3"), "mobilised-pressure": ("a4", "b3", "beta2", "g"),
}

RANGES = core.constant_ranges()
OPTIONS = ("closure", "contact", "friction", "calibration", "method", "spin", "method_tolerance")
DERIVED = ("chi", "kappa", "lambda", "fabric_limit")    # (A 7)-(A 9), and abs(A) from where (4.7) can grow without bound

TRACE_TOLERANCE = 1e-12         # of a fabric that counts as traceless
DIRECTION_TOLERANCE = 1e-9      # of a direction's magnitude 1
PRESSURE_TOLERANCE = 1e-6       # of a state's pressure against the law's for its microstructure, relative
MODULUS_FOR_LENGTH = {2: 0.018, 3: 0.004}   # eta_t above which short waves are bounded with a length (docs/well-posedness.md)
MOST_THREADS = 1024             # more than a node has processors; tens of thousands exhaust the memory of stacks


def describe_range(name: str) -> str:
    """The allowed values of a constant in words, such as "at least 0 and at most 1"."""
    lower, upper, closed = RANGES[name]
    huge = np.finfo(float).max
    words = []
    if lower > -huge:
        words.append(f"{'at least' if closed else 'above'} {lower:g}")
    if upper < huge:
        words.append(f"{'at most' if closed else 'below'} {upper:g}")
    return " and ".join(words) or "any finite number"


class Ellipticity(NamedTuple):
    """What `Material.ellipticity` finds, for states of shape (...).

    Attributes
    ----------
    eta_t : array (...)
        Transverse modulus over p, see `Material.transverse_modulus`.
    eigenvalue : array (...)
        Smallest eigenvalue of the acoustic tensor's symmetric part over all normals, in p.
    normal : array (..., 3)
        The normal at which it is found.
    determinant : array (...)
        Smallest determinant of the acoustic tensor over all normals, in p^2 (e_r = 0) or p^3.
    determinant_normal : array (..., 3)
        The normal at which it is found.
    """

    eta_t: np.ndarray
    eigenvalue: np.ndarray
    normal: np.ndarray
    determinant: np.ndarray
    determinant_normal: np.ndarray


class Material:
    """The constitutive law of Sun & Sundaresan (2011) with its constants.

    Parameters
    ----------
    mu : float
        Interparticle friction coefficient, 0 to 1; the other constants follow from it.
    closure : str
        Equation of the deviatoric stress: "critical" (A 10)-(A 12), "basic" (4.1), "n2" (A 1), "full" (A 4), "kinematic", which
        is (A 4) with a4 = -2 b2, "mobilised", in which friction follows the direction of shearing over the elastic strain, or
        "mobilised-pressure", the same with (4.8) for the rate of the pressure, from which Z2 follows by (4.2).
    contact : str
        Equation of the pressure: "hookean" (4.2) or "hertzian" (4.4).
    friction : str
        Equation of the friction coefficient: "linear" (4.5) or "quadratic" (4.6); the latter needs b1, b2 and b3, which the paper
        does not print.
    calibration : str
        Where a4 is taken from, as the paper gives it in three places: "table-1", "text" or "figure-16"; or "dem-2026", constants
        fitted to discrete-element runs; or the name of a calibration file, which ends in ".toml", whose constants take the place of
        table 1's.
    elastic_strain : float, optional
        e_r, the strain over which the deviatoric stress relaxes to the model's; with 0, the paper's law, it is the model's at once.
        In the closures "mobilised" and "mobilised-pressure", which need one, the strain over which friction turns; 0.005 to 0.02
        in discrete-element runs. The default is the calibration's, 0 in the paper's.
    method : str
        How increments are integrated: "exact", or, to compare with it, "forward-euler", "midpoint" (explicit), "rk4" or
        "backward-euler" in one step per increment, or "bogacki-shampine" in substeps whose error is estimated.
    spin : str
        "inside": the spin is integrated together with the strain; "before": the state is rotated first and strained then, as is
        usual in UMATs.
    method_tolerance : float
        Relative error that "bogacki-shampine" may estimate in a substep.
    **constants : float
        Values that replace the calibration's, by name: a1 a2 a3 a4 b1 b2 b3 Zc phic c1 c2 c3 d1 d2 d3 beta1 beta2 g.

    Attributes
    ----------
    closure, contact, friction, calibration, method, spin : str
        As given.
    constants : mapping of str to float
        All constants by their symbols, given or not, and those that follow from them: chi, kappa, lambda (A 7)-(A 9) and
        fabric_limit, the abs(A) from where (4.7) can grow without bound. `material["Zc"]` is short for
        `material.constants["Zc"]`. A material does not change: another one is `Material(**(material.definition | changes))`.

    Raises
    ------
    ValueError
        Names every mistake at once.
    """

    closure: str
    contact: str
    friction: str
    calibration: str
    method: str
    spin: str
    constants: Mapping[str, float]
    _par: np.ndarray
    _scheme: core.Scheme
    _given: dict[str, Any]

    def __init__(self, mu: float = 0.5, closure: str = "full", contact: str = "hookean", friction: str = "linear",
                 calibration: str = "table-1", elastic_strain: float | None = None, method: str = "exact", spin: str = "inside",
                 method_tolerance: float = 1e-6, **constants: float) -> None:
        faults: list[str] = []
        closure_number = choose("closure", closure, CLOSURES, faults)
        contact_number = choose("contact", contact, CONTACTS, faults)
        calibration, calibration_number, fitted = _calibrated(calibration, mu, closure, contact, friction, faults)
        choose("friction", friction, FRICTIONS, faults)
        method_number = choose("method", method, METHODS, faults)
        spin_number = choose("spin", spin, SPINS, faults)
        if not is_number(method_tolerance) or not 0 < method_tolerance < 1:
            faults.append(f"method_tolerance = {method_tolerance!r}: must be a number in (0, 1)")
        chosen = constants if elastic_strain is None else {"elastic_strain": elastic_strain, **constants}
        given = {"mu": mu, **fitted, **chosen}
        for name, value in given.items():
            if name not in RANGES:
                choose("unknown name", name, OPTIONS + tuple(RANGES), faults)
            elif not is_number(value):
                faults.append(f"{name} = {value!r}: must be a number, {describe_range(name)}")
            elif name in constants and closure in CLOSURES and name in UNUSED[closure]:
                faults.append(f"{name} = {value!r}: has no role in the closure {closure!r}")
        missing = [name for name in ("b1", "b2", "b3") if name not in given]
        if friction == "quadratic" and missing:
            faults.append(f"friction 'quadratic': the paper prints no constants, give {', '.join(missing)} as well")
        if friction == "linear" and "b3" in constants:
            faults.append("b3: belongs to friction 'quadratic'")
        values = {name: float(value) for name, value in given.items() if name in RANGES and is_number(value)}

        usable_mu = values.get("mu", 0.0) if np.isfinite(values.get("mu", 0.0)) else 0.0
        par = core.parameters_from_friction(usable_mu, closure_number, contact_number, calibration_number)
        names = list(RANGES)
        for name, value in values.items():
            par[names.index(name)] = value
        if closure in ("kinematic", *TURNING):
            par[names.index("a4")] = -2 * par[names.index("b2")]
        faulty, valid = core.complete_parameters(par)
        faults += [f"{name} = {value!r}: must be {describe_range(name)}"
                   for name, value in values.items() if faulty[names.index(name)]]
        turns_over = values.get("elastic_strain", None if "elastic_strain" in given else 0.0)
        turning_faults = _turning_faults(closure, turns_over, method) if closure in TURNING else []
        faults += turning_faults
        if not faulty.any() and not valid[0] and not turning_faults:
            faults.append(", ".join(f"{name} = {par[names.index(name)]!r}" for name in ("c1", "c2", "c3"))
                          + ": chi, kappa, lambda (A 7)-(A 9), which follow from them, must be finite and kappa above 0")
        refuse("the material cannot be made", faults)
        par.flags.writeable = False
        vars(self).update(                                       # past __setattr__
            closure=closure, contact=contact, friction=friction, calibration=calibration, method=method, spin=spin,
            constants=MappingProxyType(dict(zip(names + list(DERIVED), par.tolist()))), _par=par,
            _scheme=(method_number, spin_number, method_tolerance),
            _given={"mu": mu, "closure": closure, "contact": contact, "friction": friction, "calibration": calibration,
                    "method": method, "spin": spin, "method_tolerance": method_tolerance, **chosen})

    def __setattr__(self, name: str, value: object) -> None:
        raise TypeError(f"{name} cannot be set: a material does not change; make another one, "
                        f"Material(**(material.definition | {{{name!r}: {value!r}}}))")

    def __repr__(self) -> str:
        return "Material(" + ", ".join(f"{name}={value!r}" for name, value in self._given.items()) + ")"

    def __reduce__(self) -> tuple[Any, ...]:
        return _remake, (self._given,)

    def __getitem__(self, name: str) -> float:
        """A constant by its symbol, such as material["Zc"]."""
        if name not in self.constants:
            raise KeyError(f"{name!r}: must be one of {', '.join(self.constants)}")
        return self.constants[name]

    @property
    def parameters(self) -> np.ndarray:
        """The numbers that the compiled core takes for this material, in the core's order; read-only."""
        return self._par

    @property
    def definition(self) -> dict[str, Any]:
        """The arguments that make this material; they are also the table [material] of a path file."""
        return dict(self._given)

    @property
    def is_exact(self) -> bool:
        """Whether increments are integrated exactly, not by a method that is to be compared."""
        return self.method == "exact" and self.spin == "inside"

    # ---- states ----------------------------------------------------------------------------------------------------

    def state(self, volume_fraction: float, coordination_number: float, fabric: ArrayLike | None = None,
              direction: ArrayLike | None = None, stress: ArrayLike | None = None) -> np.record:
        """Make a state and check it.

        Parameters
        ----------
        volume_fraction : float
            phi, in (0, 1).
        coordination_number : float
            Z2; up to the material's Zc the state is unjammed.
        fabric : array (6,) or (3, 3), optional
            A (3.1), the default is 0: traceless, eigenvalues of A + I/3 in [0, 1], abs(A) below `fabric_limit`.
        direction : array (6,) or (3, 3), optional
            D/abs(D) of the last strain, of magnitude 1; the default 0 stands for no strain yet. In the closures "mobilised"
            and "mobilised-pressure" it follows D/abs(D) over the elastic strain, its deviator is the direction of friction, and its
            magnitude is at most 1.
        stress : array (6,) or (3, 3), optional
            Cauchy stress in k/d (k_Hz for Hertzian contacts), tension positive; the default is the model's.

        Returns
        -------
        record of dtype STATE

        Raises
        ------
        ValueError
            Names every mistake.
        """
        state = np.zeros(1, STATE)
        faults: list[str] = []
        numbers = {"volume_fraction": volume_fraction, "coordination_number": coordination_number}
        for name, value in numbers.items():
            if is_finite_number(value):
                state[name] = value
            else:
                faults.append(f"{name} = {value!r}: must be a finite number")
        if not faults and not 0 < volume_fraction < 1:
            faults.append(f"volume_fraction = {volume_fraction!r}: must be in (0, 1)")
        for name, tensor in {"fabric": fabric, "direction": direction, "stress": stress}.items():
            if tensor is not None:
                state[name] = _components(name, tensor, faults)
        faults += self._fabric_faults(state["fabric"][0])
        size = tensors.magnitude(state["direction"][0])
        if self.closure in TURNING and not size < 1 + DIRECTION_TOLERANCE:
            faults.append(f"direction: its magnitude is {size:g}, must be at most 1")
        elif self.closure not in TURNING and not (size == 0 or abs(size - 1) < DIRECTION_TOLERANCE):
            faults.append(f"direction: its magnitude is {size:g}, must be 1, or 0 before any strain")
        refuse("the state is not admissible", faults)
        if stress is None:
            core.evaluate(self._par, state)
        return state.view(np.recarray)[0]

    def _fabric_faults(self, fabric: np.ndarray) -> list[str]:
        faults = []
        if abs(tensors.trace(fabric)) > TRACE_TOLERANCE:
            faults.append(f"fabric: its trace is {tensors.trace(fabric):g}, must be 0")
        eigenvalues = np.linalg.eigvalsh(tensors.to_matrix(fabric)) + 1 / 3
        if eigenvalues[0] < 0 or eigenvalues[-1] > 1:
            values = ", ".join(f"{value:.6g}" for value in eigenvalues)
            faults.append(f"fabric: eigenvalues of A + I/3 are {values}, must be in [0, 1]")
        size, limit = tensors.magnitude(fabric), self["fabric_limit"]
        if size >= limit:
            faults.append(f"fabric: abs(A) = {size:.6g}, must be below {limit:.6g}, from where (4.7) can blow up")
        return faults

    def check_start(self, states: np.ndarray | np.record | np.void) -> None:
        """Check that states can be where a path or a body of this material starts; increments do not ask.

        Parameters
        ----------
        states : record array (...) of dtype STATE

        Raises
        ------
        TypeError
            They are no states.
        ValueError
            A state is not finite, its fabric or phi is out of range, or its pressure is not what this material's law gives for its
            microstructure: it belongs to another material.
        """
        records = _records(states).reshape(-1)
        fabric, phi = records["fabric"], records["volume_fraction"]
        usable = np.isfinite(core.numbers(records)).all(axis=1)
        faults = [(~usable, "holds numbers that are not finite"),
                  (usable & ~((phi > 0) & (phi < 1)), "has a volume fraction outside (0, 1)"),
                  (usable & (tensors.magnitude(fabric) >= self["fabric_limit"]),
                   f"has a fabric of abs(A) not below this material's fabric_limit, {self['fabric_limit']:.6g}")]
        usable &= ~np.any([found for found, _ in faults], axis=0)
        p = -tensors.trace(records["stress"]) / 3
        law = p.copy()
        law[usable] = -tensors.trace(self.evaluate(records[usable])[0]) / 3
        differs = usable & ~(abs(p - law) <= PRESSURE_TOLERANCE * np.maximum(abs(p), abs(law)))
        if differs.any():
            first = int(np.flatnonzero(differs)[0])
            faults.append((differs, f"has the pressure {p[first]:.6g}, but this material's law gives {law[first]:.6g} for its "
                                    "microstructure: it is of another material, or its stress was set by hand"))
        refuse("the states cannot be started from", [
            f"point {int(np.flatnonzero(found)[0])} " + (f"(and {found.sum() - 1} more) " if found.sum() > 1 else "") + words
            for found, words in faults if found.any()])

    def isotropic(self, volume_fraction: float, pressure: float | None = None,
                  coordination_number: float | None = None) -> np.record:
        """Make the state of an isotropic packing, A = 0.

        Parameters
        ----------
        volume_fraction : float
            phi, in (0, 1). In the critical closure, where the pressure is a function of phi alone (A 11), a given pressure or
            coordination number holds and replaces it.
        pressure : float, optional
            Mean pressure in k/d (k_Hz for Hertzian contacts), at least 0. Give either this or the coordination number; the critical
            closure needs neither.
        coordination_number : float, optional
            Z2.

        Returns
        -------
        record of dtype STATE

        Raises
        ------
        ValueError
            Names every mistake.
        """
        faults = []
        given = [value for value in (pressure, coordination_number) if value is not None]
        if len(given) > 1 or (not given and self.closure != "critical"):
            faults.append("give either pressure or coordination_number")
        elif pressure is not None and (not is_number(pressure) or not 0 <= pressure < np.inf):
            faults.append(f"pressure = {pressure!r}: must be a finite number, at least 0")
        elif pressure is not None:
            coordination_number = float(self.coordination_number(pressure))
        if not faults and self.closure == "critical" and coordination_number is None:
            coordination_number = self["Zc"]                     # that of phi replaces it
        elif not faults and self.closure == "critical" and is_finite_number(volume_fraction) and 0 < volume_fraction < 1 \
                and is_finite_number(coordination_number):       # or `state` refuses them
            volume_fraction = float(self.volume_fraction(volume_fraction, coordination_number))
            if not volume_fraction < 1:
                faults.append(f"Z2 = {coordination_number:.6g} needs phi = {volume_fraction:.6g} in the critical closure")
        refuse("the isotropic state cannot be made", faults)
        assert coordination_number is not None                   # or there were faults
        return self.state(volume_fraction, coordination_number)

    def coordination_number(self, pressure: ArrayLike) -> np.ndarray:
        """Coordination numbers Z2 (...) of isotropic packings under pressures (...) of at least 0: the inverse of (4.2), (4.4).

        In the critical closure (A 11) has kappa in place of abs(A).
        """
        pressure = real_array("pressure", pressure)
        if not ((pressure >= 0) & (pressure < np.inf)).all():
            raise ValueError(f"pressure = {short(pressure)}: must be finite and at least 0")
        hookean = pressure ** (2 / 3) if self.contact == "hertzian" else pressure
        factor = self["a1"] + (self["a2"] * self["kappa"] if self.closure == "critical" else 0)
        return self["Zc"] + np.sqrt(hookean / factor)

    def volume_fraction(self, given: float, coordination_number: ArrayLike) -> np.ndarray:
        """Volume fractions (...) of packings with coordination numbers Z2 (...), for which `given` was asked.

        They are as given, but in the critical closure, where Z2 = f(phi), they follow from Z2: the inverse of (4.9). Up to Zc they
        are as given there too, but at most phic.
        """
        if not is_finite_number(given) or not 0 < given < 1:
            raise ValueError(f"volume fraction = {given!r}: must be a number in (0, 1)")
        excess = real_array("coordination_number", coordination_number) - self["Zc"]
        if self.closure != "critical":
            return np.full(excess.shape, given)
        with np.errstate(divide="ignore", over="ignore"):
            return np.where(excess > 0, self["phic"] + (np.maximum(excess, 0) / self["beta1"]) ** (1 / self["beta2"]),
                            min(given, self["phic"]))

    @overload
    def steady(self, volume_fraction: float) -> np.record: ...

    @overload
    def steady(self, volume_fraction: np.ndarray) -> np.recarray: ...

    def steady(self, volume_fraction: float | np.ndarray) -> np.record | np.recarray:
        """Find the state of steady simple shear at constant volume, du_x/dz > 0: A and Z2 at which (4.7) and (4.8) vanish.

        Found by the exact update, whatever the material's method.

        Parameters
        ----------
        volume_fraction : float or array (...)
            phi, in (0, 1); several take hardly longer than one.

        Returns
        -------
        record or record array (...) of dtype STATE
        """
        packings = np.array([self.state(phi, self["Zc"]) for phi in np.ravel(volume_fraction).tolist()], STATE)
        states, status = core.steady_states(self._par, packings["volume_fraction"])
        _refuse_failures(status, states)
        return states.reshape(np.shape(volume_fraction)).view(np.recarray) if np.ndim(volume_fraction) else states[0]

    # ---- increments ------------------------------------------------------------------------------------------------

    def update(self, states: States, gradient: ArrayLike, out: np.ndarray | None = None, threads: int = 1,
               nonlocal_strain: ArrayLike | None = None) -> States:
        """Find the states after an increment of deformation, of many points at once.

        The method "exact" integrates (4.7), (4.8) and, with e_r > 0, the relaxation of the stress to round-off, for a velocity
        gradient that is constant over the increment.

        Parameters
        ----------
        states : record array (...) of dtype STATE
        gradient : array (..., 3, 3)
            du_i/dx_j of the increment; its skew part is the spin.
        out : record array (...) of dtype STATE, contiguous, optional
            Receives the result; may be `states` itself.
        threads : int, optional
            OpenMP threads that share the points; the result does not depend on their number, bit for bit.
        nonlocal_strain : array (...), optional
            With a length: the increments m of the nonlocal strain, which smooths abs(D) over the neighbourhood; needs the method
            "exact". At least 0, and above 0 where D is not 0. With m = abs(D) the update is the one without a length.

        Returns
        -------
        record array (...) of dtype STATE

        Raises
        ------
        MaterialError
            If points cannot follow; carries the status of every point. These points keep their old states, the others have their
            new ones.
        ValueError
            If shapes do not match.
        """
        return self._update(states, gradient, nonlocal_strain, out, threads, None, None)

    @overload
    def update_with_tangent(self, states: States, gradient: ArrayLike, spin: bool = ..., plane: bool = ...,
                            out: np.ndarray | None = ..., threads: int = ...,
                            nonlocal_strain: None = ...) -> tuple[States, np.ndarray]: ...

    @overload
    def update_with_tangent(self, states: States, gradient: ArrayLike, spin: bool = ..., plane: bool = ...,
                            out: np.ndarray | None = ..., threads: int = ..., *,
                            nonlocal_strain: ArrayLike) -> tuple[States, np.ndarray, np.ndarray]: ...

    def update_with_tangent(self, states: States, gradient: ArrayLike, spin: bool = False, plane: bool = False,
                            out: np.ndarray | None = None, threads: int = 1, nonlocal_strain: ArrayLike | None = None,
                            ) -> tuple[States, np.ndarray] | tuple[States, np.ndarray, np.ndarray]:
        """Find the states as `update` does, and the consistent tangent: the derivative of the exact update, whatever the method.

        At D = 0 the tangent is that of a strain of 1e-4 along the last direction (isotropic compression before any strain). With a
        length and m > 0 it is that of D = 0 itself, with the last direction in A:S^.

        Parameters
        ----------
        states, gradient
            As in update.
        spin : bool
            Whether the derivatives by the spin increments W_12, W_13, W_23 at fixed strain are appended.
        plane : bool
            Whether only the components of plane strain in x and y are wanted: stresses xx yy zz xy, strains xx yy xy, spin W_12.
        out, threads, nonlocal_strain
            As in update.

        Returns
        -------
        states : record array (...) of dtype STATE
        tangent : array (..., 6, 6), with the spin (..., 6, 9); plane (..., 4, 3), with the spin (..., 4, 4)
            d stress_i / d (strain_j, spin_j), tension positive, engineering shear strains, in the order xx yy zz xy xz yz; 0 for
            points that cannot follow. At constant nonlocal strain, if that is given.
        by_nonlocal : array (..., 6), plane (..., 4)
            d stress_i / d m, at constant strain and spin; only if the nonlocal strain is given.

        Raises
        ------
        MaterialError, ValueError
            As update.
        """
        rows, columns, spins = (4, 3, 1) if plane else (6, 6, 3)
        tangent = np.empty((*np.shape(states), rows, columns + spins * spin))
        by_nonlocal = np.empty((*np.shape(states), rows))
        new = self._update(states, gradient, nonlocal_strain, out, threads, tangent, by_nonlocal)
        return (new, tangent) if nonlocal_strain is None else (new, tangent, by_nonlocal)

    def _update(self, states: np.ndarray | np.record, gradient: ArrayLike, nonlocal_strain: ArrayLike | None,
                out: np.ndarray | None, threads: int, tangent: np.ndarray | None, by_nonlocal: np.ndarray | None) -> Any:
        old = _records(states).reshape(-1)
        gradient = real_array("gradient", gradient)
        shape = np.shape(states)
        if gradient.shape != (*shape, 3, 3):
            raise ValueError(f"gradient has shape {gradient.shape}: must be {(*shape, 3, 3)} for states of shape {shape}")
        m = None if nonlocal_strain is None else self._nonlocal_strain(nonlocal_strain, shape)
        new = np.empty(shape, STATE) if out is None else out
        threads = _usable_threads(threads, old.size)
        if not isinstance(new, np.ndarray) or new.dtype != STATE or new.shape != shape or not new.flags.c_contiguous:
            raise ValueError(f"out must be a contiguous array of shape {shape} and dtype STATE")
        if np.may_share_memory(old, new):
            old = old.copy()                                     # the core must not write where it still reads
        status = np.zeros(old.size, np.int32)
        arguments = self._par, old, gradient.reshape(-1, 3, 3), new.reshape(-1), status
        if old.size == 0:                                        # the core takes no empty arrays
            return new.view(np.recarray)
        if m is not None and tangent is not None and by_nonlocal is not None:
            core.update_nonlocal_with_tangent(*arguments[:3], m, *arguments[3:], tangent.reshape(-1, *tangent.shape[-2:]),
                                              by_nonlocal.reshape(-1, by_nonlocal.shape[-1]), threads)
        elif m is not None:
            core.update_nonlocal(*arguments[:3], m, *arguments[3:], threads)
        elif tangent is not None:
            core.update_with_tangent(*arguments, tangent.reshape(-1, *tangent.shape[-2:]), threads)
        elif self.is_exact:
            core.update(*arguments, threads)
        if not self.is_exact:
            core.update_by_method(self._par, self._scheme, *arguments[1:], threads)
        records: Any = new.view(np.recarray) if shape else new.reshape(1).view(np.recarray)[0]
        _refuse_failures(status.reshape(shape), records)
        return records

    def _nonlocal_strain(self, nonlocal_strain: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
        """Nonlocal strains (n,) as the core takes them; whether they are positive is the core's to say."""
        m = real_array("nonlocal_strain", nonlocal_strain)
        faults = []
        if m.shape != shape:
            faults.append(f"nonlocal_strain has shape {m.shape}: must be {shape}, as that of the states")
        if not self.is_exact:
            faults.append("nonlocal_strain needs the method 'exact' with the spin 'inside', "
                          f"not {self.method!r} with {self.spin!r}")
        refuse("the update cannot be made", faults)
        return m.reshape(-1)

    def evaluate(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the stress and the friction coefficient that the states' microstructure (A, Z2, phi, D^) has by the law.

        The stress is not the states' own where that is kept, at D = 0, or relaxes, with e_r > 0.

        Parameters
        ----------
        states : record array (...) of dtype STATE

        Returns
        -------
        stress : array (..., 6)
            Tension positive, (4.1)-(4.4), (A 1), (A 4) or (A 10)-(A 12) by the closure.
        eta : array (...)
            Friction coefficient (4.5), (4.6).
        """
        states = np.array(_records(states))
        eta = core.evaluate(self._par, states.reshape(-1))
        return states["stress"], eta.reshape(states.shape)

    # ---- well-posedness ----------------------------------------------------------------------------------------------

    def transverse_modulus(self, states: np.ndarray) -> np.ndarray:
        """Transverse modulus over p, eta_t: the stiffness against a change of the strain's direction at constant |D|.

        eta_t = b1 + (b2 + a4/2) x + b3 x^2 with x = A:S^; the critical closure has b1 + b2 chi + b3 chi^2. A change T of S^ with
        T:S^ = 0 changes the stress (tension positive) by

            p eta_t T + p (b2 + 2 b3 x + a4/2) (A:T) S^ - a3 p (A T + T A - (2/3) (A:T) I),

        so, apart from the term with a3, T:d sigma = eta_t p T:T. With e_r > 0 the whole response is divided by e_r; eta_t does not
        depend on it.

        Parameters
        ----------
        states : record array (...) of dtype STATE

        Returns
        -------
        array (...)
        """
        states = _records(states)
        return core.transverse_modulus(self._par, states.reshape(-1)).reshape(states.shape)

    def response(self, states: np.ndarray) -> np.ndarray:
        """Instantaneous response C of the stress to the rate of deformation, from which `ellipticity` forms the acoustic tensor.

        It is taken at fixed A, Z2, phi (in the critical closure A = lambda S^ changes with D) and at D = D^, the state's direction,
        |D| = 1:

        - e_r = 0: C = d sigma/dD, which is homogeneous of degree -1 in D, so that C:D = 0. p depends on D only through g.
        - e_r > 0: C = d(d sigma/dt)/dD with d sigma'/dt = abs(D) (sigma'_model(D^) - sigma')/e_r and dp/dt from (4.2), (4.7),
          (4.8); homogeneous of degree 0, so that C:D is the rate of stress. The jump of p with g tr D^ is left out.
        - in the closure "mobilised" the same of the stress that A, M, Z2 have, with D along the direction of friction.

        Parameters
        ----------
        states : record array (...) of dtype STATE

        Returns
        -------
        array (..., 6, 6)
            In units of p, tension positive, by engineering shear strains; NaN where there is none: before any strain, and for
            e_r > 0 where p = 0.
        """
        states = _records(states)
        return core.response(self._par, states.reshape(-1)).reshape(states.shape + (6, 6))

    def ellipticity(self, states: np.ndarray, threads: int = 1) -> Ellipticity:
        """Find how far states are from the loss of ellipticity.

        The acoustic tensor Q(n) gives the change Q v of the traction on the normal n when the velocity gradient changes by v n.
        Two minima are searched over all normals n, first on a grid and then locally:

        - eigenvalue: the smallest eigenvalue of (Q + Q^T)/2, the minimum of v.Q(n).v with abs(v) = 1; strong ellipticity is lost
          where it reaches 0;
        - determinant: the smallest det Q(n); a band with the normal n can form where it reaches 0 (Rudnicki & Rice 1975).

        With e_r = 0, Q_il = n_j C_ijkl n_k with C of `response`. A change of volume meets the bulk stiffness, some 90 p per strain,
        which C does not contain; therefore v is normal to n, and Q is 2 x 2. In plane strain the smallest value is 0 at best, since
        C:D = 0 and D is the symmetric part of v n for some n, a characteristic; the loss shows in a negative value.

        With e_r > 0, Q is 3 x 3 for all v and contains the rate of p. The spin rotates the stress, which adds
        ((n.sigma n) I - sigma + (sigma n) n - n (sigma n))/2; this is exact for the rate of the nominal traction too (Rice 1976).

        Parameters
        ----------
        states : record array (...) of dtype STATE
        threads : int, optional
            OpenMP threads that share the points.

        Returns
        -------
        Ellipticity
        """
        states = _records(states)
        threads = _usable_threads(threads, states.size)
        least, normal = core.ellipticity(self._par, states.reshape(-1), threads)
        least, normal = least.reshape(states.shape + (2,)), normal.reshape(states.shape + (2, 3))
        return Ellipticity(self.transverse_modulus(states), least[..., 0], normal[..., 0, :], least[..., 1], normal[..., 1, :])

    def length_fault(self, dimensions: int) -> str | None:
        """Say why a length should not be given to this material, if so.

        With a length short waves are bounded where the transverse modulus eta_t is positive; where it is not, a length makes them
        grow faster. It is least just after a reversal of steady shear, at A:S^ = abs(chi); out of the plane of shear a3 takes
        abs(a3 chi)/2 away.

        Parameters
        ----------
        dimensions : int
            Of the body: 2 for plane strain, 3.

        Returns
        -------
        str or None
            A sentence that names the closures to take instead; None where a length is right.

        Raises
        ------
        ValueError
            If there are no so many dimensions.
        """
        if dimensions not in MODULUS_FOR_LENGTH:
            raise ValueError(f"dimensions = {dimensions!r}: must be 2 or 3")
        least, needed = self._least_modulus(dimensions), MODULUS_FOR_LENGTH[dimensions]
        if least > needed:
            return None
        same = {name: self._given[name] for name in ("mu", "contact", "calibration")}
        others = [Material(closure=closure, elastic_strain=self["elastic_strain"] or 1.0, **same)
                  for closure in ("kinematic", "mobilised") if closure != self.closure]
        better = [repr(other.closure) for other in others if other._least_modulus(dimensions) > needed]
        mu = self["mu"]
        return (f"a length does not suit the closure {self.closure!r} at mu = {mu:g} in {dimensions} dimensions: just after "
                f"a reversal of shear its transverse modulus is {least:.3f} of the pressure, and where it is not above {needed:g} "
                "a length makes short waves grow faster; "
                + (f"take the closure {' or '.join(better)}" if better
                   else "neither 'kinematic' nor 'mobilised' has a larger one at this mu"))

    def _least_modulus(self, dimensions: int) -> float:
        """The transverse modulus over p just after a reversal of steady shear, in the worst direction."""
        b1, b2, b3, a3, a4 = (self[name] for name in ("b1", "b2", "b3", "a3", "a4"))
        x = abs(self["chi"])
        if self.closure in TURNING:
            return b1                                            # friction turns with M, and a3 acts on the fabric alone
        if self.closure == "critical":                           # A = lambda S^ in the term with a3 as well
            return b1 - b2 * x + b3 * x**2 - abs(a3) * x * (dimensions - 2)
        return b1 + (b2 + a4 / 2) * x + b3 * x**2 - abs(a3) * x / 2 * (dimensions - 2)

    def follow(self, state: np.record | np.void, gradients: np.ndarray, modes: np.ndarray, functionals: np.ndarray,
               targets: np.ndarray, tolerance: float) -> tuple[np.recarray, np.ndarray, int]:
        """Follow increments of one point with free deformations and prescribed stresses; `driver.run` is made of this.

        Parameters
        ----------
        state : record of dtype STATE
        gradients : array (n, 3, 3)
            du_i/dx_j of each increment.
        modes : array (m, 3, 3)
            Displacement gradients that are free: their amplitudes are found.
        functionals : array (m, 6)
            Weights of the stress components (tension positive) whose sums are prescribed.
        targets : array (n + 1, m)
            Values of these sums at the start and after each increment, linear in between.
        tolerance : float
            As in driver.run; without free modes there are no substeps.

        Returns
        -------
        states : record array (done,) of dtype STATE
        amplitudes : array (done, m)
            Of the modes in each increment.
        status : int
            0, or the core's status that tells why fewer than n increments were done.
        """
        start = np.array(state, STATE).reshape(1)
        return core.follow_path(self._par, self._scheme, start, gradients, modes, functionals, targets, tolerance)


def _refuse_failures(status: np.ndarray, records: Any) -> None:
    """MaterialError if the core's status (...) says that not all points have a new state."""
    failed = np.flatnonzero(status)
    if failed.size:
        words = f"point {failed[0]}: {status_message(status.flat[failed[0]])}"
        raise MaterialError(words + (f" (and {failed.size - 1} more)" if failed.size > 1 else ""), status, records)


def _turning_faults(closure: str, elastic_strain: float | None, method: str) -> list[str]:
    """What a closure in which friction turns does not allow, in words."""
    faults = []
    if elastic_strain == 0:
        faults.append(f"elastic_strain = 0: the closure {closure!r} needs one above 0, the strain over which friction turns")
    if method != "exact" and method in METHODS:
        faults.append(f"method {method!r}: the closure {closure!r} is integrated by the method 'exact' only")
    return faults


def _usable_threads(threads: int, points: int) -> int:
    """At most as many threads as there are points; ValueError if they are no such number."""
    if not is_positive_integer(threads) or threads > MOST_THREADS:
        raise ValueError(f"threads = {threads!r}: must be an integer from 1 to {MOST_THREADS}")
    return max(1, min(threads, points))


def _records(states: object) -> np.ndarray:
    """States (...) as the core takes them, contiguous, without a copy if they are; TypeError if they are none."""
    check_type("states", states, (np.ndarray, np.void), "an array of dtype STATE, or one of its records")
    assert isinstance(states, (np.ndarray, np.void))
    if isinstance(states, np.ma.MaskedArray):
        raise TypeError("states: are a masked array, whose masked states would count: give an array without a mask")
    if states.dtype != STATE:
        raise TypeError(f"states: are of dtype {states.dtype}: must be of granumat.STATE, {STATE}")
    return np.ascontiguousarray(states).reshape(states.shape)


def _calibrated(calibration: str, mu: float, closure: str, contact: str, friction: str,
                faults: list[str]) -> tuple[str, int, dict[str, float]]:
    """The name of a calibration, a file's in full; its number in the core; what it has in place of the printed constants."""
    if is_calibration_file(calibration):
        calibration = str(Path(calibration).absolute())
    elif not isinstance(calibration, str) or calibration not in SHIPPED:
        return calibration, choose("calibration", calibration, (*CALIBRATIONS, *SHIPPED), faults), {}
    constants = [name for name in RANGES if name != "mu"]
    filename = SHIPPED.get(calibration, calibration)
    fitted = attempt(faults, "", read_constants, filename, mu, contact, closure, CLOSURES, constants) or {}
    unused = (*UNUSED.get(closure, ()), *(("b3",) if friction == "linear" else ()))
    return calibration, 0, {name: value for name, value in fitted.items() if name not in unused}


def _remake(given: dict[str, Any]) -> Material:
    return Material(**given)


def _components(name: str, value: ArrayLike, faults: list[str]) -> np.ndarray:
    """Six components from what was given for a tensor; 0 and a fault if it is no symmetric tensor of finite numbers."""
    try:
        value = real_array(name, value)
    except TypeError:
        value = np.full(0, np.nan)
    if value.shape == (3, 3) and np.allclose(value, value.T, rtol=0, atol=1e-14):
        value = tensors.to_voigt(value)
    if value.shape != (6,):
        faults.append(f"{name}: must be 6 numbers xx yy zz xy xz yz or a symmetric 3 x 3 tensor")
    elif not np.isfinite(value).all():
        faults.append(f"{name} = {value.tolist()}: must be finite")
    else:
        return value
    return np.zeros(6)
