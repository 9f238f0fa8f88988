"""How an increment is cut into substeps, seen in its result: docs/theory.md's single substep, to round-off."""

import numpy as np
import pytest

from granumat import Material, tensors
from test_theory import IDENTITY, VOIGT, Law, Substep


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
