"""Prints what one UMAT call costs, over an elastic UMAT's call and over a point of a batch with its tangent."""

import statistics
import subprocess
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core import STATE
from ..material import Material
from .batches import random_batch

POINTS = 20_000
REPEATS = 5


class UmatCosts(NamedTuple):
    """Nanoseconds, medians over the repetitions."""

    elastic: float      # a call of an elastic UMAT
    umat: float         # a call of granumat's
    point: float        # a point of a batch with its tangent


def umat_costs(points: int = POINTS, repeats: int = REPEATS) -> UmatCosts:
    """Measure a UMAT call, by the program umat_cost of the build, and a batch of points in turn."""
    program = Path(__file__).parents[1] / "umat_cost"
    material = Material()
    states, gradient = random_batch(material, points)
    out = np.empty(points, STATE)
    rows = []
    for _ in range(repeats):
        printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
        start = time.process_time()
        material.update_with_tangent(states, gradient, out=out)
        rows.append([*map(float, printed.split()), (time.process_time() - start) / points * 1e9])
    return UmatCosts(*(statistics.median(column) for column in zip(*rows)))


def print_umat(points: int = POINTS, repeats: int = REPEATS) -> None:
    """Print the costs of a UMAT call."""
    cost = umat_costs(points, repeats)
    print(f"one UMAT call with all its arguments, {cost.umat:.0f} ns: {cost.umat / cost.elastic:.0f} x an elastic UMAT's, "
          f"{cost.umat / cost.point:.1f} x a point in the batch with its tangent")
