"""Sun & Sundaresan (2011): rate-independent granular materials whose stress follows from evolving microstructure."""

from .core import STATE
from .errors import ConstrainedDeformationWarning, GranumatError, MaterialError, PathError
from .material import Material

__all__ = ["STATE", "ConstrainedDeformationWarning", "GranumatError", "Material", "MaterialError", "PathError"]
__version__ = "0.1.0"
