"""The study of ellipticity after a reversal: what it writes, and the numbers of docs/well-posedness.md."""

import csv

import numpy as np
import pytest

from granumat import Material
from granumat.cli import main
from granumat.studies import growth, wellposed


@pytest.mark.parametrize("mu, closure, eta_t, plane, space, lasts", [
    (0.5, "basic", -0.095, -0.050, -0.050, 0.131), (0.5, "n2", -0.095, -0.050, -0.081, 0.131),
    (0.5, "full table-1", 0.071, -0.0003, -0.0003, 0), (0.5, "kinematic", 0.152, 0, 0, 0),
    (0.1, "full table-1", -0.057, -0.030, -0.044, 0.125), (0.3, "full table-1", 0.021, -0.002, -0.018, 0.055),
    (1.0, "full figure-16", 0.033, -0.002, -0.021, 0.055)])
def test_what_the_closures_lose_after_a_reversal(mu, closure, eta_t, plane, space, lasts):
    curve = wellposed.curve(mu, closure, 0.0)
    assert curve.loss("eta_t")["after_reversal"] == pytest.approx(eta_t, abs=6e-4)
    assert curve.loss("in_plane")["after_reversal"] == pytest.approx(plane, abs=6e-4)
    assert curve.loss("eigenvalue")["after_reversal"] == pytest.approx(space, abs=6e-4)
    assert curve.loss("eigenvalue")["duration_deep"] == pytest.approx(lasts, abs=0.002)


@pytest.mark.parametrize("closure, eigenvalue, lasts, steady", [
    ("basic", -5.2, 0.105, -0.057), ("full table-1", 0.02, 0, -0.023), ("kinematic", 4.1, 0, -0.013)])
def test_an_elastic_strain_does_not_change_which_closures_lose_it(closure, eigenvalue, lasts, steady):
    curve = wellposed.curve(0.5, closure, 0.01)
    loss = curve.loss("eigenvalue")
    assert loss["after_reversal"] == pytest.approx(eigenvalue, abs=0.05 * abs(eigenvalue) + 0.01)
    assert loss["duration"] == pytest.approx(lasts, abs=0.002) == curve.loss("determinant")["duration"]
    assert loss["steady"] == pytest.approx(steady, abs=6e-4)


@pytest.mark.parametrize("closure, eigenvalue, lasts", [("mobilised", -3.58, 0.79), ("mobilised-pressure", -4.23, 0.58)])
def test_where_friction_turns_the_stiffness_in_compression_takes_the_shear_stress_along(closure, eigenvalue, lasts):
    curve = wellposed.curve(0.5, closure, 0.01)
    loss = curve.loss("eigenvalue")
    assert loss["after_reversal"] == pytest.approx(eigenvalue, abs=0.01) == loss["steady"]
    assert loss["duration"] == pytest.approx(lasts, abs=0.01)
    material = Material(0.5, closure, elastic_strain=0.01)
    steady = material.steady(material["phic"] + wellposed.DISTANCE)
    compression = material.response(steady)[:, :3].sum(1) / 3                          # by tr D
    ratio = 3 * steady.stress / steady.stress[:3].sum()
    np.testing.assert_allclose(compression, compression[:3].mean() * ratio, rtol=0, atol=1e-9 * compression[0])


@pytest.mark.slow
@pytest.mark.release_only
def test_the_command_writes_curves_table_and_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(wellposed, "MUS", (0.1, 0.5))
    monkeypatch.setattr(wellposed, "INCREMENTS", 50)
    monkeypatch.setattr(growth, "ANGLES", np.array([0.1, 1.0]))
    monkeypatch.setattr(growth, "CLOSURES", ("basic", "kinematic"))
    assert main(["wellposed", "--out", str(tmp_path / "new")]) == 0
    printed = capsys.readouterr().out
    for name in ("wellposed.csv", "wellposed-loss.csv", "wellposed.png", "growth.csv", "growth.png"):
        assert f"wrote {tmp_path / 'new' / name}" in printed
    assert " 0.5 kinematic        0.01   0.1520   0.000" in printed
    assert "kinematic  steady           0.01  0.8" in printed
    with open(tmp_path / "new/wellposed-loss.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * (6 * 2 + 2) * 4 and {row["closure"] for row in rows} == set(wellposed.CLOSURES)
    with open(tmp_path / "new/wellposed.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * (6 * 2 + 2) * 51
    kept = [float(row["eta_t"]) for row in rows if row["closure"] == "kinematic" and row["mu"] == "0.5"]
    np.testing.assert_allclose(kept, kept[0], rtol=1e-6)
    assert (tmp_path / "new/wellposed.png").read_bytes()[:4] == b"\x89PNG"
