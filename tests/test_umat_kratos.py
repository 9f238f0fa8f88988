"""User_Mod and the UMAT in Kratos: demos/linking/kratos against the single-point driver."""

import runpy

import pytest


@pytest.fixture(scope="module")
def demo(kratos, tmp_path_factory):
    """What the demo's main returns: errors by name, iterations of the triaxial test."""
    return runpy.run_path(str(kratos / "run.py"))["main"](tmp_path_factory.mktemp("kratos"))


@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_strained_elements_equal_the_driver_to_round_off(demo):
    errors, _ = demo
    assert all(errors[f"{interface}, {dimension}D"] < 1e-12 for interface in ("UDSM", "UMAT") for dimension in (2, 3)), errors


def test_an_element_under_side_pressure_equals_the_driver_to_the_drivers_tolerance_in_three_iterations_an_increment(demo):
    errors, iterations = demo
    assert errors["UDSM, triaxial"] < 1e-9                            # the driver holds stresses to 1e-10
    assert iterations.min() > 0 and iterations.max() <= 3 and len(iterations) == 80
