"""What README and the pages of docs/ say is so.

Their programs run and print what stands below them, their files are accepted, their links lead somewhere, the files that they name
exist, and the site builds without a warning.
"""

import contextlib
import io
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from granumat import Material, cli, driver
from granumat.core import constant_ranges, status_message
from granumat.material import describe_range
from granumat.paths import read_path_file
from granumat.studies.cases import CASES

ROOT = Path(__file__).resolve().parents[1]
README, DOCS = ROOT / "README.md", ROOT / "docs"
PAGES = {str(path.relative_to(ROOT)): path.read_text() for path in (README, *sorted(DOCS.rglob("*.md")))}
PROGRAM = re.compile(r"^```python\n(.*?)^```\n(?:\n```\n(.*?)^```$)?", re.M | re.S)          # and what it prints
SHELL = re.compile(r"^```sh\n(.*?)^```\n(?:\n```\n(.*?)^```$)?", re.M | re.S)              # and what it prints, among other lines

pytestmark = pytest.mark.release_only


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGES[page], re.M | re.S)


def pages_with(language):
    return [page for page in PAGES if blocks(page, language)]


def printed_by(program, names):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(program, names)
    return printed.getvalue()


def commands():
    """The names of granumat's commands."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit):
        cli.main(["--help"])
    return re.search(r"\{([a-z,]+)\}", printed.getvalue())[1].split(",")


COMMANDS = commands()


# ---- what can be run -------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("page", pages_with("python"))
def test_the_programs_of_a_page_print_what_stands_below_them(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    programs = PROGRAM.findall(PAGES[page])
    assert len(programs) == len(blocks(page, "python"))
    for program, below in programs:
        if re.search(r"\bfem\b|dolfinx", program):
            pytest.importorskip("dolfinx")
        assert printed_by(program, names) == below


def test_the_first_problem_is_short_and_leaves_its_files(tmp_path, monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.chdir(tmp_path)
    program = blocks("docs/finite-elements.md", "python")[0]
    assert program.count("\n") <= 15
    printed_by(program, {})
    assert {path.name for path in tmp_path.iterdir()} == {"ring.xdmf", "ring.bin", "torque.csv", "phi-000025.png"}


@pytest.mark.parametrize("page", pages_with("toml"))
def test_the_files_of_a_page_are_accepted(page, tmp_path):
    np.savetxt(tmp_path / "table.csv", [[0, 0.007], [0.1, 0.008]], delimiter=",", header="gamma,p", comments="")
    for text in blocks(page, "toml"):
        content = tomllib.loads(text)
        (tmp_path / "file.toml").write_text(text)
        if "step" in content:
            read_path_file(tmp_path / "file.toml")
        elif "mesh" in content:
            pytest.importorskip("dolfinx")
            from granumat.fem import scene
            scene.read_scene(tmp_path / "file.toml")


def test_the_path_file_with_every_key_has_all_steps(tmp_path):
    (tmp_path / "path.toml").write_text(blocks("docs/point.md", "toml")[0])
    np.savetxt(tmp_path / "table.csv", [[0, 0.007], [0.1, 0.008]], delimiter=",", header="gamma,p", comments="")
    path = read_path_file(tmp_path / "path.toml")
    assert len(path.steps) == 4 + 8 + 2 + 2 + 6 + 4


def test_the_scene_file_with_every_key_runs(tmp_path):
    pytest.importorskip("dolfinx")
    from granumat.fem import scene
    text = blocks("docs/scene-files.md", "toml")[0].replace("until = 120", "until = 1").replace("cells = [16, 8]", "cells = [4, 2]")
    text = text.replace("at = [40, 120]", "at = [0.5, 1]")
    (tmp_path / "scene.toml").write_text(text)
    problem, files = scene.solve(tmp_path / "scene.toml", tmp_path / "out")
    assert problem.t == 1 and len(files) == 5 and all(path.exists() for path in files)


def test_the_first_block_of_readme_holds_the_two_commands():
    commands = blocks("README.md", "sh")[0].split("\n")[:2]
    assert commands == ["./demos/run.sh", "./tests/run.sh"]
    for command in commands:
        assert (ROOT / command).stat().st_mode & 0o100


def test_every_command_is_in_the_table_of_commands():
    assert sorted(re.findall(r"^\| `granumat ([a-z]+)", PAGES["docs/getting-started.md"], re.M)) == sorted(COMMANDS)


@pytest.mark.slow
def test_the_commands_of_the_first_hour_print_what_stands_below_them(tmp_path):
    """Those after the installation, in their order, in an empty folder."""
    pytest.importorskip("dolfinx")
    page = PAGES["docs/getting-started.md"]
    part = page[page.index("## A load path at one point"):page.index("## The commands")]
    (tmp_path / "granumat").write_text(f'#!/bin/sh\nexec {sys.executable} -m granumat "$@"\n')
    (tmp_path / "granumat").chmod(0o755)
    (tmp_path / "demos").symlink_to(ROOT / "demos")
    found = SHELL.findall(part)
    assert len(found) == part.count("```sh") == 5
    for commands, below in found:
        ran = subprocess.run(["sh", "-euc", f"PATH={tmp_path}:$PATH\n{commands}"], cwd=tmp_path, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
        assert [line for line in below.splitlines() if line not in ran.stdout.splitlines()] == []


# ---- what is named ---------------------------------------------------------------------------------------------------

def anchors(text):
    """The anchors that hosting pages and Sphinx give to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_every_link_and_picture_of_a_page_exists(page):
    for target in re.findall(r"\]\(([^()\s]+)\)", PAGES[page]):
        if not target.startswith("http"):
            name, _, anchor = target.partition("#")
            path = (ROOT / page).parent / name if name else ROOT / page
            assert path.is_file(), target
            assert not anchor or anchor in anchors(path.read_text()), target


@pytest.mark.parametrize("page", ["README.md", "docs/where-things-are.md"])
def test_every_file_of_the_map_exists(page):
    rows = "\n".join(line for line in PAGES[page].split("\n") if line.startswith("|"))
    named = re.findall(r"`((?:fortran|python|demos|tests|docs|cmake)\b[\w./-]*|CMakeLists.txt)`", rows)
    assert len(named) > 12
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES)
def test_every_demo_scene_and_test_that_a_page_names_exists(page):
    named = re.findall(r"\b(?:demos|tests)/[\w./-]+\.(?:py|toml|f90|sh)\b", PAGES[page])
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_every_picture_of_the_demos_is_shown():
    shown = {Path(target).name for text in PAGES.values() for target in re.findall(r"!\[[^]]*\]\(([^()]+)\)", text)}
    assert {path.name for path in (ROOT / "demos/pictures").iterdir()} <= shown


def test_the_gallery_shows_every_picture_with_the_command_that_draws_it():
    shown = re.findall(r"^[^\n]*: `(.+?)`\n\n!\[[^]]*\]\(\.\./demos/pictures/([\w.-]+)\)$", PAGES["docs/gallery.md"], re.M)
    assert sorted(name for _, name in shown) == sorted(path.name for path in (ROOT / "demos/pictures").iterdir())
    for command, _ in shown:
        program, *words = command.split()
        is_script = (ROOT / (words[0] if program == "python3" else program)).is_file()
        assert is_script or (program == "granumat" and words[0] in COMMANDS)


def test_every_status_is_explained_in_the_core_s_words():
    source = (ROOT / "fortran/base/status.f90").read_text()
    numbers = re.findall(r"public :: \w+ = (\d+)$", source, re.M)
    rows = re.findall(r"^\| (\d+) \| (.*?) \| (.+?) \|$", PAGES["docs/troubleshooting.md"], re.M)
    assert [number for number, _, _ in rows] == [number for number in numbers if status_message(int(number)) != "unknown status"]
    assert len(rows) > 15 and all(status_message(int(number)) == words for number, words, _ in rows)


def test_every_message_that_is_explained_is_one_that_can_be_met():
    page = PAGES["docs/troubleshooting.md"].split("## At a point")[1].split("## In another code")[0]
    messages = re.findall(r"^\| `(.+?)` \|", page, re.M)
    source = "".join(path.read_text() for folder in ("python", "fortran/base") for path in sorted((ROOT / folder).rglob("*.*9*"))
                     + sorted((ROOT / folder).rglob("*.py")))
    source = re.sub(r'"\s*\n\s*\+?\s*f?"', "", source.replace('\\"', '"'))                # texts that go on in the next line
    assert len(messages) > 20
    parts = [part for message in messages for part in re.split(r" ?\.\.\. ?|\(\.\.\.\)", message) if part]
    assert [part for part in parts if part not in source] == []


def test_the_table_of_parameters_has_their_ranges_and_effects():
    def steady(material):
        columns = driver.state_columns(material, np.array(material.steady(0.60)).reshape(1))
        return np.array([columns["p"][0], columns["stress_ratio"][0]])
    rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| ([^|]+) \| ([-+.\d]+) \| ([-+.\d]+) \|$", PAGES["docs/parameters.md"], re.M)
    assert {name for name, _, _, _ in rows} == constant_ranges().keys() - {"b3"}
    for name, allowed, *effects in rows:
        value = 0.5 if name == "mu" else Material(0.5)[name]
        changed = {name: 1.01 * value or 0.01}
        change = 100 * (steady(Material(**{"mu": 0.5} | changed)) / steady(Material(0.5)) - 1)
        assert allowed == describe_range(name)
        np.testing.assert_allclose([float(effect) for effect in effects], change, atol=0.00501, err_msg=name)


def test_the_page_of_the_c_interface_names_what_the_header_declares():
    declared = re.findall(r"^void (\w+)\(", (ROOT / "fortran/faces/granumat.h").read_text(), re.M)
    named = re.findall(r"`(granumat_\w+)(?:\([^`]*\))?`", PAGES["docs/c-interface.md"])
    assert set(named) - {"granumat_state"} == set(declared)


def test_constants_follow_from_mu_as_the_page_says():
    rows = re.findall(r"^\| (?:`(\w+)`)? ?\| [^|]*?(?:calibration `([\w-]+)`)? \| ([-\d][^|,]*|0\.1 mu) \|$",
                      PAGES["docs/closures-and-limits.md"], re.M)
    checked = []
    for name, calibration, formula in rows:
        name = name or checked[-1]
        for mu in (0.0, 0.3, 1.0):
            value = eval(formula.replace("0.1 mu", "0.1 * mu").replace(" exp", " * exp").replace(" mu)", " * mu)"),
                         {"exp": np.exp, "mu": mu})
            assert Material(mu, calibration=calibration or "table-1")[name] == pytest.approx(value, abs=1e-14), (name, mu)
        checked.append(name)
    assert checked == ["a1", "a2", "a3", "a4", "a4", "a4", "b1", "b2", "Zc", "phic", "elastic_strain"]


def test_the_chart_page_names_the_cases():
    table = PAGES["docs/method-chart.md"].split("| case | what happens |")[1].split("\n\n")[0]
    assert re.findall(r"^\| `([\w-]+)`", table, re.M) == list(CASES)


# ---- the site --------------------------------------------------------------------------------------------------------

@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    built = subprocess.run([DOCS / "build.sh", tmp_path], capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    pages = {str(path.relative_to(tmp_path).with_suffix("")) for path in tmp_path.rglob("*.html")}
    assert pages >= {page.removeprefix("docs/").removesuffix(".md") for page in PAGES.keys() - {"README.md"}}
