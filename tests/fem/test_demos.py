"""The demos of boundary-value problems, in short, and the same on one, two and three ranks."""

from pathlib import Path

import numpy as np
import pytest

DEMOS = Path(__file__).parents[2] / "demos"
SCRIPT = f"""
import sys
sys.path.insert(0, {str(DEMOS)!r})
import importlib
import traceback
import numpy as np
from mpi4py import MPI
try:
    demo = importlib.import_module(sys.argv[1])
    data = demo.main(**demo.SHORT, out=sys.argv[2])
except Exception:                       # or the other ranks would wait for this one
    traceback.print_exc()
    MPI.COMM_WORLD.Abort(1)
if MPI.COMM_WORLD.rank == 0:
    np.savez(sys.argv[2] + ".npz", **data)
"""
# The largest difference between one rank and several, of a quantity's largest value. Round-off grows by more than 1e-9 only where
# the whole body is without stress: then forces hold no point, and each is left where the last iteration puts it.
AGREEMENT = {"homogeneous_shear": 1e-9, "direct_shear": 1e-6, "platen_gravity": 1e-9, "ring_shear_3d": 1e-9, "biaxial_block": 1e-9}


@pytest.mark.parametrize("name", AGREEMENT)
def test_a_demo_gives_the_same_and_its_picture_on_one_two_and_three_ranks(name, mpirun, tmp_path):
    for ranks in (1, 2, 3):
        mpirun(SCRIPT, ranks, name, tmp_path / f"{ranks}")
        assert (tmp_path / f"{ranks}" / f"{name.replace('_', '-')}.png").exists()
    one = np.load(tmp_path / "1.npz")
    for ranks in (2, 3):
        several = np.load(tmp_path / f"{ranks}.npz")
        for key in one.files:
            size = 1.0 if key == "difference" else abs(one[key]).max()
            assert np.allclose(several[key], one[key], rtol=0, atol=AGREEMENT[name] * size), (name, ranks, key)
