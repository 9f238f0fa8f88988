"""UMAT: the results are the material's, in whatever frame and layout a host works."""

import copy

import numpy as np
import pytest
from scipy.linalg import expm, logm, polar, sqrtm
from scipy.spatial.transform import Rotation

from granumat import Material, tensors
from granumat.material import CALIBRATIONS, CLOSURES, CONTACTS
from support import reference
from support.states import CLOSURES_AND_STRAINS, random_states
from support.umat_host import (
    DIRECTION,
    EYE,
    FABRIC,
    N_STATEV,
    PHI,
    STRESS,
    WORK,
    Z2,
    call,
    engineering,
    increment,
    properties,
    statev_of,
)
from test_tangent import WEIGHTS, unit_gradients

UNIT = 2.5e6                                      # a stress unit, Pa


def material_and_props(closure="full", contact="hookean", calibration="table-1", elastic_strain=0.0, mu=0.5, spin=0):
    props = properties(mu, UNIT, CLOSURES.index(closure), CONTACTS.index(contact), elastic_strain, spin=spin,
                       calibration=CALIBRATIONS.index(calibration))
    return Material(mu, closure, contact, calibration=calibration, elastic_strain=elastic_strain), props


def assert_is_state(result, state, rtol):
    """A result's stress and STATEV against a record of granumat.STATE."""
    np.testing.assert_allclose(result.stress / UNIT, state.stress, rtol=0, atol=rtol * 0.01)
    np.testing.assert_allclose(result.statev[STRESS], state.stress, rtol=0, atol=rtol * 0.01)
    np.testing.assert_allclose(result.statev[FABRIC], state.fabric, rtol=0, atol=rtol * 0.04)
    np.testing.assert_allclose(result.statev[DIRECTION], state.direction, rtol=0, atol=rtol)
    np.testing.assert_allclose(result.statev[[Z2, PHI]], [state.coordination_number, state.volume_fraction], rtol=rtol)


@pytest.mark.parametrize("spin", [0, 1, 2])
@pytest.mark.parametrize(("closure", "elastic_strain"), CLOSURES_AND_STRAINS)
def test_stress_state_and_tangent_are_the_materials(rng, closure, elastic_strain, spin):
    material, props = material_and_props(closure, elastic_strain=elastic_strain, spin=spin)
    states, gradients = random_states(rng, material, 40, 0.1, excess=(0.5, 1.2))
    if spin == 0:
        gradients = (gradients + np.swapaxes(gradients, 1, 2)) / 2
    new, tangent = material.update_with_tangent(states, gradients)
    for i in range(len(states)):
        result = call(np.full(6, np.nan), statev_of(states[i]), props=props, **increment(gradients[i], spin))
        assert result.status == 0
        assert_is_state(result, new[i], 1e-11)
        np.testing.assert_allclose(result.ddsdde / UNIT, tangent[i], rtol=0, atol=1e-10 * np.abs(tangent[i]).max())


@pytest.mark.parametrize("calibration", CALIBRATIONS)
@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("mu", [0.0, 0.3, 1.0])
def test_contact_calibration_and_friction_coefficient_are_the_materials(rng, mu, contact, calibration):
    material, props = material_and_props("full", contact, calibration, mu=mu)
    states, gradients = random_states(rng, material, 5, 0.1, excess=(0.5, 1.2))
    gradients = (gradients + np.swapaxes(gradients, 1, 2)) / 2
    for state, gradient in zip(states, gradients):
        result = call(np.zeros(6), statev_of(state), props=props, **increment(gradient, 0))
        assert_is_state(result, material.update(state, gradient), 1e-12)


# ---- where a state starts --------------------------------------------------------------------------------------------

@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("given", ["pressure in PROPS", "STRESS", "phi"])
def test_a_state_starts_from_the_pressure_in_props_else_from_stress_else_from_phi(contact, given):
    material, props = material_and_props(contact=contact)
    stress = np.zeros(6)
    if given == "phi":
        state = material.state(0.60, material["Zc"] + material["beta1"] * np.sqrt(0.60 - material["phic"]))     # (4.9)
    else:
        state = material.isotropic(0.60, pressure=0.004)
    if given == "pressure in PROPS":
        props[6] = 0.004 * UNIT
    if given == "STRESS":
        stress[:3] = -0.004 * UNIT
    assert_is_state(call(stress, np.zeros(N_STATEV), np.zeros(6), props), state, 1e-14)
    gradient = np.zeros((3, 3))
    gradient[0, 2] = gradient[2, 0] = 0.005
    assert_is_state(call(stress, np.zeros(N_STATEV), engineering(gradient), props), material.update(state, gradient), 1e-12)


def test_the_critical_closure_starts_from_phi_where_no_pressure_is_given():
    material, props = material_and_props("critical")
    result = call(np.zeros(6), np.zeros(N_STATEV), np.zeros(6), props)
    pressure = (material["a1"] + material["a2"] * material["kappa"]) * material["beta1"] ** 2 * (0.60 - material["phic"])   # (A 11)
    np.testing.assert_allclose(result.stress / UNIT, -pressure * tensors.IDENTITY, rtol=0, atol=1e-16)


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("given", ["pressure in PROPS", "STRESS"])
def test_a_given_pressure_holds_in_the_critical_closure_too_and_phi_follows(contact, given):
    material, props = material_and_props("critical", contact)
    stress = np.zeros(6)
    if given == "STRESS":
        stress[:3] = -0.004 * UNIT
    else:
        props[6] = 0.004 * UNIT
    result = call(stress, np.zeros(N_STATEV), np.zeros(6), props)
    np.testing.assert_allclose(result.stress / UNIT, -0.004 * tensors.IDENTITY, rtol=0, atol=1e-16)
    assert_is_state(result, material.isotropic(0.60, pressure=0.004), 1e-14)


def test_a_start_keeps_the_deviator_of_the_stress_handed_in():
    _, props = material_and_props(elastic_strain=0.01)
    stress = np.array([-1.2e4, -0.9e4, -0.9e4, 2e3, -1e3, 5e2])
    result = call(stress, np.zeros(N_STATEV), np.zeros(6), props)
    np.testing.assert_allclose(result.stress, stress, rtol=1e-13)
    props[6] = 2.0e4
    result = call(stress, np.zeros(N_STATEV), np.zeros(6), props)
    np.testing.assert_allclose(result.stress, stress - 1e4 * tensors.IDENTITY, rtol=1e-13)


def test_constants_left_out_at_the_end_are_zero():
    _, props = material_and_props()
    stress = np.array([-1e4, -1e4, -1e4, 0, 0, 0])
    dstran = np.array([0.001, -0.002, 0, 0.003, 0, 0])
    assert call(stress, np.zeros(N_STATEV), dstran, props[:6]).stress.tobytes() == \
        call(stress, np.zeros(N_STATEV), dstran, props).stress.tobytes()


# ---- NTENS -----------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("spin", [0, 1, 2, 3])
def test_ntens_4_is_ntens_6_without_13_and_23_bit_for_bit(rng, spin):
    _, props = material_and_props(elastic_strain=0.01, spin=spin)
    statev_6, statev_4 = np.zeros(N_STATEV), np.zeros(N_STATEV)
    stress_6, stress_4 = np.zeros(6), np.zeros(4)
    old = EYE
    for _ in range(10):
        gradient = np.zeros((3, 3))
        gradient[:2, :2] = 0.02 * rng.normal(size=(2, 2))
        gradient[2, 2] = -gradient[0, 0] - gradient[1, 1]
        new = expm(gradient) @ old
        host = {"drot": expm((gradient - gradient.T) / 2), "dfgrd0": old, "dfgrd1": new}
        six = call(stress_6, statev_6, engineering(gradient), props, **host)
        four = call(stress_4, statev_4, engineering(gradient)[:4], props, **host)
        assert six.status == four.status == 0
        np.testing.assert_array_equal(four.stress, six.stress[:4])
        np.testing.assert_array_equal(four.ddsdde, six.ddsdde[:4, :4])
        np.testing.assert_array_equal(four.statev, six.statev)
        np.testing.assert_array_equal(six.stress[4:], 0)
        stress_6, statev_6, stress_4, statev_4, old = six.stress, six.statev, four.stress, four.statev, new


# ---- the tangent -----------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("ntens", [6, 4])
@pytest.mark.parametrize("spin", [0, 1, 2])
@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
def test_tangent_equals_differences_through_the_umat(rng, elastic_strain, spin, ntens):
    material, props = material_and_props("full", elastic_strain=elastic_strain, spin=spin)
    state = material.steady(0.60)
    if ntens == 4:                                # sheared in 12 instead of 13
        swap = np.array([0, 2, 1, 4, 3, 5])
        for name in ("stress", "fabric", "direction"):
            state[name] = state[name][swap]
    state = Material(0.5).update(state, 0.01 * np.diag([1.0, -0.7, -0.3]))
    gradient = 0.005 * rng.normal(size=(3, 3))
    if ntens == 4:
        gradient[:2, 2] = gradient[2, :2] = 0
    gradient -= np.trace(gradient) / 3 * EYE

    def stress(change):
        arguments = increment(gradient + change, spin)
        arguments["dstran"] = arguments["dstran"][:ntens]
        result = call(np.zeros(ntens), statev_of(state), props=props, **arguments)
        assert result.status == 0
        return result

    step = 1e-4
    expected = np.zeros((ntens, ntens))
    for j, unit in enumerate(unit_gradients()[:ntens]):
        for m, weight in enumerate(WEIGHTS, 1):
            expected[:, j] += weight / step * (stress(m * step * unit).stress - stress(-m * step * unit).stress)
    np.testing.assert_allclose(stress(0).ddsdde, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert np.abs(expected - expected.T).max() > 1e-2 * np.abs(expected).max()             # a transposed one would be seen


@pytest.mark.parametrize("ntens", [6, 4])
def test_tangent_in_the_unrotated_frame_is_the_true_one_turned_back(rng, ntens):
    material, props = material_and_props(elastic_strain=0.01, spin=2)
    state = material.update(material.isotropic(0.60, pressure=0.005), 0.05 * np.outer([1, 0, 0], [0, 1, 0]))
    arguments = {"statev": statev_of(state), "dstran": np.zeros(ntens), "dfgrd0": EYE + 0.5 * np.outer([1, 0, 0], [0, 1, 0])}
    arguments["dfgrd1"] = (EYE + 0.01 * np.outer([0, 1, 0], [1, 0, 0])) @ arguments["dfgrd0"]
    if ntens == 6:
        q = rotation_about([3, -1, 2], 0.7)
        arguments["dfgrd0"], arguments["dfgrd1"] = q @ arguments["dfgrd0"], q @ arguments["dfgrd1"]
    true = call(np.zeros(ntens), props=props, **arguments)
    props[7] = 3
    unrotated = call(np.zeros(ntens), props=props, **arguments)
    assert true.status == unrotated.status == 0
    r = polar(arguments["dfgrd1"])[0]
    tensor_shears = np.array([1, 1, 1, 0.5, 0.5, 0.5])
    turned_strains = np.array([turn(r, unit * tensor_shears) / tensor_shears for unit in np.eye(6)]).T         # columns
    back = np.array([turn(r.T, unit) for unit in np.eye(6)]).T
    expected = back[:ntens, :ntens] @ true.ddsdde @ turned_strains[:ntens, :ntens]
    np.testing.assert_allclose(unrotated.ddsdde, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.abs(expected - true.ddsdde).max() > 0.01 * np.abs(expected).max()


def test_tangent_for_calculix_is_the_derivative_of_its_stress_by_its_strain(rng):
    """CalculiX takes U^-1 U^-1 DDSDDE U^-1 U^-1 for dS/dE of S = J U^-1 STRESS U^-1; exact for small increments only."""
    material, props = material_and_props("full", elastic_strain=0.01, spin=4)
    statev = statev_of(material.update(material.isotropic(0.60, pressure=0.01), 0.05 * np.outer([1, 0, 0], [0, 0, 1])))
    start = expm(0.2 * rng.normal(size=(3, 3)))
    r, end = polar(expm(1e-5 * rng.normal(size=(3, 3))) @ start)
    lagrange = (end @ end - EYE) / 2

    def second_piola_kirchhoff(strain):
        u = sqrtm(2 * strain + EYE).real
        result = call(np.zeros(6), statev, props=props, dstran=np.full(6, np.nan), dfgrd0=start, dfgrd1=r @ u)
        assert result.status == 0
        return np.linalg.det(u) * np.linalg.inv(u) @ tensors.to_matrix(result.stress) @ np.linalg.inv(u), result.ddsdde

    back, ddsdde = np.linalg.inv(end), second_piola_kirchhoff(lagrange)[1]
    for unit in unit_gradients():
        dE = 1e-7 * (unit + unit.T) / 2
        expected = (second_piola_kirchhoff(lagrange + dE)[0] - second_piola_kirchhoff(lagrange - dE)[0]) / 2
        taken = back @ tensors.to_matrix(ddsdde @ engineering(back @ dE @ back)) @ back
        np.testing.assert_allclose(taken, expected, rtol=0, atol=1e-3 * 1e-7 * np.abs(ddsdde).max())


# ---- frames ----------------------------------------------------------------------------------------------------------

def turn(q, components):
    return tensors.to_voigt(q @ tensors.to_matrix(components) @ q.T)


class Abaqus:
    """STRESS rotated by DROT before the call, STATEV not; strain and DROT after Hughes & Winget from the midpoint gradient."""

    def __init__(self, spin, elastic_strain=0.01):
        _, self.props = material_and_props(elastic_strain=elastic_strain, spin=spin)
        self.props[6] = 0.005 * UNIT
        self.stress, self.statev, self.old = np.zeros(6), np.zeros(N_STATEV), EYE

    def arguments(self, new):
        step = new @ np.linalg.inv(self.old)
        gradient = 2 * (step - EYE) @ np.linalg.inv(step + EYE)
        half_spin = (gradient - gradient.T) / 4
        drot = np.linalg.solve(EYE - half_spin, EYE + half_spin)
        return turn(drot, self.stress), {"dstran": engineering(gradient), "drot": drot}

    def move(self, new):
        stress, arguments = self.arguments(new)
        result, again = (call(stress, self.statev, props=self.props, dfgrd0=self.old, dfgrd1=new, **arguments) for _ in range(2))
        assert result.status == 0 and result.pnewdt == 1
        assert again.statev.tobytes() == result.statev.tobytes() and again.stress.tobytes() == result.stress.tobytes()
        self.stress, self.statev, self.old = result.stress, result.statev, new

    def true_stress(self):
        return self.stress / UNIT


class OldStress(Abaqus):
    """STRESS handed in as it was left."""

    def arguments(self, new):
        return self.stress, super().arguments(new)[1]


class Unrotated(Abaqus):
    """CalculiX's @ABAQUSNL_: all in the frame that R of F = R U leaves behind, yet DROT is the rotation."""

    def arguments(self, new):
        old_r, old_u = polar(self.old)
        new_r, new_u = polar(new)
        return self.stress, {"dstran": engineering(logm(new_u) - logm(old_u)), "drot": new_r @ old_r.T}

    def true_stress(self):
        return turn(polar(self.old)[0], self.stress) / UNIT


class Warp3D(Unrotated):
    """The same with DROT = I."""

    def arguments(self, new):
        return self.stress, super().arguments(new)[1] | {"drot": EYE}


def rotation_about(axis, angle):
    """Orthogonal to the last digit, for the volume's stiffness is 90 times the pressure."""
    return Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis)).as_matrix()


HOSTS = [(Abaqus, 1), (Abaqus, 2), (OldStress, 1), (OldStress, 2), (Unrotated, 0), (Unrotated, 3), (Warp3D, 0), (Warp3D, 3)]


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
@pytest.mark.parametrize("angle", [30, 90, 170])
@pytest.mark.parametrize("host, spin", HOSTS)
def test_shear_after_a_rigid_rotation_is_shear_turned(host, spin, angle, elastic_strain):
    straight = host(spin, elastic_strain)
    q = rotation_about([1, 2, 3], np.radians(angle))
    shear = EYE + 0.05 * np.outer([1, 0, 0], [0, 0, 1])
    for _ in range(4):
        straight.move(shear @ straight.old)
    turned = copy.deepcopy(straight)
    turned.move(q @ turned.old)
    np.testing.assert_allclose(turned.true_stress(), turn(q, straight.true_stress()), rtol=0, atol=5e-15)
    for _ in range(4):
        straight.move(shear @ straight.old)
        turned.move(q @ shear @ q.T @ turned.old)
    np.testing.assert_allclose(turned.true_stress(), turn(q, straight.true_stress()), rtol=0, atol=1e-14)
    frame = q if spin else EYE                    # STATEV of spin 0 stays in the host's frame
    for name in (FABRIC, DIRECTION, STRESS):
        np.testing.assert_allclose(turned.statev[name], turn(frame, straight.statev[name]), rtol=0, atol=1e-12)
    assert np.abs(straight.true_stress()[4]) > 5e-4


@pytest.mark.parametrize("elastic_strain", [0.0, 0.01])
@pytest.mark.parametrize("host, spin", [(Abaqus, 2), (OldStress, 2), (Unrotated, 3), (Warp3D, 3)])
def test_large_simple_shear_in_increments_of_an_eighth_is_exact(host, spin, elastic_strain):
    increments = 32
    gradient = 0.125 * np.outer([1, 0, 0], [0, 0, 1])
    point = host(spin, elastic_strain)
    for _ in range(increments):
        point.move((EYE + gradient) @ point.old)
    material, _ = material_and_props(elastic_strain=elastic_strain)
    start = material.isotropic(0.60, pressure=0.005)
    fabric, z2, phi, p, deviator = reference.integrate(
        reference.constants(0.5) | {"elastic_strain": elastic_strain}, np.zeros((1, 3, 3)), start.coordination_number, 0.60,
        increments * gradient[None], np.zeros((1, 3, 3)))
    np.testing.assert_allclose(tensors.to_matrix(point.statev[FABRIC]), fabric[0], rtol=0, atol=1e-10 * material["kappa"])
    np.testing.assert_allclose(point.statev[[Z2, PHI]], [z2[0], phi[0]], rtol=1e-10)
    np.testing.assert_allclose(tensors.to_matrix(point.true_stress()), -p[0] * EYE - deviator[0], rtol=0, atol=1e-10 * p[0])


def test_rotating_first_or_not_at_all_is_wrong_in_large_simple_shear():
    """What the choice in PROPS is for: fabric errors over kappa at increments of 0.125."""
    gradient = 0.125 * np.outer([1, 0, 0], [0, 0, 1])
    points = {(host, spin): host(spin, 0.0) for host, spin in ((Abaqus, 2), (Abaqus, 1), (Abaqus, 0), (Unrotated, 0))}
    before = Material(0.5, spin="before")
    state = before.isotropic(0.60, pressure=0.005)
    for _ in range(32):
        for point in points.values():
            point.move((EYE + gradient) @ point.old)
        state = before.update(state, gradient)
    exact = points.pop((Abaqus, 2)).statev[FABRIC]
    errors = [np.abs(point.statev[FABRIC] - exact).max() / before["kappa"] for point in points.values()]
    assert errors[0] < 2e-4                       # spin 1: Hughes & Winget's DROT is a rotation by 2 atan(gamma/4), not gamma/2
    assert min(errors[1:]) > 1e-2
    assert np.abs(state.fabric - exact).max() / before["kappa"] > 1e-2


def test_work_is_the_integral_of_stress_power_by_the_trapezoidal_rule():
    point = Abaqus(2)
    expected, before = 0.0, 0.0
    for _ in range(20):
        point.move((EYE + 0.05 * np.outer([1, 0, 0], [0, 0, 1])) @ point.old)
        expected += 0.05 * (before + point.stress[4]) / 2
        before = point.stress[4]
    assert point.statev[WORK] == pytest.approx(expected, rel=1e-12)
