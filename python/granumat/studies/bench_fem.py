"""Prints and draws what a Newton iteration of the finite-element solver costs.

Shown are the shares of its parts, the cost over that of linear elasticity in UFL, the gain by two ranks, and how time and memory
grow with the problem.

Every measurement is a process of its own (`python3 -m granumat.studies.bench_fem N`, under mpirun for several ranks): memory is its
peak, and time is the processor's.
"""

import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from matplotlib.figure import Figure
from mpi4py import MPI

from .. import core
from ..core import STATE
from ..errors import GranumatError
from ..fem.conditions import Displacement, Periodic
from ..fem.meshes import box
from ..fem.problem import Problem
from ..fem.system import ITERATIVE, make_solver
from ..material import Material

CELLS = 27                             # along an edge: 19 683 hexahedra
SIZES = (11, 17, 27, 39)               # cells along an edge, 5 184 to 192 000 unknowns
SHEAR = 0.005                          # shear strain of an increment
INCREMENTS = 2
REPEATS = 5                            # of an iteration of linear elasticity, of which the median counts
PAIRS = 3                              # of runs on one and on two ranks, of whose ratios the median counts
PHASES = ("material", "coupling", "assembly", "solution")


Measured = dict[str, Any]


def shear_cell(comm: MPI.Comm, n: int, **options: Any) -> Problem:
    """Make a cube in simple shear at constant volume, with periodic sides, before its steady state.

    Parameters
    ----------
    comm : MPI.Comm
    n : int
        Hexahedra along an edge.
    **options
        Of Problem.

    Returns
    -------
    Problem
        Its volume fraction varies in space, and so does its solution.
    """
    material = Material(0.5, elastic_strain=1e-2)

    def state(x: np.ndarray) -> np.ndarray:
        states = np.full(len(x), material.steady(0.60), STATE)
        states["fabric"] *= 0.3
        states["stress"][:, 3:] *= 0.3
        states["volume_fraction"] += 0.005 * np.cos(2 * np.pi * x).prod(axis=1)
        return states

    def side(axis: int, end: float) -> Any:
        return lambda x: np.isclose(x[axis], end)

    conditions: list[Any] = [Displacement(side(2, 0)), Displacement(side(2, 1), lambda x, t: np.array([SHEAR * t, 0, 0]))]
    conditions += [Periodic(side(axis, 1), lambda x, axis=axis: x - np.eye(3)[axis]) for axis in range(2)]
    return Problem(box(comm, (1, 1, 1), (n, n, n)), material, state, conditions, **options)


@contextlib.contextmanager
def _phases(problem: Problem) -> Iterator[dict[str, float]]:
    """Processor seconds of each phase while the problem is solved; coupling is all that is not material, assembly or solution."""
    seconds = dict.fromkeys(PHASES, 0.0)
    watched = []

    def time_it(owner: Any, name: str, phase: str) -> None:
        action = getattr(owner, name)

        def timed(*arguments: Any, **options: Any) -> Any:
            start = time.process_time()
            try:
                return action(*arguments, **options)
            finally:
                seconds[phase] += time.process_time() - start
        setattr(owner, name, timed)
        watched.append((owner, name, action))

    time_it(problem.material, "update", "material")
    time_it(problem.material, "update_with_tangent", "material")
    time_it(core, "element_stiffness", "assembly")
    time_it(problem.system, "assemble", "assembly")
    time_it(problem.system, "solve_assembled", "solution")
    start = time.process_time()
    yield seconds
    seconds["coupling"] = time.process_time() - start - sum(seconds.values())
    for owner, name, action in watched:
        setattr(owner, name, action)


def measure(n: int, comm: MPI.Comm = MPI.COMM_WORLD) -> Measured:
    """Measure the shear cell with n hexahedra along an edge.

    Returns
    -------
    dict
        "unknowns"; "newton" and "krylov", iterations in all and for each Newton iteration; "iteration" and each of PHASES,
        processor seconds of a Newton iteration on the rank that takes most; "bytes" for each unknown, of all ranks together.
    """
    problem = shear_cell(comm, 2)                                  # so that what is imported or compiled once is not measured
    problem.accept(problem.solve_increment(1.0))
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    problem = shear_cell(comm, n)
    problem.accept(problem.solve_increment(1.0))
    problem.system.solver.setConvergenceHistory(reset=False)
    newton = 0
    with _phases(problem) as seconds:
        for _ in range(INCREMENTS):
            trial = problem.solve_increment(1.0)
            newton += len(trial.residuals) - 1
            problem.accept(trial)
    bytes_used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - start
    krylov = len(problem.system.solver.getConvergenceHistory()) - newton           # each history begins before the first iteration
    found = {"unknowns": problem.system.size, "newton": newton, "krylov": round(krylov / newton)}
    found |= {phase: comm.allreduce(value, MPI.MAX) / newton for phase, value in seconds.items()}
    return found | {"iteration": comm.allreduce(sum(seconds.values()), MPI.MAX) / newton,
                    "bytes": comm.allreduce(bytes_used) / problem.system.size}


def measure_elasticity(n: int, krylov: int, matrix_type: str) -> float:
    """Processor seconds of residual, matrix and a number of Krylov iterations of linear elasticity in UFL, on the same mesh."""
    problem = shear_cell(MPI.COMM_WORLD, n)
    space = problem.space
    u, v, w = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)

    def stress(displacement: Any) -> Any:
        strain = ufl.sym(ufl.grad(displacement))
        return ufl.tr(strain) * ufl.Identity(3) + 2 * strain

    dx = ufl.dx(metadata={"quadrature_degree": 2})                 # as many points as granumat's cells have
    held = fem.dirichletbc(fem.Function(space), problem.nodes_at(lambda x: np.isclose(x[2], 0) | np.isclose(x[2], 1)))
    left = fem.form(ufl.inner(stress(w), ufl.sym(ufl.grad(v))) * dx)
    right = fem.form(ufl.inner(stress(u), ufl.sym(ufl.grad(v))) * dx)
    matrix = petsc.create_matrix(left, matrix_type)
    solver = make_solver(MPI.COMM_WORLD, ITERATIVE | {"ksp_convergence_test": "skip", "ksp_max_it": krylov})
    u.x.array[:] = np.random.default_rng(0).normal(size=u.x.array.size)
    seconds = []
    for _ in range(REPEATS):
        start = time.process_time()
        residual = petsc.assemble_vector(right)
        matrix.zeroEntries()
        petsc.assemble_matrix(matrix, left, [held])
        matrix.assemble()
        petsc.set_bc(residual, [held])
        solver.setOperators(matrix)
        solution = residual.duplicate()
        solver.solve(residual, solution)
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


def _run(arguments: Sequence[object], ranks: int = 1) -> Any:
    """Let a process of its own, or one for each rank, measure."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
                                "OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    command = [sys.executable, "-m", "granumat.studies.bench_fem", *map(str, arguments)]
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    result = subprocess.run(launcher + command, env=environment, capture_output=True, text=True)
    if result.returncode:
        raise GranumatError(f"{' '.join(command)}:\n{result.stderr}")
    return json.loads(result.stdout.splitlines()[-1])


def print_fem(directory: str | Path, n: int = CELLS, sizes: Sequence[int] = SIZES) -> None:
    """Print all ratios, and draw them into the file fem-cost.png of a directory.

    Parameters
    ----------
    directory : path
        It is created if it does not exist.
    n : int
        Cells along an edge where shares and ranks are measured.
    sizes : sequence of int
        Cells along an edge where the growth is measured.
    """
    one = _run([n])
    print(f"shear cell of {n**3} hexahedra, {one['unknowns']} unknowns: {one['newton'] / INCREMENTS:.1f} Newton iterations an "
          f"increment, {one['krylov']} Krylov iterations each, {one['iteration']:.2f} s of one processor a Newton iteration:")
    for phase in PHASES:
        print(f"  {phase:9} {one[phase] / one['iteration']:6.1%}")
    elasticity = {kind: _run([n, one["krylov"], kind]) for kind in ("aij", "baij")}
    for kind, seconds in elasticity.items():
        print(f"  {one['iteration'] / seconds:.2f} x an iteration of linear elasticity in UFL into {kind.upper()}, as many Krylov "
              "iterations")
    pairs = [(_run([n], ranks=2), _run([n])) for _ in range(PAIRS)]
    ratios = {name: statistics.median(two[name] / one[name] for two, one in pairs) for name in ("iteration", *PHASES)}
    busy = os.getloadavg()[0] / (os.cpu_count() or 1)
    print(f"  2 ranks take {ratios.pop('iteration'):.2f} of the time of 1 (median of {PAIRS}; {busy:.1f} processes a processor "
          "meanwhile): " + ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items()))
    print(f"{'unknowns':>10} {'Newton':>8} {'Krylov':>8} {'us/unknown':>12} {'kB/unknown':>12}")
    growth = []
    for size in sizes:
        row = _run([size])
        growth.append(row)
        print(f"{row['unknowns']:>10} {row['newton'] / INCREMENTS:>8.1f} {row['krylov']:>8} "
              f"{row['iteration'] / row['unknowns'] * 1e6:>12.1f} {row['bytes'] / 1e3:>12.2f}", flush=True)
    file = Path(directory) / "fem-cost.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    draw(one, elasticity, growth).savefig(file, dpi=110)
    print(f"wrote {file}")


def draw(one: Measured, elasticity: Mapping[str, float], growth: Sequence[Measured]) -> Figure:
    """Draw the shares of the phases beside linear elasticity, and the growth of time and memory with the number of unknowns."""
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    bars, times, memory = figure.subplots(1, 3)
    bottom = 0.0
    for phase in PHASES:
        bars.bar("granumat", one[phase], bottom=bottom, label=phase)
        bottom += one[phase]
    for kind, seconds in elasticity.items():
        bars.bar(f"elasticity\n{kind.upper()}", seconds, color="0.6")
    bars.set_ylabel("processor seconds of a Newton iteration")
    bars.legend(frameon=False, fontsize="small")
    unknowns = [row["unknowns"] for row in growth]
    for phase in PHASES:
        times.loglog(unknowns, [row[phase] / row["unknowns"] * 1e6 for row in growth], "o-", label=phase)
    times.set_ylabel("µs of an iteration per unknown")
    memory.semilogx(unknowns, [row["bytes"] / 1e3 for row in growth], "ko-")
    memory.set_ylim(0)
    memory.set_ylabel("kB per unknown")
    for axes in (times, memory):
        axes.set_xlabel("unknowns")
        axes.grid(linewidth=0.3, which="both")
    return figure


if __name__ == "__main__":
    cells, *others = sys.argv[1:]
    result = measure_elasticity(int(cells), int(others[0]), others[1]) if others else measure(int(cells))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(result))
