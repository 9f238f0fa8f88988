"""UMAT: what is built, what it exports and keeps, and that others can link to it."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from granumat import STATE, Material
from granumat.core import status_message
from granumat.material import CLOSURES, CONTACTS, TURNING
from support.umat_host import BUILD, call, properties

ROOT = Path(__file__).parents[1]
UMAT = (ROOT / "fortran" / "faces" / "umat.f90").read_text()
SOURCE = BUILD / "granumat_umat.f90"
LINKING = ROOT / "demos" / "linking"


def run(*command, **options):
    """Output of a command that must succeed."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def symbols(*options):
    """(kind, name) of what nm prints."""
    return {tuple(line.split()[-2:]) for line in run("nm", *options).splitlines() if len(line.split()) >= 2}


@pytest.fixture(scope="module")
def hosts_object(tmp_path_factory):
    """The one source compiled on its own as a host would."""
    directory = tmp_path_factory.mktemp("host")
    run("gfortran", "-O1", "-c", SOURCE, "-o", "umat.o", cwd=directory)
    return directory / "umat.o"


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """An installation."""
    directory = tmp_path_factory.mktemp("prefix")
    run("cmake", "--install", BUILD, "--prefix", directory)
    return directory


UMAT_NAMES = {"umat_", "sdvini_", "granumat_", "granumat_sdvini_"}
SOIL_MODEL = {"user_mod_", "getmodelcount_", "getmodelname_", "getparamcount_", "getparamname_", "getparamunit_",
              "getstatevarcount_", "getstatevarname_", "getstatevarunit_"}


def test_the_libraries_export_what_hosts_call_and_nothing_else():
    shared = {name for _, name in symbols("-D", "--defined-only", BUILD / "libGRANUMAT.so")}
    assert shared == UMAT_NAMES | SOIL_MODEL | {"GRANUMAT"}
    static = symbols("--defined-only", "--extern-only", BUILD / "libgranumat_umat.a")
    assert {name for kind, name in static if kind in "TDBRVWC"} == UMAT_NAMES


@pytest.mark.parametrize("form", ["granumat_routed.f90", "libgranumat_umat.a", "libGRANUMAT.so"])
@pytest.mark.release_only
def test_a_job_with_two_materials_and_an_umat_of_its_own_links(tmp_path, form):
    run("gfortran", "-frecursive", ROOT / "tests/fortran/router.f90", BUILD / form, f"-Wl,-rpath,{BUILD}", "-o", "router",
        cwd=tmp_path)
    sand, steel = np.array([line.split() for line in run(tmp_path / "router").splitlines()], float)
    dstran = np.array([0.001, -0.002, 0.0005, 0.003, -0.001, 0.002])
    np.testing.assert_array_equal(steel, 2e11 * dstran)
    expected = call(np.zeros(6), np.zeros(23), dstran, properties(stiffness=1e6, elastic_strain=0.01)).stress
    np.testing.assert_allclose(sand, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_nothing_is_kept_between_calls_but_which_faults_have_been_told(hosts_object):
    """No other writable static data of ours: gfortran's constant type descriptors are all there is in .data and .bss."""
    writable = {name for kind, name in symbols(hosts_object) if kind in "bBdDcCsSgG"}
    ours = {name for name in writable if "_MOD___vtab_" not in name and "_MOD___def_init_" not in name}
    assert {name.split(".")[0] for name in ours} == {"said"}


def test_the_source_has_no_save_common_input_output_or_stop_but_where_faults_are_told():
    code = re.sub(r'"[^"\n]*"', '""', re.sub(r"!.*", "", SOURCE.read_text().lower()))
    code, count = re.subn(r"  subroutine speak\(.*?  end subroutine speak\n", "", code, flags=re.S)
    assert count == 1
    forbidden = r"\b(save|common|stop|write|print|open|close|read|inquire|equivalence|data|entry|goto)\b"
    assert re.findall(forbidden, code) == []
    assert re.search(forbidden, "  write (*, *) x")


@pytest.mark.release_only
def test_the_soil_model_compiles_with_the_source_alone(prefix, tmp_path):
    share = prefix / "share/granumat"
    run("gfortran", "-shared", "-fPIC", "-frecursive", share / "granumat_umat.f90", share / "user_mod.f90", "-o", "model.so",
        cwd=tmp_path)
    assert {name for _, name in symbols("-D", "--defined-only", tmp_path / "model.so")} >= SOIL_MODEL


def test_the_source_is_one_file_of_one_lane_in_lines_that_every_compiler_takes():
    lines = SOURCE.read_text().splitlines()
    assert lines[0] == "!DIR$ FREEFORM"
    assert max(map(len, lines)) <= 132
    assert sum(":: LANES = 1" in line for line in lines) == 1
    used = set(re.findall(r"^ *use (granumat_\w+)", "\n".join(lines), re.M))
    assert used <= set(re.findall(r"^module (\w+)", "\n".join(lines), re.M))


def test_eight_threads_on_shuffled_points_equal_serial_bit_for_bit(hosts_object, tmp_path):
    run("gfortran", "-fopenmp", ROOT / "tests" / "fortran" / "threads.f90", hosts_object, "-o", tmp_path / "threads")
    assert run(tmp_path / "threads").split() == ["8", "threads,", "1000", "points:", "0", "differ"]


# ---- tables ----------------------------------------------------------------------------------------------------------

def table(prefix):
    """(number, name, description) of PROPS (P) or STATEV (S) from the code."""
    found = re.findall(rf"parameter :: {prefix}_(\w+) = (\d+) +!! (.*)", UMAT)
    return [(int(number), name.lower(), words) for name, number, words in found]


@pytest.mark.parametrize("prefix, length", [("P", 10), ("S", 23)])
def test_the_page_of_the_umat_has_the_table_of_the_code(prefix, length):
    page = (ROOT / "docs/umat.md").read_text()
    slots = table(prefix)
    numbers = [number for number, _, _ in slots]
    assert numbers == sorted(numbers) and numbers[0] == 1 and numbers[-1] == length
    for number, name, words in slots:
        assert f"| {number} | `{name}` | {words} |" in page


def test_the_page_of_the_umat_has_the_table_of_the_reasons():
    rows = re.findall(r"^\| (\d+) \| (.*) \|$", (ROOT / "docs/umat.md").read_text().split("| STATEV(23) | reason |")[1]
                      .split("\n\n")[0], re.M)
    others = {9, 10, 17}                               # of the driver, which holds stresses; of a length, which no UMAT has
    known = {number for number in range(100) if status_message(number) != "unknown status"}
    assert {int(number) for number, _ in rows} == known - others
    assert all(words == status_message(int(number)) for number, words in rows)


@pytest.mark.parametrize("deck", ["abaqus/shear.inp", "moose/shear.i", "fortran/shear.f90"])
def test_decks_name_the_constants_in_the_order_of_the_code(deck):
    text = (LINKING / deck).read_text()
    assert ", ".join(name for _, name, _ in table("P")) in text
    assert "23" in text


# ---- linking ---------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("demo, program", [("fortran", "shear"), ("c", "points")])
@pytest.mark.release_only
def test_the_demo_links_to_an_installation_by_find_package_and_agrees_with_python(prefix, tmp_path, demo, program):
    run("cmake", "-G", "Ninja", "-S", LINKING / demo, "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", tmp_path)
    check_output(demo, run(tmp_path / program))


def check_output(demo, output):
    numbers = np.array([[float(word) for word in re.findall(r"-?\d+\.\d+", line)] for line in output.splitlines()])
    material = Material(0.5, elastic_strain=0.01)
    gradient = 0.01 * np.outer([1, 0, 0], [0, 0, 1])
    expected = []
    if demo == "fortran":
        state = material.isotropic(0.60, pressure=5e-3)
        for k in range(1, 201):
            state = material.update(state, gradient if k <= 100 else -gradient)
            if k % 25 == 0:
                expected.append([0.01 * min(k, 200 - k), -1e6 * state.stress[:3].mean(), 1e6 * state.stress[4]])
        np.testing.assert_allclose(numbers, expected, rtol=0, atol=6e-4)
    else:
        states = np.array([material.isotropic(phi, pressure=0.005)
                           for phi in (0.59, 0.595, 0.60, 0.605, 0.61)], STATE)
        gradient = np.broadcast_to(gradient, (5, 3, 3))
        for _ in range(100):
            states, tangent = material.update_with_tangent(states, gradient)
        pressure = -states.stress[:, :3].mean(1)
        expected = np.column_stack([states.volume_fraction, pressure, states.stress[:, 4] / pressure, tangent[:, 4, 4]])
        np.testing.assert_allclose(numbers[:, 0], expected[:, 0], rtol=0, atol=6e-4)
        np.testing.assert_allclose(numbers[:, 1:], expected[:, 1:], rtol=0, atol=6e-7)


@pytest.mark.release_only
def test_pkg_config_finds_both_libraries(prefix, tmp_path):
    if not shutil.which("pkg-config"):
        pytest.skip("pkg-config is not installed")
    environment = {"PKG_CONFIG_PATH": str(prefix / "lib" / "pkgconfig"), "PATH": "/usr/bin:/bin",
                   "LD_LIBRARY_PATH": str(prefix / "lib")}
    for module, compiler, demo, source, program in (("granumat", "gcc", "c", "points.c", "points"),
                                                    ("granumat-umat", "gfortran", "fortran", "shear.f90", "shear")):
        flags = run("pkg-config", "--cflags", "--libs", module, env=environment).split()
        run(compiler, LINKING / demo / source, "-o", tmp_path / program, *flags, env=environment)
        check_output(demo, run(tmp_path / program, env=environment))


def test_the_header_declares_what_the_library_has(tmp_path):
    """Every procedure, every status, and the structures with the Fortran types' sizes."""
    header = (ROOT / "fortran" / "faces" / "granumat.h").read_text()
    assert set(re.findall(r"void (granumat_\w+)\(", header)) == exported()
    statuses = re.search(r"enum granumat_status \{(.*?)\}", header, re.S)[1].replace("GRANUMAT_", "").replace(",", "").split()
    table = re.findall(r"public :: (\w+) = (\d+)", (ROOT / "fortran/base/status.f90").read_text())
    assert [(name, str(number)) for number, name in enumerate(statuses)] == [row for row in table if row[0] != "MESSAGE_LENGTH"]
    (tmp_path / "sizes.c").write_text('#include "granumat.h"\n#include <stdio.h>\n'
                                      'int main(void) { printf("%zu %zu", sizeof(struct granumat_parameters), '
                                      'sizeof(struct granumat_state)); return 0; }\n')
    run("gcc", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I", ROOT / "fortran" / "faces", tmp_path / "sizes.c",
        "-o", tmp_path / "sizes")
    parameters, state = map(int, run(tmp_path / "sizes").split())
    assert parameters == Material().parameters.nbytes and state == STATE.itemsize


def exported():
    """Names in the core library."""
    return {name for _, name in symbols("-D", "--defined-only", BUILD / "python/granumat/lib/libgranumat_core.so")}


def test_the_fortran_interface_has_every_procedure_and_agrees_with_python(prefix, tmp_path):
    source = prefix / "share/granumat/granumat_c.f90"
    assert set(re.findall(r"^    end subroutine (\w+)", source.read_text(), re.M)) == exported()
    run("gfortran", "-Wall", "-Werror", "-std=f2018", source, ROOT / "tests/fortran/interface.f90", f"-L{prefix}/lib",
        "-lgranumat_core", f"-Wl,-rpath,{prefix}/lib", "-o", tmp_path / "interface", cwd=tmp_path)
    found = np.array([line.split() for line in run(tmp_path / "interface").splitlines()], float)
    material = Material(0.5, elastic_strain=0.01)
    states = np.array([material.steady(0.60), material.isotropic(0.60, pressure=0.005)], STATE)
    gradient = np.broadcast_to(0.01 * np.outer([1, 0, 0], [0, 0, 1]), (2, 3, 3))
    new, tangent = material.update_with_tangent(states, gradient)
    np.testing.assert_array_equal(found[:, 0], 0)
    np.testing.assert_allclose(found[:, 1:7], new.stress, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[:, 7], tangent[:, 0, 4], rtol=1e-12)           # d stress_11/d strain_13, not its transpose


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("contact", CONTACTS)
def test_states_to_start_from_are_those_of_python(closure, contact):
    core = ctypes.CDLL(str(BUILD / "python/granumat/lib/libgranumat_core.so"))
    material = Material(0.5, closure, contact, elastic_strain=0.01 if closure in TURNING else 0.0)

    def pointer(array):
        return ctypes.c_void_p(array.ctypes.data)

    def isotropic(*numbers):
        found, status = np.zeros(1, STATE), ctypes.c_int(-1)
        core.granumat_isotropic_state(pointer(material.parameters), *map(ctypes.c_double, numbers), pointer(found),
                                      ctypes.byref(status))
        return found[0], status.value

    def assert_same(found, expected):
        for name in STATE.names:
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-14, atol=1e-17, err_msg=name)

    for pressure in (0.005, 0.0):
        found, status = isotropic(0.60, pressure)
        assert status == 0
        assert_same(found, material.isotropic(0.60, pressure=pressure))
    for wrong in ((1.2, 0.005), (0.60, -0.005), (0.60, 100.0), (float("nan"), 0.005), (0.60, float("nan"))):
        assert isotropic(*wrong)[1] > 0 or (closure == "critical" and wrong[1] == 0.005)
    phi = np.linspace(0.58, 0.62, 11)
    found, status = np.zeros(11, STATE), np.full(11, -1, np.int32)
    core.granumat_steady_states(11, pointer(material.parameters), pointer(phi), pointer(found), pointer(status))
    assert (status == 0).all()
    assert_same(found, material.steady(phi))


def test_the_cost_of_a_call_is_measured():
    elastic, umat = map(float, run(BUILD / "python" / "granumat" / "umat_cost").split())
    assert elastic > 0 and umat > 0
