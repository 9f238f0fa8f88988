"""The command, as a user calls it."""

import subprocess
import sys

import numpy as np

from granumat import driver
from test_path_files import EXAMPLE


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
