"""The jobs with a homogeneous field, and what the single-point driver gives for each."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from ccx import Brick, boundary, equation, step

from granumat import Material, driver, tensors

UNIT = 1e8                  # k/d in Pa. CalculiX takes residual forces below 1e-6 for 0, so k/d = 1 would be too small
PHI, PRESSURE = 0.60, 0.01  # initial volume fraction and mean pressure (k/d)
SAND = Material(mu=0.5, closure="kinematic", elastic_strain=0.01)
CONSTANTS = {"mu": 0.5, "stiffness": UNIT, "closure": 4, "elastic_strain": 0.01, "phi": PHI}
START = SAND.isotropic(PHI, PRESSURE)
STRESS = [-PRESSURE * UNIT] * 3 + [0.0] * 3
COARSE = 0.999              # tolerance at which the driver halves each increment of a control once, and no further


class Job(NamedTuple):
    """A deck and the states that its integration points should go through, or the function of its Output that gives them.

    `every` is how many increments of the deck one of the states covers; `frame` (n, 3, 3) turns their stress into the global
    one.
    """

    title: str
    deck: str
    states: np.recarray | Callable
    every: int = 1
    frame: np.ndarray | None = None


def states_of(*steps):
    return driver.run(SAND, START, steps, tolerance=COARSE).states[1:]


def shear_at_constant_volume():
    """Simple shear with its spin: small displacements leave DFGRD0 and DFGRD1 as they are, so PROPS(8) = 2 finds all of it."""
    box = Brick((2, 2, 2), (1, 1, 1))
    inner = np.setdiff1d(box.on("x0", "x1", "y0", "y1"), box.on("z0", "z1"))
    deck = box.deck(CONSTANTS | {"pressure": PRESSURE * UNIT, "spin": 2})
    deck += boundary(box.on("z0"), (1, 2, 3)) + boundary(box.on("z1"), (2, 3)) + boundary(inner, (2, 3))
    for gamma, increments in ((0.2, 20), (-0.2, 40)):
        deck += step(increments, boundary(box.on("z1"), [1], gamma) + boundary(inner, [1], gamma / 2))
    return Job("simple shear, constant volume, reversal", deck,
               states_of(driver.shear(0.2, increments=20), driver.shear(-0.4, increments=40)))


def pure_shear(gamma, control, increments):
    """Simple shear without its spin, as small displacements with PROPS(8) = 0 have it."""
    return driver.deform([[0, 0, 0.5], [0, 0, 0], [0.5, 0, 0]], gamma, control, increments)


def shear_at_constant_pressure():
    """One element whose nodes follow u = (gamma z + q x, q y, q z): the force on q is 3 p times the volume."""
    box = Brick((1, 1, 1), (1, 1, 1))
    driving = len(box.nodes) + 1
    deck = f"*NODE,NSET=DRIVING\n{driving},0,0,0\n" + box.deck(CONSTANTS, stress=STRESS)
    deck += boundary([driving], [3])
    for number, (x, y, z) in enumerate(box.nodes, 1):
        for dof, gamma, q in ((1, z, x), (2, 0, y), (3, 0, z)):
            terms = [(driving, column, -factor) for column, factor in ((1, gamma), (2, q)) if factor]
            deck += equation((number, dof, 1), *terms) if terms else boundary([number], [dof])
    load = f"*CLOAD,AMPLITUDE=HELD\n{driving},2,{3 * STRESS[0]}\n"
    for gamma, increments in ((0.2, 40), (-0.2, 80)):
        deck += step(increments, boundary([driving], [1], gamma) + load)
    return Job("shear, constant mean pressure, reversal", deck,
               states_of(pure_shear(0.2, "pressure", 20), pure_shear(-0.4, "pressure", 40)), every=2)


def shear_under_a_platen(finite=False):
    """Rough platens on a layer that is periodic along x; the upper one is free to rise under its constant load.

    finite: on the moving mesh, where log F1 F0^-1 depends on how far the platen has risen. The driver follows CalculiX's own
    displacements then; that its stress is CalculiX's says that sigma_zz is held in both.
    """
    height = 1.5
    box = Brick((2, 1, 3), (1, 1, height))
    constants, interface = (CONSTANTS | {"spin": 4}, "@ABAQUSNL") if finite else (CONSTANTS, "@ABAQUS")
    deck = box.deck(constants, interface, STRESS) + boundary(box.on("z0"), (1, 2, 3))
    deck += boundary(np.setdiff1d(np.arange(1, len(box.nodes) + 1), box.on("z0")), [2])
    top = box.on("z1")
    for node in top[1:]:
        deck += equation((node, 3, 1), (top[0], 3, -1))
    inner = np.setdiff1d(box.on("x0", "x1"), box.on("z0", "z1"))
    left, right = np.intersect1d(inner, box.on("x0")), np.intersect1d(inner, box.on("x1"))
    for node in right:
        partner = next(n for n in left if np.allclose(box.nodes[n - 1][1:], box.nodes[node - 1][1:]))
        for dof in (1, 3):
            deck += equation((node, dof, 1), (partner, dof, -1))
    load = f"*CLOAD,AMPLITUDE=HELD\n{top[0]},3,{STRESS[2]}\n"
    for gamma, increments in ((0.2, 40), (-0.2, 80)):
        deck += step(increments, boundary(top, [1], height * gamma) + load, finite)
    if finite:
        return Job("simple shear, constant normal load: ABAQUSNL", deck,
                   lambda output: states_along(output.displacement[:, top[0] - 1] / height))
    return Job("shear, constant normal load, reversal", deck,
               states_of(pure_shear(0.2, "normal-load", 20), pure_shear(-0.4, "normal-load", 40)), every=2)


def states_along(displacement):
    """States along F = [[1, 0, gamma], [0, 1, 0], [0, 0, lambda]], gamma and lambda - 1 the x and z of displacement (n, 3).

    log F1 F0^-1 has log r in zz and (gamma1 - gamma0)/lambda0 * log r/(r - 1) in xz, r = lambda1/lambda0.
    """
    gamma, _, rise = np.vstack([np.zeros(3), displacement]).T
    log_r = np.diff(np.log1p(rise))
    G = np.zeros((len(gamma), 3, 3))
    G[1:, 0, 2] = np.cumsum(np.diff(gamma) / (1 + rise[:-1]) * log_r / np.expm1(log_r))
    G[1:, 2, 2] = np.cumsum(log_r)
    return states_of(driver.Step("displacements", increments=len(displacement), table=G.reshape(-1, 9)))


def biaxial_compression():
    """Plane strain between smooth platens, constant pressure on the side."""
    box = Brick((2, 1, 2), (1, 1, 2))
    deck = box.deck(CONSTANTS, stress=STRESS)
    for face, dof in (("x0", 1), ("y0", 2), ("y1", 2), ("z0", 3)):
        deck += boundary(box.on(face), [dof])
    side = box.pressure("x1", PRESSURE * UNIT)
    deck += step(80, boundary(box.on("z1"), [3], -0.08 * 2) + "*DLOAD,AMPLITUDE=HELD\n" + side)
    return Job("biaxial compression, constant side pressure", deck, states_of(driver.biaxial(0.08, increments=40)), every=2)


def shear_and_rotation(spin):
    """Large shear, a rigid quarter turn, more shear, through ABAQUSNL: its stress and strain are in the frame that turns with R
    of F = R U.

    PROPS(8) = 4 takes the deformation from DFGRD0 and DFGRD1 and is the same as in the driver; 0 takes what ABAQUSNL hands over
    for strain, the increments of log U without a spin.
    """
    n = 30
    gamma = np.concatenate([np.linspace(0, 0.3, n + 1), np.full(n, 0.3), np.linspace(0.3, 0.6, n + 1)[1:]])
    angle = np.pi / 2 * np.concatenate([np.zeros(n + 1), np.linspace(0, 1, n + 1)[1:], np.ones(n)])
    turn, shear = turns(angle), np.tile(np.eye(3), (3 * n + 1, 1, 1))
    shear[:, 0, 2] = gamma
    box = Brick((1, 1, 1), (1, 1, 1))
    deck, body = box.deck(CONSTANTS | {"spin": spin}, "@ABAQUSNL", STRESS), ""
    for number, x in enumerate(box.nodes, 1):
        for dof, path in enumerate(((turn @ shear - np.eye(3)) @ x).T, 1):
            deck += f"*AMPLITUDE,NAME=A{number}_{dof}\n" + "".join(f"{k / (3 * n):.15g},{u:.15g}\n" for k, u in enumerate(path))
            body += f"*BOUNDARY,AMPLITUDE=A{number}_{dof}\n{number},{dof},{dof},1\n"
    deck += step(3 * n, body, finite=True)
    if spin == 0:
        log_U, R = polar(shear)
        states = states_of(driver.Step("log U", increments=3 * n, table=log_U.reshape(-1, 9)))
        return Job("large shear, quarter turn, shear; log U only", deck, states, frame=(turn @ R)[1:])
    quarter = turn[-1] @ driver.SHEAR @ turn[-1].T
    return Job("large shear, quarter turn, shear", deck, states_of(
        driver.deform(driver.SHEAR, 0.3, increments=n), driver.deform(driver.SHEAR - driver.SHEAR.T, np.pi / 2, increments=n),
        driver.deform(quarter, 0.3, increments=n)))


def cut_back():
    """A reversed shear of 3 in one increment under a load: the first guess of the settlement has phi above 1, where the UMAT asks
    for a quarter of the increment."""
    box = Brick((1, 1, 1), (1, 1, 1))
    top = box.on("z1")
    deck = box.deck(CONSTANTS, stress=STRESS) + boundary(box.on("z0"), (1, 2, 3)) + boundary(top, [2])
    for node in top[1:]:
        deck += equation((node, 3, 1), (top[0], 3, -1))
    load = f"*CLOAD,AMPLITUDE=HELD\n{top[0]},3,{STRESS[2]}\n"
    deck += step(20, boundary(top, [1], 0.2) + load) + step(1, boundary(top, [1], -2.8) + load, automatic=True)
    return Job("reversal by 3 in one increment, cut back", deck,
               states_of(pure_shear(0.2, "normal-load", 10), pure_shear(-3.0, "normal-load", 2)), every=2)


def turns(angles):
    """About y, from z to x: (n, 3, 3)."""
    zero, one = np.zeros_like(angles), np.ones_like(angles)
    rows = [[np.cos(angles), zero, np.sin(angles)], [zero, one, zero], [-np.sin(angles), zero, np.cos(angles)]]
    return np.moveaxis(np.array(rows), 2, 0)


def polar(F):
    """log U and R of F = R U, (n, 3, 3) each."""
    squares, V = np.linalg.eigh(np.swapaxes(F, 1, 2) @ F)
    stretches, transposed = np.sqrt(squares)[..., None], np.swapaxes(V, 1, 2)
    return V @ (np.log(stretches) * transposed), F @ V @ (transposed / stretches)


JOBS = {
    "volume": shear_at_constant_volume,
    "pressure": shear_at_constant_pressure,
    "platen": shear_under_a_platen,
    "moving-platen": lambda: shear_under_a_platen(finite=True),
    "biaxial": biaxial_compression,
    "rotation": lambda: shear_and_rotation(4),
    "log-u": lambda: shear_and_rotation(0),
    "cutback": cut_back,
}


def errors(job, output):
    """Largest difference between CalculiX's integration points and the driver: stress over its largest value, A over kappa, Z2
    and phi."""
    states = job.states(output) if callable(job.states) else job.states
    stress = states.stress
    if job.frame is not None:
        stress = tensors.to_voigt(job.frame @ tensors.to_matrix(stress) @ np.swapaxes(job.frame, 1, 2))
    found, statev = output.stress[job.every - 1::job.every] / UNIT, output.statev[job.every - 1::job.every]
    return {
        "stress": np.abs(found - stress[:, None]).max() / np.abs(stress).max(),
        "fabric": np.abs(statev[..., 1:7] - states.fabric[:, None]).max() / SAND["kappa"],
        "Z2": np.abs(statev[..., 7] - states.coordination_number[:, None]).max(),
        "phi": np.abs(statev[..., 8] - states.volume_fraction[:, None]).max(),
    }
