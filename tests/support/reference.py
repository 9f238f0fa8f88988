"""The paper's equations integrated by SciPy's adaptive 8th-order method: shares no code with the core.

Full 3 x 3 tensors, compression-positive stress, the rate form as printed (spec: a2 = +0.1 mu, dA/dt + A W - W A).
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq


def constants(mu, closure="full"):
    """Table 1 and table 2 as a dict."""
    c = {
        "a1": 0.0073, "a2": 0.1 * mu, "a3": 1.57 * np.exp(-4.5 * mu) - 1.7, "a4": 6 - 6 * np.exp(-2 * mu),
        "b1": 0.16 - 0.16 * np.exp(-6 * mu), "b2": 1.6 * np.exp(-6 * mu) - 2.9, "b3": 0.0,
        "Zc": 1.85 * np.exp(-5 * mu) + 4.15, "phic": 0.058 * np.exp(-5 * mu) + 0.582,
        "c1": -0.52, "c2": -2.8, "c3": 100.0, "d1": -45.0, "d2": 5.6, "d3": -40.0,
        "beta1": 7.5, "beta2": 0.5, "g": 0.0, "elastic_strain": 0.0,
    }
    if closure == "basic":
        c["a3"] = 0.0
    if closure in ("kinematic", "mobilised", "mobilised-pressure"):
        c["a4"] = -2 * c["b2"]
    if closure in ("basic", "n2"):
        c["a4"] = 0.0
    return c


def double_dot(x, y):
    return np.einsum("...ij,...ij->...", x, y)


def magnitude(x):
    return np.sqrt(double_dot(x, x) / 2)


def scale(s, x):
    """Scalars (...) times tensors (..., 3, 3)."""
    return np.asarray(s)[..., None, None] * x


def parts(gradient):
    """D, W, S, |D|, |S|, tr D of displacement gradient increments (..., 3, 3)."""
    transposed = np.swapaxes(gradient, -1, -2)
    d, w = (gradient + transposed) / 2, (gradient - transposed) / 2
    tr = np.trace(d, axis1=-2, axis2=-1)
    s = d - scale(tr / 3, np.eye(3))
    return d, w, s, magnitude(d), magnitude(s), tr


def model_stress(c, fabric, z2, s_hat, expansion, contact):
    """Pressure (4.2)/(4.4) and sigma' (A 4), compression positive, of S^ and tr D^."""
    x = double_dot(fabric, s_hat)
    p = (c["a1"] + c["a2"] * magnitude(fabric) + c["g"] * expansion) * np.maximum(z2 - c["Zc"], 0) ** 2
    if contact == "hertzian":
        p = p ** 1.5
    eta = c["b1"] + c["b2"] * x + c["b3"] * x**2
    product = fabric @ s_hat
    product = product + np.swapaxes(product, -1, -2) - scale(2 / 3 * x, np.eye(3))
    ratio = -scale(eta, s_hat) + c["a3"] * product + c["a4"] * (fabric - scale(x / 2, s_hat))
    return p, scale(p, ratio)


def integrate(c, fabric, z2, phi, gradient, deviator=None, contact="hookean", rtol=1e-13, max_step=np.inf):
    """State after the increments `gradient` (n, 3, 3), each with constant velocity gradient over 0 <= t <= 1.

    Returns fabric (n, 3, 3), Z2 (n,), phi (n,), p (n,), sigma' (n, 3, 3), compression positive.
    """
    n = len(gradient)
    _, w, s, mod_d, mod_s, tr = parts(gradient)
    c1, c2, c3 = c["c1"], c["c2"], c["c3"]
    chi = -(c2 + np.sqrt(c2**2 - 8 * c1 * c3)) / (2 * c3)
    relaxing = c["elastic_strain"] > 0
    s_hat, expansion = scale(1 / mod_d, s), tr / mod_d

    def rate(y):
        y = y.reshape(n, -1)
        a, z, ph, dev = y[:, :9].reshape(n, 3, 3), y[:, 9], y[:, 10], y[:, 11:20].reshape(n, 3, 3)
        dot = np.empty_like(y)
        a_s = double_dot(a, s)
        dot_a = w @ a - a @ w + c1 * s + scale(c2 * mod_d, a) + scale(c3 * a_s, a)                   # (4.7)
        f = c["Zc"] + c["beta1"] * np.maximum(ph - c["phic"], 0) ** c["beta2"]                         # (4.9)
        dot[:, 9] = c["d1"] * (a_s - chi * mod_s) + c["d2"] * mod_d * (f - z) + c["d3"] * tr           # (4.8)
        dot[:, 10] = -ph * tr
        dot[:, :9] = dot_a.reshape(n, 9)
        dot[:, 11:20] = 0
        if relaxing:
            target = model_stress(c, a, z, s_hat, expansion, contact)[1]
            dot_dev = w @ dev - dev @ w + scale(mod_d / c["elastic_strain"], target - dev)
            dot[:, 11:20] = dot_dev.reshape(n, 9)
        return dot.ravel()

    start = np.zeros((n, 20))
    start[:, :9] = np.reshape(fabric, (n, 9))
    start[:, 9], start[:, 10] = z2, phi
    if relaxing:
        start[:, 11:20] = np.reshape(deviator, (n, 9))
    # f has infinite slope at phic: clock every point so that t - crossing = (clock - 1)^2 there
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = np.clip(np.nan_to_num(np.log(phi / c["phic"]) / tr), 0, 1)[:, None]

    def clocked(clock, y):
        speed = 2 * np.where(clock < 1, crossing * (1 - clock), (1 - crossing) * (clock - 1))
        return (rate(y).reshape(n, 20) * speed).ravel()

    y = start.ravel()
    for span in ((0, 1), (1, 2)):
        solution = solve_ivp(clocked, span, y, method="DOP853", rtol=rtol, atol=rtol * 1e-2, max_step=max_step)
        assert solution.success, solution.message
        y = solution.y[:, -1]
    y = y.reshape(n, 20)
    a, z, ph = y[:, :9].reshape(n, 3, 3), y[:, 9], y[:, 10]
    p, model = model_stress(c, a, z, s_hat, expansion, contact)
    return a, z, ph, p, (y[:, 11:20].reshape(n, 3, 3) if relaxing else model)


def first_corner(direction, w, s_hat, ratio, local=1.0):
    """The time in (0, 1) at which M:S^ first changes its sign, by a matrix exponential; 1 if it does not. local: |D|/m."""
    turn = np.kron(w, np.eye(3)) + np.kron(np.eye(3), w) - ratio * np.eye(9)                      # of the nine components of M
    system = np.zeros((10, 10))
    system[:9, :9], system[:9, 9] = turn, ratio * local * s_hat.ravel()
    onto = np.append(s_hat.ravel(), (1 - local) * double_dot(s_hat, s_hat))
    solutions = [np.append(direction, 1)]
    step = expm(system / 40)
    for _ in range(40):
        solutions.append(step @ solutions[-1])
    values = np.array(solutions) @ onto
    changes = np.flatnonzero(values[:-1] * values[1:] < 0)
    if not len(changes):
        return 1.0
    k = changes[0]
    return brentq(lambda t: onto @ expm(t * system) @ solutions[0], k / 40, (k + 1) / 40, xtol=1e-16, rtol=1e-15)


def integrate_mobilised(c, fabric, z2, phi, direction, gradient, contact="hookean", rtol=1e-13, pressure_evolves=False):
    """As `integrate`, in the closure "mobilised": also takes and returns the mobilised direction M (n, 3, 3), before p and sigma'.

    In "mobilised-pressure" z in the rates is half of p d/k/(a1 + a2 kappa), negative where Z2 < Zc. phi may not cross phic. The
    clock of every point stands at 1 where its M:S^ first changes its sign, a corner of the rates.
    """
    n = len(gradient)
    _, w, s, mod_d, mod_s, tr = parts(gradient)
    chi = -(c["c2"] + np.sqrt(c["c2"]**2 - 8 * c["c1"] * c["c3"])) / (2 * c["c3"])
    slow = -c["c1"] / (c["c2"] + c["c3"] * chi)                                                        # lambda (A 9)
    s_hat = scale(1 / mod_d, s)

    def rate(_, y):
        a, m, z, ph = np.split(y.reshape(n, 20), (9, 18, 19), axis=1)
        a, m, z, ph = a.reshape(n, 3, 3), m.reshape(n, 3, 3), z[:, 0], ph[:, 0]
        a_s = double_dot(a, s)
        dot_a = w @ a - a @ w + c["c1"] * s + scale(c["c2"] * mod_d, a) + scale(c["c3"] * a_s, a)
        dot_m = w @ m - m @ w + scale(mod_d / c["elastic_strain"], s_hat - m)
        share = np.maximum(double_dot(m, s_hat) / 2, 0)
        f = c["beta1"]**2 / 2 * (ph - c["phic"]) if pressure_evolves else c["beta1"] * np.maximum(ph - c["phic"], 0) ** c["beta2"]
        dot_z = c["d1"] * (a_s - chi * share * mod_s) + c["d2"] * mod_d * (f - z) + c["d3"] * tr
        return np.column_stack([dot_a.reshape(n, 9), dot_m.reshape(n, 9), dot_z, -ph * tr]).ravel()

    corner = np.array([first_corner(*point) for point in zip(direction, w, s_hat, mod_d / c["elastic_strain"])])[:, None]
    stiffness = c["a1"] + c["a2"] * abs(slow)                                                          # kappa = abs(lambda)
    z = z2 - c["Zc"]
    if pressure_evolves:
        z = z * abs(z) / 2 * (c["a1"] + c["a2"] * magnitude(fabric)) / stiffness
    y = np.column_stack([np.reshape(fabric, (n, 9)), np.reshape(direction, (n, 9)), z, phi]).ravel()
    for share in (corner, 1 - corner):
        solution = solve_ivp(lambda t, y, share=share: (share * rate(t, y).reshape(n, 20)).ravel(), (0, 1), y,
                             method="DOP853", rtol=rtol, atol=rtol * 1e-2)
        assert solution.success, solution.message
        y = solution.y[:, -1]
    a, m, z, ph = np.split(y.reshape(n, 20), (9, 18, 19), axis=1)
    a, m, z, ph = a.reshape(n, 3, 3), m.reshape(n, 3, 3), z[:, 0], ph[:, 0]
    if pressure_evolves:
        z = np.sign(z) * np.sqrt(2 * abs(z) * stiffness / (c["a1"] + c["a2"] * magnitude(a)))
    z = c["Zc"] + z
    p, _ = model_stress(c, a, z, s_hat, tr / mod_d, contact)
    ratio = -c["b1"] * m - 2 * c["b2"] * a + 2 * c["a3"] / slow * (a @ a - scale(double_dot(a, a) / 3, np.eye(3)))
    return a, z, ph, m, p, scale(p, ratio)


def random_increments(rng, n, mu, shear, spin=3.0, volume=0.5, margin=0.005, excess=(0.2, 1.2)):
    """Random fabrics, Z2, phi and displacement gradients (n, 3, 3): shear strains up to `shear`, spins up to `spin` times as
    large, volume strains up to `volume` times |S| that keep phi at least `margin` above phic at both ends."""
    c = constants(mu)

    def random_tensors(sign):
        x = rng.normal(size=(n, 3, 3))
        x = x + sign * np.swapaxes(x, 1, 2)
        x = x - scale(np.trace(x, axis1=1, axis2=2) / 3, np.eye(3))
        return scale(1 / magnitude(x), x)

    size = shear / 2 * rng.random(n)
    fabric = scale(0.0444 * rng.random(n), random_tensors(1))
    phi, phi_end = c["phic"] + margin + 0.04 * rng.random((2, n))
    volume_strain = np.clip(np.log(phi / phi_end), -volume * size, volume * size)
    gradient = scale(size, random_tensors(1)) + scale(spin * size * rng.random(n), random_tensors(-1))
    gradient = gradient + scale(volume_strain / 3, np.eye(3))
    return fabric, c["Zc"] + rng.uniform(*excess, n), phi, gradient


def integrate_critical(c, phi, gradient, deviator, contact="hookean", rtol=1e-13):
    """As `integrate`, in the critical-state closure (A 10)-(A 12): A = lambda S^, Z2 = f(phi); p (n,) and sigma' (n, 3, 3)."""
    n = len(gradient)
    _, w, s, mod_d, _, tr = parts(gradient)
    chi = -(c["c2"] + np.sqrt(c["c2"]**2 - 8 * c["c1"] * c["c3"])) / (2 * c["c3"])
    slow = -c["c1"] / (c["c2"] + c["c3"] * chi)                                                        # lambda (A 9)
    s_hat = scale(1 / mod_d, s)
    fabric = slow * s_hat
    bracket = 2 * slow * (s_hat @ s_hat - scale(double_dot(s_hat, s_hat) / 3, np.eye(3)))      # traceless: docs/theory.md, 1.5
    ratio = -(c["b1"] + c["b2"] * chi + c["b3"] * chi**2) * s_hat + c["a3"] * bracket

    def pressure(t):
        excess = c["beta1"] * np.maximum(phi * np.exp(-tr * t) - c["phic"], 0) ** c["beta2"]
        p = (c["a1"] + c["a2"] * abs(slow) + c["g"] * tr / mod_d) * excess**2                          # kappa = abs(lambda)
        return p ** 1.5 if contact == "hertzian" else p

    def rate(t, y):
        dev = y.reshape(n, 3, 3)
        return (w @ dev - dev @ w + scale(mod_d / c["elastic_strain"], scale(pressure(t), ratio) - dev)).ravel()

    if not c["elastic_strain"] > 0:
        return fabric, pressure(1.0), scale(pressure(1.0), ratio)
    solution = solve_ivp(rate, (0, 1), np.reshape(deviator, -1), method="DOP853", rtol=rtol, atol=rtol * 1e-4, max_step=0.05)
    assert solution.success, solution.message
    return fabric, pressure(1.0), solution.y[:, -1].reshape(n, 3, 3)


def traceless(x):
    return x - scale(np.trace(x, axis1=-2, axis2=-1) / 3, np.eye(3))


def stress_with_length(c, closure, contact, a, big_m, z, gradient, m):
    """p and sigma' (compression positive) of fabric a, mobilised direction and Z2, or what evolves in its place, with a length."""
    _, _, s, mod_d, _, tr = parts(gradient)
    chi = -(c["c2"] + np.sqrt(c["c2"]**2 - 8 * c["c1"] * c["c3"])) / (2 * c["c3"])
    slow = -c["c1"] / (c["c2"] + c["c3"] * chi)                                                        # lambda (A 9)
    size = abs(slow) if closure == "critical" else magnitude(a)
    p = (c["a1"] + c["a2"] * size + c["g"] * tr / m) * np.maximum(z - c["Zc"], 0) ** 2
    if closure == "mobilised-pressure":
        p = 2 * (c["a1"] + c["a2"] * abs(slow)) * np.maximum(z - c["Zc"], 0)
    p = p ** 1.5 if contact == "hertzian" else p
    if closure.startswith("mobilised"):
        return p, scale(p, -c["b1"] * big_m - 2 * c["b2"] * a + 2 * c["a3"] / slow * traceless(a @ a))
    s_hat, s_over_m = scale(1 / mod_d, s), scale(1 / m, s)
    x = double_dot(a, s_hat)
    eta = c["b1"] + c["b2"] * (np.full(len(m), chi) if closure == "critical" else x)
    ratio = -scale(eta + c["a4"] * x / 2, s_over_m) + c["a3"] * traceless(a @ s_over_m + s_over_m @ a) + c["a4"] * a
    return p, scale(p, ratio)


def integrate_with_length(c, closure, fabric, direction, stress, z2, phi, gradient, nonlocal_strain, contact="hookean", rtol=1e-13):
    """As `integrate`, with nonlocal strains m (n,): docs/theory.md, section 12. All closures; phi may not cross phic.

    Takes and returns tensors (n, 3, 3): fabric, the mobilised direction (unused in other closures), stress, tension positive.
    """
    n, m = len(gradient), nonlocal_strain
    _, w, s, mod_d, mod_s, tr = parts(gradient)
    chi = -(c["c2"] + np.sqrt(c["c2"]**2 - 8 * c["c1"] * c["c3"])) / (2 * c["c3"])
    slow = -c["c1"] / (c["c2"] + c["c3"] * chi)                                                        # lambda (A 9)
    turns, pressure_evolves = closure.startswith("mobilised"), closure == "mobilised-pressure"
    critical_factor = c["a1"] + c["a2"] * abs(slow)                                                    # a1 + a2 kappa
    s_hat, s_over_m = scale(1 / mod_d, s), scale(1 / m, s)

    def microstructure(a, z, ph):
        if closure != "critical":
            return a, z
        return slow * s_hat, c["Zc"] + c["beta1"] * (ph - c["phic"]) ** c["beta2"]

    def rate(_, y):
        a, big_m, dev, rest = np.split(y.reshape(n, 29), (9, 18, 27), axis=1)
        a, big_m, dev, z, ph = a.reshape(n, 3, 3), big_m.reshape(n, 3, 3), dev.reshape(n, 3, 3), rest[:, 0], rest[:, 1]
        a, z = microstructure(a, z, ph)
        a_s = double_dot(a, s)
        dot_a = w @ a - a @ w + c["c1"] * s + scale(c["c2"] * m, a) + scale(c["c3"] * a_s, a)
        dot_m, dot_dev, share = np.zeros((n, 3, 3)), np.zeros((n, 3, 3)), np.ones(n)
        if turns:
            dot_m = w @ big_m - big_m @ w + scale(m / c["elastic_strain"], s_over_m - big_m)
            share = np.maximum(double_dot(big_m + s_hat - s_over_m, s_hat) / 2, 0)
        elif c["elastic_strain"] > 0:
            model = stress_with_length(c, closure, contact, a, big_m, z, gradient, m)[1]
            dot_dev = w @ dev - dev @ w + scale(m / c["elastic_strain"], model - dev)
        f = c["Zc"] + c["beta1"] * (ph - c["phic"]) ** c["beta2"]
        f = c["Zc"] + c["beta1"]**2 / 2 * (ph - c["phic"]) if pressure_evolves else f
        dot_z = c["d1"] * (a_s - chi * share * mod_s) + c["d2"] * m * (f - z) + c["d3"] * tr
        return np.column_stack([dot_a.reshape(n, 9), dot_m.reshape(n, 9), dot_dev.reshape(n, 9), dot_z, -ph * tr]).ravel()

    corner = np.ones((n, 1))
    if turns:
        corner[:, 0] = [first_corner(*point) for point in zip(direction, w, s_hat, m / c["elastic_strain"], mod_d / m)]
    if pressure_evolves:                               # z - Zc in the rates is half of p d/k/(a1 + a2 kappa)
        z2 = c["Zc"] + (z2 - c["Zc"]) * abs(z2 - c["Zc"]) / 2 * (c["a1"] + c["a2"] * magnitude(fabric)) / critical_factor
    start = [np.reshape(x, (n, 9)) for x in (fabric, direction, -traceless(stress))]
    y = np.column_stack([*start, z2, phi]).ravel()
    for share in (corner, 1 - corner):
        solution = solve_ivp(lambda t, y, share=share: (share * rate(t, y).reshape(n, 29)).ravel(), (0, 1), y, method="DOP853",
                             rtol=rtol, atol=rtol * 1e-2, max_step=0.05)
        assert solution.success, solution.message
        y = solution.y[:, -1]
    a, big_m, dev, rest = np.split(y.reshape(n, 29), (9, 18, 27), axis=1)
    big_m, z, ph = big_m.reshape(n, 3, 3), rest[:, 0], rest[:, 1]
    a, z = microstructure(a.reshape(n, 3, 3), z, ph)
    p, model = stress_with_length(c, closure, contact, a, big_m, z, gradient, m)
    if pressure_evolves:
        z = z - c["Zc"]
        z = c["Zc"] + np.sign(z) * np.sqrt(2 * abs(z) * critical_factor / (c["a1"] + c["a2"] * magnitude(a)))
    dev = dev.reshape(n, 3, 3) if c["elastic_strain"] > 0 and not turns else model
    return a, z, ph, big_m, -dev - scale(p, np.eye(3))
