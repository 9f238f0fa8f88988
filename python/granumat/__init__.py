"""Sun & Sundaresan (2011): rate-independent granular materials whose stress follows from their evolving microstructure.

`Material` is the constitutive law, `driver` follows load paths of a single point, `granumat.fem` (with DOLFINx) solves
boundary-value problems.
"""

from . import driver, tensors
from .core import STATE
from .errors import ConstrainedDeformationWarning, GranumatError, MaterialError, PathError
from .material import Ellipticity, Material

__all__ = ["STATE", "ConstrainedDeformationWarning", "Ellipticity", "GranumatError", "Material", "MaterialError", "PathError",
           "driver", "tensors"]
__version__ = "0.1.0"
