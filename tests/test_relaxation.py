"""The weights of the exponential integration of e_r (docs/theory.md, section 4), against 60 digits."""

import subprocess
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
SOURCES = [*(f"fortran/{name}.f90" for name in ("base/kinds", "base/quadrature", "exact/relaxation")),
           "tests/fortran/relaxation_weights.f90"]
LOBATTO = [1.0, 0.0, 0.5, 0.5 + (3 / 28) ** 0.5, 0.5 - (3 / 28) ** 0.5]         # u = 1 - t of the places, those of degree n first
CROWDED = [1.0, 0.0, 0.07, 0.31, 0.71]
RATIOS = np.geomspace(1e-3, 1e3, 301)
ERROR = 1e-13                # of the largest weight: the round-off of five distinct places


def moments(ratio):
    """Integrals of ratio exp(-ratio u) u^(j-1) over 0 <= u <= 1, j = 1 ... 5: the series of the last, then backward."""
    edge = (-ratio).exp()
    term = total = edge * ratio / 5
    k = 5
    while term > total * Decimal("1e-60"):
        k += 1
        term *= ratio / k
        total += term
    found = [total]
    for j in (4, 3, 2, 1):
        found.insert(0, ratio / j * (found[0] + edge))
    return found


def lagrange(i, places):
    """Coefficients, of u^0 first, of the polynomial that is 1 at one place and 0 at the others."""
    coefficients = [Decimal(1)]
    for k, place in enumerate(places):
        if k != i:
            shifted, kept = [Decimal(0), *coefficients], [*coefficients, Decimal(0)]
            coefficients = [(s - place * c) / (places[i] - place) for s, c in zip(shifted, kept)]
    return coefficients


@pytest.mark.release_only
@pytest.mark.parametrize(("degree", "places"), [(1, LOBATTO), (2, LOBATTO), (4, LOBATTO), (4, CROWDED)])
def test_weights_are_at_round_off_for_every_ratio(tmp_path, degree, places):
    build = ["gfortran", "-O2", *(ROOT / source for source in SOURCES), "-o", "weights"]
    subprocess.run([str(word) for word in build], cwd=tmp_path, check=True)
    given = "\n".join([" ".join(map(repr, [degree, *places])), *map(repr, RATIOS.tolist())])
    printed = subprocess.run([tmp_path / "weights"], input=given, capture_output=True, text=True, check=True).stdout
    found = np.array(printed.split(), float).reshape(-1, 5)
    with localcontext() as context:
        context.prec = 80
        used = [Decimal(place) for place in places[:degree + 1]]
        polynomials = [lagrange(i, used) for i in range(degree + 1)]
        expected = np.array([[float(sum(c * m for c, m in zip(polynomial, moments(Decimal(ratio))))) for polynomial in polynomials]
                             for ratio in RATIOS.tolist()])
    errors = np.abs(found[:, :degree + 1] - expected).max(1) / np.abs(expected).max(1)
    assert errors.max() < ERROR, RATIOS[errors.argmax()]
    assert not found[:, degree + 1:].any()
