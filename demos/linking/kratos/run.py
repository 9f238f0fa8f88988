"""Strains an element in Kratos through User_Mod and through the UMAT, compares it with the driver: run.py FOLDER"""

import subprocess
import sys
from pathlib import Path

import numpy as np

import granumat
from granumat import Material, driver

KRATOS = Path(__file__).resolve().parents[3] / "build/kratos/bin/python"
LIBRARY = Path(granumat.__file__).parents[2] / "libGRANUMAT.so"
UNIT, PRESSURE, PHI = 1e6, 5e3, 0.60
SAND = Material(mu=0.5, elastic_strain=0.01)
PARAMETERS = [0.5, UNIT, 3, 0, 0.01, PHI, PRESSURE]          # mu, stiffness, closure, contact, elastic_strain, phi, pressure
XX_YY_ZZ_XY_YZ_XZ = [0, 1, 2, 3, 5, 4]                       # Kratos' order, places in ours
COARSE = 0.999                                               # tolerance at which the driver halves each increment once


def loads():
    """Displacement gradients (n, 3, 3) of wandering strains, plane and in space; axial displacements (n,), back and forth."""
    increments = 2e-3 * np.random.default_rng(2011).normal(size=(40, 3, 3))
    increments = (increments + np.swapaxes(increments, 1, 2)) / 2
    increments -= np.trace(increments, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    plane = increments.copy()
    plane[:, 2] = plane[:, :, 2] = 0
    plane[:, 1, 1] = -plane[:, 0, 0]
    axial = np.concatenate([np.linspace(0, -0.02, 41)[1:], np.linspace(-0.02, 0, 41)[1:]])
    return {"gradients_2": np.cumsum(plane, axis=0), "gradients_3": np.cumsum(increments, axis=0), "axial": axial,
            "pressure": PRESSURE, "UDSM_parameters": [*PARAMETERS, 0], "UMAT_parameters": [*PARAMETERS, 0, 0, 1]}


def along(gradients):
    """The driver's stress (n, 6) in Kratos' order."""
    state, stress = SAND.isotropic(PHI, PRESSURE / UNIT), []
    for gradient in np.diff(gradients, axis=0, prepend=0):
        state = SAND.update(state, gradient)
        stress.append(UNIT * state.stress[XX_YY_ZZ_XY_YZ_XZ])
    return np.array(stress)


def main(place):
    """Largest differences to the driver over the largest stress, by name, and the iterations of the triaxial test."""
    place = Path(place)
    place.mkdir(parents=True, exist_ok=True)
    given = loads()
    np.savez(place / "loads.npz", **given)
    done = subprocess.run([KRATOS, Path(__file__).parent / "element.py", LIBRARY, place / "loads.npz", place / "results.npz"],
                          capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"Kratos failed:\n{(done.stdout + done.stderr)[-2000:]}")
    found, errors = np.load(place / "results.npz"), {}
    for dimension in (2, 3):
        expected = along(given[f"gradients_{dimension}"])
        for interface in ("UDSM", "UMAT"):
            stress = found[f"{interface}_{dimension}"]
            difference = stress - expected[:, None, :stress.shape[2]]
            errors[f"{interface}, {dimension}D"] = np.abs(difference).max() / np.abs(expected).max()
    legs = [driver.triaxial(strain, increments=20) for strain in (0.02, -0.02)]
    states = driver.run(SAND, SAND.isotropic(PHI, PRESSURE / UNIT), legs, tolerance=COARSE).states[1:]
    expected = UNIT * states.stress[:, XX_YY_ZZ_XY_YZ_XZ]
    errors["UDSM, triaxial"] = np.abs(found["triaxial"][1::2] - expected[:, None]).max() / np.abs(expected).max()
    print("largest difference to the driver, over the largest stress")
    for name, error in errors.items():
        print(f"  {name:15} {error:.1e}")
    print("iterations of the triaxial test:", *found["iterations"])
    return errors, found["iterations"]


if __name__ == "__main__":
    main(sys.argv[1])
