"""An installation, below a prefix or from a wheel: it works anywhere, with its files for other codes, and says what is missing.

Where granumat comes from the build tree, it is installed below a prefix with a blank in its path; where it comes from a wheel, the
wheel is tested.
"""

import ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import granumat
from granumat.installed import FILES
from support.umat_host import BUILD

pytestmark = pytest.mark.release_only

ROOT = Path(__file__).parents[1]
IN_BUILD = (BUILD / "CMakeCache.txt").exists()
SOURCES = ("CMakeLists.txt", "cmake", "demos", "fortran", "python", "install-packages.sh")

only_from_build = pytest.mark.skipif(not IN_BUILD, reason="not the build tree")
only_from_wheel = pytest.mark.skipif(IN_BUILD, reason="not a wheel")


def run(*command, status=0, **options):
    """Output of a command, or what it says where it has to fail."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stderr if status else done.stdout


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The installed program granumat."""
    if not IN_BUILD:
        return Path(sys.executable).with_name("granumat")
    prefix = tmp_path_factory.mktemp("a prefix")
    run("cmake", "--install", BUILD, "--prefix", prefix)
    return prefix / "bin/granumat"


def test_the_installed_program_runs_a_sample_path_in_an_empty_environment(program, tmp_path):
    prefix = Path(run(program, "umat", "--cmake", env={}).strip()).parents[2]
    sample, = prefix.rglob("paths/reversal.toml")
    assert (sample.parents[1] / "scenes/annulus.toml").exists()
    printed = run(program, "point", sample, "--out", tmp_path / "out", env={"HOME": str(tmp_path)})
    assert "history.csv" in printed and (tmp_path / "out/history.png").exists()


def test_the_command_says_where_the_files_for_other_codes_are(program):
    found = dict(line.split(maxsplit=1) for line in run(program, "umat").splitlines())
    assert list(found) == list(FILES)
    for name, path in found.items():
        assert Path(path).exists() and run(program, "umat", f"--{name}") == path + "\n"
    assert Path(found["source"]).read_text().startswith("!DIR$ FREEFORM\n")
    assert all(hasattr(ctypes.CDLL(found["library"]), symbol) for symbol in ("umat_", "sdvini_", "GRANUMAT"))
    assert "granumat_update" in Path(found["header"]).read_text()
    assert (Path(found["cmake"]) / "granumat-config.cmake").exists() and (Path(found["pkg-config"]) / "granumat-umat.pc").exists()


@pytest.mark.skipif(not (shutil.which("cmake") and shutil.which("gfortran") and shutil.which("ninja")), reason="no compilers")
@pytest.mark.parametrize("demo, name", [("c", "points"), ("fortran", "shear")])
def test_other_codes_find_it_by_the_folder_that_the_command_prints(program, tmp_path, demo, name):
    folder = run(program, "umat", "--cmake").strip()
    run("cmake", "-G", "Ninja", "-S", ROOT / "demos/linking" / demo, "-B", tmp_path / "b", f"-Dgranumat_DIR={folder}")
    run("cmake", "--build", tmp_path / "b")
    assert run(tmp_path / "b" / name).count("\n") >= 5


@only_from_build
def test_the_build_tree_says_where_source_and_library_are_and_what_it_has_not():
    command = [sys.executable, "-m", "granumat", "umat"]
    assert run(*command, "--source") == f"{BUILD / 'granumat_umat.f90'}\n"
    assert run(*command, "--library") == f"{BUILD / 'libGRANUMAT.so'}\n"
    assert re.search(r"no include/granumat.h .*cmake --install build/release --prefix DIR", run(*command, "--header", status=2))


@only_from_wheel
def test_the_compilers_libraries_are_those_of_the_wheel():
    program = "import granumat; print(open('/proc/self/maps').read())"
    loaded = set(re.findall(r"\S*/lib(?:gfortran|gomp|granumat_core)\S*", run(sys.executable, "-c", program)))
    site = Path(granumat.__file__).parents[1]
    assert len(loaded) == 3 and all(Path(path).is_relative_to(site) for path in loaded)


@only_from_build
def test_the_lines_of_the_page_uninstall_it(program, tmp_path):
    prefix = tmp_path / "prefix"
    shutil.copytree(program.parents[1], prefix)
    (prefix / "lib/libother.so").touch()
    page = (ROOT / "docs/installing.md").read_text()
    lines, = re.findall(r"^```sh\ncd /usr/local\n(.*?)^```$", page, re.M | re.S)
    run("sh", "-euc", lines.replace("sudo ", ""), cwd=prefix)
    assert [path.name for path in prefix.rglob("*") if path.is_file()] == ["libother.so"]


# ---- what is missing -------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("module", ["mpi4py", "dolfinx", "petsc4py"])
def test_without_dolfinx_a_scene_says_in_one_sentence_what_to_install(module, tmp_path):
    (tmp_path / "scene.toml").write_text("[mesh]\n")
    for command in (["solve"], ["ladder", "--tolerance=0.1"]):
        words = [*command, str(tmp_path / "scene.toml"), f"--out={tmp_path / 'out'}"]
        said = run(sys.executable, "-c", f"import sys; sys.modules['{module}'] = None\n"
                   f"from granumat.cli import main; sys.exit(main({words}))", status=2)
        assert said.startswith("granumat: granumat.fem needs DOLFINx with PETSc: install Debian's python3-dolfinx")
        assert re.search(r"or granumat\[fem\] by pip .* \((No module named|import of) .*\)\n$", said) and said.count("\n") == 1


@pytest.mark.parametrize("name, contents", [("sudo", "exit 1"), ("type", "")])
def test_without_root_the_missing_packages_are_named_before_anything_is_done(tmp_path, name, contents):
    """With a sudo that refuses, and without any."""
    programs = {"id": "echo 1000", "dpkg-query": "exit 1", name: contents}
    for program, text in programs.items():
        (tmp_path / program).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / program).chmod(0o755)
    for needed in ("grep", "cat"):
        (tmp_path / needed).symlink_to(shutil.which(needed))
    said = run("/bin/sh", ROOT / "install-packages.sh", "one", "two", status=1, env={"PATH": str(tmp_path)})
    assert "so nothing was built" in said
    assert "apt-get update && apt-get install --no-install-recommends one two\n" in said and "docs/installing.md" in said


@only_from_build
def test_a_misspelt_build_is_refused_before_anything_is_installed():
    assert "usage: ./build.sh" in run(ROOT / "build.sh", "release", "--help", status=2)


# ---- building --------------------------------------------------------------------------------------------------------

@only_from_build
@pytest.mark.release_only
@pytest.mark.parametrize("build_type, optimised", [("", True), ("RelWithDebInfo", True), ("None", True), ("Debug", False)])
@pytest.mark.slow
def test_every_build_but_the_debug_build_is_optimised_for_every_instruction_set(tmp_path, build_type, optimised):
    run("cmake", "-G", "Ninja", "-S", ROOT, "-B", tmp_path, f"-DCMAKE_BUILD_TYPE={build_type}")
    written = (tmp_path / "build.ninja").read_text()
    flags = re.findall(r"^build CMakeFiles/(granumat_core\w*|umat_object)\.dir/\S+\.o: .*?^  FLAGS = (.*?)$", written, re.M | re.S)
    variants = {"granumat_core_v3", "granumat_core_v4"} if optimised and os.uname().machine == "x86_64" else set()
    assert {target for target, _ in flags} == {"granumat_core", "umat_object", *variants}
    for target, words in flags:
        last = re.findall(r"-O\w*", words)[-1]
        assert last == ("-O3" if optimised else "-Og"), target


@only_from_build
@pytest.mark.slow
@pytest.mark.release_only
@pytest.mark.skipif(" " in str(BUILD), reason="the build that is tested is in one")
def test_it_builds_in_a_path_with_a_blank(tmp_path):
    source = tmp_path / "a source"
    source.mkdir()
    for name in SOURCES:
        path = ROOT / name
        (shutil.copytree if path.is_dir() else shutil.copy)(path, source / name)
    run("cmake", "-G", "Ninja", "-S", source, "-B", source / "build", "-DCMAKE_BUILD_TYPE=Debug")
    run("cmake", "--build", source / "build")
    printed = run(sys.executable, "-m", "granumat", "--version", env={"PYTHONPATH": str(source / "build/python")})
    assert printed == f"granumat {granumat.__version__}\n"
