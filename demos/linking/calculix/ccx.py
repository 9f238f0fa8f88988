"""Input decks for CalculiX, and what it prints. Axes as in the driver: x flow, y vorticity, z gradient."""

import os
import re
import subprocess
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

import granumat

CCX = Path(__file__).resolve().parents[3] / "build/calculix/ccx"
LIBRARY = Path(granumat.__file__).parents[2]    # of the build that Python imports: libGRANUMAT.so
CONSTANTS = ("mu", "stiffness", "closure", "contact", "elastic_strain", "phi", "pressure", "spin", "calibration",
             "order")                           # PROPS
N_STATEV = 23

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])

# Residuals to round-off: the default, 0.5 % of the mean force, would be the error. Newton with half of the tangent takes its time.
CONTROLS = """\
*CONTROLS,PARAMETERS=FIELD
1e-10,1e-8
*CONTROLS,PARAMETERS=TIME INCREMENTATION
30,40,9,100,10,4,,5
"""
HELD = "*AMPLITUDE,NAME=HELD\n0,1,1,1\n"        # for loads: CalculiX would let them grow from 0


class Brick:
    """A box of equal brick elements.

    Attributes
    ----------
    nodes : array (n, 3)
        Coordinates; the number of a node is its row plus 1, so is an element's.
    elements : array (m, 8 or 20)
        Node numbers.
    """

    POINTS = 8                                  # integration points of an element

    def __init__(self, counts, sizes, element="C3D8"):
        self.element, self.sizes = element, np.array(sizes, float)
        offsets = 2 * CORNERS                                    # on a lattice of half elements
        if element.startswith("C3D20"):
            offsets = np.vstack([offsets, CORNERS[EDGES].sum(axis=1)])
        numbers, elements = {}, []
        for cell in product(*map(range, counts)):
            places = map(tuple, 2 * np.array(cell) + offsets)
            elements.append([numbers.setdefault(place, len(numbers) + 1) for place in places])
        self.elements = np.array(elements)
        self.nodes = np.array(list(numbers)) / (2 * np.array(counts)) * self.sizes

    def on(self, *faces):
        """Numbers of the nodes on any of the faces "x0", "x1" ... "z1"."""
        axes = ["xyz".index(axis) for axis, _ in faces]
        at = [np.isclose(self.nodes[:, i], int(side) * self.sizes[i]) for i, (_, side) in zip(axes, faces)]
        return np.flatnonzero(np.any(at, axis=0)) + 1

    def elements_at(self, face):
        """Numbers of the elements with a side on a face."""
        return np.flatnonzero(np.isin(self.elements[:, :8], self.on(face)).sum(axis=1) == 4) + 1

    def pressure(self, face, value):
        """Rows of *DLOAD for a pressure on the face "x0" or "x1"."""
        label = {"x0": "P6", "x1": "P4"}[face]
        return "".join(f"{element},{label},{value}\n" for element in self.elements_at(face))

    def deck(self, constants, interface="@ABAQUS", stress=None):
        """Mesh and material; constants by name, those not given 0; stress (6,) that the elements start from."""
        values = [f"{constants.get(name, 0):.15g}" for name in CONSTANTS]
        text = "*NODE,NSET=ALL\n" + _lines((n, *x) for n, x in enumerate(self.nodes.tolist(), 1))
        text += f"*ELEMENT,TYPE={self.element},ELSET=ALL\n" + _lines((n, *e) for n, e in enumerate(self.elements.tolist(), 1))
        text += f"*MATERIAL,NAME={interface}_GRANUMAT\n*USER MATERIAL,CONSTANTS={len(values)}\n" + _lines([values])
        text += f"*DEPVAR\n{N_STATEV}\n*SOLID SECTION,ELSET=ALL,MATERIAL={interface}_GRANUMAT\n"
        if stress is not None:
            points = product(range(1, len(self.elements) + 1), range(1, self.POINTS + 1))
            text += "*INITIAL CONDITIONS,TYPE=STRESS\n" + _lines((*point, *stress) for point in points)
        return text + HELD


def _lines(rows):
    """Rows of a card: 8 numbers a line, as few cards take more."""
    text = ""
    for row in rows:
        row = [str(number) for number in row]
        text += ",\n".join(",".join(row[i:i + 8]) for i in range(0, len(row), 8)) + "\n"
    return text


def boundary(nodes, dofs, value=0.0):
    """Displacements; 0 before the first step holds for ever, other values belong into a step, which approaches them linearly."""
    return "*BOUNDARY\n" + _lines((node, dof, dof, value) for node in nodes for dof in dofs)


def equation(*terms):
    """Sum of coefficient * displacement = 0; terms (node, dof, coefficient), of which the first is eliminated; at most 4."""
    return f"*EQUATION\n{len(terms)}\n" + ",".join(f"{node},{dof},{coefficient}" for node, dof, coefficient in terms) + "\n"


def step(increments, body, finite=False, automatic=False):
    """A step of time 1, on the moving mesh if finite, in increments of one size unless automatic."""
    geometry, size = ",NLGEOM" if finite else "", "" if automatic else ",DIRECT"
    return (f"*STEP,INC=10000{geometry}\n*STATIC{size}\n{1 / increments:.15g},1.\n{CONTROLS}{body}"
            "*NODE PRINT,NSET=ALL\nU,RF\n*EL PRINT,ELSET=ALL\nS,SDV\n*END STEP\n")


class Output(NamedTuple):
    """What a job printed, increment by increment."""

    time: np.ndarray            # (n,)
    displacement: np.ndarray    # (n, nodes, 3)
    force: np.ndarray           # (n, nodes, 3): by the rest of the world on the nodes
    stress: np.ndarray          # (n, points, 6): tension positive, 11 22 33 12 13 23
    statev: np.ndarray          # (n, points, 23)
    iterations: np.ndarray      # (n,): Newton iterations of the attempt that converged
    cutbacks: int               # attempts that a UMAT asked to repeat with a smaller increment


QUANTITIES = ("displacements", "forces", "stresses", "internal state variables")
HEADER = re.compile(r"^ (\w[\w ]+?) \(.*for set \w+ and time +(\S+)\n", re.MULTILINE)


def run(place, name, deck, threads=1):
    """Runs a deck in a directory and reads what it printed; RuntimeError with the end of the log where the job fails."""
    place = Path(place)
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{name}.inp").write_text(deck)
    environment = os.environ | {"LD_LIBRARY_PATH": str(LIBRARY), "OMP_NUM_THREADS": str(threads)}
    done = subprocess.run([CCX, name], cwd=place, env=environment, capture_output=True, text=True)
    (place / f"{name}.log").write_text(done.stdout + done.stderr)
    if "Job finished" not in done.stdout:
        raise RuntimeError(f"CalculiX: job {name} failed:\n{(done.stdout + done.stderr)[-2000:]}")
    return Output(*read_dat(place / f"{name}.dat"), read_sta(place / f"{name}.sta"), done.stdout.count("(through pnewdt)"))


def read_dat(path):
    """Times and the QUANTITIES of a .dat file."""
    parts = HEADER.split(path.read_text())[1:]
    found = {quantity: [] for quantity in QUANTITIES}
    for quantity, rows in zip(parts[0::3], parts[2::3]):
        table = np.array([row.split() for row in rows.splitlines() if row.strip()], float)
        found[quantity].append(table[:, 1 if quantity in QUANTITIES[:2] else 2:])
    times = [float(time) for quantity, time in zip(parts[0::3], parts[1::3]) if quantity == QUANTITIES[0]]
    return np.array(times), *map(np.array, found.values())


def read_sta(path):
    """Iterations of each converged increment, from a .sta file: STEP INC ATT ITRS ..., attempts marked U did not converge."""
    rows = [line.split() for line in path.read_text().splitlines()[2:]]
    return np.array([int(row[3]) for row in rows if row[2].isdigit()])
