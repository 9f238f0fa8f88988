"""What a Newton iteration of a finite-element problem costs.

Printed and drawn are the shares of material, coupling, assembly and linear solution, the ratio to an iteration of linear elasticity
in UFL, the ratio of two ranks to one, and the growth of time and memory with the number of unknowns, without and with a length.
Every measurement is a process of its own (`python3 -m granumat.studies.bench_fem N`, under mpirun for several ranks): memory is its
peak, time the processor's.
"""

import argparse
import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from matplotlib.figure import Figure
from mpi4py import MPI

from .. import core, tensors
from ..core import STATE
from ..errors import GranumatError
from ..fem.conditions import Displacement, Periodic
from ..fem.meshes import box
from ..fem.problem import Problem
from ..fem.system import ITERATIVE, make_solver
from ..files import check_writable
from ..material import Material

CELLS = 27                             # a side: 19 683 hexahedra
SIZES = (11, 17, 27, 39)               # cells a side, 5 184 to 192 000 unknowns, a third more with a length
LENGTH = 0.15                          # over the side
SHEAR = 0.005                          # of an increment
INCREMENTS = 2
REPEATS = 5
PAIRS = 3                              # of runs on one and on two ranks
PHASES = ("material", "coupling", "assembly", "solution")


def shear_cell(comm: MPI.Comm, n: int, **options: Any) -> Problem:
    """A cube of n**3 hexahedra with periodic sides in simple shear at constant volume.

    Fabric and shear stress are 0.3 of those of the steady state, the pressure is the law's, and the volume fraction varies in
    space. Options are further arguments of Problem.
    """
    material = Material(0.5, elastic_strain=1e-2)

    def state(x: np.ndarray) -> np.ndarray:
        states = np.full(len(x), material.steady(0.60), STATE)
        states["fabric"] *= 0.3
        states["stress"][:, 3:] *= 0.3
        states["stress"][:, :3] *= (tensors.trace(material.evaluate(states)[0]) / tensors.trace(states["stress"]))[:, None]
        states["volume_fraction"] += 0.005 * np.cos(2 * np.pi * x).prod(axis=1)
        return states

    def side(axis: int, end: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda x: np.isclose(x[axis], end)

    conditions = [Displacement(side(2, 0)), Displacement(side(2, 1), lambda x, t: np.array([SHEAR * t, 0, 0])),
                  Periodic(side(0, 1), lambda x: x - [1, 0, 0]), Periodic(side(1, 1), lambda x: x - [0, 1, 0])]
    return Problem(box(comm, (1, 1, 1), (n, n, n)), material, state, conditions, **options)


@contextlib.contextmanager
def _phases(problem: Problem) -> Iterator[dict[str, float]]:
    """Seconds of each of PHASES, complete at the end of the block; coupling is what is not material, assembly or solution."""
    seconds = dict.fromkeys(PHASES, 0.0)
    replaced = []

    def time_calls(owner: object, name: str, phase: str) -> None:
        action = getattr(owner, name)

        def timed(*arguments: Any, **options: Any) -> Any:
            start = time.process_time()
            try:
                return action(*arguments, **options)
            finally:
                seconds[phase] += time.process_time() - start
        setattr(owner, name, timed)
        replaced.append((owner, name, action))

    time_calls(Material, "update", "material")
    time_calls(Material, "update_with_tangent", "material")
    time_calls(core, "element_stiffness", "assembly")
    time_calls(problem.system, "assemble", "assembly")
    time_calls(problem.system, "solve_assembled", "solution")
    start = time.process_time()
    yield seconds
    seconds["coupling"] = time.process_time() - start - sum(seconds.values())
    for owner, name, action in replaced:
        setattr(owner, name, action)


def measure(n: int, length: float = 0.0, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, float]:
    """What the shear cell of n**3 cells costs, without a length or with one; the same on all ranks.

    Returns
    -------
    dict
        unknowns; newton, the iterations of all INCREMENTS; krylov, the iterations of each of these; the processor's seconds of a
        Newton iteration, of each of PHASES and in all ("iteration"), on the slowest rank; bytes per unknown.
    """
    problem = shear_cell(comm, 2, length=length)                                # what is imported or compiled once does not count
    problem.accept(problem.solve_increment(1.0))
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    problem = shear_cell(comm, n, length=length)
    problem.accept(problem.solve_increment(1.0))
    problem.system.solver.setConvergenceHistory(reset=False)
    newton = 0
    with _phases(problem) as seconds:
        for _ in range(INCREMENTS):
            trial = problem.solve_increment(1.0)
            newton += len(trial.residuals) - 1
            problem.accept(trial)
    bytes_used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - start
    krylov = len(problem.system.solver.getConvergenceHistory()) - newton           # each history begins with the right-hand side
    found = {"unknowns": problem.system.size, "newton": newton, "krylov": round(krylov / newton)}
    found |= {phase: comm.allreduce(value, MPI.MAX) / newton for phase, value in seconds.items()}
    return found | {"iteration": comm.allreduce(sum(seconds.values()), MPI.MAX) / newton,
                    "bytes": comm.allreduce(bytes_used) / problem.system.size}


def measure_elasticity(n: int, krylov: int, matrix_type: str) -> float:
    """The processor's seconds of residual, matrix and so many Krylov iterations of linear elasticity in UFL on the same mesh."""
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
        petsc.assemble_matrix(matrix, left, [held])                # type: ignore[arg-type]  # dispatched by type
        matrix.assemble()
        petsc.set_bc(residual, [held])
        solver.setOperators(matrix)
        solution = residual.duplicate()
        solver.solve(residual, solution)
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


def _run(arguments: Sequence[object], ranks: int = 1) -> Any:
    """What this module measures with command-line arguments, in a process of its own on each rank."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
                                "OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    command = [sys.executable, "-m", "granumat.studies.bench_fem", *map(str, arguments)]
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    result = subprocess.run(launcher + command, env=environment, capture_output=True, text=True)
    if result.returncode:
        raise GranumatError(f"{' '.join(command)}:\n{result.stderr}")
    return json.loads(result.stdout.splitlines()[-1])


def print_fem(directory: str | Path, n: int = CELLS, sizes: Sequence[int] = SIZES) -> None:
    """Prints the measurements and draws them into fem-cost.png in a directory, with n and with sizes cells a side."""
    check_writable(directory)                                      # it takes minutes until there is something to write
    one = _run([n])
    print(f"shear cell of {n**3} hexahedra, {one['unknowns']} unknowns: {one['newton'] / INCREMENTS:.1f} Newton iterations an "
          f"increment, {one['krylov']} Krylov iterations each, {one['iteration']:.2f} s of one processor a Newton iteration:")
    for phase in PHASES:
        print(f"  {phase:9} {one[phase] / one['iteration']:6.1%}")
    elasticity = {kind: _run([n, "--elasticity", one["krylov"], kind]) for kind in ("aij", "baij")}
    for kind, seconds in elasticity.items():
        print(f"  {one['iteration'] / seconds:.2f} x an iteration of linear elasticity in UFL into {kind.upper()}, as many Krylov "
              "iterations")
    for options, words in (((), ""), (("--length", LENGTH), "with a length ")):
        pairs = [(_run([n, *options], ranks=2), _run([n, *options])) for _ in range(PAIRS)]
        ratios = {name: statistics.median(two[name] / one[name] for two, one in pairs) for name in ("iteration", *PHASES)}
        busy = os.getloadavg()[0] / (os.cpu_count() or 1)
        print(f"  {words}2 ranks take {ratios.pop('iteration'):.2f} of the time of 1 (median of {PAIRS}; {busy:.1f} processes a "
              f"processor meanwhile), and {pairs[0][0]['krylov']} Krylov iterations for {pairs[0][1]['krylov']}: "
              + ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items()))
    print(f"{'length':>8} {'unknowns':>10} {'Newton':>8} {'Krylov':>8} {'us/unknown':>12} {'kB/unknown':>12} {'over none':>10}")
    growth = []
    for size in sizes:
        rows = [_run([size]), _run([size, "--length", LENGTH])]
        growth.append(rows[0])
        for length, row in zip((0, LENGTH), rows):
            print(f"{length:>8} {row['unknowns']:>10} {row['newton'] / INCREMENTS:>8.1f} {row['krylov']:>8} "
                  f"{row['iteration'] / row['unknowns'] * 1e6:>12.1f} {row['bytes'] / 1e3:>12.2f} "
                  f"{row['iteration'] / rows[0]['iteration']:>10.2f}", flush=True)
    file = Path(directory) / "fem-cost.png"
    draw(one, elasticity, growth).savefig(file, dpi=110)
    print(f"wrote {file}")


def draw(one: dict[str, float], elasticity: dict[str, float], growth: list[dict[str, float]]) -> Figure:
    """The phases beside linear elasticity, by matrix type, and time and memory against the number of unknowns."""
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
    parser = argparse.ArgumentParser(description="measures one shear cell, and prints what was found as JSON")
    parser.add_argument("cells", type=int, help="a side")
    parser.add_argument("--length", type=float, default=0.0, help="over the side")
    parser.add_argument("--elasticity", nargs=2, metavar=("KRYLOV", "TYPE"), help="of linear elasticity in UFL instead")
    asked = parser.parse_args()
    result = (measure_elasticity(asked.cells, int(asked.elasticity[0]), asked.elasticity[1]) if asked.elasticity
              else measure(asked.cells, asked.length))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(result))
