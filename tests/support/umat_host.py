"""Calls umat_ of the built libGRANUMAT.so as finite-element codes do, through ctypes, with guard words around every array."""

import ctypes
from pathlib import Path

import numpy as np
from scipy.linalg import expm

import granumat
from granumat import installed

BUILD = Path(granumat.__file__).parents[2]
LIBRARY = ctypes.CDLL(str(installed.find("library")))
ORDER = ("stress", "statev", "ddsdde", "sse", "spd", "scd", "rpl", "ddsddt", "drplde", "drpldt", "stran", "dstran", "time", "dtime",
         "temp", "dtemp", "predef", "dpred", "cmname", "ndi", "nshr", "ntens", "nstatv", "props", "nprops", "coords", "drot",
         "pnewdt", "celent", "dfgrd0", "dfgrd1", "noel", "npt", "layer", "kspt", "kstep", "kinc")
SCALARS = ("sse", "spd", "scd", "rpl", "drpldt", "temp", "dtemp", "celent", "dtime")
OUTPUTS = ("stress", "statev", "ddsdde", "pnewdt")
N_STATEV = 23
STATUS = 22                                       # position of the status in STATEV, from 0
FABRIC, DIRECTION, STRESS = slice(1, 7), slice(9, 15), slice(15, 21)
Z2, PHI, WORK = 7, 8, 21
GUARD = np.full(4, 0x7FF4_DEAD_BEEF_CAFE, np.uint64).view(float)       # a signalling NaN no arithmetic makes
EYE = np.eye(3)


def properties(mu=0.5, stiffness=1.0, closure=3, contact=0, elastic_strain=0.0, phi=0.60, pressure=0.0, spin=0, calibration=0,
               order=0):
    """PROPS by name."""
    return np.array([mu, stiffness, closure, contact, elastic_strain, phi, pressure, spin, calibration, order], float)


class Guarded:
    """Numbers between guard words, Fortran's order."""

    def __init__(self, values):
        values = np.asarray(values, float)
        self.shape = values.shape
        self.memory = np.concatenate([GUARD, values.ravel(order="F"), GUARD])
        self.before = self.memory.tobytes()
        self.address = self.memory.ctypes.data + GUARD.nbytes

    @property
    def values(self):
        return self.memory[4:-4].reshape(self.shape, order="F")

    def assert_intact(self):
        assert self.memory[:4].tobytes() == GUARD.tobytes() == self.memory[-4:].tobytes()


class Result:
    """What a call left: stress, statev, ddsdde, pnewdt."""

    def __init__(self, arrays):
        self.stress, self.statev, self.ddsdde = (arrays[name].values.copy() for name in OUTPUTS[:3])
        self.pnewdt = arrays["pnewdt"].values.copy() if arrays["pnewdt"] else None

    @property
    def status(self):
        return int(self.statev[STATUS])


def call(stress, statev, dstran, props, drot=EYE, dfgrd0=EYE, dfgrd1=EYE, pnewdt=1.0, symbol="umat_", null=(), at=None, **scalars):
    """One call; what is named in null is passed as a null pointer, at gives addresses of one's own. What a UMAT may not write
    must be as before, and all guard words."""
    n = len(stress)
    numbers = {
        "stress": stress, "statev": statev, "ddsdde": np.full((n, n), np.nan), "dstran": dstran, "props": props, "drot": drot,
        "dfgrd0": dfgrd0, "dfgrd1": dfgrd1, "pnewdt": [pnewdt], "time": [0.0, 0.0], "stran": np.full(n, np.nan),
        "ddsddt": np.full(n, np.nan), "drplde": np.full(n, np.nan), "coords": np.full(3, np.nan), "predef": [np.nan],
        "dpred": [np.nan],
    }
    numbers |= {name: [scalars.get(name, np.nan)] for name in SCALARS}
    integers = {"ndi": 3, "nshr": n - 3, "ntens": n, "nstatv": len(statev), "nprops": len(props), "noel": 1, "npt": 1, "layer": 1,
                "kspt": 1, "kstep": 1, "kinc": 1} | {name: scalars[name] for name in scalars if name.startswith("n")}
    arrays = {name: None if name in null else Guarded(values) for name, values in numbers.items()}
    kept = {name: ctypes.c_int(value) for name, value in integers.items()} | {"cmname": ctypes.create_string_buffer(b"G", 1)}
    addresses = {name: array and array.address for name, array in arrays.items()}
    addresses |= {name: None if name in null else ctypes.addressof(value) for name, value in kept.items()}
    addresses |= at or {}
    getattr(LIBRARY, symbol)(*(ctypes.c_void_p(addresses[name]) for name in ORDER))
    for name, array in arrays.items():
        if array:
            array.assert_intact()
            assert name in OUTPUTS or array.memory.tobytes() == array.before, name
    for name, value in integers.items():
        assert kept[name].value == value, name
    return Result(arrays)


def engineering(gradient):
    """Strain with engineering shears, 11 22 33 12 13 23, of a displacement gradient."""
    return np.array([gradient[0, 0], gradient[1, 1], gradient[2, 2], gradient[0, 1] + gradient[1, 0],
                     gradient[0, 2] + gradient[2, 0], gradient[1, 2] + gradient[2, 1]])


def increment(gradient, spin):
    """Arguments of a call for a constant velocity gradient whose integral is gradient, by the choice of spin in PROPS."""
    if spin == 0:
        return {"dstran": engineering(gradient)}
    if spin == 1:
        return {"dstran": engineering(gradient), "drot": expm((gradient - gradient.T) / 2)}
    old = expm(np.array([[0.1, 0.4, -0.3], [-0.2, -0.1, 0.7], [0.5, -0.6, 0.2]]))          # any deformation before
    return {"dstran": np.full(6, np.nan), "dfgrd0": old, "dfgrd1": expm(gradient) @ old}


def statev_of(state):
    """STATEV of a record of granumat.STATE."""
    statev = np.zeros(N_STATEV)
    statev[0] = 1
    statev[FABRIC], statev[DIRECTION], statev[STRESS] = state["fabric"], state["direction"], state["stress"]
    statev[Z2], statev[PHI] = state["coordination_number"], state["volume_fraction"]
    return statev


class StressControl:
    """A point under prescribed stresses by Newton's method with the whole tangent and no line search.

    Each row asks first for the tangent at DSTRAN = 0, as incrementalDriver does.

    Attributes
    ----------
    stress, statev : arrays (6,), (23,)
    iterations, missed : int
        Calls with a strain, and rows whose stress was not reached.
    """

    TOLERANCE, MOST_ITERATIONS = 1e-8, 20          # of the stress asked for

    def __init__(self, props):
        self.props, self.iterations, self.missed = props, 0, 0
        start = call(np.zeros(6), np.zeros(N_STATEV), np.zeros(6), props)
        self.stress, self.statev = start.stress, start.statev

    def go_to(self, target):
        """One row; the last iterate stands where it does not converge."""
        dstran = np.zeros(6)
        result = call(self.stress, self.statev, dstran, self.props)
        for _ in range(self.MOST_ITERATIONS):
            dstran = dstran + np.linalg.solve(result.ddsdde, target - result.stress)
            result = call(self.stress, self.statev, dstran, self.props)
            self.iterations += 1
            if result.status or np.abs(result.stress - target).max() < self.TOLERANCE * np.abs(target).max():
                break
        else:
            self.missed += 1
        self.missed += result.status > 0
        self.stress, self.statev = result.stress, result.statev
