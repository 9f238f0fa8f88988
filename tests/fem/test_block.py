"""The block of demos/linking/calculix/block.toml on the moving mesh, as granumat.fem and as CalculiX solve it."""

import numpy as np
from mpi4py import MPI

from granumat import Material, fem

PRINTED = 1e-6              # CalculiX prints seven digits


def refined(problem, elements):
    return problem | {"block": problem["block"] | {"elements": elements}}


def compress(problem, size, elements, cell, degree=1):
    """The body, and after every increment displacements, states and the upper platen's force.

    Size and elements in two dimensions, or in three: a layer between u_y = 0.
    """
    initial, loading, up = problem["initial"], problem["loading"], len(size) - 1
    material = Material(**problem["material"])
    sink = -loading["compression"] * size[up] / loading["increments"] * np.eye(up + 1)[up]

    def top(x):
        return np.isclose(x[up], size[up])

    conditions = [
        fem.Displacement(lambda x: np.isclose(x[up], 0)), fem.Displacement(top, lambda x, t: t * sink),
        fem.Pressure(lambda x: np.isclose(x[0], 0) | np.isclose(x[0], size[0]), initial["pressure"])]
    if up == 2:
        conditions += [fem.Displacement(lambda x: np.isclose(x[1], 0) | np.isclose(x[1], size[1]), components=[1])]
    body = fem.Problem(fem.meshes.box(MPI.COMM_WORLD, size, elements, cell), material,
                       material.isotropic(initial["phi"], pressure=initial["pressure"]), conditions, degree=degree)
    rows = []

    def watch(body):
        if body.last is not None:
            rows.append((body.displacement.copy(), body.states.copy(), -body.reaction(top)[0][up]))

    fem.run(body, loading["increments"], 1.0, observers=[watch])
    return body, *map(np.array, zip(*rows))


def test_linear_tetrahedra_are_those_of_calculix_to_the_printed_digits(calculix, tmp_path):
    from block import PROBLEM, deck
    from ccx import Brick, run
    from jobs import UNIT

    class Tetrahedra(Brick):
        """The tetrahedra of a body, numbered as there."""

        POINTS = 1

        def __init__(self, body):
            cells = np.array([body.space.dofmap.cell_dofs(cell) for cell in range(body.cells)])
            corners = body.positions[cells]
            mirrored = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
            cells[mirrored] = cells[mirrored][:, [1, 0, 2, 3]]
            self.element, self.elements = "C3D4", cells + 1
            self.nodes = body.positions.round(14)                 # CalculiX reads 20 characters
            self.sizes = self.nodes.max(axis=0)

        def pressure(self, face, value):
            faces = [np.flatnonzero(corners) for corners in np.isin(self.elements, self.on(face))]
            labels = {(0, 1, 2): "P1", (0, 1, 3): "P2", (1, 2, 3): "P3", (0, 2, 3): "P4"}
            return "".join(f"{number},{labels[tuple(corners)]},{value}\n" for number, corners in enumerate(faces, 1)
                           if len(corners) == 3)

    problem = refined(PROBLEM, [6, 3])
    width, height = problem["block"]["width"], problem["block"]["height"]
    body, displacements, states, _ = compress(problem, [width, width / 6, height], [6, 1, 3], "tetrahedron")
    output = run(tmp_path, "tetrahedra", deck(problem, Tetrahedra(body), finite=True))
    states = states.view(np.recarray)
    pairs = {"displacement": (displacements, output.displacement), "stress": (states.stress * UNIT, output.stress),
             "fabric": (states.fabric, output.statev[..., 1:7]), "Z2": (states.coordination_number, output.statev[..., 7]),
             "phi": (states.volume_fraction, output.statev[..., 8])}
    for name, (ours, theirs) in pairs.items():
        theirs = theirs.reshape(ours.shape)
        assert abs(ours - theirs).max() < PRINTED * abs(theirs).max(), name


def test_the_reaction_of_quadrilaterals_goes_to_that_of_quadratic_bricks(calculix, tmp_path):
    from block import PROBLEM, reaction
    off = {1: [], 2: []}
    for elements in ([6, 3], [12, 6]):
        problem = refined(PROBLEM, elements)
        _, force, _ = reaction(tmp_path, "C3D20R", finite=True, problem=problem)
        size = [problem["block"]["width"], problem["block"]["height"]]
        for degree, differences in off.items():
            *_, ours = compress(problem, size, elements, "quadrilateral", degree)
            differences.append(abs(ours / force[1:] - 1).max())
    for coarse, fine in off.values():
        assert fine < coarse / 3 and fine < 0.006
