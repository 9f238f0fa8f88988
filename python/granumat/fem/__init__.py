"""Quasi-static boundary-value problems on DOLFINx meshes. Needs DOLFINx; granumat itself does not."""

from importlib import import_module

try:
    for _module in ("mpi4py.MPI", "dolfinx", "petsc4py.PETSc"):    # mpi4py first: it loads for all a libmpi that pip installed
        import_module(_module)
except ImportError as error:
    raise ImportError("granumat.fem needs DOLFINx with PETSc: install Debian's python3-dolfinx, or granumat[fem] by pip for "
                      f"Python 3.12 or newer ({error})") from error

from . import meshes
from .checkpoint import Checkpoint, resume
from .conditions import Displacement, Inflow, NonlocalStrain, Outflow, Periodic, Pressure, Tied, Traction, polar, rotation
from .control import run
from .errors import SolveError
from .fields import Fields, cell_fields
from .pictures import Pictures, field_figure
from .problem import Problem, Tolerances
from .quantities import Quantities
from .symmetry import Symmetry
from .tables import Probe, Reactions

__all__ = ["Checkpoint", "Displacement", "Fields", "Inflow", "NonlocalStrain", "Outflow", "Periodic", "Pictures", "Pressure",
           "Probe", "Problem", "Quantities", "Reactions", "SolveError", "Symmetry", "Tied", "Tolerances", "Traction",
           "cell_fields", "field_figure", "meshes", "polar", "resume", "rotation", "run"]
