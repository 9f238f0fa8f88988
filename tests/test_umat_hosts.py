"""UMAT: what hosts really hand over, each quirk by itself, and what a state that cannot go on gives back."""

import ctypes
import mmap
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from granumat import Material
from granumat.core import status_message
from support.umat_host import (
    EYE,
    FABRIC,
    LIBRARY,
    N_STATEV,
    ORDER,
    PHI,
    STATUS,
    WORK,
    Guarded,
    call,
    engineering,
    properties,
    statev_of,
)

UNIT = 1.0e6
PROPS = properties(stiffness=UNIT, elastic_strain=0.01, pressure=5e3)
DSTRAN = np.array([0.001, -0.002, 0.0005, 0.003, -0.001, 0.002])
NEVER_READ = ("sse", "spd", "scd", "rpl", "ddsddt", "drplde", "drpldt", "stran", "time", "dtime", "temp", "dtemp", "predef",
              "dpred", "cmname", "ndi", "nshr", "coords", "celent", "noel", "npt", "layer", "kspt", "kstep", "kinc")


def started(props=PROPS):
    """STRESS and STATEV after a first increment."""
    result = call(np.zeros(6), np.zeros(N_STATEV), np.roll(DSTRAN, 1), props)
    assert result.status == 0
    return result.stress, result.statev


def same(x, y):
    return all(getattr(x, name).tobytes() == getattr(y, name).tobytes() for name in ("stress", "statev", "ddsdde"))


# ---- success ---------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("pnewdt", [-1.0, 0.0, 0.5, 1.0, 1e300, np.finfo(float).max, np.inf, np.nan, -np.nan])
def test_success_leaves_pnewdt_as_it_is_bit_for_bit(pnewdt):
    result = call(*started(), DSTRAN, PROPS, pnewdt=pnewdt)
    assert result.status == 0
    assert result.pnewdt.tobytes() == np.array([pnewdt]).tobytes()


def test_what_is_never_read_may_be_null():
    plain = call(*started(), DSTRAN, PROPS)
    assert same(call(*started(), DSTRAN, PROPS, null=NEVER_READ + ("pnewdt", "drot", "dfgrd0", "dfgrd1")), plain)


@pytest.mark.parametrize("spin, read", [(1, ("drot",)), (2, ("dfgrd0", "dfgrd1")), (3, ("dfgrd0", "dfgrd1"))])
def test_rotations_are_read_only_behind_their_switch(spin, read):
    props = properties(stiffness=UNIT, pressure=5e3, spin=spin)
    unread = tuple({"drot", "dfgrd0", "dfgrd1"} - set(read))
    new = EYE + 0.01 * np.arange(9).reshape(3, 3) / 9
    assert call(*started(props), DSTRAN, props, null=unread, dfgrd1=new).status == 0
    for name in read:
        failed = call(*started(props), DSTRAN, props, null=(name,), dfgrd1=new)
        assert failed.status > 0 and failed.pnewdt < 1


def test_garbage_in_what_is_not_read_changes_nothing():
    garbage = np.full((3, 3), np.nan)
    stress, statev = started()
    plain = call(stress, statev, DSTRAN, PROPS)
    odd = call(np.full(6, np.nan), statev, DSTRAN, PROPS, drot=garbage, dfgrd0=garbage, dfgrd1=garbage, dtime=0.0, ndi=-7,
               nshr=123456789)
    assert same(odd, plain)


def test_all_that_may_only_be_read_lives_in_read_only_memory():
    """KSTEP is a literal in some hosts; here every input is."""
    libc = ctypes.CDLL(None)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
    libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
    size = 4096
    page = libc.mmap(None, size, mmap.PROT_READ | mmap.PROT_WRITE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, -1, 0)
    place, at = page, {}
    doubles = {"dstran": DSTRAN, "props": PROPS, "drot": EYE, "dfgrd0": EYE, "dfgrd1": EYE, "time": np.zeros(2),
               "stran": np.zeros(6), "coords": np.zeros(3), "dtime": np.zeros(1), "temp": np.zeros(1), "celent": np.ones(1)}
    integers = {"ndi": 3, "nshr": 3, "ntens": 6, "nstatv": N_STATEV, "nprops": len(PROPS), "noel": 1, "npt": 1, "layer": 1,
                "kspt": 1, "kstep": 1, "kinc": 1}
    for name, value in doubles.items():
        ctypes.memmove(place, np.ascontiguousarray(value).ctypes.data, value.nbytes)
        at[name], place = place, place + value.nbytes
    for name, value in integers.items():
        ctypes.memmove(place, ctypes.byref(ctypes.c_int(value)), 8)
        at[name], place = place, place + 8
    at["cmname"] = place
    assert libc.mprotect(page, size, mmap.PROT_READ) == 0
    try:
        assert same(call(*started(), DSTRAN, PROPS, at=at), call(*started(), DSTRAN, PROPS))
    finally:
        libc.munmap(page, size)


def test_the_state_may_be_larger_than_needed():
    stress, statev = started()
    larger = np.concatenate([statev, np.arange(7.0), [np.nan]])
    result = call(stress, larger, DSTRAN, PROPS)
    assert result.statev[:N_STATEV].tobytes() == call(stress, statev, DSTRAN, PROPS).statev.tobytes()
    assert result.statev[N_STATEV:].tobytes() == larger[N_STATEV:].tobytes()


def test_the_same_call_twice_is_the_same():
    assert same(call(*started(), DSTRAN, PROPS), call(*started(), DSTRAN, PROPS))


def test_the_upper_case_alias_is_the_same_routine():
    assert same(call(*started(), DSTRAN, PROPS, symbol="GRANUMAT"), call(*started(), DSTRAN, PROPS))
    address = [ctypes.cast(getattr(LIBRARY, name), ctypes.c_void_p).value for name in ("umat_", "GRANUMAT")]
    assert address[0] == address[1]


def test_a_call_without_strain_changes_nothing_but_starts_the_state():
    """The first call of each increment in CalculiX and incrementalDriver: DSTRAN = 0, in the latter DTIME = 0 too."""
    first = call(np.zeros(6), np.zeros(N_STATEV), np.zeros(6), PROPS, dtime=0.0)
    np.testing.assert_allclose(first.stress, [-5e3, -5e3, -5e3, 0, 0, 0], rtol=1e-14)
    assert np.isfinite(first.ddsdde).all() and np.linalg.eigvalsh(first.ddsdde + first.ddsdde.T).min() > 0
    stress, statev = started()
    again = call(stress, statev, np.zeros(6), PROPS, dtime=0.0)
    np.testing.assert_allclose(again.stress, stress, rtol=1e-15)
    assert again.statev.tobytes() == statev.tobytes()
    assert np.isfinite(again.ddsdde).all()
    assert same(call(first.stress, first.statev, DSTRAN, PROPS), call(np.zeros(6), np.zeros(N_STATEV), DSTRAN, PROPS))


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
def test_round_off_instead_of_no_strain_is_no_strain(elastic_strain):
    props = properties(stiffness=UNIT, elastic_strain=elastic_strain, pressure=5e3)
    stress, statev = started(props)
    noise = 1e-17 * np.array([1.0, -2, 1, 5, -3, 2])
    assert same(call(stress, statev, noise, props), call(stress, statev, np.zeros(6), props))


def test_sdvini_lets_every_state_start_itself():
    statev = Guarded(np.full(30, np.nan))
    integers = [ctypes.c_int(30)] + [ctypes.c_int(1) for _ in range(5)]
    LIBRARY.sdvini_(ctypes.c_void_p(statev.address), None, *(ctypes.byref(value) for value in integers))
    statev.assert_intact()
    assert not statev.values.any()


@pytest.mark.parametrize("spin", [0, 1, 2, 3])
@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
@pytest.mark.parametrize("closure", range(5))
def test_success_raises_no_floating_point_exception(rng, closure, elastic_strain, spin):
    """Some hosts trap them."""
    libm = ctypes.CDLL("libm.so.6")
    libm.log.restype, libm.log.argtypes = ctypes.c_double, [ctypes.c_double]
    traps = 1 | 4 | 8                                                   # invalid, division by zero, overflow (x86)
    props = properties(stiffness=UNIT, closure=closure, elastic_strain=elastic_strain, spin=spin)
    stress, statev, old = np.zeros(6), np.zeros(N_STATEV), EYE
    for size in (0.0, 0.01, 0.01, 0.0, 1e-12, 0.2):
        gradient = size * rng.normal(size=(3, 3))
        gradient -= np.trace(gradient) / 3 * EYE
        new = expm(gradient) @ old
        libm.feclearexcept(traps)
        result = call(stress, statev, engineering(gradient), props, dfgrd0=old, dfgrd1=new)
        assert result.status == 0 and libm.fetestexcept(traps) == 0
        stress, statev, old = result.stress, result.statev, new
    libm.log(-1.0)
    assert libm.fetestexcept(traps) == 1


# ---- failure ---------------------------------------------------------------------------------------------------------

def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


def failures():
    """name -> arguments of a call that cannot be done."""
    stress, statev = started()
    wild = statev_of(Material(0.5).isotropic(0.60, pressure=0.005))
    wild[FABRIC] = [0.2, -0.1, -0.1, 0, 0, 0]                              # realisable, yet (4.7) blows it up along itself
    plain = {"stress": stress, "statev": statev, "dstran": DSTRAN, "props": PROPS}
    cases = {f"NaN in DSTRAN({k + 1})": {"dstran": changed(DSTRAN, k, np.nan)} for k in (0, 5)}
    cases |= {f"NaN in DSTRAN({k + 1}) alone": {"dstran": changed(np.zeros(6), k, np.nan)} for k in (0, 5)}
    cases |= {f"NaN in PROPS({k + 1})": {"props": changed(PROPS, k, np.nan)} for k in range(10)}
    cases |= {f"NaN in STATEV({k + 1})": {"statev": changed(statev, k, np.nan)} for k in (0, 1, 6, 7, 8, 9, 15, 20)}
    cases |= {
        "infinite DSTRAN": {"dstran": changed(DSTRAN, 1, np.inf)},
        "NaN in the first STRESS": {"stress": np.full(6, np.nan), "statev": np.zeros(N_STATEV),
                                    "props": changed(PROPS, 6, 0.0)},
        "tension in the first STRESS": {"stress": np.array([1.0, 1, 1, 0, 0, 0]), "statev": np.zeros(N_STATEV),
                                        "props": changed(PROPS, 6, 0.0)},
        "strain beyond reason": {"dstran": 1e6 * DSTRAN},
        "phi above 1": {"dstran": np.array([-1.0, 0, 0, 0, 0, 0])},
        "fabric blow-up": {"statev": wild, "dstran": np.array([0.4, -0.2, -0.2, 0, 0, 0])},
        "foreign state": {"statev": changed(statev, 0, 3.0)},
        "too few STATEV": {"statev": statev[:N_STATEV - 1]},
        "no STATEV": {"statev": statev[:0]},
        "too few PROPS": {"props": PROPS[:5]},
        "no PROPS": {"props": PROPS[:0]},
        "too many PROPS": {"props": np.append(PROPS, 0.0)},
        "plane stress": {"stress": stress[:3], "dstran": DSTRAN[:3]},
        "NTENS 5": {"stress": stress[:5], "dstran": DSTRAN[:5]},
        "NTENS 1": {"stress": stress[:1], "dstran": DSTRAN[:1]},
        "mu above 1": {"props": changed(PROPS, 0, 1.5)},
        "stiffness 0": {"props": changed(PROPS, 1, 0.0)},
        "closure 2.5": {"props": changed(PROPS, 2, 2.5)},
        "closure 7": {"props": changed(PROPS, 2, 7.0)},
        "contact 2": {"props": changed(PROPS, 3, 2.0)},
        "negative e_r": {"props": changed(PROPS, 4, -0.01)},
        "initial phi 1.2": {"statev": np.zeros(N_STATEV), "props": changed(PROPS, 5, 1.2)},
        "initial pressure below 0": {"statev": np.zeros(N_STATEV), "props": changed(PROPS, 6, -1.0)},
        "a pressure that the critical closure has not below phi = 1":
            {"statev": np.zeros(N_STATEV), "props": changed(changed(PROPS, 2, 0.0), 6, 1.0 * PROPS[1])},
        "spin 5": {"props": changed(PROPS, 7, 5.0)},
        "calibration 3": {"props": changed(PROPS, 8, 3.0)},
        "order 2": {"props": changed(PROPS, 9, 2.0)},
        "100 kPa with a stiffness of 1": {"statev": np.zeros(N_STATEV), "props": changed(changed(PROPS, 1, 1.0), 6, 100.0)},
        "a void ratio in STATEV(1)": {"statev": changed(statev, 0, 0.7)},
        "DROT no rotation": {"props": changed(PROPS, 7, 1.0), "drot": 1.1 * EYE},
        "DROT a reflection": {"props": changed(PROPS, 7, 1.0), "drot": np.diag([1.0, 1, -1])},
        "DROT not finite": {"props": changed(PROPS, 7, 1.0), "drot": changed(EYE, (0, 1), np.nan)},
        "DROT a half turn": {"props": changed(PROPS, 7, 1.0), "drot": np.diag([1.0, -1, -1])},
        "DFGRD0 singular": {"props": changed(PROPS, 7, 2.0), "dfgrd0": np.diag([1.0, 1, 0])},
        "DFGRD1 inside out": {"props": changed(PROPS, 7, 2.0), "dfgrd1": np.diag([1.0, 1, -1])},
        "DFGRD1 not finite": {"props": changed(PROPS, 7, 3.0), "dfgrd1": changed(EYE, (2, 1), np.inf)},
        "DFGRD1 nearly a half turn": {"props": changed(PROPS, 7, 2.0), "dfgrd1": expm(3.1 * np.cross(EYE, [0.6, 0, 0.8]))},
        "DFGRD1 a half turn": {"props": changed(PROPS, 7, 3.0), "dfgrd1": np.diag([1.0, -1, -1])},
    }
    return {name: plain | arguments for name, arguments in cases.items()}


@pytest.mark.parametrize("name", failures())
def test_failure_gives_the_old_state_a_finite_tangent_and_a_smaller_step(name):
    arguments = failures()[name]
    result = call(**arguments)
    assert result.stress.tobytes() == arguments["stress"].tobytes()
    assert np.isfinite(result.ddsdde).all() and (np.diag(result.ddsdde) > 0).all()
    assert 0 < result.pnewdt < 1
    if len(arguments["statev"]) >= N_STATEV:
        assert result.statev[:STATUS].tobytes() == arguments["statev"][:STATUS].tobytes()
        assert status_message(result.status) not in ("done", "unknown status")
    else:
        assert result.statev[:-1].tobytes() == arguments["statev"][:-1].tobytes()
        assert all(status_message(int(last)) not in ("done", "unknown status") for last in result.statev[-1:])
    call(**arguments, null=("pnewdt",))                                 # nor may a null pointer be written


@pytest.mark.parametrize("pnewdt", [-1.0, 1.0, 1e300, np.nan])
def test_failure_assigns_pnewdt_whatever_it_was(pnewdt):
    assert call(*started(), np.full(6, np.nan), PROPS, pnewdt=pnewdt).pnewdt == 0.25


def test_after_a_failure_smaller_increments_go_on():
    """What hosts do with PNEWDT: the state given back is as good as before."""
    stress, statev = started()
    large = np.array([-0.6, 0, 0, 0, 0, 0.0])
    failed = call(stress, statev, large, PROPS)
    assert failed.status > 0
    after = call(failed.stress, failed.statev, large / 16, PROPS)
    assert same(after, call(stress, statev, large / 16, PROPS)) and after.status == 0


def test_messages_say_which_of_the_layouts_is_asked_for():
    for arguments, word in ((failures()["plane stress"], "plane stress"), (failures()["too many PROPS"], "NPROPS"),
                            (failures()["foreign state"], "STATEV(1)"), (failures()["DROT a half turn"], "DROT"),
                            (failures()["initial phi 1.2"], "constant"), (failures()["initial pressure below 0"], "constant"),
                            (failures()["100 kPa with a stiffness of 1"], "initial state"),
                            (failures()["strain beyond reason"], "smaller increment")):
        assert word in status_message(call(**arguments).status)
    assert f"at least {N_STATEV}" in status_message(11)


def test_energies_are_left_alone_and_work_is_in_the_state():
    stress, statev = started()
    result = call(stress, statev, DSTRAN, PROPS, sse=np.nan, spd=np.nan, scd=np.nan)      # unchanged: checked by call
    work = (stress + result.stress) @ DSTRAN / 2
    assert result.statev[WORK] - statev[WORK] == pytest.approx(work, rel=1e-12)


def test_volume_fraction_follows_the_strain_exactly():
    stress, statev = started()
    result = call(stress, statev, DSTRAN, PROPS)
    assert result.statev[PHI] == pytest.approx(statev[PHI] * np.exp(-DSTRAN[:3].sum()), rel=1e-15)
    assert engineering(EYE).tolist() == [1, 1, 1, 0, 0, 0] and len(ORDER) == 37


# ---- what is said on unit 6 ------------------------------------------------------------------------------------------

def said(*changes):
    """What a process prints that calls three times with each of the changes to PROPS (number, from 1, and value) or STATEV."""
    program = "import numpy as np\nfrom test_umat_hosts import DSTRAN, PROPS, call\n" + "".join(
        f"for _ in range(3):\n    arrays = {{'stress': np.zeros(6), 'statev': np.zeros(23), 'props': PROPS.copy()}}\n    {change}\n"
        "    assert call(dstran=DSTRAN, **arrays).pnewdt == 0.25\n" for change in changes)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parent)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_faults_of_the_set_up_are_told_once_with_the_props_at_fault():
    lines = said("arrays['props'][[0, 5]] = 2, 60", "arrays['props'][2] = 2.5")
    assert lines == [f"granumat: UMAT refuses this call, status 2: {status_message(2)}",
                     "granumat: PROPS(1) mu = 2.0000E+00, allowed: 0 to 1",
                     "granumat: PROPS(6) phi = 6.0000E+01, allowed: between 0 and 1"]


def test_each_kind_of_fault_is_told():
    lines = said("arrays['statev'] = np.zeros(22)", "arrays['props'][[1, 6]] = 1, 100", "arrays['statev'][0] = 0.7",
                 "arrays['props'][7] = 1; arrays['drot'] = np.zeros((3, 3))")
    assert [int(line.split("status ")[1].split(":")[0]) for line in lines if "refuses" in line] == [11, 13, 12, 14]
    assert lines[1] == "granumat: NTENS 6, NSTATV 22, NPROPS 10"
    assert lines[3].startswith("granumat: PROPS(2) stiffness = 1.0000E+00;")


def test_what_a_smaller_increment_mends_is_not_told():
    program = "from test_umat_hosts import DSTRAN, PROPS, call, started\nprint(call(*started(), 1e3 * DSTRAN, PROPS).status)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parent)
    assert done.stdout.split() == ["16"], done.stderr


@pytest.mark.parametrize("spin", [0, 2])
def test_a_strain_above_1_is_cut_before_it_is_integrated(spin):
    props = properties(stiffness=UNIT, elastic_strain=0.01, pressure=5e3, spin=spin)
    stress, statev = started(props)
    for size, status in ((0.999, 0), (1.001, 16)):
        gradient = size * np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 0]])
        result = call(stress, statev, engineering(gradient), props, dfgrd1=expm(gradient))
        assert result.status == status and (result.pnewdt < 1) == (status > 0)


# ---- the order of the shears -----------------------------------------------------------------------------------------

@pytest.mark.parametrize("spin", [0, 1, 2, 3])
def test_a_host_with_the_shears_23_and_13_exchanged_gets_them_exchanged(rng, spin):
    kratos = np.array([0, 1, 2, 3, 5, 4])
    abaqus = properties(stiffness=UNIT, elastic_strain=0.01, spin=spin)
    other = changed(abaqus, 9, 1.0)
    stress, statev, old = np.array([-5e3, -4e3, -6e3, 300, -200, 100.0]), np.zeros(N_STATEV), EYE
    for _ in range(3):
        gradient = 0.02 * rng.normal(size=(3, 3))
        gradient -= np.trace(gradient) / 3 * EYE
        turn = {"drot": expm((gradient - gradient.T) / 2), "dfgrd0": old, "dfgrd1": expm(gradient) @ old}
        plain = call(stress, statev, engineering(gradient), abaqus, **turn)
        found = call(stress[kratos], statev, engineering(gradient)[kratos], other, **turn)
        assert plain.status == found.status == 0
        assert found.stress.tobytes() == plain.stress[kratos].tobytes()
        assert found.ddsdde.tobytes() == plain.ddsdde[np.ix_(kratos, kratos)].tobytes()
        assert found.statev.tobytes() == plain.statev.tobytes()
        stress, statev, old = plain.stress, plain.statev, turn["dfgrd1"]


def test_plane_strain_has_one_shear_and_no_order():
    stress, statev = started()
    plain, other = (call(stress[:4], statev, DSTRAN[:4], changed(PROPS, 9, order)) for order in (0.0, 1.0))
    assert same(plain, other)
