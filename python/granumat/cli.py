"""The command `granumat`, the same as `python3 -m granumat`."""

import argparse
import contextlib
import io
import itertools
import logging
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO, TypeVar

from . import __version__, driver, examples, installed, quantities, summaries
from .calibrations import is_calibration_file
from .checks import choose, refuse, repetitions
from .completion import SHELLS, completion_script
from .errors import GranumatError, InterruptedRunError
from .files import clear, locked, replacing
from .grains import ALL, GROUPS, KEYS
from .grains.measured import key_file, run_of
from .paths import read_path_file
from .studies.cases import CASES

T = TypeVar("T")

PATIENCE = 5.0                      # seconds that a rank with an error waits for the others to meet the same error
EXPECTED = (ValueError, OSError, ImportError, MemoryError, GranumatError)     # errors with words for the user
OVERWRITE = "remove what an earlier run has left in the directory"
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK")       # in the environment of what mpirun or srun has started
PRINTED = {                         # columns on screen, by the kind of test
    "shear": ("gamma", "phi", "p", "stress_ratio", "Z2", "A_xz"),
    "shear under a normal load": ("gamma", "phi", "p", "tau_over_sigma_n", "Z2", "A_xz"),
    "axial": ("e_zz", "phi", "p", "q", "q_over_p", "Z2"),
    "isotropic": ("volume_strain", "phi", "p", "Z2"),
    "other": ("gamma_total", "phi", "p", "q", "q_over_p", "Z2"),
}


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
        with contextlib.redirect_stdout(io.StringIO()) if options.json else contextlib.nullcontext():
            result = options.run(options)
        if options.json and not options.quiet:
            print(summaries.to_json(result))
        sys.stdout.flush()
    except BrokenPipeError:                                      # what reads the output has enough, as `head` has
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except EXPECTED as error:
        if not options.quiet:
            print(f"granumat: {error}", file=sys.stderr)
            if options.json:
                print(summaries.to_json(summaries.of_error(error)))
        return 1 if isinstance(error, GranumatError) else 2
    except KeyboardInterrupt:                                    # where there was nothing yet to keep
        print("granumat: interrupted", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="granumat", description="Rate-independent granular materials with evolving "
                                     "microstructure, after Sun & Sundaresan (2011).")
    parser.set_defaults(quiet=False, json=False)
    parser.add_argument("--version", action="version", version=f"granumat {__version__}")
    commands = parser.add_subparsers(required=True)

    def command(name: str, run: Callable[[argparse.Namespace], Any], words: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=words, description=words)
        added.set_defaults(run=run)
        if run not in (run_bench, run_calibrate, run_check, run_completion, run_example, run_umat):
            added.add_argument("--out", type=Path, required=True, help="directory for what is written")
        if run in (run_point, run_solve, run_ladder, run_check, run_compare, run_calibrate):
            added.add_argument("--json", action="store_true", help="print the result, or the error, as JSON instead of words")
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
    command("check", run_check, "say everything that is wrong with a path or scene file, and run nothing").add_argument(
        "file", type=Path, help="the path or scene, a TOML file")
    compare = command("compare", run_compare, "set the law beside measured histories of simple shear, and score it")
    compare.add_argument("data", type=Path, nargs="+", metavar="DATA", help="tables of the histories, CSV files; _s<number>.csv "
                         "are seeds of one run")
    compare.add_argument("--material", type=Path, action="append", default=[], metavar="FILE",
                         help="a TOML file whose [material] is compared beside the printed law; can be given several times")
    calibrate = command("calibrate", run_calibrate, "fit constants of the law to measured histories of simple shear")
    calibrate.add_argument("data", type=Path, nargs="+", metavar="DATA", help="tables of the histories, as for compare")
    calibrate.add_argument("--out", type=Path, required=True, metavar="NAME.toml",
                           help='the calibration file, for calibration = "NAME.toml"; an old one is replaced')
    calibrate.add_argument("--fit", default=ALL, metavar="NAME,NAME...",
                           help=f"constants to be fitted, or groups of them: {', '.join((ALL, *GROUPS))}; the default is {ALL}")
    calibrate.add_argument("--closure", action="append", metavar="NAME",
                           help="that is fitted, full if none is given; several times for several, each by itself")
    calibrate.add_argument("--calibration", default="table-1", metavar="NAME",
                           help="where constants start, and what those are that are not fitted: as in [material]")
    for user, (name, key) in itertools.product((compare, calibrate), KEYS.items()):
        user.add_argument(f"--{name}", type=key.kind, help=f"of all runs: {key.words}; {key.must_be}")
    example = command("example", run_example, "print a path or scene file to start from; without a name, list them")
    example.add_argument("name", nargs="?", help="of the example")
    example.set_defaults(completes=examples.example_files())
    command("figures", run_figures, "draw the paper's figures: the model and discrete-element runs").add_argument(
        "names", nargs="*", help="numbers of figures, such as 1 10; all if none is given")
    chart = command("chart", run_chart, "measure and draw speed against accuracy of the update and its alternatives")
    chart.add_argument("names", nargs="*", metavar="CASE", help=f"from {', '.join(CASES)}; all if none is given")
    chart.set_defaults(completes=CASES)
    command("stability", run_stability, "map how large an increment each integration method stands")
    command("wellposed", run_wellposed, "where each closure loses ellipticity after a reversal, and what a length changes")
    bench = command("bench", run_bench, "time the core: batch, tangent, threads, and paths beside SciPy's solvers")
    kind = bench.add_mutually_exclusive_group()
    kind.add_argument("--fem", type=Path, nargs="?", const=Path(), metavar="DIR",
                      help="time a finite-element problem instead, and draw it into DIR (.)")
    kind.add_argument("--quick", action="store_true",
                      help="all tables from few, small measurements in a minute at most; ratios are rough")
    which = command("umat", run_umat, "where the files for other codes are, all or one").add_mutually_exclusive_group()
    for name, (_, words) in installed.FILES.items():
        which.add_argument(f"--{name}", dest="name", action="store_const", const=name, help=words)
    completion = command("completion", run_completion, "print the script that makes a shell complete this command")
    completion.add_argument("shell", choices=SHELLS)
    completion.set_defaults(completes=SHELLS, commands=commands.choices)
    return parser


def _show_warning(message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
                  line: str | None = None) -> None:
    print(f"granumat: warning: {message}", file=sys.stderr)


def _say_written(filenames: Iterable[Path]) -> None:
    for filename in filenames:
        print(f"wrote {filename}")


def run_point(options: argparse.Namespace) -> dict[str, Any]:
    """Run `granumat point`: history.csv, history.png, and the ends of the steps on screen."""
    from .plotting import history_figure, kind_of
    if _is_idle_rank(options):
        return {}
    path = read_path_file(options.path)
    with locked(options.out):
        clear(options.out, options.overwrite, "give --overwrite to replace it, or another directory")
        try:
            history = driver.run(path.material, path.state, path.steps, options.out, path.tolerance, sys.stderr, path.acoustic,
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
    printed = PRINTED[kind_of(history)]
    print(f"{'step':>5} " + " ".join(f"{name:>12}" for name in printed))
    for row in [0, *((history["step"][:-1] != history["step"][1:]).nonzero()[0][1:]), len(history) - 1]:
        print(f"{history['step'][row]:>5} " + " ".join(f"{history[name][row]:>{max(12, len(name))}.6g}" for name in printed))
    names = ["history.csv", "history.png", *([quantities.QUANTITIES_FILE] if path.quantities else [])]
    written = [options.out / name for name in names]
    _say_written(written)
    return {"files": written} | summaries.of_history(history, path.quantities)


def run_solve(options: argparse.Namespace) -> dict[str, Any]:
    """Run `granumat solve`; the first rank speaks for all."""
    from .fem import scene

    def solve() -> Any:
        asked = scene.read_scene(options.scene).quantities if options.json else []       # before a run in which the file may change
        return asked, *scene.solve(options.scene, options.out, options.resume, options.overwrite, progress=sys.stderr)
    asked, problem, written = _on_all_ranks(options, solve)
    if options.quiet:
        return {}
    print(f"t = {problem.t:g} after {problem.increments} increments")
    _say_written(written)
    values = summaries.of_quantities(options.out / quantities.QUANTITIES_FILE, asked)
    return {"files": written, "t": problem.t, "increments": problem.increments, "quantities": values}


def run_ladder(options: argparse.Namespace) -> dict[str, Any]:
    """Run `granumat ladder`; what is there of an earlier climb in the directory is used."""
    from . import ladder

    def climb() -> ladder.Report:
        return ladder.climb(options.file, options.tolerance, options.out, options.budget, progress=sys.stderr)
    if ladder.is_scene(options.file):
        from . import fem  # noqa: F401 - fails in words where DOLFINx is missing
        report = _on_all_ranks(options, climb)
    elif _is_idle_rank(options):
        return {}
    else:
        report = climb()
    written = [options.out / name for name in ladder.FILES]
    if not options.quiet:
        print((options.out / "ladder.txt").read_text(encoding="utf-8"))
        _say_written(written)
    return {"files": written} | summaries.of_report(report)


def run_check(options: argparse.Namespace) -> dict[str, Any]:
    """Run `granumat check`."""
    from . import ladder, preview

    def look() -> dict[str, Any]:
        return preview.preview(options.file)
    if ladder.is_scene(options.file):
        from . import fem  # noqa: F401 - fails in words where DOLFINx is missing
        found = _on_all_ranks(options, look)
    elif _is_idle_rank(options):
        return {}
    else:
        found = look()
    if not options.quiet:
        print(f"{options.file} can be run: {preview.in_words(found)}")
    return found


def run_compare(options: argparse.Namespace) -> dict[str, Any]:
    """Run `granumat compare`: the scores on screen and in a table, and a table and a picture of each run."""
    from . import grains
    if _is_idle_rank(options):
        return {}
    keys = {name: getattr(options, name) for name in KEYS if getattr(options, name) is not None}
    refuse("the law cannot be compared", repetitions("name of a file with --material", [file.stem for file in options.material]))
    comparison = grains.compare(options.data, {file.stem: grains.read_model(file) for file in options.material}, **keys)
    with locked(options.out):
        written = comparison.write(options.out)
    print(comparison)
    _say_written(written)
    return {"files": written} | summaries.of_comparison(comparison)


def run_calibrate(options: argparse.Namespace) -> dict[str, Any]:
    """Run `granumat calibrate`: the calibration file, and what was found on screen."""
    from . import grains
    if _is_idle_rank(options):
        return {}
    if not is_calibration_file(options.out.name) or not options.out.absolute().parent.is_dir():
        raise ValueError(f"--out {options.out}: must be a file that ends in .toml, in a directory that is there")
    if options.out.absolute() in [key_file(run_of(table)).absolute() for table in options.data]:
        raise ValueError(f"--out {options.out}: is the file that says what the data beside it are; give another name")
    keys = {name: getattr(options, name) for name in KEYS if getattr(options, name) is not None}
    names, closures = options.fit.split(","), options.closure or ["full"]
    found = grains.calibrate(options.data, names, closures, options.calibration, sys.stderr, **keys)
    written = options.out.with_suffix(".partial.toml") if found.interrupted else options.out
    found.write(written)
    if found.interrupted:
        raise InterruptedRunError(f"{found.interrupted} has ended the calibration; the constants so far are in {written}, "
                                  f"--calibration {written} goes on from there")
    print(found)
    _say_written([written])
    return {"files": [written]} | summaries.of_calibration(found)


def run_example(options: argparse.Namespace) -> None:
    """Run `granumat example`."""
    files = examples.example_files()
    if options.name is None:
        width = max(map(len, files))
        for name, file in files.items():
            print(f"{name:{width}}  {examples.first_words(file)}")
    else:
        faults: list[str] = []
        choose("example", options.name, list(files), faults)
        refuse("there is no such file", faults)
        print(files[options.name].read_text(encoding="utf-8"), end="")


def run_completion(options: argparse.Namespace) -> None:
    """Run `granumat completion`."""
    print(completion_script(options.commands, options.shell), end="")


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
        interrupted = isinstance(error, KeyboardInterrupt)
        if not (interrupted and comm.size == 1) and not (isinstance(error, EXPECTED) and _all_ranks_come(comm)):
            if not interrupted:
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
    print("\n" + summary(draw_chart(options.out, options.names, sys.stdout)))


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
    from .studies import growth, wellposed
    curves, filenames = wellposed.write_study(options.out)
    print(wellposed.losses_in_words(curves))
    maps, more = growth.write_study(options.out)
    print("\n" + growth.growth_in_words(maps))
    _say_written(filenames + more)
