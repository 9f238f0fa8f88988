"""The command `granumat`, the same as `python3 -m granumat`."""

import argparse
import logging
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO, TypeVar

from . import __version__, driver, installed, quantities
from .errors import GranumatError, InterruptedRunError
from .files import clear, locked, replacing
from .paths import read_path_file
from .studies.cases import CASES

T = TypeVar("T")

PATIENCE = 5.0                      # seconds that a rank with an error waits for the others to meet the same error
EXPECTED = (ValueError, OSError, ImportError, MemoryError, GranumatError)     # errors with words for the user
OVERWRITE = "remove what an earlier run has left in the directory"
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK")       # in the environment of what mpirun or srun has started
PRINTED = ("gamma", "phi", "p", "stress_ratio", "Z2", "A_xz")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, optional
        The default is what the command line says.

    Returns
    -------
    int
        Exit status: 0, 1 for a failed computation, 2 for a mistake in what was asked.
    """
    options = _parser().parse_args(arguments)
    warnings.showwarning = _show_warning
    try:
        options.run(options)
    except EXPECTED as error:
        if not options.quiet:
            print(f"granumat: {error}", file=sys.stderr)
        return 1 if isinstance(error, GranumatError) else 2
    except KeyboardInterrupt:                                    # where there was nothing yet to keep
        print("granumat: interrupted", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="granumat", description="Rate-independent granular materials with evolving "
                                     "microstructure, after Sun & Sundaresan (2011).")
    parser.set_defaults(quiet=False)
    parser.add_argument("--version", action="version", version=f"granumat {__version__}")
    commands = parser.add_subparsers(required=True)

    def command(name: str, run: Callable[[argparse.Namespace], None], words: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=words, description=words)
        added.set_defaults(run=run)
        if run not in (run_bench, run_umat):
            added.add_argument("--out", type=Path, required=True, help="directory for what is written")
        return added

    point = command("point", run_point, "run a path file at one material point")
    point.add_argument("path", type=Path, help="the path, a TOML file")
    point.add_argument("--overwrite", action="store_true", help=OVERWRITE)
    solve = command("solve", run_solve, "run a scene file: a boundary-value problem on a mesh; under mpirun on several ranks")
    solve.add_argument("scene", type=Path, help="the scene, a TOML file")
    way = solve.add_mutually_exclusive_group()
    way.add_argument("--resume", action="store_true", help="go on from the checkpoint in the directory")
    way.add_argument("--overwrite", action="store_true", help=OVERWRITE)
    ladder = command("ladder", run_ladder, "find the cheapest model that will do for a path or a scene, on all ranks of mpirun")
    ladder.add_argument("file", type=Path, help="the path or scene with its quantities of interest, a TOML file")
    ladder.add_argument("--tolerance", type=float, required=True,
                        help="error that is allowed, relative to the scale of each quantity that has no tolerance of its own")
    ladder.add_argument("--budget", type=int, help="most runs that there may be")
    command("figures", run_figures, "draw the model's curves of the paper's figures").add_argument(
        "names", nargs="*", help="numbers of figures, such as 1 10; all if none is given")
    command("chart", run_chart, "measure and draw speed against accuracy of the update and its alternatives").add_argument(
        "names", nargs="*", metavar="CASE", help=f"from {', '.join(CASES)}; all if none is given")
    command("stability", run_stability, "map how large an increment each integration method stands")
    command("wellposed", run_wellposed, "where each closure loses ellipticity after a reversal")
    bench = command("bench", run_bench, "time the core: batch, tangent, threads, and paths beside SciPy's solvers")
    kind = bench.add_mutually_exclusive_group()
    kind.add_argument("--fem", type=Path, nargs="?", const=Path(), metavar="DIR",
                      help="time a finite-element problem instead, and draw it into DIR (.)")
    kind.add_argument("--quick", action="store_true",
                      help="all tables from few, small measurements in a minute at most; ratios are rough")
    which = command("umat", run_umat, "where the files for other codes are, all or one").add_mutually_exclusive_group()
    for name, (_, words) in installed.FILES.items():
        which.add_argument(f"--{name}", dest="name", action="store_const", const=name, help=words)
    return parser


def _show_warning(message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
                  line: str | None = None) -> None:
    print(f"granumat: warning: {message}", file=sys.stderr)


def _say_written(filenames: Iterable[Path]) -> None:
    for filename in filenames:
        print(f"wrote {filename}")


def run_point(options: argparse.Namespace) -> None:
    """Run `granumat point`: history.csv, history.png, and the ends of the steps on screen."""
    from .plotting import history_figure
    if _is_idle_rank(options):
        return
    path = read_path_file(options.path)
    with locked(options.out):
        clear(options.out, options.overwrite, "give --overwrite to replace it, or another directory")
        progress = driver.Progress(path.steps, sys.stderr)
        try:
            history = driver.run(path.material, path.state, path.steps, options.out, path.tolerance, progress, path.acoustic,
                                 path.quantities)
        except InterruptedRunError as error:
            raise InterruptedRunError(f"{error}; what was computed is in {options.out / 'history.csv'}, "
                                      "--overwrite runs the path from its start") from None
        except GranumatError:
            print(f"granumat: what was computed is in {options.out / 'history.csv'}, "
                  f"the failing increment in {options.out / 'failing.toml'}", file=sys.stderr)
            raise
        with replacing(options.out / "history.png") as picture:
            history_figure(history, options.path.stem).savefig(picture, dpi=130, format="png")
    print(f"{'step':>5} " + " ".join(f"{name:>12}" for name in PRINTED))
    for row in [0, *((history["step"][:-1] != history["step"][1:]).nonzero()[0][1:]), len(history) - 1]:
        print(f"{history['step'][row]:>5} " + " ".join(f"{history[name][row]:>12.6g}" for name in PRINTED))
    written = ["history.csv", "history.png", *([quantities.QUANTITIES_FILE] if path.quantities else [])]
    _say_written(options.out / name for name in written)


def run_solve(options: argparse.Namespace) -> None:
    """Run `granumat solve`; the first rank speaks for all."""
    from .fem import scene
    problem, written = _on_all_ranks(options, lambda: scene.solve(
        options.scene, options.out, options.resume, options.overwrite, progress=sys.stderr))
    if not options.quiet:
        print(f"t = {problem.t:g} after {problem.increments} increments")
        _say_written(written)


def run_ladder(options: argparse.Namespace) -> None:
    """Run `granumat ladder`; what is there of an earlier climb in the directory is used."""
    from . import ladder

    def climb() -> ladder.Report:
        return ladder.climb(options.file, options.tolerance, options.out, options.budget, progress=sys.stderr)
    if ladder.is_scene(options.file):
        from . import fem  # noqa: F401 - fails in words where DOLFINx is missing
        _on_all_ranks(options, climb)
    elif not _is_idle_rank(options):
        climb()
    if not options.quiet:
        print((options.out / "ladder.txt").read_text(encoding="utf-8"))
        _say_written(options.out / name for name in ladder.FILES)


def _is_idle_rank(options: argparse.Namespace) -> bool:
    """Whether this is a rank of mpirun to which a path, which has one point, gives nothing to do."""
    if not any(name in os.environ for name in RANK_VARIABLES):
        return False
    try:
        from mpi4py import MPI
    except ImportError:
        return False
    options.quiet = MPI.COMM_WORLD.rank > 0
    return bool(options.quiet)


def _on_all_ranks(options: argparse.Namespace, action: Callable[[], T]) -> T:
    """What an action gives in which all ranks take part; where only some of them fail, all end."""
    from mpi4py import MPI
    logging.captureWarnings(False)                               # DOLFINx's compiler sends them to its log
    options.quiet = MPI.COMM_WORLD.rank > 0
    comm = MPI.COMM_WORLD.Dup()                                  # errors may leave messages on the other
    try:
        return action()
    except BaseException as error:
        if not (isinstance(error, EXPECTED) and _all_ranks_come(comm)):
            traceback.print_exc()
            MPI.COMM_WORLD.Abort(1)                              # or the other ranks would wait for ever
        raise


def _all_ranks_come(comm: Any) -> bool:
    """Whether all ranks call this within PATIENCE."""
    request, end = comm.Ibarrier(), time.monotonic() + PATIENCE
    while not (come := request.Test()) and time.monotonic() < end:
        time.sleep(0.01)
    return come


def run_figures(options: argparse.Namespace) -> None:
    """Run `granumat figures`."""
    from .studies.figures import draw_figures
    _say_written(draw_figures(options.out, options.names or None))


def run_stability(options: argparse.Namespace) -> None:
    """Run `granumat stability`."""
    from .studies.stability import write_stability
    _say_written(write_stability(options.out))


def run_chart(options: argparse.Namespace) -> None:
    """Run `granumat chart`."""
    from .studies.chart import draw_chart, summary
    print("\n" + summary(draw_chart(options.out, options.names)))


def run_bench(options: argparse.Namespace) -> None:
    """Run `granumat bench`."""
    if options.fem:
        from .studies.bench_fem import print_fem
        print_fem(options.fem)
    else:
        from .studies.bench import print_ratios
        print_ratios(options.quick)


def run_umat(options: argparse.Namespace) -> None:
    """Run `granumat umat`."""
    if options.name:
        print(installed.find(options.name))
    else:
        for name in installed.FILES:
            print(f"{name:10} {installed.find(name)}")


def run_wellposed(options: argparse.Namespace) -> None:
    """Run `granumat wellposed`: files, and the table on screen."""
    from .studies.wellposed import losses_in_words, write_study
    curves, filenames = write_study(options.out)
    print(losses_in_words(curves))
    _say_written(filenames)
