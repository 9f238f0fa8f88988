"""The material and the state of its points."""

from typing import NamedTuple

import numpy as np

from . import core, tensors
from .checks import choose, is_number, refuse
from .core import STATE, status_message
from .errors import MaterialError

CLOSURES = ("critical", "basic", "n2", "full", "kinematic")       # positions are the core's numbers
CONTACTS = ("hookean", "hertzian")
CALIBRATIONS = ("table-1", "text", "figure-16")
FRICTIONS = ("linear", "quadratic")
METHODS = ("exact", "forward-euler", "midpoint", "rk4", "bogacki-shampine", "backward-euler")
SPINS = ("inside", "before")

# What a closure does without.
UNUSED = {
    "critical": ("a4", "d1", "d2", "d3"), "basic": ("a3", "a4"), "n2": ("a4",), "full": (), "kinematic": ("a4",),
}


RANGES = core.constant_ranges()
OPTIONS = ("closure", "contact", "friction", "calibration", "method", "spin", "method_tolerance")
DERIVED = ("chi", "kappa", "lambda", "fabric_limit")


def describe_range(name):
    """The allowed values of a constant in words."""
    lower, upper, closed = RANGES[name]
    huge = np.finfo(float).max
    words = []
    if lower > -huge:
        words.append(f"{'at least' if closed else 'above'} {lower:g}")
    if upper < huge:
        words.append(f"{'at most' if closed else 'below'} {upper:g}")
    return " and ".join(words) or "any finite number"


class Material:
    """The constitutive law with its constants.

    Parameters
    ----------
    mu : float
        Interparticle friction coefficient, 0 to 1; the other constants follow from it.
    closure : str
        "critical" (A 10)-(A 12), "basic" (4.1), "n2" (A 1), "full" (A 4) or "kinematic" ((A 4) with a4 = -2 b2).
    contact : str
        "hookean" (4.2) or "hertzian" (4.4).
    friction : str
        "linear" (4.5) or "quadratic" (4.6); the latter needs b1, b2 and b3, which the paper does not print.
    calibration : str
        Source of a4: "table-1", "text" or "figure-16".
    elastic_strain : float
        e_r, strain over which the deviatoric stress relaxes to the model's; 0 is the paper.
    method : str
        How increments are integrated: "exact", or to compare with it "forward-euler", "midpoint" (explicit), "rk4",
        "backward-euler", one step an increment each, or "bogacki-shampine", in substeps with an error estimate.
    spin : str
        "inside": integrated with the rest; "before": the state is rotated first, then strained, as UMATs usually do.
    method_tolerance : float
        Of the relative error that "bogacki-shampine" estimates in a substep.
    **constants : float
        Overrides, by name: a1 a2 a3 a4 b1 b2 b3 Zc phic c1 c2 c3 d1 d2 d3 beta1 beta2 g.

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    """

    def __init__(self, mu=0.5, closure="full", contact="hookean", friction="linear", calibration="table-1",
                 elastic_strain=0.0, method="exact", spin="inside", method_tolerance=1e-6, **constants):
        faults = []
        closure_number = choose("closure", closure, CLOSURES, faults)
        contact_number = choose("contact", contact, CONTACTS, faults)
        calibration_number = choose("calibration", calibration, CALIBRATIONS, faults)
        choose("friction", friction, FRICTIONS, faults)
        method_number = choose("method", method, METHODS, faults)
        spin_number = choose("spin", spin, SPINS, faults)
        if not is_number(method_tolerance) or not 0 < method_tolerance < 1:
            faults.append(f"method_tolerance = {method_tolerance!r}: must be a number in (0, 1)")
        given = {"mu": mu, "elastic_strain": elastic_strain, **constants}
        for name, value in given.items():
            if name not in RANGES:
                choose("unknown name", name, OPTIONS + tuple(RANGES), faults)
            elif not is_number(value):
                faults.append(f"{name} = {value!r}: must be a number, {describe_range(name)}")
            elif name in constants and name in UNUSED.get(closure, ()):
                faults.append(f"{name} = {value!r}: has no role in the closure {closure!r}")
        missing = [name for name in ("b1", "b2", "b3") if name not in constants]
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
        if closure == "kinematic":
            par[names.index("a4")] = -2 * par[names.index("b2")]
        faulty, valid = core.complete_parameters(par)
        faults += [f"{name} = {value!r}: must be {describe_range(name)}"
                   for name, value in values.items() if faulty[names.index(name)]]
        if not faulty.any() and not valid[0]:
            faults.append(", ".join(f"{name} = {par[names.index(name)]!r}" for name in ("c1", "c2", "c3"))
                          + ": chi, kappa, lambda (A 7)-(A 9), which follow from them, must be finite and kappa above 0")
        refuse("the material cannot be made", faults)
        self._scheme = method_number, spin_number, method_tolerance
        self._par = par
        self._par.flags.writeable = False
        self.closure, self.contact, self.friction, self.calibration = closure, contact, friction, calibration
        self.method, self.spin = method, spin
        self.constants = dict(zip(names + list(DERIVED), par.tolist()))
        self._given = {"mu": mu, "closure": closure, "contact": contact, "friction": friction, "calibration": calibration,
                       "elastic_strain": elastic_strain, "method": method, "spin": spin, "method_tolerance": method_tolerance,
                       **constants}

    def __repr__(self):
        return "Material(" + ", ".join(f"{name}={value!r}" for name, value in self._given.items()) + ")"

    def __reduce__(self):
        return _remake, (self._given,)

    def __getitem__(self, name):
        """A constant by its symbol: material["Zc"]."""
        return self.constants[name]

    @property
    def definition(self):
        """The arguments that make this material, as the [material] table of a path file."""
        return dict(self._given)

    @property
    def is_exact(self):
        """Whether increments are integrated exactly, not by a method that is to be compared."""
        return self.method == "exact" and self.spin == "inside"

    # ---- states ----------------------------------------------------------------------------------------------------

    def state(self, volume_fraction, coordination_number, fabric=None, direction=None, stress=None):
        """A checked state.

        Parameters
        ----------
        volume_fraction : float
            phi, in (0, 1).
        coordination_number : float
            Z2; up to the material's Zc the state is unjammed.
        fabric : array (6,) or (3, 3), optional
            A: traceless, eigenvalues of A + I/3 in [0, 1], abs(A) below the limit above which (4.7) can blow up.
        direction : array (6,) or (3, 3), optional
            D/abs(D) of the last strain: modulus 1, or 0 before any strain.
        stress : array (6,) or (3, 3), optional
            Tension positive; the default is the model's.

        Returns
        -------
        numpy record of dtype STATE
        """
        state = np.zeros(1, STATE)
        faults = []
        numbers = {"volume_fraction": volume_fraction, "coordination_number": coordination_number}
        for name, value in numbers.items():
            if not is_number(value) or not np.isfinite(value):
                faults.append(f"{name} = {value!r}: must be a finite number")
            else:
                state[name] = value
        if not faults and not 0 < volume_fraction < 1:
            faults.append(f"volume_fraction = {volume_fraction!r}: must be in (0, 1)")
        for name, value in {"fabric": fabric, "direction": direction, "stress": stress}.items():
            if value is not None:
                state[name] = _components(name, value, faults)
        faults += self._fabric_faults(state["fabric"][0])
        size = tensors.magnitude(state["direction"][0])
        if not (size == 0 or abs(size - 1) < 1e-9):
            faults.append(f"direction: its modulus is {size:g}, must be 1, or 0 before any strain")
        refuse("the state is not admissible", faults)
        if stress is None:
            core.evaluate(self._par, state)
        return state.view(np.recarray)[0]

    def _fabric_faults(self, fabric):
        faults = []
        if abs(tensors.trace(fabric)) > 1e-12:
            faults.append(f"fabric: its trace is {tensors.trace(fabric):g}, must be 0")
        eigenvalues = np.linalg.eigvalsh(tensors.to_matrix(fabric)) + 1 / 3
        if eigenvalues[0] < 0 or eigenvalues[-1] > 1:
            values = ", ".join(f"{value:.6g}" for value in eigenvalues)
            faults.append(f"fabric: eigenvalues of A + I/3 are {values}, must be in [0, 1]")
        size, limit = tensors.magnitude(fabric), self["fabric_limit"]
        if size >= limit:
            faults.append(f"fabric: abs(A) = {size:.6g}, must be below {limit:.6g}, from where (4.7) can blow up")
        return faults

    def isotropic(self, volume_fraction, pressure=None, coordination_number=None):
        """An isotropic packing (A = 0), from its mean pressure or its coordination number.

        The critical closure has no state variables: it takes neither, its pressure follows from the volume fraction.
        """
        faults = []
        if self.closure == "critical":
            if pressure is not None or coordination_number is not None:
                faults.append("the critical closure takes no pressure or coordination_number: phi sets both")
            coordination_number = self["Zc"]
        elif (pressure is None) == (coordination_number is None):
            faults.append("give either pressure or coordination_number")
        elif pressure is not None:
            if not is_number(pressure) or not 0 <= pressure < np.inf:
                faults.append(f"pressure = {pressure!r}: must be a finite number, at least 0")
            else:
                coordination_number = float(self.coordination_number(pressure))
        refuse("the isotropic state cannot be made", faults)
        return self.state(volume_fraction, coordination_number)

    def coordination_number(self, pressure):
        """Z2 (...) of isotropic packings that bear pressures (...), at least 0: (4.2), (4.4)."""
        hookean = pressure ** (2 / 3) if self.contact == "hertzian" else pressure
        return self["Zc"] + np.sqrt(hookean / self["a1"])

    @property
    def steady_strain(self):
        """Shear strain after which what is left of the start is below round-off."""
        return 2 * STEADY_DECAYS / max(self["d2"], SLOWEST_DECAY)

    def steady(self, volume_fraction):
        """Steady simple shear at constant volume, du_x/dz > 0: the fixed point of (4.7) with its spin, and of (4.8).

        Found by the exact update, whatever the material's method.
        """
        gradient = np.zeros((3, 3))
        gradient[0, 2] = self.steady_strain
        exact = Material(**(self._given | {"method": "exact", "spin": "inside"}))
        return exact.update(exact.state(volume_fraction, self["Zc"]), gradient)

    # ---- what the core does ----------------------------------------------------------------------------------------

    def update(self, states, gradient, out=None, threads=1):
        """The states after an increment of deformation; by the method "exact", exact for a velocity gradient constant over it.

        Parameters
        ----------
        states : record array (...) of dtype STATE
        gradient : array (..., 3, 3)
            du_i/dx_j of the increment; its skew part is the spin.
        out : record array (...) of dtype STATE, contiguous, optional
            Receives the result; may be `states` itself.
        threads : int, optional
            OpenMP threads that share the points; the result is the same, bit for bit.

        Returns
        -------
        record array (...) of dtype STATE

        Raises
        ------
        MaterialError
            With the status of every point; failing points keep their old state, the others are done.
        """
        return self._update(states, gradient, out, threads, None)

    def update_with_tangent(self, states, gradient, spin=False, plane=False, out=None, threads=1):
        """As update, with the consistent tangent: the derivative of the exact update (whatever the method), in closed form.

        At D = 0 it is that of a strain of 1e-4 along the last direction (isotropic compression before any).

        Parameters
        ----------
        spin : bool
            Whether the derivatives by the spin increments W_12, W_13, W_23 at fixed strain are appended.
        plane : bool
            Whether only what plane strain in x and y has is wanted: stresses xx yy zz xy, strains xx yy xy and the spin W_12.
        states, gradient, out, threads
            As in update.

        Returns
        -------
        states : record array (...) of dtype STATE
        tangent : array (..., 6, 6), with the spin (..., 6, 9); plane (..., 4, 3), with the spin (..., 4, 4)
            d stress_i / d (strain_j, spin_j): tension positive, engineering shear strains, xx yy zz xy xz yz; 0 where the
            update fails.
        """
        rows, columns, spins = (4, 3, 1) if plane else (6, 6, 3)
        tangent = np.empty((*np.shape(states), rows, columns + spins * spin))
        return self._update(states, gradient, out, threads, tangent), tangent

    def _update(self, states, gradient, out, threads, tangent):
        old = np.ascontiguousarray(states, STATE).reshape(-1)
        gradient = np.ascontiguousarray(gradient, float)
        shape = np.shape(states)
        if gradient.shape != (*shape, 3, 3):
            raise ValueError(f"gradient has shape {gradient.shape}: must be {(*shape, 3, 3)} for states of shape {shape}")
        new = np.empty(shape, STATE) if out is None else out
        _check_threads(threads)
        if new.dtype != STATE or new.shape != shape or not new.flags.c_contiguous:
            raise ValueError(f"out must be a contiguous array of shape {shape} and dtype STATE")
        if np.may_share_memory(old, new):
            old = old.copy()                                     # the core may not read what it writes
        status = np.zeros(old.size, np.int32)
        arguments = self._par, old, gradient.reshape(-1, 3, 3), new.reshape(-1), status
        if tangent is not None:
            core.update_with_tangent(*arguments, tangent.reshape(-1, *tangent.shape[-2:]), threads)
        elif self.is_exact:
            core.update(*arguments, threads)
        if not self.is_exact:
            core.update_by_method(self._par, self._scheme, *arguments[1:], threads)
        records = new.view(np.recarray) if shape else new.reshape(1).view(np.recarray)[0]
        if status.any():
            first = int(np.flatnonzero(status)[0])
            others = np.count_nonzero(status) - 1
            raise MaterialError(f"point {first}: {status_message(status[first])}" + (f" (and {others} more)" if others else ""),
                                status.reshape(shape), records)
        return records

    def evaluate(self, states):
        """The model's stress (..., 6), tension positive, and friction coefficient eta (...) of the states' microstructure.

        Differs from the states' own stress where it is held or, with e_r > 0, relaxing.
        """
        states = np.array(states, STATE)
        eta = core.evaluate(self._par, states.reshape(-1))
        return states["stress"], eta.reshape(states.shape)

    # ---- well-posedness ----------------------------------------------------------------------------------------------

    def transverse_modulus(self, states):
        """eta_t (...) of states: the modulus of the deviatoric stress against a turn of the strain's direction.

        eta_t = b1 + (b2 + a4/2) x + b3 x^2 with x = A:S^; the critical closure has b1 + b2 chi + b3 chi^2. A change T of S^ with
        T:S^ = 0 changes the stress (tension positive) by

            p eta_t T + p (b2 + 2 b3 x + a4/2) (A:T) S^ - a3 p (A T + T A - (2/3) (A:T) I),

        so, a3 apart, T:d sigma = eta_t p T:T. It does not depend on e_r, which divides the whole response.
        """
        states = np.ascontiguousarray(states, STATE)
        return core.transverse_modulus(self._par, states.reshape(-1)).reshape(states.shape)

    def response(self, states):
        """The response C (..., 6, 6) that `ellipticity` searches, in units of p: stress components by engineering strains.

        At frozen A, Z2, phi (A = lambda S^ of the critical closure follows D), and D = D^ the state's direction, |D| = 1;
        tension positive.

        - e_r = 0: C = d sigma/dD, of degree -1 in D, so C:D = 0. p depends on D through g only.
        - e_r > 0: C = d(d sigma/dt)/dD of d sigma'/dt = abs(D) (sigma'_model(D^) - sigma')/e_r and of dp/dt from (4.2), (4.7),
          (4.8); of degree 0, so C:D is the rate itself. The jump of p with g tr D^ is left out.

        NaN where there is none: before any strain, and for e_r > 0 where p = 0.
        """
        states = np.ascontiguousarray(states, STATE)
        return core.response(self._par, states.reshape(-1)).reshape(states.shape + (6, 6))

    def ellipticity(self, states, threads=1):
        """How far states are from the loss of ellipticity.

        The acoustic tensor Q(n) takes v to the traction on n when grad v changes by v n. Over all unit normals n, from a grid and
        local searches:

        - eigenvalue: the smallest of (Q + Q^T)/2, that is of v.Q(n).v with abs(v) = 1: strong ellipticity;
        - determinant: the smallest det Q(n); a band along n can form where it reaches 0 (Rudnicki & Rice 1975).

        e_r = 0: Q_il = n_j C_ijkl n_k, C of `response`. The volume is kept by a bulk stiffness of some 90 p per strain, which this
        C has not: v is normal to n and Q is 2 x 2. In plane strain C:D = 0 makes the smallest value 0 at best, as D is the
        symmetric part of v n for some n, a characteristic: what signals the loss is a negative value.

        e_r > 0: all v, 3 x 3, with the rate of p. The spin carries the stress along, which adds
        ((n.sigma n) I - sigma + (sigma n) n - n (sigma n))/2, exact for the nominal traction rate too (Rice 1976).

        Parameters
        ----------
        states : record array (...) of dtype STATE
        threads : int, optional

        Returns
        -------
        Ellipticity
        """
        _check_threads(threads)
        states = np.ascontiguousarray(states, STATE)
        least, normal = core.ellipticity(self._par, states.reshape(-1), threads)
        least, normal = least.reshape(states.shape + (2,)), normal.reshape(states.shape + (2, 3))
        return Ellipticity(self.transverse_modulus(states), least[..., 0], normal[..., 0, :], least[..., 1], normal[..., 1, :])

    def follow(self, state, gradients, modes, functionals, targets, tolerance):
        """Follows increments of one point; the driver's engine.

        Parameters
        ----------
        state : record of dtype STATE
        gradients : array (n, 3, 3)
            du_i/dx_j of each increment.
        modes : array (m, 3, 3)
            Displacement gradients that are free: their amplitudes are found.
        functionals : array (m, 6)
            Weights of the stress components (tension positive) that are prescribed.
        targets : array (n + 1, m)
            Their values at the start and after each increment, linear between.
        tolerance : float
            Largest error of fabric/kappa, Z2 and phi in an inner step, where there are free modes.

        Returns
        -------
        states : record array (done,) of dtype STATE
        amplitudes : array (done, m)
        status : int
            0, or why fewer than n increments were done.
        """
        return core.follow_path(self._par, self._scheme, np.array(state, STATE).reshape(1), gradients, modes, functionals, targets, tolerance)


class Ellipticity(NamedTuple):
    """What `Material.ellipticity` finds, for states of shape (...)."""

    eta_t: np.ndarray                   # (...): transverse modulus
    eigenvalue: np.ndarray              # (...): smallest of the acoustic tensor's symmetric part, in p
    normal: np.ndarray                  # (..., 3): where it is
    determinant: np.ndarray             # (...): smallest of the acoustic tensor, in p^2 (e_r = 0) or p^3
    determinant_normal: np.ndarray      # (..., 3): where it is


STEADY_DECAYS = 39.0    # exp(-39) is below round-off; Z2 decays by exp(-d2 s), s half the shear strain, the fabric faster
SLOWEST_DECAY = 1.0     # d2 below which steady states are not waited for any longer


def _check_threads(threads):
    if isinstance(threads, bool) or not isinstance(threads, (int, np.integer)) or threads < 1:
        raise ValueError(f"threads = {threads!r}: must be an integer, at least 1")


def _remake(given):
    return Material(**given)


def _components(name, value, faults):
    try:
        value = np.asarray(value, float)
    except (TypeError, ValueError):
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
