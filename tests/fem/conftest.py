import os
import subprocess
import sys

import pytest


@pytest.fixture
def mpirun(tmp_path):
    """Runs a script (its text) on some ranks with arguments; returns what it printed."""
    def run(script, ranks, *arguments):
        path = tmp_path / "script.py"
        path.write_text(script)
        environment = os.environ | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMP_NUM_THREADS": "1"}
        command = ["mpirun", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-n", ranks, sys.executable, path, *arguments]
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True,
                              env=environment, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout
    return run
