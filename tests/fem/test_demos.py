"""The demos of boundary-value problems, in short, and the same on one, two and three ranks."""

from pathlib import Path

import numpy as np

DEMOS = Path(__file__).parents[2] / "demos"
SCRIPT = f"""
import sys
sys.path.insert(0, {str(DEMOS)!r})
import importlib
import traceback
import numpy as np
from mpi4py import MPI
out, *names = sys.argv[1:]
for name in names:
    try:
        demo = importlib.import_module(name)
        data = demo.main(**demo.SHORT, out=out)
    except Exception:                       # or the other ranks would wait for this one
        traceback.print_exc()
        MPI.COMM_WORLD.Abort(1)
    if MPI.COMM_WORLD.rank == 0:
        np.savez(out + "/" + name + ".npz", **data)
"""
NAMES = ("homogeneous_shear", "direct_shear", "platen_gravity", "ring_shear_3d", "biaxial_block", "radial_hopper", "drawn_bed",
         "split_bottom")
AGREEMENT = 1e-9            # largest difference between one rank and several, of a quantity's largest value


def test_demos_give_the_same_and_their_pictures_on_one_two_and_three_ranks(mpirun, tmp_path):
    for ranks in (1, 2, 3):
        mpirun(SCRIPT, ranks, tmp_path / f"{ranks}", *NAMES)
    for name in NAMES:
        assert all((tmp_path / f"{ranks}/{name.replace('_', '-')}.png").exists() for ranks in (1, 2, 3)), name
        one = np.load(tmp_path / f"1/{name}.npz")
        for ranks in (2, 3):
            several = np.load(tmp_path / f"{ranks}/{name}.npz")
            for key in one.files:
                size = 1.0 if key == "difference" else abs(one[key]).max()
                assert np.allclose(several[key], one[key], rtol=0, atol=AGREEMENT * size), (name, ranks, key)


def test_where_flow_ends_is_drawn(mpirun, tmp_path):
    said = mpirun(SCRIPT, 1, tmp_path, "where_flow_ends")        # which points unjam first is not the same on any number of ranks
    assert "is unjammed" in said and np.load(tmp_path / "where_flow_ends.npz")["t"] < 2
    assert (tmp_path / "where-flow-ends.png").exists()


def test_what_the_ladder_recommends_for_paths_of_the_demos_is_as_good_as_it_says(mpirun, tmp_path):
    mpirun(SCRIPT, 1, tmp_path, "ladder")
    pairs = np.load(tmp_path / "ladder.npz")
    assert pairs["true"].size == 2 and pairs["proved"].all() and (pairs["true"] <= pairs["predicted"] + 1e-4).all()
    assert (tmp_path / "ladder.png").exists()
