import subprocess

import pytest

from support.ranks import ENVIRONMENT, on_ranks


@pytest.fixture
def mpirun(tmp_path):
    """Runs a script (its text) on some ranks with arguments; returns what it printed."""
    def run(script, ranks, *arguments):
        path = tmp_path / "script.py"
        path.write_text(script)
        done = subprocess.run(on_ranks(ranks, path, *arguments), capture_output=True, text=True, env=ENVIRONMENT, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout
    return run
