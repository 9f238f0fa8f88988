"""The paper's rate equations in Python, and outside solvers of them: NumPy for a batch, SciPy for a point, and a reference.

Shares no code with the core; bench.py has simple shear alone, in fewer components and with the pressure held. Here a component is
a float for one point or an array (n,) for many. A list y holds A_xx A_yy A_zz A_xy A_xz A_yz, Z2, phi and, with e_r > 0, the six
components of sigma' (compression positive).
"""

from typing import NamedTuple

import numpy as np

from .. import tensors

REFERENCE_RTOL = 1e-13
REFERENCE_MAX_STEP = 1 / 16        # of an increment; half of it changes nothing above 1e-12 (tests/test_chart.py)


# ---- the equations ---------------------------------------------------------------------------------------------------

def contract(x, y):
    """X : Y of six components each."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + 2 * (x[3] * y[3] + x[4] * y[4] + x[5] * y[5])


def modulus(x):
    """The paper's abs(T) = sqrt(T:T/2) of six components."""
    return (contract(x, x) / 2) ** 0.5


def positive(x):
    """max(x, 0), of a float or an array."""
    return (x + abs(x)) / 2


class Flow(NamedTuple):
    """A constant velocity gradient over an increment."""

    S: tuple            # dev D, six components
    w: tuple            # W_xy W_xz W_yz
    mod_S: object
    mod_D: object
    tr_D: object

    @classmethod
    def of(cls, gradient):
        """From gradient[i][j] = du_i/dx_j."""
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = gradient
        tr = xx + yy + zz
        S = (xx - tr / 3, yy - tr / 3, zz - tr / 3, (xy + yx) / 2, (xz + zx) / 2, (yz + zy) / 2)
        mod_S = modulus(S)
        return cls(S, ((xy - yx) / 2, (xz - zx) / 2, (yz - zy) / 2), mod_S, (mod_S * mod_S + tr * tr / 6) ** 0.5, tr)


def turning(w, x):
    """W X - X W."""
    (a, b, c), (xx, yy, zz, xy, xz, yz) = w, x
    axy, bxz, cyz = a * xy, b * xz, c * yz
    return (2 * (axy + bxz), 2 * (cyz - axy), -2 * (bxz + cyz),
            a * (yy - xx) + b * yz + c * xz, a * yz + b * (zz - xx) - c * xy, c * (zz - yy) - a * xz - b * xy)


def stress(c, flow, A, z2):
    """p (4.2) and the six components of sigma' (A 4), Hookean, compression positive."""
    xx, yy, zz, xy, xz, yz = A
    n1, n2, n3, n4, n5, n6 = n = [component / flow.mod_D for component in flow.S]                     # S^
    x = contract(A, n)
    p = (c["a1"] + c["a2"] * modulus(A)) * positive(z2 - c["Zc"]) ** 2
    product = (2 * (xx * n1 + xy * n4 + xz * n5), 2 * (xy * n4 + yy * n2 + yz * n6), 2 * (xz * n5 + yz * n6 + zz * n3),
               xx * n4 + xy * (n1 + n2) + xz * n6 + yy * n4 + yz * n5,
               xx * n5 + xy * n6 + xz * (n1 + n3) + yz * n4 + zz * n5,
               xy * n5 + yy * n6 + yz * (n2 + n3) + zz * n6 + xz * n4)                                # A S^ + S^ A
    along = c["b1"] + c["b2"] * x + c["a4"] * x / 2
    third = 2 / 3 * x
    ratio = [c["a3"] * q + c["a4"] * a - along * m for q, a, m in zip(product, A, n)]
    return p, [p * (r - c["a3"] * third) for r in ratio[:3]] + [p * r for r in ratio[3:]]


def rate(c, flow, y):
    """dy per increment, a list as y."""
    A, z2, phi = y[:6], y[6], y[7]
    a_s = contract(A, flow.S)
    grow, c1 = c["c2"] * flow.mod_D + c["c3"] * a_s, c["c1"]
    dot = [turn + c1 * s + grow * a for turn, s, a in zip(turning(flow.w, A), flow.S, A)]              # (4.7)
    f = c["Zc"] + c["beta1"] * positive(phi - c["phic"]) ** c["beta2"]                                 # (4.9)
    dot.append(c["d1"] * (a_s - c["chi"] * flow.mod_S) + c["d2"] * flow.mod_D * (f - z2) + c["d3"] * flow.tr_D)   # (4.8)
    dot.append(-phi * flow.tr_D)
    if c["elastic_strain"] > 0:
        dev, fast = y[8:], flow.mod_D / c["elastic_strain"]
        dot += [turn + fast * (m - s) for turn, m, s in zip(turning(flow.w, dev), stress(c, flow, A, z2)[1], dev)]
    return dot


# ---- states and results ----------------------------------------------------------------------------------------------

def unknowns(material, states):
    """y (m, n) of states (n,)."""
    y = [*states["fabric"].T, states["coordination_number"], states["volume_fraction"]]
    if material["elastic_strain"] > 0:
        y += [*-tensors.deviator(states["stress"]).T]
    return np.array(y)


def components_first(gradients):
    """Gradients (steps, n, 3, 3) as (steps, 3, 3, n), the order of the equations above."""
    return np.ascontiguousarray(np.moveaxis(gradients, 1, 3))


def result(c, flow, y):
    """Rows of a result, (14, n): A, Z2, phi and the stress, tension positive as in a STATE."""
    p, dev = stress(c, flow, y[:6], y[6])
    if c["elastic_strain"] > 0:
        dev = y[8:]
    return np.array([*y[:8], *(-s - p for s in dev[:3]), *(-s for s in dev[3:])])


# ---- solvers ---------------------------------------------------------------------------------------------------------

def runge_kutta(material, y, gradients, substeps):
    """Classical Runge-Kutta in NumPy, all points together.

    Parameters
    ----------
    material : Material
        Closure full, Hookean.
    y : array (m, n)
        The unknowns at the start.
    gradients : array (steps, 3, 3, n)
    substeps : int
        Of each increment.

    Returns
    -------
    array (steps, 14, n)
        `result` after each increment.
    """
    c, h = material.constants, 1 / substeps
    path = np.empty((len(gradients), 14, y.shape[1]))
    for gradient, row in zip(gradients, path):
        flow = Flow.of(gradient)
        for _ in range(substeps):
            k1 = np.array(rate(c, flow, y))
            k2 = np.array(rate(c, flow, y + h / 2 * k1))
            k3 = np.array(rate(c, flow, y + h / 2 * k2))
            k4 = np.array(rate(c, flow, y + h * k3))
            y = y + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        row[:] = result(c, flow, y)
    return path


def solve_point(material, y, gradients, method, rtol):
    """SciPy's solve_ivp for one point; increments that repeat the one before share a call, with output in between.

    Parameters and result as in runge_kutta, without the last axis. ArithmeticError where SciPy gives up.
    """
    from scipy.integrate import solve_ivp
    c, path = material.constants, []
    changes = np.flatnonzero((gradients[1:] != gradients[:-1]).any((1, 2))) + 1
    for run in np.split(gradients, changes):
        flow = Flow.of(run[0].tolist())
        times = np.arange(1.0, len(run) + 1)
        solution = solve_ivp(lambda _, y, flow=flow: rate(c, flow, y.tolist()), (0, len(run)), y, method, times, rtol=rtol,
                             atol=rtol * 1e-2)
        if not solution.success:
            raise ArithmeticError(solution.message)
        y = solution.y[:, -1]
        path += [result(c, flow, column.tolist()) for column in solution.y.T]
    return np.array(path)


def reference(material, y, gradients, max_step=REFERENCE_MAX_STEP):
    """As runge_kutta, by SciPy's adaptive 8th-order method at REFERENCE_RTOL with steps of at most max_step of an increment."""
    c, path = material.constants, []
    for gradient in gradients:
        flow = Flow.of(gradient)
        y = _reference_increment(c, y, flow, max_step)
        path.append(result(c, flow, y))
    return np.array(path)


def _reference_increment(c, y, flow, max_step):
    """y after one increment, in the clock u of each point with t - t_c = u abs(u), where phi = phic at t_c: f has infinite
    slope there, but is smooth in u on either side. Far from phic any clock serves."""
    from scipy.integrate import solve_ivp
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = np.clip(np.nan_to_num(np.log(y[7] / c["phic"]) / flow.tr_D), -1, 2)
    start, end = (np.sign(t - crossing) * np.sqrt(np.abs(t - crossing)) for t in (0, 1))
    middle = np.clip(0, start, end)
    flat = y.ravel()
    for first, last in ((start, middle), (middle, end)):
        def clocked(s, flat, first=first, length=last - first):
            dot = np.array(rate(c, flow, flat.reshape(y.shape)))
            return (2 * abs(first + s * length) * length * dot).ravel()
        if (last > first).any():
            solution = solve_ivp(clocked, (0, 1), flat, "DOP853", rtol=REFERENCE_RTOL, atol=REFERENCE_RTOL * 1e-2,
                                 max_step=max_step)
            if not solution.success:
                raise ArithmeticError(solution.message)
            flat = solution.y[:, -1]
    return flat.reshape(y.shape)
