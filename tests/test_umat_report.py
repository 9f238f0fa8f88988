"""The validation report and the page of hosts say what is so."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
REPORT, HOSTS = ((ROOT / "docs" / name).read_text() for name in ("validation-report.md", "hosts.md"))
pytestmark = pytest.mark.release_only


@pytest.fixture(scope="module")
def report():
    """What demos/linking/report.py defines, and its histories."""
    names = runpy.run_path(str(ROOT / "demos/linking/report.py"))
    return names | {"histories": names["run_all"]()}


def ends(report, name):
    """p/p0 and q/p (n,) of the loose and of the dense packing."""
    for phi in report["DENSITIES"]:
        p, q = report["invariants"](report["histories"][name, phi].states)
        yield p, q / np.maximum(p, 1e-12)


def test_the_table_of_element_tests_is_what_they_give(report):
    assert "\n".join(report["table"](report["histories"])) in REPORT


def test_drained_friction_rises_without_a_peak_to_the_same_value(report):
    for name in list(report["TESTS"])[2:5:2] + [list(report["TESTS"])[5]]:
        (_, loose), (_, dense) = ends(report, name)
        assert np.diff(loose).min() > -1e-3 and np.diff(dense).min() > -1e-3, name
        assert abs(loose[-1] - dense[-1]) < 0.01, name


def test_volume_and_pressure_go_as_the_report_says(report):
    histories, tests = report["histories"], list(report["TESTS"])
    loose, dense = (histories[tests[5], phi]["phi"] for phi in report["DENSITIES"])
    assert loose.max() > loose[0] + 5e-4 and dense.max() < dense[0] + 1e-4 and abs(loose[-1] - dense[-1]) < 1e-3
    for name in (tests[3], tests[6]):
        (loose, _), (dense, _) = ends(report, name)
        assert loose.min() < 0.6 and dense.min() > 0.99, name
    (loose, _), (dense, _) = ends(report, tests[7])
    assert loose[8 * 200] < 0.01 and 0.9 < dense[-1] < 1
    root = np.sqrt(next(ends(report, tests[0]))[0])
    strain = np.log(histories[tests[0], 0.59]["phi"])
    assert np.corrcoef(root, strain)[0, 1] > 0.999


def test_k0_is_as_the_report_says(report):
    stress = report["histories"][list(report["TESTS"])[1], 0.59].states.stress[-1]
    assert f"K0 after 0.2 % is {stress[0] / stress[2]:.2f}" in REPORT


def test_the_parameters_of_the_report_are_those_of_the_code():
    code = re.findall(r'property\("(\w+)", .*?"([^"]+)", +"([^"]+)"\)', (ROOT / "fortran/faces/umat.f90").read_text())
    rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| ([^|]+) \| ([^|]+) \|", REPORT, re.M)
    units = {"-": "-", "F/L^2#": "stress"}
    assert rows == [(name, allowed, units[unit]) for name, allowed, unit in code] and len(rows) == 10


def test_every_host_is_run_by_a_command_or_said_not_to_be():
    rows = [[cell.strip() for cell in line.split("|")] for line in HOSTS.splitlines() if line.startswith("|")][2:]
    for _, host, _, command, _, state, _ in rows:
        run = (ROOT / command.strip("`")).is_file()
        assert run == (state == "run by the tests") == (command != "not run"), host
    assert len(rows) == 11
