"""What a scene file would run: its mesh and conditions are made, and nothing is solved."""

from pathlib import Path
from typing import Any

from mpi4py import MPI

from .scene import problem_of
from .scene_file import read_scene


def preview(file: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, Any]:
    """As granumat.preview.preview, of a scene; collective."""
    scene = read_scene(file)
    problem, _ = problem_of(scene, comm)
    return {"kind": "scene", "cells": comm.allreduce(problem.cells), "unknowns": problem.system.size, "until": scene.run.end,
            "increment": scene.run.increment(0.0), "quantities": [quantity.name for quantity in scene.quantities]}
