"""The cheapest model that will do: what a path or a scene needs for its quantities and a tolerance.

A *ladder* has axes (`coarsen`), along each of which a model can be made cheaper. It is climbed from the top down, one axis at a
time: every rung is compared with the finest or richest of its axis, never with its neighbour, because two poor models may agree
with each other. Numerical errors are extrapolated from three sizes at least. What is recommended is run against the top of all
axes, and its measured error is what counts.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import numpy as np

from . import coarsen, estimate
from .checks import is_finite_number, is_positive_integer, refuse
from .choice import LEAST_SAVING, Choice, Finding, Report, Study, choose, predicted
from .coarsen import CONSTANT, DIMENSION, MODEL, NUMERICS, Axis, Content, Rung
from .estimate import TINY
from .files import locked_by_one
from .ladder_report import write_report
from .paths import read_material
from .quantities import Quantity
from .runs import BudgetSpent, PointRunner, Result, Runner, Runs
from .toml import read_toml

FILES = ("ladder.txt", "ladder.csv", "ladder.png", "recommended.toml")
SHARE_OF_REMAINDER = 0.15           # of the tolerance, that the extrapolated error of an axis's finest rung may take
SHARE_OF_STUDY = 0.25               # the same for the rung at which the other axes are studied
NEWTON_SHARE = 0.05                 # the same for errors that are not extrapolated
COARSER_SHARE = 0.5                 # the error of the coarsest rung below which one still coarser is looked at
MODEL_FACTOR = 1.25                 # on errors of models measured on coarse meshes
MODELS_DIFFER = 1.5                 # one coarse mesh's error over the other's, from where a third mesh is asked
INFLATION = 1.5                     # of predicted errors at least, after a recommendation that failed its proof
ATTEMPTS = 5                        # recommendations that are proved before the top itself is recommended
LOCALISES = "the shear localises: the share of the body that does half of it goes on falling with the cells"
CONVERGES = "The quantities converge nevertheless; strains and states where it localises do not, and depend on the mesh"
FEWEST_RUNS = 4                     # of a budget: the file, the top, the recommendation and one to compare


class Ladder:
    """A content with its axes, and the runs that compare them.

    Parameters
    ----------
    content : dict
        Of the file.
    axes : list of Axis
        The dimension first, for meshes depend on it.
    quantities : list of Quantity
    tolerance : float
        Of quantities that have none of their own.
    runs : Runs
    """

    def __init__(self, content: Content, axes: Sequence[Axis], quantities: Sequence[Quantity], tolerance: float,
                 runs: Runs) -> None:
        self.content, self.runs = content, runs
        self.axes = [axis for axis in axes if axis.kind != CONSTANT]
        self.constants = [axis for axis in axes if axis.kind == CONSTANT]
        self.quantities = list(quantities)
        self.tolerances = np.array([quantity.tolerance or tolerance for quantity in quantities])
        self.zero = np.zeros(len(self.quantities))
        # Rungs at which the other axes are studied.
        self.setting = {axis.name: axis.rungs[axis.start] if axis.kind == NUMERICS else axis.rungs[0] for axis in self.axes}
        self.meshes: list[Rung] = []    # on which models are compared, from the coarsest
        self.report = Report(self.quantities, self.tolerances)

    def climb(self) -> Report:
        """Study all axes, choose, and prove the choice."""
        report = self.report
        self.runs.reserve = 3
        for axis in self.axes:
            study = self._attempt(axis, {DIMENSION: self._dimension, NUMERICS: self._numerics, MODEL: self._model}[axis.kind])
            report.studies.append(study)
        report.constants = [self._attempt(axis, self._constant) for axis in self.constants]
        self.runs.reserve = 0
        self._choose_and_prove()
        self._compare_file()
        report.runs, report.seconds = self.runs.count, self.runs.seconds
        return report

    def _attempt(self, axis: Axis, study: Callable[[Axis], Study]) -> Study:
        """A study, or what is left of it where the budget ends: the axis then stays at the file's rung, or at its richest."""
        try:
            return study(axis)
        except BudgetSpent:
            rung = axis.own if axis.kind == NUMERICS else axis.rungs[0]
            self.setting[axis.name] = rung
            self.report.undecided.append(axis.name)
            return Study(axis, (Finding(rung, self.zero, 1.0, is_known=False),), is_complete=False)

    # ---- runs ------------------------------------------------------------------------------------------------------

    def changed(self, rungs: Mapping[str, Rung]) -> Content:
        """The file's content with rungs of axes by name; axes that are not named are as in the setting."""
        content = self.content
        for axis in self.axes:
            content = rungs.get(axis.name, self.setting[axis.name]).change(content)
        for axis in self.constants:
            if axis.name in rungs:
                content = rungs[axis.name].change(content)
        return content

    def run(self, rungs: Mapping[str, Rung]) -> Result:
        """The result of the setting with other rungs."""
        words = {axis.name: rungs.get(axis.name, self.setting[axis.name]) for axis in self.axes} | dict(rungs)
        name = ", ".join(f"{name} {rung.name}" for name, rung in rungs.items()) or "where others are studied"
        mesh = words.get("mesh")
        if mesh is not None and "mesh" not in rungs:
            name += f", mesh {mesh.name}"
        return self.runs.get(self.changed(rungs), name)

    def errors(self, result: Result, reference: Result) -> np.ndarray:
        """Errors (quantities,) of a result."""
        return estimate.errors(result, reference, self.quantities)

    def reason(self, result: Result, reference: Result) -> str:
        """Why a result differs from a reference."""
        elastic_strain = self.content.get("material", {}).get("elastic_strain", 0.0)
        return estimate.reason(result, reference, self.runs.runner.kinks, elastic_strain)

    # ---- one axis --------------------------------------------------------------------------------------------------

    def _dimension(self, axis: Axis) -> Study:
        """The reduced body against the body, on the coarsest mesh; the one that is taken is the setting from here on."""
        mesh = {} if axis.mesh is None else {"mesh": axis.mesh}
        full, reduced = (self.run({axis.name: rung, **mesh}) for rung in axis.rungs)
        errors = self.errors(reduced, full)
        findings = [Finding(axis.rungs[0], self.zero, 1.0)]
        reason = "" if (errors <= SHARE_OF_STUDY * self.tolerances).all() else self.reason(reduced, full)
        if not reason and full.unstable:
            noisy = self.runs.get(coarsen.with_noise(self.changed({axis.name: axis.rungs[0], **mesh})), f"{axis.name} with noise")
            errors = np.maximum(errors, self.errors(noisy, full))
            if (errors > SHARE_OF_STUDY * self.tolerances).any():
                reason = "a little noise in the initial state makes it lose its symmetry"
        findings.append(Finding(axis.rungs[1], errors, _ratio(reduced, full), reason))
        if reason:
            return Study(axis, tuple(findings), f"the symmetry does not hold: {reason}")
        self.setting[axis.name] = axis.rungs[1]
        return Study(axis, tuple(findings))

    def _numerics(self, axis: Axis) -> Study:
        return self._sequence(axis) if axis.is_sequence else self._alternatives(axis)

    def _alternatives(self, axis: Axis) -> Study:
        """Rungs whose errors cannot be extrapolated, each against the first."""
        first = self.run({axis.name: axis.rungs[0]})
        findings = [Finding(axis.rungs[0], self.zero, 1.0)]
        for rung in axis.rungs[1:]:
            result = self.run({axis.name: rung})
            findings.append(Finding(rung, self.errors(result, first), _ratio(result, first), _failure(result)))
        fine = [finding for finding in findings if (finding.errors <= NEWTON_SHARE * self.tolerances).all()]
        self.setting[axis.name] = min(fine, key=lambda finding: finding.time).rung
        return Study(axis, tuple(findings))

    def _sequence(self, axis: Axis) -> Study:
        """Three rungs from the axis's start up, finer ones until the finest is fine enough, and coarser ones while they may do."""
        found: dict[int, Result] = {}
        spent = False
        try:
            self._refine(axis, found)
            self._coarsen(axis, found)
        except BudgetSpent:
            if len(_good(found)) < 2:
                raise
            spent = True
            self.report.undecided.append(f"{axis.name}: finer or coarser ones than those {len(found)}")
        good, rest = _good(found), self._remainder(axis, found)
        verdict = self._verdict(axis, found, rest)
        if axis.name == "mesh":
            self.meshes = [axis.rungs[number] for number in reversed(good) if number <= axis.start][:3]
        findings = [Finding(axis.rungs[number], self.errors(found[number], found[good[0]]) + rest, _ratio(found[number],
                            found[good[0]])) for number in good]
        if verdict:
            self.setting[axis.name] = axis.own
            own = Finding(axis.own, self.zero, self._time_of_own(axis, found), is_known=False)
            return Study(axis, (own, *findings), verdict, is_complete=not spent)
        if not spent:
            findings += self._own(axis, found[good[0]], rest)
        fine = [number for number in good if number <= axis.start + 1
                and (self.errors(found[number], found[good[0]]) <= SHARE_OF_STUDY * self.tolerances).all()]       # the finest is
        self.setting[axis.name] = axis.rungs[max(fine)]
        remarks = [f"{LOCALISES}. {CONVERGES}"] if axis.name == "mesh" and self._narrows(found) else []
        remarks += [f"No rung is fine enough: {self._finest_in_words(axis, found, rest)}"] if (rest > self.tolerances).any() else []
        return Study(axis, tuple(findings), is_complete=not spent, remark=". ".join(remarks))

    def _time_of_own(self, axis: Axis, found: Mapping[int, Result]) -> float:
        """Time of the file's own rung over the finest one's, if it is one of those that were run; otherwise as long as that."""
        own = self.changed({axis.name: axis.own})
        return next((_ratio(found[number], found[_good(found)[0]]) for number in _good(found)
                     if self.changed({axis.name: axis.rungs[number]}) == own), 1.0)

    def _verdict(self, axis: Axis, found: Mapping[int, Result], rest: np.ndarray) -> str:
        """Why none of a sequence's rungs can be recommended."""
        good = _good(found)
        if len(good) < 2:
            return "no two of them can be compared: " + next(_failure(result) for result in found.values() if result.failure)
        if axis.name == "mesh" and self._narrows(found) and not self._converges_for_sure(found):
            return f"{LOCALISES}. It needs a length or a rate term, and no mesh can be recommended"
        if (rest > self.tolerances).any() and not estimate.fall_regularly(self._differences(found)):
            return f"does not converge, so that none can be recommended: {self._finest_in_words(axis, found, rest)}"
        return ""

    def _finest_in_words(self, axis: Axis, found: Mapping[int, Result], rest: np.ndarray) -> str:
        failures = [_failure(result) for result in found.values() if result.failure]
        errors = ", ".join(f"{error:.1%} ({quantity.name})" for quantity, error in zip(self.quantities, rest))
        finest = f"even the finest rung, {axis.rungs[_good(found)[0]].name}, may be off by {errors}"
        return finest + "".join(f"; a finer one {failure}" for failure in failures[-1:])

    def _refine(self, axis: Axis, found: dict[int, Result]) -> None:
        """Run rungs of a sequence until the finest is fine enough, or one cannot be computed although a coarser one could."""
        for number in range(axis.start, -1, -1):
            found[number] = self.run({axis.name: axis.rungs[number]})
            good = _good(found)
            if found[number].failure and len(good) > 1:
                break
            if len(good) < 3 or (self._remainder(axis, found) > SHARE_OF_REMAINDER * self.tolerances).any():
                continue
            if not self._narrows(found) or self._converges_for_sure(found):
                break

    def _differences(self, found: Mapping[int, Result]) -> list[np.ndarray]:
        """Between neighbours, from the coarsest to the finest."""
        return [self.errors(found[coarse], found[fine]) for coarse, fine in itertools.pairwise(reversed(_good(found)))]

    def _remainder(self, axis: Axis, found: Mapping[int, Result]) -> np.ndarray:
        """What the finest rung of a sequence is off by."""
        numbers = list(reversed(_good(found)))
        return estimate.remainders([found[number] for number in numbers], [axis.rungs[number].size for number in numbers],
                                   self.quantities)

    def _narrows(self, found: Mapping[int, Result]) -> bool:
        return estimate.keeps_narrowing([found[number].share for number in reversed(_good(found))])

    def _converges_for_sure(self, found: Mapping[int, Result]) -> bool:
        return estimate.converge_for_sure(self._differences(found), SHARE_OF_REMAINDER * self.tolerances)

    def _coarsen(self, axis: Axis, found: dict[int, Result]) -> None:
        """Run coarser rungs of a sequence while they may do and save time, or are needed to tell whether it converges."""
        for number in range(axis.start + 1, len(axis.rungs)):
            good = _good(found)
            coarsest = found[number - 1]
            if coarsest.failure or len(good) < 2:
                break
            errors = self.errors(coarsest, found[good[0]]) + self._remainder(axis, found)
            in_doubt = axis.name == "mesh" and self._narrows(found) and len(good) < 4
            if not in_doubt and (errors > COARSER_SHARE * self.tolerances).any():
                break
            found[number] = self.run({axis.name: axis.rungs[number]})
            if found[number].seconds > (1 - LEAST_SAVING) * coarsest.seconds and not in_doubt:
                break

    def _own(self, axis: Axis, finest: Result, rest: np.ndarray) -> list[Finding]:
        """The file's own rung, where it is none of the sequence."""
        own = self.changed({axis.name: axis.own})
        if any(self.changed({axis.name: rung}) == own for rung in axis.rungs):
            return []
        try:
            result = self.run({axis.name: axis.own})
        except BudgetSpent:
            return []
        return [] if result.failure else [Finding(axis.own, self.errors(result, finest) + rest, _ratio(result, finest))]

    def _model(self, axis: Axis) -> Study:
        """Ingredients dropped alone, each against the richest model on the same mesh; on two coarse meshes, or on three."""
        findings = [Finding(axis.rungs[0], self.zero, 1.0)]
        meshes: list[dict[str, Rung]] = [{"mesh": rung} for rung in self.meshes] or [{}]
        for rung in axis.rungs[1:]:
            pairs: list[tuple[Result, Result]] = []
            for mesh in meshes[:2]:
                pairs.append((self.run({axis.name: rung, **mesh}), self.run({axis.name: axis.rungs[0], **mesh})))
            errors = [self.errors(*pair) for pair in pairs]
            if len(meshes) > 2 and self._differ(*errors):
                third = self.run({axis.name: rung, **meshes[2]}), self.run({axis.name: axis.rungs[0], **meshes[2]})
                if not third[0].failure and not third[1].failure:
                    pairs.append(third)
                    errors = [*errors[1:], self.errors(*third)]
            factor = MODEL_FACTOR if len(errors) > 1 else 1.0
            findings.append(Finding(rung, factor * np.max(errors, axis=0), max(_ratio(*pair) for pair in pairs),
                                    self.reason(*pairs[-1])))
        return Study(axis, tuple(findings))

    def _differ(self, one: np.ndarray, other: np.ndarray) -> bool:
        """Whether errors on two meshes differ where they matter."""
        low, high = np.minimum(one, other), np.maximum(one, other)
        return bool((np.isfinite(high) & (high > MODELS_DIFFER * low) & (high > NEWTON_SHARE * self.tolerances)).any())

    def _constant(self, axis: Axis) -> Study:
        """Other values of a constant, on the coarsest mesh."""
        mesh: dict[str, Rung] = {"mesh": self.meshes[0]} if self.meshes else {}
        first = self.run(mesh)
        findings = [Finding(axis.rungs[0], self.zero, 1.0)]
        for rung in axis.rungs[1:]:
            result = self.run({axis.name: rung, **mesh})
            findings.append(Finding(rung, self.errors(result, first), _ratio(result, first), self.reason(result, first)))
        return Study(axis, tuple(findings))

    # ---- choice and proof ------------------------------------------------------------------------------------------

    def _choose_and_prove(self) -> None:
        report = self.report
        inflation = 1.0
        top = {study.axis.name: study.findings[0] for study in report.studies}
        for study in report.studies:
            if study.axis.kind == DIMENSION and not study.verdict and study.is_complete:
                top[study.axis.name] = study.findings[-1]        # the top of the body that is left
        report.of_top = predicted(top)
        report.top = self._run_choice(top, "top of all axes")
        try:
            for _ in range(ATTEMPTS):
                chosen = choose(report.studies, self.tolerances / inflation)
                if chosen is None:
                    break
                self._prove(chosen)
                if report.is_within:
                    break
                inflation *= INFLATION
        except BudgetSpent:
            report.undecided.append("a proof of a finer recommendation than the one that failed it")
        if not report.choice or not report.is_within:
            self._prove(top)
        self._keep_what_costs_nothing()
        report.alone = {quantity.name: chosen for number, quantity in enumerate(self.quantities)
                        if (chosen := choose(report.studies, self.tolerances, number)) is not None}
        report.content = self._content(report.choice)

    def _prove(self, choice: dict[str, Finding]) -> None:
        """Run a choice against the top."""
        report = self.report
        assert report.top is not None
        report.recommended = self._run_choice(choice, "recommended")
        report.choice, report.measured = choice, self.errors(report.recommended, report.top)

    def _keep_what_costs_nothing(self) -> None:
        """Ask of each poorer model in the recommendation whether it saves time there too, or else take the richer one."""
        report = self.report
        for study in report.studies:
            first, chosen = study.findings[0], report.choice[study.axis.name]
            if study.axis.kind != MODEL or chosen is first:
                continue
            proved = report.choice, report.recommended, report.measured
            assert report.recommended is not None
            poorer = report.recommended.seconds
            try:
                self._prove({**report.choice, study.axis.name: first})
            except BudgetSpent:
                report.undecided.append(f"whether {chosen.rung.name} saves time in the recommendation")
                return
            if poorer < (1 - LEAST_SAVING) * report.recommended.seconds or not report.is_within:
                report.choice, report.recommended, report.measured = proved

    def _content(self, choice: Choice) -> Content:
        return self.changed({name: finding.rung for name, finding in choice.items()})

    def _run_choice(self, choice: Choice, name: str) -> Result:
        return self.runs.get(self._content(choice), name)

    def _compare_file(self) -> None:
        """Run the file as it is, and with its dimension reduced."""
        report = self.report
        assert report.top is not None
        try:
            report.file = self.runs.get(self.content, "the file")
            report.of_file = self.errors(report.file, report.top)
            for axis in self.axes:
                if axis.kind == DIMENSION and self.setting[axis.name] is axis.rungs[1]:
                    reduced = self.runs.get(axis.rungs[1].change(self.content), "the file, reduced")
                    report.of_reduction = self.errors(reduced, report.file)
                    self._take_time_of_reduction(axis, _ratio(reduced, report.file))
        except BudgetSpent:
            report.undecided.append("the file itself, with which times and the reduced dimension would be compared")


    def _take_time_of_reduction(self, axis: Axis, time: float) -> None:
        """The time that a reduction saves is that on the file's mesh, not on the coarse one where it was checked."""
        report = self.report
        position = next(number for number, study in enumerate(report.studies) if study.axis is axis)
        study = report.studies[position]
        reduced = replace(study.findings[-1], time=time)
        report.studies[position] = replace(study, findings=(*study.findings[:-1], reduced))
        report.choice = {**report.choice, axis.name: reduced}


def _good(found: Mapping[int, Result]) -> list[int]:
    """Rungs that did not fail, from the finest; those above one that failed do not count."""
    return [number for number in sorted(found) if not found[number].failure]


def _ratio(result: Result, reference: Result) -> float:
    return result.seconds / max(reference.seconds, TINY)


def _failure(result: Result) -> str:
    return f"cannot be computed: {result.failure.splitlines()[0]}" if result.failure else ""


# ---- files --------------------------------------------------------------------------------------------------------------

def climb(file: str | Path, tolerance: float, out: str | Path, budget: int | None = None, runner: Runner | None = None,
          progress: TextIO | None = None) -> Report:
    """Find the cheapest model that will do for a path or scene file, and write what was found.

    Parameters
    ----------
    file : path
        With at least one [[quantity]].
    tolerance : float
        Error that is allowed for quantities without one of their own, relative to their scales.
    out : path
        Receives ladder.txt, ladder.csv, ladder.png, recommended.toml and the runs. What is there of an earlier climb is used.
    budget : int, optional
        Most runs that there may be.
    runner : Runner, optional
        Of the file, if it is not to be made here.
    progress : text stream, optional
        Receives a line for each run.

    Returns
    -------
    Report

    Raises
    ------
    ValueError
        Names everything that is wrong at once.
    """
    file, out = Path(file), Path(out)
    faults = []
    if not is_finite_number(tolerance) or not 0 < tolerance < 1:
        faults.append(f"tolerance = {tolerance!r}: must be a number in (0, 1)")
    if budget is not None and (not is_positive_integer(budget) or budget < FEWEST_RUNS):
        faults.append(f"budget = {budget!r}: must be an integer, at least {FEWEST_RUNS}")
    refuse("the ladder cannot be climbed", faults)
    content = read_toml(file)
    runner = runner or (_scene_runner(file) if is_scene(file) else PointRunner(file))
    if not runner.quantities:
        raise ValueError(f"{file} has no [[quantity]]: there is nothing to compare models by")
    elastic_strain = read_material(content, file.parent)["elastic_strain"]       # the calibration's, where the file has none
    if elastic_strain and "elastic_strain" not in content["material"]:
        content = coarsen.with_material(content, elastic_strain=elastic_strain)
    axes = (coarsen.scene_axes(content) if is_scene(file) else coarsen.path_axes(content)) + coarsen.constants(content)
    with locked_by_one(runner.on_one, out):
        ladder = Ladder(content, axes, runner.quantities, tolerance, Runs(runner, out, file.parent, budget, progress))
        report = ladder.climb()
        runner.on_one(lambda: write_report(report, file, out))
    return report


def is_scene(file: str | Path) -> bool:
    """Whether a file is a scene's, with a mesh, and not a path's."""
    return "mesh" in read_toml(file)


def _scene_runner(file: Path) -> Runner:
    from .fem.ladder import SceneRunner
    return SceneRunner(file)
