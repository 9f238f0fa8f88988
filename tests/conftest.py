import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import Material

CALCULIX = Path(__file__).resolve().parents[1] / "demos/linking/calculix"
NO_DOWNLOAD = 69            # exit status of its build.sh
PROGRAMS = {"calculix", "mpirun"}     # fixtures: tests of other programs, or of several ranks


def pytest_collection_modifyitems(items):
    for item in items:
        if PROGRAMS.intersection(item.fixturenames):
            item.add_marker("slow")
            item.add_marker("release_only")


@pytest.fixture(scope="session")
def calculix():
    """CalculiX is there, and the modules of demos/linking/calculix can be imported."""
    built = subprocess.run([CALCULIX / "build.sh"], capture_output=True, text=True)
    if built.returncode == NO_DOWNLOAD:
        pytest.skip(f"CalculiX's source cannot be downloaded, nor was it before: {built.stderr.strip()}")
    assert built.returncode == 0, built.stdout + built.stderr
    sys.path.insert(0, str(CALCULIX))
    yield
    sys.path.remove(str(CALCULIX))


@pytest.fixture
def material():
    return Material(mu=0.5)


@pytest.fixture
def rng():
    return np.random.default_rng(2011)
