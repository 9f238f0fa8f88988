"""The command, as a user calls it."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import cli, driver, examples, plotting, summaries
from granumat.paths import read_path_file
from test_path_files import EXAMPLE

pytestmark = pytest.mark.release_only

ROOT = Path(__file__).parents[1]
FAULTY = EXAMPLE.replace("mu = 0.5", "mu = 5").replace("phi = 0.60", "phi = 60")


def undocumented(result, of):
    """The keys of a result that its row in docs/results.md does not name."""
    row, = re.findall(rf"^\| {of} \| (.*) \|$", (ROOT / "docs/results.md").read_text(), re.M)
    return [key for key in result if f"`{key}`" not in row]


def granumat(*arguments, cwd):
    return subprocess.run([sys.executable, "-m", "granumat", *map(str, arguments)], cwd=cwd, capture_output=True, text=True)


def test_point_writes_history_and_figure_and_names_them(tmp_path):
    (tmp_path / "path.toml").write_text(EXAMPLE)
    result = granumat("point", "path.toml", "--out", "new/out", cwd=tmp_path)
    assert result.returncode == 0 and result.stderr == ""
    for name in ("history.csv", "history.png"):
        assert f"wrote new/out/{name}" in result.stdout
    table = np.genfromtxt(tmp_path / "new/out/history.csv", delimiter=",", names=True)
    assert table.dtype.names == driver.COLUMNS and len(table) == 402
    assert (tmp_path / "new/out/history.png").read_bytes()[:4] == b"\x89PNG"


def test_a_mistake_in_the_file_ends_with_2_and_words(tmp_path):
    (tmp_path / "path.toml").write_text(EXAMPLE.replace("mu = 0.5", "mu = 5"))
    result = granumat("point", "path.toml", "--out", "out", cwd=tmp_path)
    assert result.returncode == 2 and "mu = 5.0: must be at least 0 and at most 1" in result.stderr
    assert not (tmp_path / "out").exists() and "Traceback" not in result.stderr
    assert granumat("point", "no.toml", "--out", "out", cwd=tmp_path).returncode == 2


def test_a_failing_path_ends_with_1_names_what_it_left_and_the_left_step_fails_alike(tmp_path):
    (tmp_path / "path.toml").write_text(EXAMPLE + "[[step]]\nshear = 0.3\nfree = [\"e_zz\"]\nstress = { sigma_xz = 0.02 }\n")
    result = granumat("point", "path.toml", "--out", "out", cwd=tmp_path)
    assert result.returncode == 1 and "cannot be reached" in result.stderr and "out/failing.toml" in result.stderr
    assert (tmp_path / "out/history.csv").exists()
    again = granumat("point", "out/failing.toml", "--out", "again", cwd=tmp_path)
    assert again.returncode == 1 and "cannot be reached" in again.stderr


def test_a_constrained_path_warns_on_screen(tmp_path):
    step = "[[step]]\ntest = \"isotropic\"\ncompression = 0.001\n"
    (tmp_path / "path.toml").write_text("[initial]\nphi = 0.6\nstate = \"steady\"\n" + step)
    result = granumat("point", "path.toml", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0 and "warning: step 1 (isotropic compression): abs(tr D^) reaches 2.45" in result.stderr


# ---- check, example, --json, completion ------------------------------------------------------------------------------

def test_check_says_everything_that_is_wrong_and_runs_nothing(tmp_path):
    (tmp_path / "path.toml").write_text(FAULTY)
    result = granumat("check", "path.toml", cwd=tmp_path)
    assert result.returncode == 2 and result.stdout == ""
    assert "mu = 5.0: must be" in result.stderr and "phi = 60" in result.stderr
    (tmp_path / "path.toml").write_text(EXAMPLE)
    result = granumat("check", "path.toml", cwd=tmp_path)
    assert result.returncode == 0 and result.stdout == "path.toml can be run: a path, steps: 3, increments: 401\n"
    assert [path.name for path in tmp_path.iterdir()] == ["path.toml"]
    found = json.loads(granumat("check", "path.toml", "--json", cwd=tmp_path).stdout)
    assert found["kind"] == "path" and found["steps"] == ["shear 1", "pause", "deformation"] and found["increments"] == 401
    assert not undocumented(found, "`check` of a path")


def test_check_of_a_scene_finds_what_only_its_mesh_shows(tmp_path):
    pytest.importorskip("dolfinx")
    text = (ROOT / "demos/scenes/shear-box.toml").read_text()
    (tmp_path / "scene.toml").write_text(text)
    found = json.loads(granumat("check", "scene.toml", "--json", cwd=tmp_path).stdout)
    assert not undocumented(found, "`check` of a scene")
    assert found == {"kind": "scene", "cells": 16 * 8, "unknowns": 2 * 17 * 9, "until": 120, "increment": 1,
                     "quantities": ["shear-force", "phi"]}
    contradictory = "displacement = { y = 0 }\nplaten = \"y\""
    (tmp_path / "scene.toml").write_text(text.replace("displacement = { x = 0, y = 0 } ", contradictory))
    result = granumat("check", "scene.toml", cwd=tmp_path)
    assert result.returncode == 2 and "condition" in result.stderr and "Traceback" not in result.stderr


def test_every_sample_path_and_scene_is_an_example_with_words(tmp_path):
    files = examples.example_files()
    assert {path.name for folder in ("paths", "scenes") for path in (ROOT / "demos" / folder).glob("*.toml")} == {
        file.name for file in files.values()}
    listed = granumat("example", cwd=tmp_path).stdout.splitlines()
    for (name, file), line in zip(files.items(), listed, strict=True):
        words = re.fullmatch(rf"{name} +(\S.*\.)", line)[1]
        assert file.read_text().startswith(f"# {words}\n")


def test_an_example_is_printed_as_it_is_and_an_unknown_one_refused(tmp_path):
    printed = granumat("example", "dss", cwd=tmp_path).stdout
    assert printed == (ROOT / "demos/paths/dss.toml").read_text()
    result = granumat("example", "ds", cwd=tmp_path)
    assert result.returncode == 2 and "(did you mean 'dss'?)" in result.stderr


@pytest.mark.parametrize("path", sorted((ROOT / "demos/paths").glob("*.toml")), ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::granumat.ConstrainedDeformationWarning")
def test_every_sample_path_runs_to_its_end(path):
    content = read_path_file(path)
    history = driver.run(content.material, content.state, content.steps, tolerance=content.tolerance)
    assert history.times[-1] == len(content.steps) and content.quantities
    assert plotting.kind_of(history) in plotting.PANELS.keys() & cli.PRINTED.keys() - {"other"}


def test_the_result_of_a_path_is_printed_as_json_and_nothing_else(tmp_path):
    (tmp_path / "path.toml").write_text(EXAMPLE + "[[quantity]]\nname = \"a\"\nof = \"p\"\nat = [1, 3]\n")
    result = granumat("point", "path.toml", "--out", "out", "--json", cwd=tmp_path)
    found = json.loads(result.stdout)
    table = np.genfromtxt(tmp_path / "out/history.csv", delimiter=",", names=True)
    assert result.returncode == 0 and found["rows"] == len(table) == 402
    assert found["files"] == ["out/history.csv", "out/history.png", "out/quantities.csv"]
    assert [step["step"] for step in found["steps"]] == [0, 1, 2, 3]
    for row, step in zip((0, 200, 201, 401), found["steps"]):
        assert list(step) == list(driver.COLUMNS) and step["p"] == pytest.approx(table["p"][row], rel=1e-14)
    assert not undocumented(found, "`point`")
    assert found["quantities"]["a"] == {"t": [1, 3], "value": [found["steps"][1]["p"], found["steps"][3]["p"]]}


def test_what_is_not_finite_is_null_in_json():
    text = summaries.to_json({"a": np.array([1.5, np.inf]), "b": (np.float64("nan"), Path("x"), np.int64(2), True)})
    assert json.loads(text, parse_constant=pytest.fail) == {"a": [1.5, None], "b": [None, "x", 2, True]}


def test_an_error_is_printed_as_json_with_every_fault(tmp_path):
    (tmp_path / "path.toml").write_text(FAULTY)
    for command in (["check", "path.toml"], ["point", "path.toml", "--out", "out"]):
        result = granumat(*command, "--json", cwd=tmp_path)
        found = json.loads(result.stdout)
        assert result.returncode == 2 and found["error"] == "path.toml cannot be run" and len(found["faults"]) == 2
        assert not undocumented(found, "an error")
        assert "mu = 5.0" in found["faults"][0] and "phi = 60" in found["faults"][1]


def test_the_result_of_a_scene_is_printed_as_json(tmp_path):
    pytest.importorskip("dolfinx")
    text = (ROOT / "demos/scenes/shear-box.toml").read_text()
    for old, new in (("until = 120", "until = 2"), ("cells = [16, 8]", "cells = [4, 2]"), ("at = [40, 80, 120]", "at = [1, 2]")):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "scene.toml").write_text(text)
    found = json.loads(granumat("solve", "scene.toml", "--out", "out", "--json", cwd=tmp_path).stdout)
    assert not undocumented(found, "`solve`")
    assert found["t"] == 2 and found["increments"] == 2 and "out/fields.xdmf" in found["files"]
    table = np.genfromtxt(tmp_path / "out/quantities.csv", delimiter=",", names=True)
    assert found["quantities"]["shear-force"] == {"t": [1, 2], "value": list(table["shearforce"])}


def test_the_result_of_a_ladder_is_printed_as_json(tmp_path):
    (tmp_path / "path.toml").write_text(EXAMPLE.split("[[step]]")[0] + "[[step]]\nshear = -0.2\ncontrol = \"pressure\"\n"
                                        "increments = 20\n[[quantity]]\nname = \"ratio\"\nof = \"stress_ratio\"\n")
    result = granumat("ladder", "path.toml", "--tolerance", "0.2", "--out", "out", "--json", cwd=tmp_path)
    found = json.loads(result.stdout)
    assert not undocumented(found | found["quantities"]["ratio"], "`ladder`")
    assert found["proved"] is True and found["quantities"]["ratio"]["error"] < 0.2 == found["quantities"]["ratio"]["tolerance"]
    assert set(found["choice"]) >= {"closure", "increment"} and found["recommended"]["step"] and found["runs"] > 3


@pytest.mark.parametrize("command", [["chart", "--out", "chart"], ["bench", "--quick"]])
def test_without_scipy_the_commands_that_need_it_say_what_to_install_before_they_measure(tmp_path, command):
    program = f"import sys; sys.modules['scipy'] = None; from granumat import cli; sys.exit(cli.main({command}))"
    result = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 2 and result.stdout == "" and not list(tmp_path.iterdir())
    assert result.stderr.startswith("granumat: the comparison with SciPy's solvers needs SciPy: install Debian's python3-scipy, "
                                    "or granumat[study] by pip") and result.stderr.count("\n") == 1


def test_output_that_nobody_reads_to_its_end_is_no_error(tmp_path):
    command = f"{sys.executable} -m granumat example annulus | true"
    assert subprocess.run(command, shell=True, capture_output=True, text=True, cwd=tmp_path).stderr == ""


COMPLETIONS = [
    (["so"], "solve"), (["point", "--ou"], "--out"), (["ladder", "file.toml", "--"], "--budget --help --json --out --tolerance"),
    (["example", "oe"], "oedometer"), (["chart", "un"], "unjamming"), (["point", "demos"], ""), (["nothing", "-"], ""),
    (["completion", ""], "bash zsh"),
]


@pytest.mark.parametrize("words, completed", COMPLETIONS, ids=[" ".join(words) for words, _ in COMPLETIONS])
@pytest.mark.parametrize("shell", ["bash", pytest.param("zsh", marks=pytest.mark.skipif(not shutil.which("zsh"), reason="no zsh"))])
def test_the_shell_completes(tmp_path, shell, words, completed):
    (tmp_path / "script").write_text(granumat("completion", shell, cwd=tmp_path).stdout)
    arrays = "setopt ksharrays; " if shell == "zsh" else ""                   # as zsh's own bashcompinit has them
    line = f"COMP_WORDS=(granumat {' '.join(repr(word) for word in words)}); COMP_CWORD={len(words)}"
    ask = f"source ./script; {arrays}{line}; _granumat; echo \"${{COMPREPLY[@]}}\""
    result = subprocess.run([shell, "-c", ask], capture_output=True, text=True, cwd=tmp_path)
    offered = [word for word in result.stdout.split() if word.startswith(words[-1]) or shell == "bash"]   # zsh looks at it itself
    assert sorted(offered) == completed.split(), result.stderr


def test_every_command_and_option_is_completed(tmp_path):
    script = granumat("completion", "bash", cwd=tmp_path).stdout
    shown = re.search(r"\{([a-z,]+)\}", granumat("--help", cwd=tmp_path).stdout)[1].split(",")
    assert re.search(r'names="(.*?)"', script.split("-eq 1")[1])[1].split() == shown
    options = re.search(r'solve\) options="(.*?)"', script)[1].split()
    assert {"-h", "--help", "--out", "--json", "--resume"} <= set(options) and len(options) == len(set(options))
