"""Calibration files: that their constants are those of the material, wherever the file is named, and that faults have words."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from granumat import Material, calibrations
from granumat.coarsen import referred_files, relocated
from granumat.grains import Yardstick, predict, read_model, read_runs
from granumat.material import CLOSURES, TURNING
from granumat.paths import read_path_file
from granumat.toml import read_toml, write_content

DATA = Path(__file__).parents[1] / "demos" / "data"

ROWS = [{"mu": 0.5, "a1": 0.009, "phic": 0.577, "d3": -17.0}, {"mu": 0.1, "a1": 0.011, "phic": 0.612, "d3": -25.0}]
PATH = '[material]\nmu = 0.3\ncalibration = "sand.toml"\n[initial]\nstate = "steady"\nphi = 0.61\n[[step]]\nshear = 0.1\n'


@pytest.fixture
def file(tmp_path):
    write_content(tmp_path / "sand.toml", {"contact": "hookean", "constants": ROWS, "provenance": {"fitted to": "nothing"}})
    return tmp_path / "sand.toml"


def test_constants_are_those_of_the_file_and_linear_between_two_mu(file):
    for row in ROWS:
        material = Material(row["mu"], calibration=str(file))
        assert {name: material[name] for name in row} == row
        assert material["c1"] == Material(row["mu"])["c1"]                     # those that the file does not have are printed ones
    assert Material(0.2, calibration=str(file))["phic"] == pytest.approx(0.612 - 0.25 * 0.035, rel=1e-14)


def test_a_file_that_is_written_anew_is_read_anew(file):
    Material(0.5, calibration=str(file))
    file.write_text(file.read_text().replace("0.577", "0.578"))
    assert Material(0.5, calibration=str(file))["phic"] == 0.578


def test_constants_that_are_given_come_before_those_of_the_file(file):
    assert Material(0.5, calibration=str(file), phic=0.58)["phic"] == 0.58


def test_constants_without_a_role_in_a_closure_are_left_out(file):
    material = Material(0.5, "critical", calibration=str(file))
    assert (material["phic"], material["d3"]) == (0.577, Material(0.5)["d3"])


def test_a_file_of_the_printed_constants_gives_the_printed_material(tmp_path):
    names = ("a1", "a2", "a3", "a4", "b1", "b2", "Zc", "phic", "c1", "c2", "c3", "d1", "d2", "d3", "beta1", "beta2", "g")
    printed = Material(0.3)
    write_content(tmp_path / "printed.toml", {"constants": [{"mu": 0.3} | {name: printed[name] for name in names}]})
    assert np.array_equal(Material(0.3, calibration=str(tmp_path / "printed.toml")).parameters, printed.parameters)


def test_a_material_can_be_made_again_in_another_folder(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    material = Material(0.3, calibration="sand.toml")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    for again in (Material(**material.definition), pickle.loads(pickle.dumps(material))):
        assert np.array_equal(again.parameters, material.parameters)
    assert Material(**(material.definition | {"mu": 0.1}))["phic"] == 0.612


def test_a_path_file_and_a_model_name_it_from_their_own_folder(file, tmp_path, monkeypatch):
    (tmp_path / "path.toml").write_text(PATH)
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    expected = Material(0.3, calibration=str(file))
    assert np.array_equal(read_path_file(tmp_path / "path.toml").material.parameters, expected.parameters)
    assert np.array_equal(Material(**read_model(tmp_path / "path.toml")).parameters, expected.parameters)


def test_a_ladder_knows_that_it_is_a_file():
    content = {"material": {"calibration": "sand.toml"}, "step": [{"csv": "table.csv"}, {"shear": 1.0}]}
    assert referred_files(content) == ["table.csv", "sand.toml"]
    moved = relocated(content, lambda name: f"/there/{name}")
    assert moved["material"]["calibration"] == "/there/sand.toml" and content["material"]["calibration"] == "sand.toml"
    assert referred_files({"material": {"calibration": "text"}}) == []


def test_a_closure_with_a_table_of_its_own_takes_its_constants_from_there(tmp_path):
    own = [{"mu": 0.1, "a1": 0.02}, {"mu": 0.5, "a1": 0.03}]
    write_content(tmp_path / "sand.toml", {"constants": ROWS, "kinematic": own, "fitted": [{"closure": "kinematic", "mu": 0.1}]})
    kinematic, full = (Material(0.3, closure, calibration=str(tmp_path / "sand.toml")) for closure in ("kinematic", "full"))
    assert kinematic["a1"] == pytest.approx(0.025) and kinematic["phic"] == Material(0.3)["phic"]
    assert full["a1"] == pytest.approx(0.010)


def test_a_file_for_one_closure_only_is_refused_by_the_others(tmp_path):
    write_content(tmp_path / "sand.toml", {"kinematic": ROWS})
    assert Material(0.5, "kinematic", calibration=str(tmp_path / "sand.toml"))["a1"] == 0.009
    with pytest.raises(ValueError, match="has constants for the closure kinematic, not for full"):
        Material(0.5, calibration=str(tmp_path / "sand.toml"))


def test_the_elastic_strain_is_the_calibrations_where_it_is_not_given(tmp_path):
    write_content(tmp_path / "sand.toml", {"constants": [{"mu": 0.5, "elastic_strain": 0.02}]})
    for given, expected in (({}, 0.02), ({"elastic_strain": 0.0}, 0.0), ({"elastic_strain": 0.005}, 0.005)):
        material = Material(0.5, calibration=str(tmp_path / "sand.toml"), **given)
        assert material["elastic_strain"] == expected == Material(**material.definition)["elastic_strain"]
    assert Material(0.5)["elastic_strain"] == 0
    assert Material(0.5, "mobilised", calibration=str(tmp_path / "sand.toml"))["elastic_strain"] == 0.02


# ---- dem-2026 ----------------------------------------------------------------------------------------------------------------

SHIPPED = read_toml(calibrations.SHIPPED["dem-2026"])


@pytest.mark.parametrize("closure", CLOSURES)
def test_dem_2026_is_a_calibration_of_every_closure_by_name(closure, tmp_path):
    material = Material(0.4, closure, calibration="dem-2026")
    rows = SHIPPED.get(closure) or SHIPPED["constants"]
    for name in ("a1", "b1", "b2", "phic", "c1", "c2", "elastic_strain"):
        known = [row[name] for row in rows]
        assert material[name] == pytest.approx(np.interp(0.4, [row["mu"] for row in rows], known), rel=1e-12), name
    write_content(tmp_path / "path.toml", {"material": material.definition, "initial": {"state": "steady", "phi": 0.61},
                                           "step": [{"shear": 0.1}]})
    assert np.array_equal(read_path_file(tmp_path / "path.toml").material.parameters, material.parameters)
    assert np.array_equal(pickle.loads(pickle.dumps(material)).parameters, material.parameters)


def test_the_printed_constants_remain_the_default():
    assert Material(0.5).calibration == "table-1" and Material(0.5)["phic"] != Material(0.5, calibration="dem-2026")["phic"]


def test_dem_2026_says_where_it_holds_and_how_well_it_is_known():
    for noted in SHIPPED["fitted"]:
        assert noted["runs"] and len(noted["phi"]) == 2 and noted["strain"] > 1 and noted["scores run left out"]["all"]["p"] < 0.2
        row, = (row for row in SHIPPED.get(noted["closure"]) or SHIPPED["constants"] if row["mu"] == noted["mu"])
        assert noted["deviations"].keys() <= row.keys() and noted["deviations"]["phic"] < 0.02
    mus = [row["mu"] for row in SHIPPED["constants"]]
    with pytest.raises(ValueError, match=f"has constants for mu = {mus[0]:g} to {mus[-1]:g}, not for 0.9"):
        Material(0.9, calibration="dem-2026")


@pytest.mark.release_only
@pytest.mark.parametrize("closure", ["full", *TURNING])
def test_dem_2026_halves_the_error_of_the_printed_constants_on_the_figures_data(closure):
    for table in sorted(DATA.glob("cv_mu*_s*.csv")):
        run, = read_runs([table])
        yardstick = Yardstick.of(run)
        options = {"closure": closure} | ({"elastic_strain": 0.01} if closure in TURNING else {})
        printed, fitted = (yardstick.scores(predict(run, Material(run.mu, **definition)))[0]
                           for definition in (options, {"closure": closure, "calibration": "dem-2026"}))
        assert (fitted[:4] < 0.7 * printed[:4]).all(), table


@pytest.mark.parametrize("content, words", [
    ({}, r"has no \[\[constants\]\]"),
    ({"constants": ROWS, "constant": 1}, "unknown table or key 'constant': .*did you mean 'constants'"),
    ({"constants": [{"mu": 0.5, "phi_c": 0.58}]}, "constants 1: unknown name 'phi_c': .*did you mean 'phic'"),
    ({"constants": [{"mu": 0.5, "a1": "soft"}]}, "constants 1: a1 = 'soft': must be a finite number"),
    ({"constants": [{"a1": 0.01}]}, "constants 1: mu is missing"),
    ({"constants": [*ROWS, {"mu": 0.7, "a1": 0.01}]}, "constants 3: has mu, a1, but the first has mu, a1, phic, d3"),
    ({"constants": [*ROWS, *ROWS]}, "has constants for one mu twice: 0.1, 0.1, 0.5, 0.5"),
    ({"constants": ROWS[:1]}, "has constants for mu = 0.5, not for 0.3"),
    ({"constants": [{"mu": 0.4, "a1": 0.01}, {"mu": 0.6, "a1": 0.01}]}, "has constants for mu = 0.4 to 0.6, not for 0.3"),
    ({"contact": "hertzian", "constants": ROWS}, "has constants for contact = 'hertzian', not for 'hookean'"),
    ({"constants": [row | {"a1": -1.0} for row in ROWS]}, "a1 = -1.0: must be"),
])
def test_each_fault_of_a_file_has_its_words(tmp_path, content, words):
    write_content(tmp_path / "sand.toml", content)
    with pytest.raises(ValueError, match=words):
        Material(0.3, calibration=str(tmp_path / "sand.toml"))


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(ValueError, match=r"the material cannot be made:\n .*none.toml"):
        Material(0.3, calibration="none.toml")
