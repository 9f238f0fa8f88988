import fcntl
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granumat import Material

LINKING = Path(__file__).resolve().parents[1] / "demos/linking"
NO_DOWNLOAD = 69            # exit status of build.sh there
signal.signal(signal.SIGINT, signal.default_int_handler)     # processes of pytest-xdist ignore it, and so would what tests start
PROGRAMS = {"calculix", "kratos", "mpirun"}     # fixtures: tests of other programs, or of several ranks


def pytest_collection_modifyitems(items):
    for item in items:
        if PROGRAMS.intersection(item.fixturenames):
            item.add_marker("slow")
            item.add_marker("release_only")


def built(name):
    """The folder of a program in demos/linking, which is there; skips the test where it cannot be downloaded."""
    with open(__file__) as one_at_a_time:           # of all processes that test: they share apt, and the programs
        fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
        done = subprocess.run([LINKING / name / "build.sh"], capture_output=True, text=True)
    if done.returncode == NO_DOWNLOAD:
        pytest.skip(f"{name} cannot be downloaded, nor was it before: {done.stderr.strip()}")
    assert done.returncode == 0, done.stdout + done.stderr
    return LINKING / name


@pytest.fixture(scope="session")
def calculix():
    """CalculiX is there, and the modules of demos/linking/calculix can be imported."""
    folder = str(built("calculix"))
    sys.path.insert(0, folder)
    yield
    sys.path.remove(folder)


@pytest.fixture(scope="session")
def kratos():
    """demos/linking/kratos, Kratos being there."""
    return built("kratos")


@pytest.fixture
def material():
    return Material(mu=0.5)


@pytest.fixture
def rng():
    return np.random.default_rng(2011)
