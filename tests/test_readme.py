"""What README shows is what happens."""

import contextlib
import io
import re
from pathlib import Path

import numpy as np

from granumat.paths import read_path_file

README = (Path(__file__).parents[1] / "README.md").read_text()


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.M | re.S)


def test_the_example_prints_what_readme_says():
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(blocks("python")[0], {})
    assert printed.getvalue() == README.split("```python")[1].split("```\n\n```\n")[1].split("```")[0]


def test_the_path_file_of_readme_is_accepted(tmp_path):
    (tmp_path / "path.toml").write_text(blocks("toml")[0])
    np.savetxt(tmp_path / "table.csv", [[0, 0.007], [0.1, 0.008]], delimiter=",", header="gamma,p", comments="")
    path = read_path_file(tmp_path / "path.toml")
    assert len(path.steps) == 4 + 8 + 2


def test_the_first_block_holds_the_two_commands():
    commands = blocks("sh")[0].split("\n")[:2]
    for command in commands:
        assert (Path(__file__).parents[1] / command).stat().st_mode & 0o100
