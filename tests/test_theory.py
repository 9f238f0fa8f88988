"""docs/theory.md transcribed into NumPy, one point at a time: its formulas give the core's states and tangents.

Numbers in comments are the page's sections and the paper's equations. Substeps are uniform and more than the core's.
"""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from granumat import Material

ORDER = 20                                                                    # of the fabric's series
FINER = 4                                                                     # substeps of a quarter of the core's length
STRESS = 1e-3 * np.array([-4, -3, -5, 1, 0, 2])
AXES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def symmetric(i, j):
    unit = np.zeros((3, 3))
    unit[i, j] = unit[j, i] = 1
    return unit


# 2.1: orthonormal basis of the deviators, unit spins, and W X - X W and dev(X Y + Y X) in components
BASIS = np.array([np.diag([1, -1, 0]), np.diag([-1, -1, 2]) / math.sqrt(3), symmetric(0, 1), symmetric(0, 2), symmetric(1, 2)])
BASIS /= math.sqrt(2)
SPINS = np.array([np.triu(symmetric(*axes)) - np.tril(symmetric(*axes)) for axes in AXES[3:]])
COROTATE = np.einsum("aij,cik,bkj->acb", BASIS, SPINS, BASIS) - np.einsum("aij,bik,ckj->acb", BASIS, BASIS, SPINS)
PRODUCT = np.einsum("aij,bik,ckj->abc", BASIS, BASIS, BASIS)
PRODUCT = PRODUCT + PRODUCT.transpose(0, 2, 1)
VOIGT = np.array([[unit[axes] for unit in BASIS] for axes in AXES])           # six components of a deviator
IDENTITY = np.array([1, 1, 1, 0, 0, 0])

# 3.4: Gauss points on [0, 1]; 4.2: places of polynomials of degree 1, 2, 4, and of those with a steep kernel
POINTS = (np.polynomial.legendre.leggauss(4)[0] + 1) / 2
PLACES = {1: [0, 1], 2: [0, 1 / 2, 1], 4: [0, 1 / 2 - math.sqrt(3 / 28), 1 / 2, 1 / 2 + math.sqrt(3 / 28), 1]}
STEEP, CROWDED = 2, [0, 0.29, 0.69, 0.93, 1]


def integrals(places):
    """3.4: [i, m], the i-th Lagrange polynomial of the Gauss points integrated up to the m-th place."""
    powers = np.arange(4)[:, None]
    return np.linalg.solve(POINTS**powers, np.array(places) ** (powers + 1) / (powers + 1))


def size(X):
    return math.sqrt(X @ X / 2)


def commute(v, w):
    """V W - W V of spins 12, 13, 23."""
    return np.array([v[2] * w[1] - v[1] * w[2], v[0] * w[2] - v[2] * w[0], v[1] * w[0] - v[0] * w[1]])


def moments(y, x):
    """m_c = y . (W_c x - x W_c) for rows of y."""
    return np.einsum("...a,acb,b->...c", y, COROTATE, x)


def rotation(w):
    """4.5: X -> R X R^T in components, R = exp(W)."""
    W, angle = np.tensordot(w, SPINS, 1), np.linalg.norm(w) + 1e-300
    R = np.eye(3) + math.sin(angle) / angle * W + 2 * (math.sin(angle / 2) / angle) ** 2 * W @ W
    return np.einsum("aij,ik,bkl,jl->ab", BASIS, R, BASIS, R)


def relaxation_weights(ratio, u):
    """4.2, 4.3: weights and their derivative by the ratio."""
    n = len(u)
    moment = np.empty(n)
    moment[-1] = math.exp(-ratio) * sum(ratio ** (k + 1) / math.prod(range(n, n + k + 1)) for k in range(60))
    for j in range(n - 1, 0, -1):
        moment[j - 1] = ratio / j * (moment[j] + math.exp(-ratio))
    slope = math.exp(-ratio) - np.arange(n) * moment / ratio
    return np.linalg.solve(u ** np.arange(n)[:, None], np.array([moment, slope]).T).T


class Law:
    """6: the stress at a microstructure, and its slopes."""

    def __init__(self, c, closure, contact):
        self.c, self.critical, self.hertzian = c, closure == "critical", contact == "hertzian"
        self.mobilised = closure == "mobilised"
        self.relaxes = c["elastic_strain"] > 0 and not self.mobilised

    def excess_target(self, phi):
        """f - Zc (4.9) and its derivative by ln(phi)."""
        distance = max(phi - self.c["phic"], 0)
        f = self.c["beta1"] * distance ** self.c["beta2"]
        return f, (self.c["beta2"] * f / distance * phi if distance > 0 else 0)

    def pressure(self, A, excess, tr_hat):
        """6.1, 6.3: p and its derivatives by A, Z2 - Zc and tr D^."""
        c, z = self.c, max(excess, 0)
        modulus = c["kappa"] if self.critical else size(A)
        factor = c["a1"] + c["a2"] * modulus + c["g"] * tr_hat
        outer = 1.5 * math.sqrt(factor) * z if self.hertzian else 1
        by_A = 0 * A if self.critical else outer * z**2 * c["a2"] * A / (2 * max(modulus, 1e-300))
        return (factor * z**2) ** (1.5 if self.hertzian else 1), by_A, 2 * outer * factor * z, outer * z**2 * c["g"]

    def deviator_over_pressure(self, A, S_hat):
        """6.2, 6.4: n and its derivatives by A and S^, tension positive."""
        c = self.c
        x = c["chi"] if self.critical else A @ S_hat
        eta, slope = c["b1"] + x * (c["b2"] + x * c["b3"]), 0 if self.critical else c["b2"] + 2 * c["b3"] * x
        along, across = slope + c["a4"] / 2, eta + c["a4"] * (A @ S_hat) / 2
        n = across * S_hat - c["a4"] * A - c["a3"] * (PRODUCT @ A) @ S_hat
        return (n, along * np.outer(S_hat, S_hat) - c["a4"] * np.eye(5) - c["a3"] * PRODUCT @ S_hat,
                along * np.outer(S_hat, A) + across * np.eye(5) - c["a3"] * PRODUCT @ A)

    def mobilised_over_pressure(self, A, M):
        """11.2, 11.3: n and its derivatives by A and S^."""
        c, product = self.c, self.c["a3"] / self.c["lambda"] * PRODUCT @ A
        return c["b1"] * M + 2 * c["b2"] * A - product @ A, 2 * c["b2"] * np.eye(5) - 2 * product, np.zeros((5, 5))


class Substep:
    """5.7: one substep, a share of the increment; forward, and (7) backward. Arrays by place begin at the start."""

    def __init__(self, law, inc, share, A, excess, phi, dev, M=None, degree=4):
        c, self.law, self.inc, self.share = law.c, law, inc, share
        self.mod_D, self.tr_D, self.S, self.w = share * inc["mod_D"], share * inc["tr_D"], share * inc["S"], share * inc["w"]
        tau = [math.sqrt(max(math.log(phi / c["phic"]) - t * self.tr_D, 0)) for t in (0, 1)]            # 3.3
        tau = tau if max(tau) > 0 else [1, 1]
        steep = self.mod_D >= STEEP * c["elastic_strain"] > 0
        places = np.array(CROWDED if steep else PLACES[degree])
        self.t_nodes, self.t = (xi * (2 * tau[0] + xi * (tau[1] - tau[0])) / sum(tau) for xi in (POINTS, places))
        self.dt = 2 * (tau[0] + POINTS * (tau[1] - tau[0])) / sum(tau)
        self.integrals = integrals(places)
        self.phi, self.M = phi * np.exp(-self.tr_D * self.t), None                                       # 3.1
        if law.critical:                                                                                # 1.5
            self.excess, self.f_slope = np.array([law.excess_target(value) for value in self.phi]).T
            self.A = np.tile(c["lambda"] * inc["S_hat"], (len(places), 1))
        else:
            self.f, self.f_slope = np.array([law.excess_target(phi * math.exp(-self.tr_D * t)) for t in self.t_nodes]).T
            self.solve_microstructure(c, A, excess, M)
        stress = [law.pressure(A, z, inc["tr_hat"]) for A, z in zip(self.A, self.excess)]
        self.p, self.p_by_A, self.p_by_excess, self.p_by_tr = (np.array(part) for part in zip(*stress))
        n = [law.mobilised_over_pressure(A, self.M) if law.mobilised else law.deviator_over_pressure(A, inc["S_hat"])
             for A in self.A]
        self.n, self.n_by_A, self.n_by_S_hat = (np.array(part) for part in zip(*n))
        self.dev = self.p[-1] * self.n[-1]
        if law.relaxes:                                                                                 # 4
            ratio, self.u = self.mod_D / c["elastic_strain"], 1 - self.t
            self.weights, self.slopes = relaxation_weights(ratio, self.u)
            self.R, self.decayed = [rotation(u * self.w) for u in self.u], math.exp(-ratio)
            self.R_old = rotation(self.w)
            self.old = self.decayed * self.R_old @ dev
            self.rotated = np.array([R @ (p * n) for R, p, n in zip(self.R, self.p, self.n)])
            self.dev = self.old + self.weights @ self.rotated

    def solve_microstructure(self, c, A, excess, M):
        matrix = np.zeros((6, 6))                                                                       # 2.3
        matrix[:5, :5] = c["c2"] * self.mod_D * np.eye(5) + np.einsum("acb,c->ab", COROTATE, self.w)
        matrix[:5, 5], matrix[5, :5] = c["c1"] * self.S, -c["c3"] * self.S
        self.matrix, self.series = matrix, [np.append(A, 1)]
        for k in range(1, ORDER + 1):                                                                   # 2.4
            self.series.append(matrix @ self.series[-1] / k)
        self.series, k = np.array(self.series), np.arange(ORDER + 1)
        self.powers = self.t[:, None] ** k                                                              # [m, k]
        solution = self.powers @ self.series
        self.y, self.A = solution[:, 5], solution[:, :5] / solution[:, 5:]
        self.powers_nodes = self.t_nodes[:, None] ** k                                                  # [i, k]
        self.powers_slope = k * self.t_nodes[:, None] ** np.maximum(k - 1, 0)
        self.y_nodes = self.powers_nodes @ self.series[:, 5]
        self.A_S = -(self.powers_slope @ self.series[:, 5]) / (c["c3"] * self.y_nodes)                   # 2.6
        self.mobilised = np.ones(4)
        if self.law.mobilised:
            self.solve_mobilisation(self.mod_D / c["elastic_strain"], M)
        decay = c["d2"] * self.mod_D                                                                    # 3.2
        forcing = c["d1"] * (self.A_S - c["chi"] * self.mobilised * size(self.S)) + decay * self.f + c["d3"] * self.tr_D
        self.growth, self.decay = np.exp(decay * self.t_nodes), np.exp(-decay * self.t)
        self.integrand = self.growth * self.dt * forcing
        self.excess = (excess + self.integrand @ self.integrals) * self.decay

    def solve_mobilisation(self, ratio, M):
        """11.2"""
        self.turn, self.M_series = np.einsum("acb,c->ab", COROTATE, self.w) - ratio * np.eye(5), [M]
        for k in range(1, ORDER + 1):
            self.M_series.append((self.turn @ self.M_series[-1] + (k == 1) * ratio * self.inc["S_hat"]) / k)
        self.M, self.M_nodes = sum(self.M_series), self.powers_nodes @ self.M_series
        self.mobilised = np.maximum(self.M_nodes @ self.inc["S_hat"] / 2, 0)

    def adjoint(self, f):
        """7.4: adjoints f of the six functions at the end become those at the start."""
        c, share = self.law.c, self.share
        f["tr_D"] = f["tr_D"] - share * f["log_phi"]
        A, excess = np.zeros((6, len(self.t), 5)), np.zeros((6, len(self.t)))                           # [function, place, ...]
        A[:, -1], excess[:, -1] = f["A"], f["excess"]
        if self.law.relaxes:
            self.adjoint_relaxation(c, f, A, excess)
        if self.law.critical:                                                                           # 7.8
            by_log_phi = excess * self.f_slope
            f["log_phi"] = f["log_phi"] + by_log_phi.sum(1)
            f["tr_D"] = f["tr_D"] - share * by_log_phi @ self.t
            f["S_hat"] = f["S_hat"] + c["lambda"] * A.sum(1)
            f["A"], f["excess"] = np.zeros((6, 5)), np.zeros(6)
        else:
            kernel = self.adjoint_microstructure(c, f, A, excess)
            if self.law.mobilised:
                self.adjoint_mobilisation(c, f, excess[:, -1:] * kernel[:, -1])

    def adjoint_mobilisation(self, c, f, by_forcing):
        """11.3"""
        S_hat, share, ratio = self.inc["S_hat"], self.share, self.mod_D / c["elastic_strain"]
        by_projection = -c["d1"] * c["chi"] * size(self.S) * by_forcing * (self.mobilised > 0) / 2       # of M : S^ at the nodes
        f["S_hat"] = f["S_hat"] + by_projection @ self.M_nodes
        g = f["M"][:, None] + np.einsum("fi,ik,a->fka", by_projection, self.powers_nodes, S_hat)
        q = g[:, ORDER]
        for k in range(ORDER, 0, -1):
            f["mod_D"] = f["mod_D"] + share / c["elastic_strain"] / k * q @ ((k == 1) * S_hat - self.M_series[k - 1])
            f["S_hat"] = f["S_hat"] + (k == 1) * ratio * q
            f["w"] = f["w"] + share / k * moments(q, self.M_series[k - 1])
            q = q @ self.turn / k + g[:, k - 1]
        f["M"] = q

    def adjoint_relaxation(self, c, f, A, excess):
        """7.5"""
        dev, second, third = f["dev"], [], []
        places, x = np.append(self.u, 1), np.vstack([self.weights[:, None] * self.rotated, self.old])    # the last: from the start
        for m in range(len(self.t)):
            q = self.weights[m] * dev @ self.R[m]
            by_p = q @ self.n[m]
            A[:, m] += self.p[m] * q @ self.n_by_A[m] + np.outer(by_p, self.p_by_A[m])
            excess[:, m] += by_p * self.p_by_excess[m]
            f["S_hat"] = f["S_hat"] + self.p[m] * q @ self.n_by_S_hat[m]
            f["tr_hat"] = f["tr_hat"] + by_p * self.p_by_tr[m]
        for u in places:
            a = u * np.linalg.norm(self.w)
            second.append((1 - math.cos(a)) / a**2 if a > 1e-2 else 1 / 2 - a**2 / 24 + a**4 / 720)
            third.append((a - math.sin(a)) / a**3 if a > 1e-1 else 1 / 6 - a**2 / 120 + a**4 / 5040 - a**6 / 362880)
        f["mod_D"] = f["mod_D"] + self.share / c["elastic_strain"] * dev @ (self.slopes @ self.rotated - self.old)
        for i in range(6):
            by_1, by_2, by_3 = (moments(dev[i], factor @ x) for factor in (places, places**2 * second, places**3 * third))
            f["w"][i] += self.share * (by_1 + commute(self.w, commute(self.w, by_3) - by_2))
        f["dev"] = self.decayed * dev @ self.R_old

    def adjoint_microstructure(self, c, f, A, excess):
        share, k = self.share, np.arange(ORDER + 1)
        kernel = self.integrals * (self.growth * self.dt)[:, None] * self.decay                          # 7.6: [i, m]
        f["excess"] = excess @ self.decay
        f["mod_S"] = f["mod_S"] - c["d1"] * c["chi"] * share * excess @ (self.mobilised @ kernel)
        by_mod_D = (self.integrals * self.decay).T @ (self.t_nodes * self.integrand) + kernel.T @ self.f - self.t * self.excess
        f["mod_D"] = f["mod_D"] + c["d2"] * share * excess @ by_mod_D
        by_log_phi = c["d2"] * self.mod_D * kernel * self.f_slope[:, None]
        f["log_phi"] = f["log_phi"] + excess @ by_log_phi.sum(0)
        f["tr_D"] = f["tr_D"] + share * excess @ (c["d3"] * kernel.sum(0) - self.t_nodes @ by_log_phi)
        A_S_by_y = -(self.powers_slope / c["c3"] + self.powers_nodes * self.A_S[:, None]) / self.y_nodes[:, None]    # [i, k]
        by_B = A / self.y[:, None]                                                                      # 7.7
        by_y = -np.einsum("fma,ma->fm", by_B, self.A)
        g = np.zeros((6, ORDER + 1, 6))                                                                 # [function, k, (B, y)]
        g[:, :, :5] = np.einsum("mk,fma->fka", self.powers, by_B)
        g[:, :, 5] = by_y @ self.powers + c["d1"] * excess @ kernel.T @ A_S_by_y
        q = g[:, ORDER]
        for k in range(ORDER, 0, -1):
            B, y = self.series[k - 1, :5], self.series[k - 1, 5]
            f["S"] = f["S"] + share / k * (c["c1"] * y * q[:, :5] - c["c3"] * np.outer(q[:, 5], B))
            f["mod_D"] = f["mod_D"] + c["c2"] * share / k * q[:, :5] @ B
            f["w"] = f["w"] + share / k * moments(q[:, :5], B)
            q = q @ self.matrix / k + g[:, k - 1]
        f["A"] = q[:, :5]
        return kernel


def update_with_tangent(material, closure, contact, state, gradient):
    """The new state (fabric, Z2, phi, stress) and d stress / d (strain, spin)."""
    law, c = Law(material.constants, closure, contact), material.constants
    D, W = (gradient + gradient.T) / 2, (gradient - gradient.T) / 2
    mod_D, tr_D, S = math.sqrt((D * D).sum() / 2), np.trace(D), np.tensordot(BASIS, D, 2)
    inc = {"mod_D": mod_D, "tr_D": tr_D, "S": S, "w": np.array([W[axes] for axes in AXES[3:]]),
           "S_hat": S / mod_D, "tr_hat": tr_D / mod_D}
    start = [VOIGT.T @ (state["fabric"] * [1, 1, 1, 2, 2, 2]), state["coordination_number"] - c["Zc"], state["volume_fraction"],
             VOIGT.T @ (state["stress"] * [1, 1, 1, 2, 2, 2]), VOIGT.T @ (state["direction"] * [1, 1, 1, 2, 2, 2])]
    rate = (abs(c["c2"]) + math.sqrt(-2 * c["c1"] * c["c3"])) * mod_D + 2 * np.linalg.norm(inc["w"]) \
        + 2 * (c["c3"] * size(start[0]) + c["d2"]) * mod_D                                              # 5.2
    if law.mobilised:
        rate += mod_D / c["elastic_strain"]
    e = math.log(start[2] / c["phic"])
    crossing = e / tr_D if e * (e - tr_D) < 0 else 1                                                    # 5.1
    steps = []
    for part in (crossing, 1 - crossing):
        n = math.ceil(FINER * part * rate / 0.4)
        for _ in range(n):
            steps.append(Substep(law, inc, part / n, *start))
            start = [steps[-1].A[-1], steps[-1].excess[-1], steps[-1].phi[-1], steps[-1].dev, steps[-1].M]
    last = steps[-1]
    f = {name: np.zeros((6, 5)) for name in ("A", "dev", "M", "S", "S_hat")} | {"w": np.zeros((6, 3))}       # 7.3
    f |= {name: np.zeros(6) for name in ("excess", "log_phi", "mod_S", "tr_D", "mod_D", "tr_hat")}
    f["A"][5], f["excess"][5], f["tr_hat"][5] = last.p_by_A[-1], last.p_by_excess[-1], last.p_by_tr[-1]
    if law.mobilised:
        f["M"][:5] = last.p[-1] * c["b1"] * np.eye(5)
    if law.relaxes:
        f["dev"][:5] = np.eye(5)
    else:
        f["A"][:5] = last.p[-1] * last.n_by_A[-1] + np.outer(last.n[-1], last.p_by_A[-1])
        f["excess"][:5], f["tr_hat"][:5] = last.n[-1] * last.p_by_excess[-1], last.n[-1] * last.p_by_tr[-1]
        f["S_hat"][:5] = last.p[-1] * last.n_by_S_hat[-1]
    for step in reversed(steps):
        step.adjoint(f)
    S_hat, D_hat = inc["S_hat"], np.array([D[axes] for axes in AXES]) / mod_D                           # 7.9
    by_mod_D = f["mod_D"] - (f["S_hat"] @ S_hat + f["tr_hat"] * inc["tr_hat"]) / mod_D
    by_strain = (f["S"] + f["S_hat"] / mod_D + np.outer(f["mod_S"], S_hat) / (2 * size(S_hat))) @ VOIGT.T \
        + np.outer(by_mod_D / 2, D_hat) + np.outer(f["tr_D"] + f["tr_hat"] / mod_D, IDENTITY)
    rows = np.hstack([by_strain, f["w"]])
    return (VOIGT @ last.A[-1], c["Zc"] + last.excess[-1], last.phi[-1], VOIGT @ last.dev - last.p[-1] * IDENTITY,
            VOIGT @ rows[:5] - np.outer(IDENTITY, rows[5]))


CASES = [("full", "hookean", 0.0), ("full", "hookean", 0.01), ("kinematic", "hertzian", 0.0), ("n2", "hertzian", 0.003),
         ("critical", "hookean", 0.0), ("critical", "hookean", 0.02), ("basic", "hookean", 1.0), ("mobilised", "hookean", 0.01),
         ("mobilised", "hertzian", 0.1)]


@pytest.mark.parametrize(("closure", "contact", "elastic_strain"), CASES)
def test_the_formulas_of_the_theory_page_give_the_states_and_tangents_of_the_core(rng, closure, contact, elastic_strain):
    material = Material(0.5, closure, contact, elastic_strain=elastic_strain, g=1e-4)
    for across in [False, False, False] + [True] * (elastic_strain == 0):       # the last one crosses phic
        fabric, gradient = rng.normal(size=6) * 0.01, rng.normal(size=(3, 3)) * 0.01
        fabric[2] = -fabric[0] - fabric[1]
        volume_strain = -0.003 if across else 0.3 * np.trace(gradient)
        gradient -= (np.trace(gradient) - volume_strain) / 3 * np.eye(3)
        old = material.state(material["phic"] - 0.001 if across else 0.60, 5.2, fabric, stress=STRESS)
        if closure == "mobilised":                                              # sheared before in a direction not far from this
            old["direction"] = [gradient[axes] + gradient[axes[::-1]] for axes in AXES]
            old["direction"] *= 0.6 / size(old["direction"] * [1, 1, 1, 2**0.5, 2**0.5, 2**0.5])
            old["direction"] += 0.2 * fabric / size(fabric)
        new, tangent = material.update_with_tangent(np.array([old]), gradient[None], spin=True)
        expected = update_with_tangent(material, closure, contact, old, gradient)
        found = new["fabric"][0], new["coordination_number"][0], new["volume_fraction"][0], new["stress"][0], tangent[0]
        errors = [np.abs(x - y).max() / np.abs(y).max() for x, y in zip(found, expected)]
        assert max(errors) < 1e-9, errors


def test_every_name_on_the_page_is_in_the_code():
    root = Path(__file__).parents[1]
    code = "\n".join(file.read_text(encoding="utf-8") for file in sorted((root / "fortran").glob("*/*.f90")))
    names = set(re.findall(r"`(?:\w+%)?([A-Za-z]\w*)`", (root / "docs" / "theory.md").read_text(encoding="utf-8")))
    assert len(names) > 40
    assert not {name for name in names if not re.search(rf"\b{name}\b", code, re.IGNORECASE)}
