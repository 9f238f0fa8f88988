"""How an increment is integrated, seen in its result: docs/theory.md's single substep, to round-off."""

import numpy as np
import pytest

from granumat import Material, tensors
from test_theory import BASIS, IDENTITY, SPINS, VOIGT, Law, Substep


@pytest.mark.parametrize("ratio", [4, 8])
def test_a_small_increment_of_an_isotropic_packing_is_one_substep(ratio):
    """|A| is smooth on the way from A = 0: substeps need not shrink as they do next to it. Those would be 25 here, and the result
    nearer to the exact one by 1e-11."""
    S = np.array([0.3, -0.5, 0.4, 0.2, 0.6])
    S *= 0.009 * np.sqrt(2) / np.linalg.norm(S)
    material = Material(0.5, elastic_strain=0.009 / ratio)
    state = material.isotropic(material["phic"] - 0.02, coordination_number=material["Zc"] + 1)
    increment = {"mod_D": 0.009, "tr_D": 0.0, "S": S, "w": np.zeros(3), "S_hat": S / 0.009, "tr_hat": 0.0}
    step = Substep(Law(material.constants, "full", "hookean"), increment, 1.0, np.zeros(5), 1.0, state.volume_fraction, np.zeros(5))
    expected = VOIGT @ step.dev - step.p[-1] * IDENTITY
    new = material.update(state, tensors.to_matrix(VOIGT @ S))
    np.testing.assert_allclose(new.stress, expected, rtol=0, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize(("degree", "mod_D"), [(1, 2.5e-6), (2, 1.2e-4)])
def test_a_quiet_increment_takes_a_lower_degree(degree, mod_D):
    """Of all states nearly that in which it errs the most, so that degrees can be told apart."""
    S_hat = np.array([0.3, -0.5, 0.4, 0.2, 0.6])
    S_hat *= np.sqrt(2) / np.linalg.norm(S_hat)
    volume = 2.0                                                      # volume strain over |S|, a fast compaction
    mod_S = mod_D / np.sqrt(1 + volume**2 / 6)
    S, A, w = mod_S * S_hat, -0.04 * S_hat, mod_S * np.array([1.0, -0.5, 0.7])
    material = Material(1.0, "kinematic", elastic_strain=0.01)
    state = material.state(material["phic"] - 0.02, material["Zc"] + 1, VOIGT @ A)
    increment = {"mod_D": mod_D, "tr_D": volume * mod_S, "S": S, "w": w, "S_hat": S / mod_D, "tr_hat": volume * mod_S / mod_D}
    law, dev = Law(material.constants, "kinematic", "hookean"), VOIGT.T @ (state.stress * [1, 1, 1, 2, 2, 2])
    steps = [Substep(law, increment, 1.0, A, 1.0, state.volume_fraction, dev, degree=n) for n in (degree, 4)]
    as_expected, finer = (VOIGT @ step.dev - step.p[-1] * IDENTITY for step in steps)
    new = material.update(state, np.tensordot(S, BASIS, 1) + volume * mod_S / 3 * np.eye(3) + np.tensordot(w, SPINS, 1))
    error, difference = (np.abs(new.stress - stress).max() / np.abs(finer).max() for stress in (as_expected, finer))
    assert error < 2e-15 and 10 * error < difference < 1e-12
