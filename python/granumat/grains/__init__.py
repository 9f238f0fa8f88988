"""The law against measured histories of grains in simple shear: reading, driving the law along their paths, scores."""

from .calibration import ALL, GROUPS, Calibration, FittedSet, calibrate
from .comparison import Comparison, compare, read_model
from .measured import KEYS, Run, read_runs
from .predicted import Prediction, predict
from .scores import PHASES, QUANTITIES, Yardstick

__all__ = ["ALL", "GROUPS", "KEYS", "PHASES", "QUANTITIES", "Calibration", "Comparison", "FittedSet", "Prediction", "Run",
           "Yardstick", "calibrate", "compare", "predict", "read_model", "read_runs"]
