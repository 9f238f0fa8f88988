"""The command `granumat`, the same as `python3 -m granumat`."""

import argparse
import sys
import warnings
from pathlib import Path

from . import __version__, driver
from .errors import GranumatError
from .paths import read_path_file
from .scenes import SCENES

SAID_ON_SCREEN = ("gamma", "phi", "p", "stress_ratio", "Z2", "A_xz")


def main(arguments=None):
    """Runs the command; returns its exit status: 0, 1 for a failed computation, 2 for a mistake in what was asked."""
    parser = argparse.ArgumentParser(prog="granumat", description="Rate-independent granular materials with evolving "
                                     "microstructure, after Sun & Sundaresan (2011).")
    parser.add_argument("--version", action="version", version=f"granumat {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    point = commands.add_parser("point", help="run a path file at one material point")
    point.add_argument("path", type=Path, help="the path, a TOML file")
    figures = commands.add_parser("figures", help="draw the model's curves of the paper's figures")
    figures.add_argument("names", nargs="*", help="numbers of figures, such as 1 10; all if none is given")
    chart = commands.add_parser("chart", help="measure and draw speed against accuracy of the update and its alternatives")
    chart.add_argument("names", nargs="*", metavar="SCENE", help=f"from {', '.join(SCENES)}; all if none is given")
    commands.add_parser("bench", help="time paths against SciPy's solvers at equal error")
    for command in (point, figures, chart):
        command.add_argument("--out", type=Path, required=True, help="directory for what is written")
    options = parser.parse_args(arguments)
    warnings.showwarning = lambda message, category, *_: print(f"granumat: warning: {message}", file=sys.stderr)
    try:
        {"point": run_point, "figures": run_figures, "chart": run_chart, "bench": run_bench}[options.command](options)
    except (ValueError, OSError, ImportError) as error:
        print(f"granumat: {error}", file=sys.stderr)
        return 2
    except GranumatError as error:
        print(f"granumat: {error}", file=sys.stderr)
        return 1
    return 0


def run_point(options):
    from .plotting import history_figure
    path = read_path_file(options.path)
    progress = driver.Progress(path.steps, sys.stderr)
    try:
        history = driver.run(path.material, path.state, path.steps, options.out, path.tolerance, progress)
    except GranumatError:
        print(f"granumat: what was computed is in {options.out / 'history.csv'}, "
              f"the failing increment in {options.out / 'failing.toml'}", file=sys.stderr)
        raise
    history_figure(history, options.path.stem).savefig(options.out / "history.png", dpi=130)
    print(f"{'step':>5} " + " ".join(f"{name:>12}" for name in SAID_ON_SCREEN))
    for row in [0, *((history["step"][:-1] != history["step"][1:]).nonzero()[0][1:]), len(history) - 1]:
        print(f"{history['step'][row]:>5} " + " ".join(f"{history[name][row]:>12.6g}" for name in SAID_ON_SCREEN))
    print(f"wrote {options.out / 'history.csv'}\nwrote {options.out / 'history.png'}")


def run_figures(options):
    from .figures import draw_figures
    for path in draw_figures(options.out, options.names or None):
        print(f"wrote {path}")


def run_chart(options):
    from .chart import draw_chart, summary
    print("\n" + summary(draw_chart(options.out, options.names)))


def run_bench(options):
    from .bench import print_ratios
    print_ratios()
