import numpy as np
import pytest

from granumat import Material


@pytest.fixture
def material():
    return Material(mu=0.5)


@pytest.fixture
def rng():
    return np.random.default_rng(2011)
