"""Python on several ranks of MPI."""

import os
import sys

ENVIRONMENT = os.environ | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMP_NUM_THREADS": "1"}


def on_ranks(ranks, *arguments):
    """The command that runs Python with arguments on some ranks, in ENVIRONMENT."""
    words = ["mpirun", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-n", ranks, sys.executable, *arguments]
    return [str(word) for word in words]
