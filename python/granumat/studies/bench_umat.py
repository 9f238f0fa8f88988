"""Prints what one UMAT call costs, as a multiple of an elastic UMAT's and of the batch's per-point cost with the tangent."""

import statistics
import subprocess
import time
from pathlib import Path

import numpy as np

from ..core import STATE
from ..material import Material
from .batches import random_batch

POINTS = 20_000
REPEATS = 5


def umat_costs():
    """Nanoseconds of an elastic UMAT's call, of this one's, and of a point in the batch with its tangent; medians of turns."""
    program = Path(__file__).with_name("umat_cost")
    material = Material()
    states, gradient = random_batch(material, POINTS)
    out = np.empty(POINTS, STATE)
    rows = []
    for _ in range(REPEATS):
        printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
        start = time.process_time()
        material.update_with_tangent(states, gradient, out=out)
        rows.append([*map(float, printed.split()), (time.process_time() - start) / POINTS * 1e9])
    return [statistics.median(column) for column in zip(*rows)]


def print_umat():
    elastic, umat, point = umat_costs()
    print(f"one UMAT call with all its arguments, {umat:.0f} ns: {umat / elastic:.0f} x an elastic UMAT's, "
          f"{umat / point:.1f} x a point in the batch with its tangent")
