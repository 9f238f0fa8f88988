"""The law in rate form, as the paper prints it, in NumPy; and solvers for it that share no code with the core.

The solvers are a Runge-Kutta method in NumPy for a batch of points, SciPy's for one point, and a reference to measure errors with.
Here a component is a float for one point or an array (n,) for many. A list y of unknowns holds A_xx A_yy A_zz A_xy A_xz A_yz, Z2,
phi and, with e_r > 0, the six components of sigma' (compression positive). Plain floats are the fastest right-hand side that SciPy
can be given for one point: with `y.tolist()` the general equations take as long as equations of simple shear alone do with NumPy's
scalars, and a step of SciPy takes longer than either.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .. import tensors
from ..material import Material

REFERENCE_RTOL = 1e-13
REFERENCE_MAX_STEP = 1 / 16        # of an increment; half of it changes nothing above 1e-12 (tests/test_chart.py)
VOLUME_RATE_TOLERANCE = 1e-14      # of the volume strain rate at constant pressure, per unit of shear strain
MOST_ITERATIONS = 50

Component = Any                    # float or array (n,)
Components = Sequence[Component] | np.ndarray
Constants = Mapping[str, float]


# ---- the equations ---------------------------------------------------------------------------------------------------

def contract(x: Components, y: Components) -> Component:
    """X:Y of symmetric tensors with six components each."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + 2 * (x[3] * y[3] + x[4] * y[4] + x[5] * y[5])


def magnitude(x: Components) -> Component:
    """The paper's abs(T) = sqrt(T:T/2)."""
    return (contract(x, x) / 2) ** 0.5


def positive(x: Component) -> Component:
    """max(x, 0), of a float or an array."""
    return (x + abs(x)) / 2


class Flow(NamedTuple):
    """A velocity gradient that is constant over an increment."""

    S: Components           # dev D
    w: Components           # W_xy W_xz W_yz
    mod_S: Component        # |S|
    mod_D: Component        # |D|
    tr_D: Component         # tr D

    @classmethod
    def of(cls, gradient: Any) -> "Flow":
        """From gradient[i][j] = du_i/dx_j."""
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = gradient
        tr = xx + yy + zz
        S = (xx - tr / 3, yy - tr / 3, zz - tr / 3, (xy + yx) / 2, (xz + zx) / 2, (yz + zy) / 2)
        mod_S = magnitude(S)
        return cls(S, ((xy - yx) / 2, (xz - zx) / 2, (yz - zy) / 2), mod_S, (mod_S * mod_S + tr * tr / 6) ** 0.5, tr)

    def with_volume_rate(self, tr_D: Component) -> "Flow":
        """The same S and W with another tr D."""
        return self._replace(mod_D=(self.mod_S * self.mod_S + tr_D * tr_D / 6) ** 0.5, tr_D=tr_D)


def corotate(w: Components, x: Components) -> Components:
    """W X - X W, the part of dX/dt that is due to the spin."""
    (a, b, c), (xx, yy, zz, xy, xz, yz) = w, x
    axy, bxz, cyz = a * xy, b * xz, c * yz
    return (2 * (axy + bxz), 2 * (cyz - axy), -2 * (bxz + cyz),
            a * (yy - xx) + b * yz + c * xz, a * yz + b * (zz - xx) - c * xy, c * (zz - yy) - a * xz - b * xy)


def pressure(c: Constants, A: Components, z2: Component) -> Component:
    """Pressure p of a Hookean material (4.2)."""
    return (c["a1"] + c["a2"] * magnitude(A)) * positive(z2 - c["Zc"]) ** 2


def deviatoric_stress(c: Constants, flow: Flow, A: Components, z2: Component) -> list[Component]:
    """Deviatoric stress sigma' (A 4) with eta of (4.5), compression positive."""
    xx, yy, zz, xy, xz, yz = A
    n1, n2, n3, n4, n5, n6 = n = [component / flow.mod_D for component in flow.S]                     # S^
    x = contract(A, n)                                                                                # A:S^
    product = (2 * (xx * n1 + xy * n4 + xz * n5), 2 * (xy * n4 + yy * n2 + yz * n6), 2 * (xz * n5 + yz * n6 + zz * n3),
               xx * n4 + xy * (n1 + n2) + xz * n6 + yy * n4 + yz * n5,
               xx * n5 + xy * n6 + xz * (n1 + n3) + yz * n4 + zz * n5,
               xy * n5 + yy * n6 + yz * (n2 + n3) + zz * n6 + xz * n4)                                # A S^ + S^ A
    along_S = c["b1"] + c["b2"] * x + c["a4"] * x / 2
    isotropic = c["a3"] * (2 / 3 * x)
    p = pressure(c, A, z2)
    over_p = [c["a3"] * q + c["a4"] * a - along_S * m for q, a, m in zip(product, A, n)]
    return [p * (component - isotropic) for component in over_p[:3]] + [p * component for component in over_p[3:]]


def steady_coordination(c: Constants, phi: Component) -> Component:
    """The f of (4.9), the Z2 towards which (4.8) tends at constant volume once A:S^ = chi."""
    return c["Zc"] + c["beta1"] * positive(phi - c["phic"]) ** c["beta2"]


def rate(c: Constants, flow: Flow, y: Components) -> list[Component]:
    """Rates of the unknowns.

    Parameters
    ----------
    c : dict of str to float
        Constants of a Hookean material with the closure "full".
    flow : Flow
    y : list of components

    Returns
    -------
    list of components
        dy/dt, ordered as y: (4.7), (4.8), the balance of mass and, with e_r > 0, the relaxation of sigma'.
    """
    A, z2, phi = y[:6], y[6], y[7]
    a_s = contract(A, flow.S)
    factor, c1 = c["c2"] * flow.mod_D + c["c3"] * a_s, c["c1"]
    dot = [spin + c1 * s + factor * a for spin, s, a in zip(corotate(flow.w, A), flow.S, A)]           # (4.7)
    f = steady_coordination(c, phi)
    dot.append(c["d1"] * (a_s - c["chi"] * flow.mod_S) + c["d2"] * flow.mod_D * (f - z2) + c["d3"] * flow.tr_D)   # (4.8)
    dot.append(-phi * flow.tr_D)
    if c["elastic_strain"] > 0:
        dev, relaxation = y[8:], flow.mod_D / c["elastic_strain"]
        dot += [spin + relaxation * (model - s)
                for spin, model, s in zip(corotate(flow.w, dev), deviatoric_stress(c, flow, A, z2), dev)]
    return dot


def rate_at_constant_pressure(c: Constants, flow: Flow, y: Components) -> list[Component]:
    """Rates of the unknowns of one jammed point with A not 0, with the tr D that makes dp/dt = 0.

    p of (4.2) depends on A and Z2, whose rates are affine in tr D but for |D|; a few fixed-point iterations give tr D to round-off.

    Parameters
    ----------
    c, y
        As in `rate`.
    flow : Flow
        Its tr D is where the iteration starts.

    Returns
    -------
    list of components

    Raises
    ------
    ArithmeticError
        If the iteration does not converge.
    """
    A, excess = y[:6], y[6] - c["Zc"]
    mod_A = magnitude(A)
    factor = c["a1"] + c["a2"] * mod_A
    for _ in range(MOST_ITERATIONS):
        dot = rate(c, flow, y)
        dot_mod_A = contract(A, dot[:6]) / (2 * mod_A)
        dot_p = c["a2"] * dot_mod_A * excess + 2 * factor * dot[6]                                     # over Z2 - Zc
        change = -dot_p / (2 * factor * c["d3"])                                                       # tr D acts on Z2 by d3 tr D
        if abs(change) < VOLUME_RATE_TOLERANCE:
            return dot
        flow = flow.with_volume_rate(flow.tr_D + change)
    raise ArithmeticError("no volume strain rate keeps the pressure")


# ---- states and results ----------------------------------------------------------------------------------------------

def unknowns(material: Material, states: np.ndarray) -> np.ndarray:
    """The unknowns y (m, n) of states (n,) of dtype STATE; m is 8, or 14 with e_r > 0."""
    y = [*states["fabric"].T, states["coordination_number"], states["volume_fraction"]]
    if material["elastic_strain"] > 0:
        y += [*-tensors.deviator(states["stress"]).T]
    return np.array(y)


def components_first(gradients: np.ndarray) -> np.ndarray:
    """Displacement gradients (steps, n, 3, 3) as (steps, 3, 3, n), the order of the equations above."""
    return np.ascontiguousarray(np.moveaxis(gradients, 1, 3))


def result(c: Constants, flow: Flow, y: Components) -> np.ndarray:
    """Rows (14, n) of a result: A, Z2, phi and the stress, tension positive as in a STATE."""
    dev = y[8:] if c["elastic_strain"] > 0 else deviatoric_stress(c, flow, y[:6], y[6])
    p = pressure(c, y[:6], y[6])
    return np.array([*y[:8], *(-s - p for s in dev[:3]), *(-s for s in dev[3:])])


# ---- solvers ---------------------------------------------------------------------------------------------------------

def runge_kutta(material: Material, y: np.ndarray, gradients: np.ndarray, substeps: int) -> np.ndarray:
    """Integrate by the classical Runge-Kutta method in NumPy, all points together.

    Parameters
    ----------
    material : Material
        Hookean, with the closure "full".
    y : array (m, n)
        The unknowns at the start.
    gradients : array (steps, 3, 3, n)
        Displacement gradient of each increment.
    substeps : int
        Equal substeps of each increment.

    Returns
    -------
    array (steps, 14, n)
        `result` after each increment.
    """
    c, h = material.constants, 1 / substeps
    trajectory = np.empty((len(gradients), 14, y.shape[1]))
    for gradient, end in zip(gradients, trajectory):
        flow = Flow.of(gradient)
        for _ in range(substeps):
            k1 = np.array(rate(c, flow, y))
            k2 = np.array(rate(c, flow, y + h / 2 * k1))
            k3 = np.array(rate(c, flow, y + h / 2 * k2))
            k4 = np.array(rate(c, flow, y + h * k3))
            y = y + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        end[:] = result(c, flow, y)
    return trajectory


def scipys_solver() -> Callable[..., Any]:
    """The function scipy.integrate.solve_ivp.

    Returns
    -------
    function

    Raises
    ------
    ImportError
        If there is no SciPy; says what to install.
    """
    try:
        from scipy.integrate import solve_ivp
    except ImportError as error:
        raise ImportError("the comparison with SciPy's solvers needs SciPy: install Debian's python3-scipy, or granumat[study] by "
                          f"pip ({error})") from error
    return solve_ivp


def solve_point(material: Material, y: np.ndarray, gradients: np.ndarray, method: str, rtol: float) -> np.ndarray:
    """Integrate one point by SciPy's solve_ivp; equal increments in a row are one call, with output in between.

    Parameters
    ----------
    material : Material
        Hookean, with the closure "full".
    y : array (m,)
        The unknowns at the start.
    gradients : array (steps, 3, 3)
    method : str
        Of solve_ivp.
    rtol : float
        Relative tolerance; the absolute one is a hundredth of it.

    Returns
    -------
    array (steps, 14)
        `result` after each increment.

    Raises
    ------
    ArithmeticError
        If SciPy gives up.
    """
    solve_ivp, c, trajectory = scipys_solver(), material.constants, []
    changes = np.flatnonzero((gradients[1:] != gradients[:-1]).any((1, 2))) + 1
    for equal in np.split(gradients, changes):
        flow = Flow.of(equal[0].tolist())
        times = np.arange(1.0, len(equal) + 1)
        solution = solve_ivp(lambda _, y, flow=flow: rate(c, flow, y.tolist()), (0, len(equal)), y, method, times, rtol=rtol,
                             atol=rtol * 1e-2)
        if not solution.success:
            raise ArithmeticError(solution.message)
        y = solution.y[:, -1]
        trajectory += [result(c, flow, column.tolist()) for column in solution.y.T]
    return np.array(trajectory)


def reference(material: Material, y: np.ndarray, gradients: np.ndarray, max_step: float = REFERENCE_MAX_STEP) -> np.ndarray:
    """Integrate all points together by SciPy's adaptive 8th-order method, DOP853, with the relative tolerance REFERENCE_RTOL.

    Parameters
    ----------
    material, y, gradients
        As in `runge_kutta`.
    max_step : float
        Largest step, in increments.

    Returns
    -------
    array (steps, 14, n)
        `result` after each increment.
    """
    c, trajectory = material.constants, []
    for gradient in gradients:
        flow = Flow.of(gradient)
        y = _reference_increment(c, y, flow, max_step)
        trajectory.append(result(c, flow, y))
    return np.array(trajectory)


def _reference_increment(c: Constants, y: np.ndarray, flow: Flow, max_step: float) -> np.ndarray:
    """The unknowns y after one increment 0 <= t <= 1.

    f (4.9) has an infinite slope at phi = phic, which each point reaches at a time t_c of its own. In the variable u with
    t - t_c = u abs(u), the square root of (4.9) is smooth on either side of u = 0, so each point is integrated over u, first to 0
    and then from 0. Points that stay away from phic are integrated in the same way with t_c outside the increment.
    """
    solve_ivp = scipys_solver()
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = np.clip(np.nan_to_num(np.log(y[7] / c["phic"]) / flow.tr_D), -1, 2)
    start, end = (np.sign(t - crossing) * np.sqrt(np.abs(t - crossing)) for t in (0, 1))
    middle = np.clip(0, start, end)
    flat = y.ravel()
    for first, last in ((start, middle), (middle, end)):
        def rate_in_u(s: float, flat: np.ndarray, first: np.ndarray = first, length: np.ndarray = last - first) -> np.ndarray:
            dot = np.array(rate(c, flow, flat.reshape(y.shape)))
            return (2 * abs(first + s * length) * length * dot).ravel()                 # u = first + s length, dt/du = 2 |u|
        if (last > first).any():
            solution = solve_ivp(rate_in_u, (0, 1), flat, "DOP853", rtol=REFERENCE_RTOL, atol=REFERENCE_RTOL * 1e-2,
                                 max_step=max_step)
            if not solution.success:
                raise ArithmeticError(solution.message)
            flat = solution.y[:, -1]
    return flat.reshape(y.shape)
