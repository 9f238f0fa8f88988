# %% [markdown]
# # What every path and scene of the demos needs, and whether the ladder tells the truth
#
# `granumat ladder` is given each file at several tolerances. What it recommends is compared with a run of its own, on a mesh and in
# increments that are finer than any that the ladder has used: the true error, against the predicted one. Last, the times of the
# models beside each other, and of plane strain beside three dimensions.

# %%
import sys
from pathlib import Path

import fields
import numpy as np
from matplotlib.figure import Figure

from granumat import coarsen, estimate, ladder
from granumat.fem.ladder import SceneRunner
from granumat.runs import PointRunner, Runs
from granumat.toml import read_toml

DEMOS = Path(__file__).parent
TOLERANCES = (0.1, 0.05, 0.02, 0.01)
SHOWN = 0.05                        # the tolerance of the tables
PATHS = ("reversal", "reversal-pressure", "oscillation", "start-up", "compression", "triaxial", "undrained-cycles")
SCENES = {                          # the meshes of the true solutions; none where the shear localises
    "annulus": {"sector": True, "cells": [96, 480]},
    "shear-box": {"layer": True, "cells": [64, 64]},
    "homogeneous-shear": {"layer": True, "plane": True, "cells": [16, 4, 16]},
    "direct-shear": {"cells": [108, 36]},
    "platen-gravity": {"layer": True, "cells": [128, 128]},
    "biaxial-block": None,
    "biaxial-block-rate": {"cells": [48, 96]},
    "biaxial-block-length": {"cells": [96, 192]},
    "ring-shear-3d": {"sector": True, "cells": [20, 320, 18]},
}
REPETITIONS = 3                     # of the runs whose times are compared
COARSER = "4 times the file's"      # their increments
FINER = 4                           # increments of the true solutions, of one of the file's
ROUND_OFF = 1e-5                    # errors below are round-off and what Newton's tolerance leaves
SHORT = {"paths": ("reversal", "start-up"), "scenes": (), "tolerances": (0.05,)}


# %%
def true_path(content):
    steps = [step | {"increments": FINER * step.get("increments", 200)} for step in content["step"] if "pause" not in step]
    return content | {"tolerance": 1e-9, "step": [step if "pause" in step else steps.pop(0) for step in content["step"]]}


def true_scene(content, mesh):
    run = content["run"] | {"increment": content["run"]["increment"] / FINER}
    return content | {"mesh": content["mesh"] | mesh, "run": run}


def study(file, mesh, tolerances, out):
    """Rows of tolerance, report, true errors (quantities); `mesh` is that of the true solution, True for a path, None for none."""
    content, is_path = read_toml(file), mesh is True
    runner = PointRunner(file) if is_path else SceneRunner(file)
    truth = None
    if mesh is not None:
        truth = Runs(runner, out / "truth", progress=sys.stderr).get(
            true_path(content) if is_path else true_scene(content, mesh), "true solution")
    rows = []
    for tolerance in tolerances:
        report = ladder.climb(file, tolerance, out, runner=runner, progress=sys.stderr)
        rows.append((tolerance, report, None if truth is None else estimate.errors(report.recommended, truth, runner.quantities)))
    return rows


def main(paths=PATHS, scenes=tuple(SCENES), tolerances=TOLERANCES, out="results/ladder"):
    found = {}
    for name in paths:
        found[name] = study(DEMOS / f"paths/{name}.toml", True, tolerances, Path(out) / name)
    for name in scenes:
        found[name] = study(DEMOS / f"scenes/{name}.toml", SCENES[name], tolerances, Path(out) / name)
    print_table({name: found[name] for name in paths}, "paths")
    print_table({name: found[name] for name in scenes}, "scenes")
    pairs = summary(found)
    fields.save(picture(found), out, "ladder")
    print_costs(scenes, Path(out) / "costs")
    return pairs


# %%
def print_table(found, folder):
    """What is recommended at the tolerance SHOWN, where it is not as in the file, in Markdown."""
    print("\n| file | recommended | predicted | proved | true | times as fast | runs; in runs of the file |")
    print("|---|---|---|---|---|---|---|")
    for name, rows in found.items():
        content = read_toml(DEMOS / f"{folder}/{name}.toml")
        for tolerance, report, true in rows:
            if tolerance == SHOWN:
                words = [rung.name if axis in ("dimension", "mesh") else f"{axis} {rung.name}" for axis, rung in
                         ((axis, finding.rung) for axis, finding in report.choice.items()) if rung.change(content) != content]
                errors = " | ".join("-" if each is None else ", ".join(f"{error:.2%}" for error in each)
                                    for each in (report.predicted, report.measured + report.of_top, true))
                print(f"| {name} | {'; '.join(words)}{'' if report.is_proved else '; **not proved**'} | {errors} | "
                      f"{report.file.seconds / report.recommended.seconds:.3g} | "
                      f"{report.runs}; {report.seconds / report.file.seconds:.3g} |")


def summary(found):
    """Predicted and true error of the worst quantity (largest over its tolerance), and whether they are proved, in columns."""
    pairs = []
    for rows in found.values():
        for tolerance, report, true in rows:
            if true is not None:
                worst = np.argmax(true)
                pairs.append((tolerance, report.predicted[worst], true[worst], report.is_proved))
    tolerance, predicted, true, proved = np.array(pairs, float).T
    ratio = (predicted / true)[true > ROUND_OFF]
    print(f"\n{true.size} pairs, in {true.size - ratio.size} of them the true error is round-off. In the other {ratio.size} it is "
          f"below the predicted one in {sum(ratio >= 1)}, within a factor of 2 of it in {sum((ratio >= 0.5) & (ratio <= 2))}, "
          f"and more than twice as large in {sum(ratio < 0.5)}.")
    above = true > tolerance
    print(f"It is above the tolerance in {sum(above)}, and in {sum(above & (proved == 1))} of these without saying so.")
    return {"tolerance": tolerance, "predicted": predicted, "true": true, "proved": proved}


def compare_times(runner, variants, out):
    """Times of variants of a scene over the first one's, by name, medians of runs that alternate; not a number if one fails."""
    seconds = {name: [] for name in variants}
    for _ in range(REPETITIONS):
        for name, content in variants.items():
            out.mkdir(parents=True, exist_ok=True)
            result = runner.run(coarsen.bare(content), out)
            (out / "checkpoint.npz").unlink(missing_ok=True)
            seconds[name].append(np.nan if result.failure else result.seconds)
    first = np.median(seconds[next(iter(variants))])
    return {name: np.median(values) / first for name, values in seconds.items()}


def print_costs(scenes, out):
    """Times of the models over the richest one's, and of plane strain over three dimensions, in Markdown."""
    print("\n| scene | time over that of the first |")
    print("|---|---|")
    for name in scenes:
        file = DEMOS / f"scenes/{name}.toml"
        content = read_toml(file)
        axes = {axis.name: axis for axis in coarsen.scene_axes(content)}
        content = next(rung for rung in axes["increment"].rungs if rung.name == COARSER).change(content)
        if "dimension" in axes:
            content = axes["dimension"].rungs[1].change(content)
        rungs = [*axes["closure"].rungs, *axes["elastic strain"].rungs[1:]]
        print_times(name, compare_times(SceneRunner(file), {rung.name: rung.change(content) for rung in rungs}, out))
    solid = {"homogeneous-shear": read_toml(DEMOS / "scenes/homogeneous-shear.toml"), "annulus": ring_in_space()}
    for name, content in solid.items():
        if name in scenes:
            plane = content | {"mesh": content["mesh"] | {"plane": True}}
            variants = {"three dimensions": content, "plane strain": plane}
            print_times(name, compare_times(SceneRunner(DEMOS / f"scenes/{name}.toml"), variants, out))


def print_times(name, times):
    print(f"| {name} | " + ", ".join(f"{variant} {time:.2f}" for variant, time in times.items()) + " |")


def ring_in_space():
    """The annulus as a hollow cylinder of one layer of cells."""
    content = read_toml(DEMOS / "scenes/annulus.toml")
    content["mesh"] |= {"height": 0.1, "cells": [8, 24, 1]}
    content["condition"].append({"on": ["bottom", "top"], "displacement": {"z": 0}})
    content["quantity"] = [{"name": "torque", "of": "moment z of inner"}]
    content["output"] = {}
    content["run"]["increment"] *= FINER
    return content


def picture(found):
    """True against predicted errors over their tolerances, and what is gained."""
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, (name, rows) in enumerate(found.items()):
        style = {"color": f"C{number % 10}", "marker": "os^Dv"[number // 4 % 5], "label": name, "markersize": 5}
        if rows[0][2] is not None:
            worst = [(np.max(true), report.predicted[np.argmax(true)]) for _, report, true in rows]
            for (true, predicted), (_, report, _) in zip(np.maximum(worst, ROUND_OFF), rows):
                left.plot(predicted, true, linestyle="none", fillstyle="full" if report.is_proved else "none", **style)
        gain = [(tolerance, report.file.seconds / report.recommended.seconds) for tolerance, report, _ in rows]
        right.plot(*zip(*gain), linewidth=0.8, **style)
    line = np.array([ROUND_OFF, 0.2])
    left.plot(line, line, "k-", linewidth=0.8)
    left.fill_between(line, line / 2, line * 2, color="0.9", zorder=0)
    left.set(xscale="log", yscale="log", xlabel="predicted error of the recommendation",
             ylabel="true error (grey: factor of 2; empty: said to be not proved)")
    right.axhline(1, color="black", linewidth=0.8)
    right.set(xscale="log", yscale="log", xlabel="tolerance", ylabel="time of the file over the recommendation's",
              xticks=TOLERANCES, xticklabels=[f"{tolerance:.0%}" for tolerance in TOLERANCES])
    right.minorticks_off()
    right.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


if __name__ == "__main__":
    main(out=fields.directory())
