"""Quasi-static boundary-value problems on DOLFINx meshes. Needs DOLFINx; granumat itself does not."""

from . import meshes
from .conditions import Displacement, Periodic, Pressure, Tied, Traction, polar, rotation
from .control import run
from .errors import SolveError
from .problem import Problem, Tolerances

__all__ = ["Displacement", "Periodic", "Pressure", "Problem", "SolveError", "Tied", "Tolerances", "Traction", "meshes", "polar",
           "rotation", "run"]
