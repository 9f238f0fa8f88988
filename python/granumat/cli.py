"""The command `granumat`, the same as `python3 -m granumat`."""

import argparse
import logging
import sys
import time
import traceback
import warnings
from pathlib import Path

from . import __version__, driver
from .errors import GranumatError
from .paths import read_path_file
from .studies.cases import CASES

PATIENCE = 5.0                      # seconds that a rank with an error waits for the others to have it too
SAID_ON_SCREEN = ("gamma", "phi", "p", "stress_ratio", "Z2", "A_xz")


def main(arguments=None):
    """Runs the command; returns its exit status: 0, 1 for a failed computation, 2 for a mistake in what was asked."""
    parser = argparse.ArgumentParser(prog="granumat", description="Rate-independent granular materials with evolving "
                                     "microstructure, after Sun & Sundaresan (2011).")
    parser.set_defaults(quiet=False)
    parser.add_argument("--version", action="version", version=f"granumat {__version__}")
    commands = parser.add_subparsers(required=True)

    def command(name, run, words):
        added = commands.add_parser(name, help=words, description=words)
        added.set_defaults(run=run)
        if run is not run_bench:
            added.add_argument("--out", type=Path, required=True, help="directory for what is written")
        return added

    command("point", run_point, "run a path file at one material point").add_argument(
        "path", type=Path, help="the path, a TOML file")
    solve = command("solve", run_solve, "run a scene file: a boundary-value problem on a mesh; under mpirun on several ranks")
    solve.add_argument("scene", type=Path, help="the scene, a TOML file")
    solve.add_argument("--resume", action="store_true", help="go on from the checkpoint in the directory")
    command("figures", run_figures, "draw the model's curves of the paper's figures").add_argument(
        "names", nargs="*", help="numbers of figures, such as 1 10; all if none is given")
    command("chart", run_chart, "measure and draw speed against accuracy of the update and its alternatives").add_argument(
        "names", nargs="*", metavar="CASE", help=f"from {', '.join(CASES)}; all if none is given")
    command("stability", run_stability, "map how large an increment each integration method stands")
    command("wellposed", run_wellposed, "where each closure loses ellipticity after a reversal")
    command("bench", run_bench, "time the core: batch, tangent, threads, and paths beside SciPy's solvers").add_argument(
        "--fem", type=Path, nargs="?", const=Path(), metavar="DIR",
        help="time a finite-element problem instead, and draw it into DIR (.)")
    options = parser.parse_args(arguments)
    warnings.showwarning = lambda message, category, *_: print(f"granumat: warning: {message}", file=sys.stderr)
    try:
        options.run(options)
    except (ValueError, OSError, ImportError, GranumatError) as error:
        if not options.quiet:
            print(f"granumat: {error}", file=sys.stderr)
        return 1 if isinstance(error, GranumatError) else 2
    return 0


def run_point(options):
    from .plotting import history_figure
    path = read_path_file(options.path)
    progress = driver.Progress(path.steps, sys.stderr)
    try:
        history = driver.run(path.material, path.state, path.steps, options.out, path.tolerance, progress, path.acoustic)
    except GranumatError:
        print(f"granumat: what was computed is in {options.out / 'history.csv'}, "
              f"the failing increment in {options.out / 'failing.toml'}", file=sys.stderr)
        raise
    history_figure(history, options.path.stem).savefig(options.out / "history.png", dpi=130)
    print(f"{'step':>5} " + " ".join(f"{name:>12}" for name in SAID_ON_SCREEN))
    for row in [0, *((history["step"][:-1] != history["step"][1:]).nonzero()[0][1:]), len(history) - 1]:
        print(f"{history['step'][row]:>5} " + " ".join(f"{history[name][row]:>12.6g}" for name in SAID_ON_SCREEN))
    print(f"wrote {options.out / 'history.csv'}\nwrote {options.out / 'history.png'}")


def run_solve(options):
    try:
        from mpi4py import MPI

        from .fem import scene
    except ImportError as error:
        raise ImportError(f"granumat solve needs DOLFINx (Debian: python3-dolfinx): {error}") from None
    logging.captureWarnings(False)                               # DOLFINx's compiler has taken them for its log
    options.quiet = MPI.COMM_WORLD.rank > 0
    apart = MPI.COMM_WORLD.Dup()
    try:
        problem, written = scene.solve(options.scene, options.out, options.resume, progress=sys.stderr)
    except BaseException as error:
        expected = isinstance(error, (ValueError, OSError, ImportError, GranumatError))
        if not (expected and _all_come_here(apart)):
            traceback.print_exc()
            MPI.COMM_WORLD.Abort(1)                              # or the other ranks wait for ever
        raise
    if not options.quiet:
        print(f"t = {problem.t:g} after {problem.increments} increments", *(f"wrote {path}" for path in written), sep="\n")


def _all_come_here(comm):
    """Whether all ranks do within a few seconds."""
    request, end = comm.Ibarrier(), time.monotonic() + PATIENCE
    while not (come := request.Test()) and time.monotonic() < end:
        time.sleep(0.01)
    return come


def run_figures(options):
    from .studies.figures import draw_figures
    for path in draw_figures(options.out, options.names or None):
        print(f"wrote {path}")


def run_stability(options):
    from .studies.stability import write_stability
    for path in write_stability(options.out):
        print(f"wrote {path}")


def run_chart(options):
    from .studies.chart import draw_chart, summary
    print("\n" + summary(draw_chart(options.out, options.names)))


def run_bench(options):
    if options.fem:
        from .studies.bench_fem import print_fem
        print_fem(options.fem)
    else:
        from .studies.bench import print_ratios
        print_ratios()


def run_wellposed(options):
    from .studies.wellposed import losses_in_words, write_study
    curves, paths = write_study(options.out)
    print(losses_in_words(curves))
    for path in paths:
        print(f"wrote {path}")
