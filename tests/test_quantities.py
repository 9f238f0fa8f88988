"""Quantities of interest of load paths: how a file names them, and their table."""

import numpy as np
import pytest

from granumat import PathError, cli, driver
from granumat.paths import read_path_file
from granumat.quantities import Quantity, read_values

pytestmark = pytest.mark.release_only

PATH = """
[material]
elastic_strain = 0.01
[initial]
phi = 0.60
state = "isotropic"
pressure = 0.007
[[step]]
shear = 0.4
increments = 20
[[step]]
shear = -1.0
until = "gamma_total > 0.5"
increments = 100
[[step]]
cycles = 1
amplitude = 0.03
increments = 3
[[quantity]]
name = "pressure"
of = "p"
at = [0, 0.25, 1, 2, 3.6666666666666667]
tolerance = 0.02
scale = 0.01
[[quantity]]
name = "phi-end"
of = "phi"
[[quantity]]
name = "A"
of = "A_xz"
at = "range"
"""


def written(tmp_path, text):
    (tmp_path / "path.toml").write_text(text)
    return tmp_path / "path.toml"


def faults(tmp_path, *tables):
    path = '[initial]\nphi = 0.6\nstate = "steady"\n[[step]]\nshear = 1\nincrements = 7\n[[step]]\nshear = 1\nuntil = "steady"\n'
    with pytest.raises(ValueError) as caught:
        read_path_file(written(tmp_path, path + "".join(f"[[quantity]]\n{table}\n" for table in tables)))
    return str(caught.value)


def test_a_paths_quantities_are_columns_of_its_history_at_numbers_of_steps(tmp_path):
    path = read_path_file(written(tmp_path, PATH))
    assert path.quantities == [Quantity("pressure", "p", (0, 0.25, 1, 2, 3 + 2 / 3), 0.02, 0.01), Quantity("phi-end", "phi"),
                               Quantity("A", "A_xz", "range")]
    history = driver.run(path.material, path.state, path.steps, tmp_path, quantities=path.quantities)
    step = history["step"]
    ends = [np.flatnonzero(step == number)[-1] for number in range(5)]
    assert ends[2] - ends[1] < 100                                                      # ended early,
    assert history.times[ends].tolist() == [0, 1, 2, 3, 4]                              # at its number all the same
    values = read_values(tmp_path / "quantities.csv", path.quantities)
    times, pressure = values["pressure"]
    assert times == pytest.approx([0, 0.25, 1, 2, 3 + 2 / 3], rel=1e-14)
    rows = [0, 5, ends[1], ends[2], ends[3] + 2]
    np.testing.assert_allclose(pressure, history["p"][rows], rtol=1e-13)
    assert values["phi-end"] == (4, pytest.approx(history["phi"][-1:], rel=1e-13))
    np.testing.assert_allclose(values["A"][1], history["A_xz"], rtol=1e-13)
    assert len(values["A"][0]) == len(history)


def test_the_command_writes_them(tmp_path, capsys):
    assert cli.main(["point", str(written(tmp_path, PATH)), "--out", str(tmp_path / "out")]) == 0
    assert f"wrote {tmp_path / 'out/quantities.csv'}" in capsys.readouterr().out
    assert (tmp_path / "out/quantities.csv").read_text().split("\n")[0] == "t,pressure,phi-end,A"
    assert cli.main(["point", str(written(tmp_path, PATH.split("[[quantity]]")[0])), "--out", str(tmp_path / "none")]) == 0
    assert not (tmp_path / "none/quantities.csv").exists()


@pytest.mark.slow
def test_a_path_that_fails_leaves_what_it_has_come_to(tmp_path):
    text = PATH.replace("cycles = 1\namplitude = 0.03\nincrements = 3", "shear = 0.1\nfree = [\"e_xz\"]\nstress = { p = 1 }")
    path = read_path_file(written(tmp_path, text.replace(", 3.6666666666666667", "")))
    with pytest.raises(PathError) as caught:
        driver.run(path.material, path.state, path.steps, tmp_path, quantities=path.quantities)
    values = read_values(tmp_path / "quantities.csv", path.quantities)
    assert len(values["A"][0]) == len(caught.value.history)


def test_every_fault_comes_in_one_message(tmp_path):
    said = faults(tmp_path, 'name = "q"\nof = "pressure"\nwhere = 3', 'name = "q"\nof = "acoustic"\nat = "start"', "of = 3",
                  'name = "t"\nof = "p"\nat = [0.5, 1.5, 3]', 'name = "a/b"\nof = "p"\nat = [1, 0.5]\ntolerance = 2\nscale = 0')
    for words in ("quantity 1: cannot be evaluated", "unknown key 'where': allowed are name, of, at, tolerance, scale",
                  "of = 'pressure': must be a column of the history, one of gamma, gamma_total, e_xx",
                  "the quantity 'q' is given 2 times", "of = 'acoustic': needs acoustic = true in [output]",
                  "at = 'start': must be a list of increasing times, or one of end, range", "quantity 3: cannot be evaluated",
                  "name is missing", "of = 3: must be a text in quotes", "name = 't': must begin with a letter",
                  "at 0.5: lies 3.5 increments into step 1, which has 7: must be the end of one",
                  "at 1.5: step 2 may end early, so that only its end can be met",
                  "at 3: must be from 0 to 2, the number of steps", "name = 'a/b'", "at = [1, 0.5]",
                  "tolerance = 2: must be a number in (0, 1)", "scale = 0: must be a number above 0"):
        assert words in said, words + "\n" + said


def test_a_scale_is_given_or_the_largest_value_or_the_range_of_a_volume_fraction():
    values = np.array([0.55, -0.6, 0.58])
    assert Quantity("q", "p").scale_of(values) == 0.6
    assert Quantity("q", "p", scale=3.0).scale_of(values) == 3
    assert Quantity("q", "phi").scale_of(values) == Quantity("q", "mean phi of core").scale_of(values) == pytest.approx(1.18)
    assert Quantity("q", "mean p of phi").scale_of(values) == 0.6


def test_a_table_that_lacks_something_is_refused_with_words(tmp_path):
    file = tmp_path / "quantities.csv"
    file.write_text("t,q\n1,2\n2,3\n")
    with pytest.raises(ValueError) as caught:
        read_values(file, [Quantity("q", "p", (1.0, 3.0)), Quantity("r", "p")])
    assert "there is no column 'r': it has t, q" in str(caught.value)
    assert "q: its times 3 are not in the run, which has come to 2" in str(caught.value)
    for content in ("", "t,q\n", "t,q\n1,2,3\n", "a,q\n1,2\n", "t,q\n1,x\n"):
        file.write_text(content)
        with pytest.raises(ValueError, match=r"quantities\.csv: not a table"):
            read_values(file, [Quantity("q", "p")])
