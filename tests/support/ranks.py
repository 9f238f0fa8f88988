"""Python on several ranks, by the mpirun of Open MPI or MPICH that belongs to this Python's mpi4py."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ENVIRONMENT = os.environ | {
    "OMP_NUM_THREADS": "1",
    # Open MPI 4 and 5: as root, with more ranks than cores, which then take turns. MPICH asks for none of this.
    "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}

FOLDER = tempfile.TemporaryDirectory()          # until this process ends; LD_PRELOAD takes no path with a blank
if shutil.which("gcc"):
    YIELD = Path(FOLDER.name) / "yield.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", YIELD, Path(__file__).with_name("yield.c")], check=True)
    ENVIRONMENT["LD_PRELOAD"] = str(YIELD)      # ranks that wait leave the processors to those that compute


def on_ranks(ranks, *arguments):
    """The command that runs Python with arguments on some ranks, in ENVIRONMENT."""
    launcher = shutil.which("mpirun", path=Path(sys.executable).parent) or "mpirun"
    return [str(word) for word in (launcher, "-n", ranks, sys.executable, *arguments)]
