"""The block of block.toml in CalculiX."""

import tomllib
from pathlib import Path

import numpy as np
from ccx import Brick, boundary, run, step
from jobs import UNIT

from granumat.material import CLOSURES

PROBLEM = tomllib.loads((Path(__file__).parent / "block.toml").read_text())


def deck(problem, element, finite=False):
    """One layer of elements between u_y = 0, its thickness the elements' width; finite: on the moving mesh, through ABAQUSNL."""
    block, initial, loading = problem["block"], problem["initial"], problem["loading"]
    thickness = block["width"] / block["elements"][0]
    box = Brick((block["elements"][0], 1, block["elements"][1]), (block["width"], thickness, block["height"]), element)
    pressure = initial["pressure"] * UNIT
    constants = problem["material"] | {"closure": CLOSURES.index(problem["material"]["closure"]), "stiffness": UNIT,
                                       "phi": initial["phi"], "spin": 4 if finite else 0}
    text = box.deck(constants, "@ABAQUSNL" if finite else "@ABAQUS", [-pressure] * 3 + [0.0] * 3)
    text += boundary(np.arange(1, len(box.nodes) + 1), [2]) + boundary(box.on("z0"), [1, 3]) + boundary(box.on("z1"), [1])
    loads = "*DLOAD,AMPLITUDE=HELD\n"
    for face, label in (("x1", "P4"), ("x0", "P6")):
        loads += "".join(f"{element},{label},{pressure}\n" for element in box.elements_at(face))
    platen = boundary(box.on("z1"), [3], -loading["compression"] * block["height"])
    return box, text + step(loading["increments"], platen + loads, finite)


def reaction(place, element, finite=False, problem=PROBLEM):
    """Compression and reaction (n + 1,) of the upper platen, compression positive, and what CalculiX printed."""
    box, text = deck(problem, element, finite)
    output = run(place, f"block-{element}{'-finite' if finite else ''}", text)
    thickness = box.sizes[1]
    force = output.force[:, box.on("z1") - 1, 2].sum(axis=1) / (UNIT * thickness)
    start = problem["initial"]["pressure"] * problem["block"]["width"]
    return problem["loading"]["compression"] * np.append(0, output.time), np.append(start, -force), output
