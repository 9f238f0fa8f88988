"""One element in Kratos, for Kratos' own Python: element.py LIBRARY LOADS.npz RESULTS.npz"""

import sys
from itertools import product

import KratosMultiphysics as Kratos
import KratosMultiphysics.GeoMechanicsApplication as Geo
import numpy as np

variable = Kratos.KratosGlobals.GetVariable

NODAL = ("DISPLACEMENT", "VELOCITY", "ACCELERATION", "REACTION", "WATER_PRESSURE", "DT_WATER_PRESSURE", "REACTION_WATER_PRESSURE",
         "VOLUME_ACCELERATION", "HYDRAULIC_DISCHARGE", "POINT_LOAD")
DRAINED = {"DENSITY_SOLID": 0.0, "DENSITY_WATER": 0.0, "POROSITY": 0.4, "BULK_MODULUS_SOLID": 1e12, "BULK_MODULUS_FLUID": 1e9,
           "DYNAMIC_VISCOSITY": 1e-3, "BIOT_COEFFICIENT": 1.0, "SATURATED_SATURATION": 1.0, "RESIDUAL_SATURATION": 0.0}
DRAINED |= {f"PERMEABILITY_{pair}": 0.0 for pair in ("XX", "YY", "ZZ", "XY", "YZ", "ZX")}
ELEMENTS = {2: "UPwSmallStrainElement2D4N", 3: "UPwSmallStrainElement3D8N"}
LAWS = {2: "2DPlaneStrainLaw", 3: "3DLaw"}
CORNERS = {2: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]}
CORNERS[3] = CORNERS[2] + [(x, y, 1) for x, y, _ in CORNERS[2]]


class Element:
    """A unit square or cube of dry sand; interface "UDSM" (User_Mod) or "UMAT"."""

    def __init__(self, dimension, interface, library, parameters):
        self.model = Kratos.Model()
        self.part = part = self.model.CreateModelPart("sand")
        part.SetBufferSize(2)
        self.axes = "XYZ"[:dimension]
        self.info = part.ProcessInfo
        self.info[Kratos.DOMAIN_SIZE] = dimension
        self.info[variable("VELOCITY_COEFFICIENT")] = self.info[variable("DT_PRESSURE_COEFFICIENT")] = 1.0
        for name in NODAL:
            part.AddNodalSolutionStepVariable(variable(name))
        for number, corner in enumerate(CORNERS[dimension], 1):
            part.CreateNewNode(number, *map(float, corner))
        material = part.CreateNewProperties(1)
        for name, value in DRAINED.items():
            material[variable(name)] = value
        material[variable("IGNORE_UNDRAINED")] = True
        material[variable("RETENTION_LAW")] = "SaturatedLaw"
        material[variable("UDSM_NAME")] = library
        material[variable("UDSM_NUMBER")] = 1
        material[variable("IS_FORTRAN_UDSM")] = True
        material[variable("UMAT_PARAMETERS")] = Kratos.Vector(list(parameters))
        material[variable("STATE_VARIABLES")] = Kratos.Vector(23, 0.0)
        law = Kratos.KratosGlobals.GetConstitutiveLaw(f"SmallStrain{interface}{LAWS[dimension]}")
        material[Kratos.CONSTITUTIVE_LAW] = law.Clone()
        part.CreateNewElement(ELEMENTS[dimension], 1, [node.Id for node in part.Nodes], material)
        for axis in self.axes:
            Kratos.VariableUtils().AddDof(variable(f"DISPLACEMENT_{axis}"), variable(f"REACTION_{axis}"), part)
        Kratos.VariableUtils().AddDof(variable("WATER_PRESSURE"), variable("REACTION_WATER_PRESSURE"), part)
        for node in part.Nodes:
            node.Fix(variable("WATER_PRESSURE"))
        self.material = material

    def prescribe(self, node, axis, value):
        node.Fix(variable(f"DISPLACEMENT_{axis}"))
        node.SetSolutionStepValue(variable(f"DISPLACEMENT_{axis}"), float(value))

    def push_sides(self, pressure):
        """Forces of a pressure on the sides x = 1 and y = 1; the sides x = 0 and y = 0 do not move along their normals."""
        for number, node in enumerate(self.part.Nodes, 1):
            self.part.CreateNewCondition("UPwForceCondition3D1N", number, [node.Id], self.material)
            for axis, place in (("X", node.X0), ("Y", node.Y0)):
                if place == 0:
                    self.prescribe(node, axis, 0)
                else:
                    node.SetSolutionStepValue(variable(f"POINT_LOAD_{axis}"), -pressure / 4)

    def start(self):
        self.strategy = Kratos.ResidualBasedNewtonRaphsonStrategy(
            self.part, Geo.BackwardEulerQuasistaticUPwScheme(), Kratos.ResidualCriteria(1e-14, 1e-9),
            Kratos.ResidualBasedBlockBuilderAndSolver(Kratos.SkylineLUFactorizationSolver()), 30, True, False, False)
        self.strategy.SetEchoLevel(0)
        self.strategy.Initialize()
        self.time = 0

    def begin(self):
        self.time += 1
        self.part.CloneTimeStep(float(self.time))
        self.info[Kratos.STEP], self.info[Kratos.DELTA_TIME] = self.time, 1.0

    def solve(self):
        """Newton iterations, or -1, and the stress (points, 4 or 6) after the step."""
        self.strategy.InitializeSolutionStep()
        self.strategy.Predict()
        converged = self.strategy.SolveSolutionStep()
        self.strategy.FinalizeSolutionStep()
        element = next(iter(self.part.Elements))
        stress = element.CalculateOnIntegrationPoints(variable("CAUCHY_STRESS_VECTOR"), self.info)
        return self.info[Kratos.NL_ITERATION_NUMBER] if converged else -1, [list(point) for point in stress]


def strain(element, gradients):
    """All nodes follow symmetric displacement gradients (n, 3, 3), from the start: stress (n, points, 4 or 6)."""
    element.start()
    stress = []
    for gradient in gradients:
        element.begin()
        for node in element.part.Nodes:
            for axis, value in zip(element.axes, gradient @ [node.X0, node.Y0, node.Z0]):
                element.prescribe(node, axis, value)
        stress.append(element.solve()[1])
    return np.array(stress)


def triaxial(element, axial, pressure):
    """Axial displacements (n,) of the face z = 1 under a constant pressure on the sides: iterations (n,), stress (n, points, 6)."""
    element.push_sides(pressure)
    element.start()
    iterations, stress = [], []
    for displacement in axial:
        element.begin()
        for node in element.part.Nodes:
            element.prescribe(node, "Z", displacement * node.Z0)
        iteration, point = element.solve()
        iterations.append(iteration)
        stress.append(point)
    return np.array(iterations), np.array(stress)


def main(library, loads, results):
    given, found = np.load(loads), {}
    for dimension, interface in product((2, 3), ("UDSM", "UMAT")):
        element = Element(dimension, interface, library, given[f"{interface}_parameters"])
        found[f"{interface}_{dimension}"] = strain(element, given[f"gradients_{dimension}"])
    element = Element(3, "UDSM", library, given["UDSM_parameters"])
    found["iterations"], found["triaxial"] = triaxial(element, given["axial"], float(given["pressure"]))
    np.savez(results, **found)


if __name__ == "__main__":
    main(*sys.argv[1:])
