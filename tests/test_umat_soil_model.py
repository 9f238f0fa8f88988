"""User_Mod, called as hosts of user-defined soil models do: by reference, null pointers where they have no array."""

import ctypes
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granumat.core import status_message
from support.umat_host import LIBRARY, N_STATEV, STATUS, Guarded, call, properties

UNIT, PRESSURE = 1e6, 5e3
PARAMETERS = np.array([0.5, UNIT, 3, 0, 0.01, 0.60, PRESSURE, 0])
UMAT = properties(stiffness=UNIT, elastic_strain=0.01, pressure=PRESSURE, order=1)
DEPS = np.array([0.001, -0.002, 0.0005, 0.003, -0.001, 0.002])
ORDER = ("idtask", "imod", "isundr", "istep", "iter", "iel", "int", "x", "y", "z", "time0", "dtime", "props", "sig0", "swp0",
         "stvar0", "deps", "d", "bulkw", "sig", "swp", "stvar", "ipl", "nstat", "nonsym", "istrsdep", "itimedep", "itang",
         "iprjdir", "iprjlen", "iabort")
INTEGERS = ("idtask", "imod", "isundr", "istep", "iter", "iel", "int", "ipl", "nstat", "nonsym", "istrsdep", "itimedep", "itang",
            "iprjlen", "iabort")
OUTPUTS = ("d", "bulkw", "sig", "swp", "stvar")
STRESS, TANGENT, COUNT, ATTRIBUTES, ELASTIC = 2, 3, 4, 5, 6


def user_mod(task, stvar0=None, deps=DEPS, props=PARAMETERS, sig0=None, null=(), **given):
    """What a call leaves, by the names of the arguments; arrays between guard words, others as they were."""
    numbers = {"x": 0.0, "y": 0.0, "z": 0.0, "time0": 0.0, "dtime": 0.0, "props": np.append(props, np.full(42, np.nan)),
               "sig0": np.append(np.zeros(6) if sig0 is None else sig0, np.full(14, np.nan)), "swp0": 0.0,
               "stvar0": np.zeros(N_STATEV) if stvar0 is None else stvar0, "deps": np.append(deps, np.full(6, np.nan)),
               "d": np.full((6, 6), np.nan), "bulkw": 0.0, "sig": np.full(6, np.nan), "swp": np.nan,
               "stvar": np.full(N_STATEV, np.nan)} | {name: given[name] for name in given if name not in INTEGERS}
    arrays = {name: Guarded(value) for name, value in numbers.items()}
    integers = {name: ctypes.c_int(-7) for name in INTEGERS} | {"isundr": ctypes.c_int(0), "iabort": ctypes.c_int(0)}
    integers |= {"idtask": ctypes.c_int(task), "imod": ctypes.c_int(1)}
    integers |= {name: ctypes.c_int(given[name]) for name in given if name in INTEGERS}
    addresses = {name: array.address for name, array in arrays.items()} | {"iprjdir": None}
    addresses |= {name: ctypes.addressof(value) for name, value in integers.items()} | dict.fromkeys(null)
    LIBRARY.user_mod_(*(ctypes.c_void_p(addresses[name]) for name in ORDER))
    for name, array in arrays.items():
        array.assert_intact()
        assert name in OUTPUTS or array.memory.tobytes() == array.before, name
    return {name: array.values.copy() for name, array in arrays.items()} | {name: value.value for name, value in integers.items()}


def test_the_model_says_what_it_is_before_there_are_states():
    none = ("stvar0", "stvar")
    assert user_mod(COUNT, null=none)["nstat"] == N_STATEV
    found = user_mod(ATTRIBUTES, null=none)
    assert [found[name] for name in ("nonsym", "istrsdep", "itimedep", "itang", "iabort")] == [1, 1, 0, 1, 0]


def test_stress_and_states_are_the_umats_bit_for_bit():
    sig, stvar, stress, statev = np.zeros(6), np.zeros(N_STATEV), np.zeros(6), np.zeros(N_STATEV)
    for turn in range(4):
        deps = np.roll(DEPS, turn)
        found, expected = user_mod(STRESS, stvar, deps, sig0=sig), call(stress, statev, deps, UMAT)
        assert found["iabort"] == expected.status == 0 and np.isnan(found["d"]).all()
        assert found["sig"].tobytes() == expected.stress.tobytes()
        assert found["stvar"].tobytes() == expected.statev.tobytes()
        sig, stvar, stress, statev = found["sig"], found["stvar"], expected.stress, expected.statev


def test_a_state_starts_from_the_hosts_stress_where_no_pressure_is_given():
    sig0 = np.array([-4e3, -5e3, -6e3, 100, 200, -300.0])
    found = user_mod(STRESS, deps=np.zeros(6), props=np.append(PARAMETERS[:6], [0, 0]), sig0=sig0)
    np.testing.assert_allclose(found["sig"], sig0, rtol=1e-13)


@pytest.mark.parametrize("task", [TANGENT, ELASTIC])
def test_the_matrix_is_the_umats_tangent_and_for_elasticity_that_without_a_strain(task):
    start = user_mod(STRESS, deps=np.roll(DEPS, 1))
    found = user_mod(task, start["stvar"], sig0=start["sig"])
    expected = call(start["sig"], start["stvar"], DEPS if task == TANGENT else np.zeros(6), UMAT)
    assert found["d"].tobytes() == expected.ddsdde.tobytes()
    assert np.isnan(found["sig"]).all() and np.isnan(found["stvar"]).all()             # not asked for, not written


def test_undrained_water_gets_the_volume_strain():
    start = user_mod(STRESS, deps=np.roll(DEPS, 1))
    bulk = user_mod(TANGENT, start["stvar"], isundr=1)["bulkw"]
    assert bulk == pytest.approx(100 * user_mod(TANGENT, start["stvar"])["d"][:3, :3].sum() / 9) and bulk > 0
    assert user_mod(STRESS, start["stvar"], isundr=1, bulkw=bulk, swp0=-50.0)["swp"] == pytest.approx(-50 + bulk * DEPS[:3].sum())
    assert user_mod(STRESS, start["stvar"], bulkw=bulk, swp0=-50.0)["swp"] == -50


@pytest.mark.parametrize("wrong", [{"deps": 1e3 * DEPS}, {"props": np.append(2.0, PARAMETERS[1:])}, {"deps": np.full(6, np.nan)}])
def test_a_call_that_fails_aborts_with_the_old_stress_and_states_and_the_reason(wrong):
    start = user_mod(STRESS)
    found = user_mod(STRESS, start["stvar"], sig0=start["sig"], **wrong)
    assert found["iabort"] == 1 and found["sig"].tobytes() == start["sig"].tobytes()
    assert found["stvar"][:STATUS].tobytes() == start["stvar"][:STATUS].tobytes()
    assert status_message(int(found["stvar"][STATUS])) not in ("done", "unknown status")


@pytest.mark.parametrize("unknown", [{"imod": 2}, {"imod": 0}])
def test_another_model_than_the_first_aborts(unknown):
    assert user_mod(STRESS, **unknown)["iabort"] == 1


@pytest.mark.parametrize("task", [0, 7, -1])
def test_an_unknown_task_aborts(task):
    assert user_mod(task)["iabort"] == 1


def test_every_reason_to_abort_is_told():
    program = "from test_umat_soil_model import *\nuser_mod(STRESS, deps=1e3 * DEPS)\nuser_mod(STRESS, props=-PARAMETERS)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parent)
    lines = done.stdout.splitlines()
    assert lines[0] == f"granumat: User_Mod refuses this call, status 16: {status_message(16)}", done.stderr
    assert lines[1].startswith("granumat: User_Mod refuses this call, status 2:") and "mu" in lines[2]


def text(name, *numbers):
    """A name in a buffer of blanks, whose first character is its length."""
    buffer = ctypes.create_string_buffer(b"#" * 40, 40)
    getattr(LIBRARY, name)(*(ctypes.byref(ctypes.c_int(number)) for number in numbers), buffer, ctypes.c_size_t(20))
    assert buffer.raw[20:] == b"#" * 20
    return buffer.raw[1:1 + buffer.raw[0]].decode()


def count(name, *numbers):
    found = ctypes.c_int(-1)
    getattr(LIBRARY, name)(*(ctypes.byref(ctypes.c_int(number)) for number in numbers), ctypes.byref(found))
    return found.value


def test_dialogs_get_names_and_units():
    page = (Path(__file__).parents[1] / "docs/hosts.md").read_text()
    names = [text("getparamname_", 1, number) for number in range(1, 1 + count("getparamcount_", 1))]
    assert f"`{', '.join(names)}`" in " ".join(page.split())
    assert [text("getparamunit_", 1, number) for number in range(1, 9)] == ["-", "F/L^2#", "-", "-", "-", "-", "F/L^2#", "-"]
    assert count("getmodelcount_") == 1 and text("getmodelname_", 1) == "granumat"
    states = [text("getstatevarname_", 1, number) for number in range(1, 1 + count("getstatevarcount_", 1))]
    assert len(states) == N_STATEV and states[7:9] == ["Z2", "phi"] and states[-1] == "status"
    assert text("getstatevarunit_", 1, 22) == "F/L^2#" and text("getstatevarunit_", 1, 8) == "-"
    assert text("getparamname_", 1, 9) == "" and text("getstatevarname_", 1, 0) == ""
