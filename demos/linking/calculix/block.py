"""The block of block.toml in CalculiX."""

import tomllib
from pathlib import Path

import numpy as np
from ccx import Brick, boundary, run, step
from jobs import UNIT

from granumat.material import CLOSURES

PROBLEM = tomllib.loads((Path(__file__).parent / "block.toml").read_text())


def brick(problem, element):
    """One layer of elements, its thickness their width."""
    (across, along), width = problem["block"]["elements"], problem["block"]["width"]
    return Brick((across, 1, along), (width, width / across, problem["block"]["height"]), element)


def deck(problem, box, finite=False):
    """The block between u_y = 0; finite: on the moving mesh, through ABAQUSNL."""
    initial, loading = problem["initial"], problem["loading"]
    pressure = initial["pressure"] * UNIT
    constants = problem["material"] | {"closure": CLOSURES.index(problem["material"]["closure"]), "stiffness": UNIT,
                                       "phi": initial["phi"], "spin": 4 if finite else 0}
    text = box.deck(constants, "@ABAQUSNL" if finite else "@ABAQUS", [-pressure] * 3 + [0.0] * 3)
    text += boundary(np.arange(1, len(box.nodes) + 1), [2]) + boundary(box.on("z0"), [1, 3]) + boundary(box.on("z1"), [1])
    loads = "*DLOAD,AMPLITUDE=HELD\n" + box.pressure("x0", pressure) + box.pressure("x1", pressure)
    platen = boundary(box.on("z1"), [3], -loading["compression"] * problem["block"]["height"])
    return text + step(loading["increments"], platen + loads, finite)


def reaction(place, element, finite=False, problem=PROBLEM):
    """Compression and reaction (n + 1,) of the upper platen, compression positive, and what CalculiX printed."""
    box = brick(problem, element)
    output = run(place, f"block-{element}{'-finite' if finite else ''}", deck(problem, box, finite))
    force = -output.force[:, box.on("z1") - 1, 2].sum(axis=1) / (UNIT * box.sizes[1])
    start = problem["initial"]["pressure"] * problem["block"]["width"]
    if finite:
        force += problem["initial"]["pressure"] * lift(box, problem["block"]["elements"][1], output.displacement)
    return problem["loading"]["compression"] * np.append(0, output.time), np.append(start, force), output


def lift(box, rows, displacement):
    """Vertical force (n,) per thickness of a unit pressure on tilted sides on the platen's nodes, which CalculiX's RF contains.

    It is the integral of N dx over the edges of the elements at the platen, N the shape function of the node at the platen.
    """
    parts = {0: 1 / 2, 1: -1 / 2} if box.element.startswith("C3D8") else {0: 1 / 2, 0.5: -2 / 3, 1: 1 / 6}
    x, y, z = box.nodes.T
    force = 0.0
    for down, part in parts.items():
        level = np.isclose(y, 0) & np.isclose(z, box.sizes[2] * (1 - down / rows))
        for side, sign in ((0, -1), (box.sizes[0], 1)):
            force = force + sign * part * displacement[:, level & np.isclose(x, side), 0].sum(axis=1)
    return force
