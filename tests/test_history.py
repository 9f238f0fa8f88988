"""What a history has: its columns, its names, its one line, and the figure of each test."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import Material, driver
from granumat.history import ACOUSTIC, COLUMNS, WORDS
from granumat.plotting import PANELS, history_figure, kind_of

SAND = Material(0.5, elastic_strain=0.001)
START = SAND.isotropic(0.60, pressure=0.005)
RESULTS = (Path(__file__).parents[1] / "docs/results.md").read_text()

pytestmark = [pytest.mark.release_only, pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")]


def run(*steps, state=START):
    return driver.run(SAND, state, steps)


def names_in_table(heading):
    """What stands in backquotes in the first column of the table below a heading of docs/results.md."""
    rows = re.findall(r"^\| (`.*?)\|", RESULTS.split(f"## {heading}\n")[1].split("\n## ")[0], re.M)
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


# ---- columns ---------------------------------------------------------------------------------------------------------

def test_the_page_names_every_column():
    assert names_in_table("Columns of a history") == [*COLUMNS, ACOUSTIC]


@pytest.mark.parametrize("step", [driver.triaxial(0.02), driver.biaxial(0.02), driver.shear(0.2, "pressure"),
                                  driver.isotropic_compression(pressure=0.007), driver.oedometer(sigma_zz=0.007)],
                         ids=lambda step: step.name)
def test_the_volume_strain_is_the_logarithm_of_the_volume_of_the_grains(step):
    history = run(step)
    np.testing.assert_allclose(history["volume_strain"], np.log(history["phi"][0] / history["phi"]), atol=1e-13)
    np.testing.assert_allclose(history["volume_strain"], history["e_xx"] + history["e_yy"] + history["e_zz"], atol=1e-15)
    assert abs(history["volume_strain"][-1]) > 1e-4


def test_strains_are_those_of_the_steps_and_go_on_from_step_to_step():
    history = run(driver.triaxial(0.02, increments=40), driver.pause(), driver.shear(0.1, increments=10))
    np.testing.assert_allclose(history["e_zz"][:41], -np.linspace(0, 0.02, 41), atol=1e-15)
    assert history["e_zz"][-1] == pytest.approx(-0.02) and history["e_xz"][-1] == pytest.approx(0.05)
    assert history["e_xx"][-1] == history["e_yy"][-1] != 0 and (history["e_xy"] == 0).all()


def test_q_and_its_ratio_are_those_of_the_triaxial_test():
    history = run(driver.triaxial(0.02))
    np.testing.assert_allclose(history["q"], history["sigma_zz"] - history["sigma_xx"], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(history["q_over_p"] * history["p"], history["q"], rtol=1e-14)


def test_the_ratio_on_the_plane_of_shear_is_that_of_the_held_normal_stress():
    history = run(driver.direct_shear(0.2))
    np.testing.assert_allclose(history["tau_over_sigma_n"], -history["sigma_xz"] / 0.005, rtol=1e-6)
    assert history["tau_over_sigma_n"][-1] < history["stress_ratio"][-1]


def test_ratios_of_a_body_without_pressure_are_zero():
    columns = driver.run(SAND, SAND.state(0.5, 1.0), [driver.shear(0.01, increments=2)]).columns
    assert all((columns[name] == 0).all() for name in ("p", "q", "q_over_p", "stress_ratio", "tau_over_sigma_n"))


@pytest.mark.parametrize("until, name, value", [("stress_ratio > 0.3", "stress_ratio", 0.3), ("q/p > 0.5", "q_over_p", 0.5),
                                                ("tau/sigma_n >= 0.2", "tau_over_sigma_n", 0.2)])
def test_a_step_ends_at_a_stress_ratio(until, name, value):
    history = run(driver.direct_shear(1.0, increments=2000, until=until))
    assert history[name][-2] < value <= history[name][-1] < value + 1e-3 and len(history) < 2001


# ---- a mapping -------------------------------------------------------------------------------------------------------

def test_a_history_is_a_mapping_of_its_columns():
    history = run(driver.shear(0.1, increments=10))
    assert list(history) == list(COLUMNS) == list(dict(history)) == list(history.keys())
    assert len(history) == 11 and len(history.values()) == len(history.items()) == len(COLUMNS)
    assert all(history[word] is history[symbol] for word, symbol in WORDS.items())
    assert "phi" in history and "volume_fraction" in history and "nothing" not in history
    assert history.get("nothing") is None and history == history and history != run(driver.pause())
    with pytest.raises(KeyError, match="there is no column 'nothing': there are step, gamma"):
        history["nothing"]


def test_a_history_prints_one_line():
    line = repr(run(driver.shear(0.1, increments=1000)))
    assert line.startswith("<History: 1001 rows, ") and "gamma 0.1, phi 0.6," in line
    assert "\n" not in line and len(line) < 132


def test_a_history_becomes_a_table_of_pandas():
    pandas = pytest.importorskip("pandas")
    history = run(driver.shear(0.1, increments=10))
    frame = history.to_pandas()
    assert isinstance(frame, pandas.DataFrame) and list(frame) == list(COLUMNS) and frame.index.name == "t"
    assert (frame["p"].to_numpy() == history["p"]).all() and (frame.index == history.times).all()


def test_without_pandas_the_table_is_refused_and_nothing_else(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    history = run(driver.pause())
    with pytest.raises(ImportError, match="pandas"):
        history.to_pandas()


# ---- the figure ------------------------------------------------------------------------------------------------------

FIGURES = [         # steps, kind, what the labels of the abscissa and of the panels contain
    ([driver.shear(0.1), driver.pause(), driver.shear(-0.1)], "shear", "accumulated",
     ["-\\sigma_{xz}/p", "pressure", "Z_2", "A_{xz}", "normal"]),
    ([driver.direct_shear(0.1)], "shear under a normal load", "accumulated",
     ["\\sigma_{zz}$", "pressure", "\\phi", "Z_2", "A_{xz}", "normal"]),
    ([driver.biaxial(0.02)], "axial", "-e_{zz}", ["$q\\", "q/p", "volume strain", "Z_2", "fabric", "normal"]),
    ([driver.triaxial(0.02, drained=False)], "axial", "-e_{zz}", ["$q\\", "q/p", "Z_2", "fabric", "normal", "pressure"]),
    (driver.cyclic_triaxial(1, 0.001), "axial", "-e_{zz}", ["$q\\", "q/p", "volume strain", "Z_2", "fabric", "normal"]),
    ([driver.isotropic_compression(pressure=0.006)], "isotropic", "e_{yy}", ["pressure", "\\phi", "Z_2", "normal"]),
    ([driver.deform([[0, 0.1, 0.1], [0, 0, 0], [0, 0, 0]])], "other", "accumulated",
     ["pressure", "q/p", "Z_2", "fabric", "normal"]),
    ([driver.pause()], "isotropic", "e_{yy}", ["pressure"]),
]


@pytest.mark.parametrize("steps, kind, abscissa, panels", FIGURES, ids=[figure[1] for figure in FIGURES])
def test_the_panels_are_those_of_the_test(steps, kind, abscissa, panels):
    history = run(*steps)
    assert kind_of(history) == kind
    axes = history_figure(history).axes
    assert len(axes) == len(panels) and all(words in ax.get_ylabel() for words, ax in zip(panels, axes)), [
        ax.get_ylabel() for ax in axes]
    assert all(abscissa in ax.get_xlabel() for ax in axes)
    if steps[0].name != "pause":
        for ax in axes:
            assert any(np.ptp(line.get_ydata()) > 1e-7 for line in ax.get_lines()[::2]), ax.get_ylabel()


def test_the_deviator_of_cycles_is_drawn_with_its_sign():
    line = history_figure(run(*driver.cyclic_triaxial(1, 0.001))).axes[0].get_lines()[0]
    assert line.get_ydata().max() == pytest.approx(0.001) and line.get_ydata().min() == pytest.approx(-0.001)


def test_every_kind_of_figure_is_tested():
    assert {kind for _, kind, _, _ in FIGURES} == set(PANELS)
