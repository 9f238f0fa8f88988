"""The figures: what they draw, against numbers that do not come from granumat.studies.figures."""

import numpy as np
import pytest

from granumat import Material
from granumat.studies import ensemble, figures
from support.reference import constants

pytestmark = pytest.mark.release_only


@pytest.fixture(scope="module")
def draw():
    """Figures by number with the printed constants alone, each drawn once."""
    drawn = {}

    def figure(name):
        if name not in drawn:
            drawn[name] = figures.FIGURES[name]()
        return drawn[name]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "SHOWN", ["table-1"])
        yield figure


def curves(figure, panel, dem=False):
    """Data (x, y) of the model's curves in a panel, or of its DEM points."""
    lines = [line for line in figure.axes[panel].lines if (line.get_linestyle() == "None") == dem]
    return [np.array(line.get_data(), float) for line in lines if dem or len(line.get_xdata()) > 2]


@pytest.mark.slow
def test_every_figure_is_written_under_its_number(tmp_path):
    paths = figures.draw_figures(tmp_path / "new")
    assert [path.name for path in paths] == [f"figure-{n:02d}.png" for n in range(1, 17)]
    for path in paths:
        assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and path.stat().st_size > 20_000, path.name


@pytest.mark.slow
def test_chosen_figures_are_written_in_the_order_asked_for(tmp_path):
    assert figures.draw_figures(tmp_path, [16, "5"]) == [tmp_path / "figure-16.png", tmp_path / "figure-05.png"]
    assert len(list(tmp_path.iterdir())) == 2


def test_all_numbers_without_a_figure_are_refused_at_once(tmp_path):
    with pytest.raises(ValueError, match=r"(?s)'0': must be one of 1, 2, 3.*'17'"):
        figures.draw_figures(tmp_path / "none", ["1", "0", 17])
    assert not (tmp_path / "none").exists()


def test_missing_data_are_said_to_be_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(ensemble, "FOLDER", tmp_path / "none")
    for read in (lambda: ensemble.programme("reversal", 0.5, 0.6), lambda: ensemble.steady(0.5), ensemble.compressions):
        with pytest.raises(FileNotFoundError, match=r"no DEM data in .*none: the build puts demos/data/ensemble"):
            read()


def test_figures_whose_runs_are_not_there_yet_say_so_and_draw_the_model(monkeypatch):
    monkeypatch.setattr(figures, "programme", lambda *_: None)
    for name in ("2", "10", "11"):
        figure = figures.FIGURES[name]()
        assert "no DEM run of this project yet" in figure.texts[1].get_text()
        assert curves(figure, 0) and not curves(figure, 0, dem=True)


def test_a_calibration_is_drawn_beside_the_printed_one_where_it_has_constants(tmp_path, monkeypatch):
    file = tmp_path / "other.toml"
    file.write_text("".join(f"[[constants]]\nmu = {mu}\nphic = 0.57\nZc = 4.5\n" for mu in (0.1, 0.5)))
    monkeypatch.setattr(figures, "SHOWN", ["table-1", str(file)])
    printed, other = curves(figures.FIGURES["1"](), 0)
    assert other[1][0] == pytest.approx(-Material(0.5, calibration=str(file)).steady(0.6)["stress"][:3].mean())
    assert other[1][0] > 1.2 * printed[1][0]
    (mu, _), (other_mu, other_Zc) = curves(figures.FIGURES["5"](), 0)
    assert (mu[0], mu[-1]) == (0, 1) and (other_mu[0], other_mu[-1]) == (0.1, 0.5) and set(other_Zc) == {4.5}
    assert len(curves(figures.FIGURES["9"](), 0)) == 8            # five mu printed, three of them in the other


@pytest.mark.parametrize("name", figures.FIGURES)
def test_every_panel_has_labels_finite_data_and_the_figure_its_conditions(draw, name):
    figure = draw(name)
    title, conditions = (text.get_text() for text in figure.texts)
    assert title.startswith(f"Figure {name}: ") and conditions
    for axes in figure.axes:
        assert axes.get_xlabel() and axes.get_ylabel()
        assert axes.lines
        for line in axes.lines:
            assert np.isfinite(np.array(line.get_data(), float)).all()


# ---- the model's curves ----------------------------------------------------------------------------------------------

def test_figure_1_holds_through_the_pause_and_jumps_at_the_reversal(draw):
    for panel in range(4):
        [(t, y)] = curves(draw("1"), panel)
        assert t[0] == 0 and t[-1] == pytest.approx(4)
        assert y[t <= 2 + 1e-9] == pytest.approx(y[0], rel=1e-10)
        assert ((t > 1 + 1e-9) & (t < 2 - 1e-9)).sum() == 0
    t, ratio = curves(draw("1"), 1)[0]
    c, x = constants(0.5), 0.0875                                                    # A:S^ of steady shear, spin included
    assert ratio[0] == pytest.approx(c["b1"] - c["b2"] * x, abs=1e-3)
    assert ratio[t > 2 + 1e-9][0] == pytest.approx(-(c["b1"] + c["b2"] * x), abs=0.01)


def test_figure_4_pressure_is_linear_in_the_squared_distance_from_jamming(draw):
    slopes = [np.polyfit(x, p, 1)[0] for x, p in curves(draw("4"), 3)]
    assert slopes == pytest.approx([0.0073 + 0.1 * mu * 0.0444 for mu in (0, 0.1, 0.3, 0.5, 1)], rel=1e-3)
    for mu, (z2, p) in zip((0, 0.1, 0.3, 0.5, 1), curves(draw("4"), 1)):              # isotropic
        assert p == pytest.approx(0.0073 * (z2 - constants(mu)["Zc"]) ** 2, rel=1e-9, abs=1e-15)


def test_figures_5_8_and_16_draw_the_fits_of_their_captions(draw):
    drawn = {name: curves(draw(figure), panel) for name, figure, panel in
             (("Zc", "5", 0), ("a2", "5", 1), ("phic", "5", 2), ("a3", "16", 0))}
    drawn["b1"], drawn["b2"] = ([line] for line in curves(draw("8"), 1))
    for name, [(mu, y)] in drawn.items():
        assert y == pytest.approx([constants(x)[name] for x in mu], rel=1e-12), name
    at_one = [y[-1] for _, y in curves(draw("16"), 1)]
    assert at_one == pytest.approx([6 - 6 * np.exp(-2), 6.5 - 6.5 * np.exp(-2), 4 - 3.7 * np.exp(-1.2)])


def test_figure_8_friction_is_the_printed_fit_within_its_digits(draw):
    steady, closed_form, printed = (y for _, y in curves(draw("8"), 0))
    mu = np.linspace(0, 1, 101)
    assert printed == pytest.approx(-0.3 * np.exp(-6 * mu) + 0.41)
    assert abs(steady - printed).max() < 0.005
    assert abs(closed_form - printed).max() < 0.01


def test_figure_9_coordination_number_collapses_on_the_printed_line(draw):
    for root, distance in curves(draw("9"), 1):
        assert distance == pytest.approx(7.5 * root - 45 / 5.6 * 0.00145, abs=1e-3)     # d1/d2 times what the spin takes from chi


def test_figure_11_ends_at_the_volume_fraction_with_that_steady_pressure(draw):
    [(_, phi)] = curves(draw("11"), 0)
    [line] = [line for line in draw("11").axes[0].lines if len(line.get_xdata()) == 2]
    assert phi[-1] == pytest.approx(line.get_ydata()[0], abs=5e-4)


@pytest.mark.parametrize("definition", [{}, {"phic": 0.577}, {"beta2": 0.7, "c1": -0.7}])
@pytest.mark.parametrize("pressure", [0.001, 0.02])
def test_the_steady_state_at_a_pressure_has_it(definition, pressure):
    state = figures.steady_at(Material(0.5, **definition), pressure)
    assert -state["stress"][:3].mean() == pytest.approx(pressure, rel=1e-8)


def test_figure_13_normal_stresses_average_to_the_pressure_at_every_volume_fraction(draw):
    xx, yy, zz = (y for _, y in curves(draw("13"), 0))
    assert xx + yy + zz == pytest.approx(3, rel=1e-12)
    assert np.ptp([xx, yy, zz], axis=1) == pytest.approx(0, abs=1e-9)


def test_figure_14_sigma_yy_is_twice_as_far_from_the_pressure_as_the_mean_of_the_others(draw):
    for panel in (0, 1):
        lines = [y for _, y in curves(draw("14"), panel)]
        for sigma_13, sigma_yy in zip(lines[:len(lines) // 2], lines[len(lines) // 2:]):
            assert sigma_yy - 1 == pytest.approx(-2 * (sigma_13 - 1), abs=1e-12)          # (A 2)


def test_figure_15_first_difference_is_a_third_of_the_second_and_keeps_its_sign_through_the_reversal(draw):
    xx, yy, zz = (y for _, y in curves(draw("15"), 2))
    assert (xx < zz).all()
    assert ((xx - zz) / (zz - yy))[[0, -1]] == pytest.approx(-1 / 3, abs=0.03)


# ---- the DEM points --------------------------------------------------------------------------------------------------

def test_dem_runs_have_the_steady_state_that_was_measured():
    steady = ensemble.steady(0.5)
    assert (steady.columns["I"] < 1e-3).all() and len(ensemble.steady(0.5, slow=1).columns["I"]) > len(steady.columns["I"])
    row = steady.rows((steady.columns["phi"] == 0.6) & (steady.columns["rate"] == 6e-5))
    assert row.columns["p"] == pytest.approx(0.0102, abs=0.001)              # of two older packings; p scatters by a tenth
    assert row.columns["stress_ratio"] == pytest.approx(0.385, abs=0.015)
    assert row.columns["A_xz"] == pytest.approx(-0.044, abs=0.002)
    assert set(ensemble.steady().columns["mu"]) >= {0.1, 0.3, 0.5}


def test_a_programme_is_the_mean_of_its_packings_or_the_only_one_or_not_there():
    means = ensemble.programme("reversal", 0.5, 0.60)
    files = list((ensemble.FOLDER / "mu0.5_phi0.600").glob("reversal_s*[0-9].csv"))
    seeds = [np.genfromtxt(file, delimiter=",", names=True)["p"] for file in files]
    assert means.packings == len(seeds) > 1
    assert means.columns["p"] == pytest.approx(np.mean(seeds, axis=0), rel=1e-4)
    assert means.scatter["p"] == pytest.approx(np.std(seeds, axis=0, ddof=1), rel=1e-3, abs=1e-7)
    assert ensemble.programme("reversal", 0.7, 0.60) is None


def test_figure_1_rests_without_a_change_of_stress_and_has_no_other_dem_points_in_the_pause(draw):
    points = curves(draw("1"), 0, dem=True)
    before, pause, after = points
    assert before[0][-1] == pytest.approx(1) and after[0][0] == 2
    assert (before[0] > 0).all() and pause[0][-1] == pytest.approx(1.06)
    assert pause[1] == pytest.approx(pause[1][0], rel=0.02)


def test_quadratic_friction_recovers_known_constants():
    x = np.linspace(-0.09, 0.09, 50)
    run = {"A_xz": -x / 2, "stress_ratio": -(0.1 - 4 * x - 12 * x**2)}
    assert figures.quadratic_friction([run, run]) == pytest.approx({"b1": 0.1, "b2": -4, "b3": -12})


def test_figure_7_prints_the_fit_it_draws_and_it_is_nearer_to_the_dem_than_the_linear_law(draw):
    columns = ensemble.programme("reversal", 0.5, 0.60).rows(slice(1, None)).columns
    fit = figures.quadratic_friction([columns])
    for value in fit.values():
        assert f"= {value:.3g}$" in draw("7").texts[1].get_text()
    x, eta = -2 * columns["A_xz"], -columns["stress_ratio"]
    c = constants(0.5)
    errors = [np.std(eta - model) for model in (fit["b1"] + fit["b2"] * x + fit["b3"] * x**2, c["b1"] + c["b2"] * x)]
    assert errors[0] < 0.6 * errors[1]
    linear, quadratic = curves(draw("7"), 0)
    assert abs(quadratic[1] - linear[1]).max() > 0.1


def test_jamming_recovers_a_known_compression():
    p = np.geomspace(1e-5, 0.03, 9)
    columns = {"p": p, "Z2": 4.3 + np.sqrt(p / 0.0073), "phi": 0.58 + 0.5 * p}
    assert figures.jamming(columns) == pytest.approx((0.0073, 4.3, 0.58))


def magnitude(columns):
    """abs(A) of columns of fabric."""
    return np.sqrt(sum(columns[f"A_{axis}"] ** 2 for axis in ("xx", "yy", "zz")) / 2
                   + sum(columns[f"A_{axis}"] ** 2 for axis in ("xy", "xz", "yz")))


@pytest.mark.parametrize("name, phi", [("reversal", 0.60), ("reversal", 0.61), ("reversal", 0.62), ("pressure-reversal", 0.60)])
def test_figure_3_dem_pressure_is_that_of_4_2_with_the_printed_constants(name, phi):
    columns, c = ensemble.programme(name, 0.5, phi).columns, constants(0.5)
    p = (c["a1"] + c["a2"] * magnitude(columns)) * (columns["Z2"] - c["Zc"]) ** 2
    rows = columns["p"] > 0.2 * columns["p"][0]
    assert np.sqrt(np.mean((p / columns["p"] - 1)[rows] ** 2)) < 0.1


def test_figure_9_dem_has_the_printed_beta1_but_jams_at_a_lower_volume_fraction_than_printed():
    columns, c = ensemble.steady(0.5).columns, constants(0.5)
    assert len(set(columns["phi"])) >= 4
    slope, offset = np.polyfit(columns["phi"], (columns["Z2"] - c["Zc"]) ** 2, 1)
    assert np.sqrt(slope) == pytest.approx(7.5, rel=0.05)
    assert -offset / slope == pytest.approx(0.580, abs=0.002) and c["phic"] == pytest.approx(0.587, abs=0.001)


def test_figure_6_hertzian_pressure_is_proportional_to_the_hookean_to_the_power_of_3_2():
    hookean, hertzian = (ensemble.steady(0.5, contact=contact, slow=2e-3).columns for contact in ("hookean", "hertzian"))
    root = np.polyval(np.polyfit(hookean["Z2"], np.sqrt(hookean["p"]), 1), hertzian["Z2"])       # (4.2): linear in Z2
    assert np.ptp(hertzian["p"]) > 0.5 * hertzian["p"].max()
    assert root**3 / hertzian["p"] == pytest.approx(1.83, rel=0.06)


def test_figure_12_packings_jam_at_many_volume_fractions_but_one_coordination_number():
    found = [figures.jamming(data.rows(data.columns["step"] > 0).columns) for data in ensemble.compressions(0.5).values()]
    a1, Zc, phi_ci = np.array(found).T
    assert len(found) >= 6 and np.ptp(phi_ci) > 0.06 and np.ptp(Zc) < 0.12
    assert (np.diff(phi_ci) > 0).all() and (np.diff(a1) < 0).all() and a1[0] == pytest.approx(0.0073, rel=0.1)
