"""Path files: a material, an initial state and the steps of a load path, as TOML."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import steps
from .calibrations import is_calibration_file
from .checks import attempt, is_finite_number, is_number, refuse
from .files import read_lines
from .history import ACOUSTIC, COLUMNS, column_name
from .material import Material
from .quantities import Quantity, are_same_times, read_quantities
from .steps import TOLERANCE, Step
from .toml import read_toml, table_of, write_content

Table = Mapping[str, Any]

INITIAL = {
    "steady": ("phi",), "isotropic": ("phi", "pressure", "Z2"), "given": ("phi", "Z2", "fabric", "direction", "stress"),
}
TABLES = ("material", "initial", "step", "tolerance", "quantity", "output")


@dataclass(frozen=True)
class PathFile:
    """What a path file says.

    Attributes
    ----------
    material : Material
    state : record of dtype STATE
        Start of the path.
    steps : list of Step
    tolerance : float
        As in driver.run.
    acoustic : bool
        Whether the history is to have the column "acoustic".
    quantities : sequence of Quantity
        Columns of the history.
    """

    material: Material
    state: np.record
    steps: list[Step]
    tolerance: float = TOLERANCE
    acoustic: bool = False
    quantities: Sequence[Quantity] = ()


def read_path_file(filename: str | Path) -> PathFile:
    """Read a path file.

    Parameters
    ----------
    filename : path

    Returns
    -------
    PathFile

    Raises
    ------
    ValueError
        Names every mistake in the file at once.
    OSError
        If the file cannot be read.
    """
    filename = Path(filename)
    content = read_toml(filename)
    faults = [f"unknown table or key {name!r}: allowed are {', '.join(TABLES)}" for name in content if name not in TABLES]
    material = attempt(faults, "", read_material, content, filename.parent)
    state = attempt(faults, "", read_initial, material, content)
    entries = content.get("step", [])
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        faults.append("no steps: give at least one [[step]]")
        entries = []
    found = []
    for number, entry in enumerate(entries, 1):
        found += attempt(faults, f"step {number}: ", read_step, entry, filename.parent) or []
    tolerance = content.get("tolerance", TOLERANCE)
    if not is_number(tolerance) or not 0 < tolerance < 1:
        faults.append(f"tolerance = {tolerance!r}: must be a number in (0, 1)")
    output = attempt(faults, "", table_of, content, "output") or {}
    faults += [f"[output]: unknown key {key!r}: allowed is {ACOUSTIC}" for key in output if key != ACOUSTIC]
    acoustic = output.get(ACOUSTIC, False)
    if not isinstance(acoustic, bool):
        faults.append(f"[output]: {ACOUSTIC} = {acoustic!r}: must be true or false")
    quantities = attempt(faults, "", read_quantities, content, lambda of: _check_column(of, acoustic),
                         lambda t: _check_time(t, found))
    refuse(f"{filename} cannot be run", faults)
    assert material is not None and state is not None and quantities is not None         # or there were faults
    return PathFile(material, state, found, tolerance, acoustic, quantities)


def read_material(content: Table, directory: Path = Path()) -> Material:
    """The material of a file's table [material]; a calibration file is looked for in a directory, that of the file."""
    return Material(**material_table(content, directory))


def material_table(content: Table, directory: Path) -> dict[str, Any]:
    """A file's table [material], with the name of a calibration file as it is found from the directory of the file."""
    table = table_of(content, "material")
    if is_calibration_file(table.get("calibration")):
        table = table | {"calibration": str(directory / table["calibration"])}
    return table


def initial_table(content: Table) -> dict[str, Any]:
    """A file's table [initial] with the symbols phi and Z2 for their words, volume_fraction and coordination_number."""
    table = table_of(content, "initial")
    refuse("[initial]", [f"{key} is {column_name(key)}, which is given too" for key in table
                         if column_name(key) != key and column_name(key) in table])
    return {column_name(key): value for key, value in table.items()}


def read_initial(material: Material | None, content: Table) -> np.record | None:
    """Read the state of a file's table [initial].

    Parameters
    ----------
    material : Material or None
        None if the file's material is faulty; then the table is only checked.
    content : dict
        Of the file.

    Returns
    -------
    record of dtype STATE, or None without a material

    Raises
    ------
    ValueError
        Names every mistake in the table.
    """
    table = initial_table(content)
    kind = table.get("state")
    if not isinstance(kind, str) or kind not in INITIAL:
        raise ValueError(f"[initial]: state = {kind!r}: must be one of {', '.join(INITIAL)}")
    values = {key: value for key, value in table.items() if key != "state"}
    faults = [f"unknown key {key!r}: allowed with state = {kind!r} are {', '.join(INITIAL[kind])}"
              for key in values if key not in INITIAL[kind]]
    if "phi" not in values:
        faults.append("phi is missing")
    elif not is_number(values["phi"]) or not 0 < values["phi"] < 1:
        faults.append(f"phi = {values['phi']!r}: must be a number in (0, 1)")
    if kind == "given" and "Z2" not in values:
        faults.append("Z2 is missing")
    refuse("[initial]", faults)
    if material is None:
        return None
    if kind == "steady":
        return material.steady(values["phi"])
    if kind == "isotropic":
        return material.isotropic(values["phi"], values.get("pressure"), values.get("Z2"))
    return material.state(values["phi"], values["Z2"], *(values.get(name) for name in ("fabric", "direction", "stress")))


def _check_column(of: str, acoustic: object) -> None:
    """Raises ValueError where a quantity is of no column of the history."""
    if of == ACOUSTIC and acoustic is not True:
        raise ValueError(f"needs {ACOUSTIC} = true in [output]")
    if column_name(of) not in (*COLUMNS[1:], ACOUSTIC):
        raise ValueError(f"must be a column of the history, one of {', '.join(COLUMNS[1:])}")


def _check_time(t: float, found: Sequence[Step]) -> None:
    """Raises ValueError where no increment of the steps ends at a time."""
    if not 0 <= t <= len(found):
        raise ValueError(f"must be from 0 to {len(found)}, the number of steps (of cycles two each)")
    number = int(np.ceil(t))
    if are_same_times(t, np.round(t)):
        return
    step = found[number - 1]
    if step.until:
        raise ValueError(f"step {number} may end early, so that only its end can be met")
    increments = (t - number + 1) * step.increments
    if not are_same_times(increments, np.round(increments)):
        raise ValueError(f"lies {increments:.6g} increments into step {number}, which has {step.increments}: must be the end of one"
                         " of them")


# ---- steps -------------------------------------------------------------------------------------------------------------

def _shear(strain: float, directory: Path, **options: Any) -> list[Step]:
    return [Step(f"shear {strain:g}", steps.SHEAR, strain, shear=True, **_with_control(options))]


def _deformation(gradient: Any, directory: Path, strain: float = 1.0, **options: Any) -> list[Step]:
    return [Step("deformation", gradient, strain, **_with_control(options))]


def _with_control(options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of Step from keys of a file: `control` is replaced by what it leaves free and holds."""
    if "free" in options or "stress" in options:
        return options | {"free": tuple(options.get("free", ())), "stress": options.get("stress", {})}
    control = steps.controlled(options.pop("control", "volume"))
    return options | control


def _cycles(number: Any, directory: Path, amplitude: float, **options: Any) -> list[Step]:
    return steps.cycles(amplitude, number, **options)


def _test(name: str, directory: Path, **options: Any) -> list[Step]:
    test = TESTS[name]
    allowed = (*test.required, *test.optional)
    faults = [f"unknown key {key!r}: allowed with test = {name!r} are {', '.join(allowed)}"
              for key in options if key not in allowed]
    faults += [f"{key} is missing" for key in test.required if key not in options]
    refuse("cannot be made", faults)
    made = test.make(**test.settings, **options)
    return made if isinstance(made, list) else [made]


def _pause(value: bool, directory: Path) -> list[Step]:
    return [steps.pause()]


def _table(name: Any, directory: Path, free: tuple[str, ...] = (), until: str = "") -> list[Step]:
    return [_from_csv(directory / str(name), tuple(free), until)]


class _Test(NamedTuple):
    """A ready test: the keys that it needs, those that it may have, and the function of `steps` that makes it of them."""

    required: tuple[str, ...]
    optional: tuple[str, ...]
    make: Callable[..., Step | list[Step]]
    settings: dict[str, Any] = {}                     # noqa: RUF012 - of the function, beside the keys


USUAL = ("increments", "until")
TESTS = {
    "isotropic": _Test((), ("compression", "pressure", *USUAL), steps.isotropic_compression),
    "oedometer": _Test((), ("compression", "sigma_zz", *USUAL), steps.oedometer),
    "dss": _Test(("strain",), ("control", *USUAL), steps.direct_shear),
    "dss-cyclic": _Test(("number",), ("amplitude", "stress_amplitude", "control", *USUAL), steps.cyclic_direct_shear),
} | {
    f"{test}-{drainage}": _Test(required, USUAL, make, {"drained": drainage == "drained"})
    for test, required, make in (("biaxial", ("compression",), steps.biaxial), ("triaxial", ("compression",), steps.triaxial),
                                 ("triaxial-cyclic", ("number", "stress_amplitude"), steps.cyclic_triaxial))
    for drainage in ("drained", "undrained")
}


class _Kind(NamedTuple):
    """A kind of step: the keys that it needs, those that it may have, and the function that makes it."""

    required: tuple[str, ...]
    optional: tuple[str, ...]
    make: Callable[..., list[Step]]         # of the value of the key that names the kind, the file's directory, and the other keys


CONTROL = ("control", "free", "stress")
KINDS = {
    "shear": _Kind((), (*CONTROL, "increments", "until"), _shear),
    "pause": _Kind((), (), _pause),
    "velocity_gradient": _Kind((), ("strain", *CONTROL, "increments", "until"), _deformation),
    "cycles": _Kind(("amplitude",), ("control", "increments"), _cycles),
    "test": _Kind((), tuple(dict.fromkeys(key for test in TESTS.values() for key in (*test.required, *test.optional))), _test),
    "csv": _Kind((), ("free", "until"), _table),
}
# Keys whose values are checked here: the check, and what the value must be in words.
CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "control": (lambda value: isinstance(value, str) and value in steps.CONTROLS, f"one of {', '.join(steps.CONTROLS)}"),
    **dict.fromkeys(("shear", "strain", "amplitude", "stress_amplitude", "compression", "pressure", "sigma_zz"),
                    (is_finite_number, "a finite number")),
    "free": (lambda value: isinstance(value, list) and all(isinstance(name, str) for name in value), "a list of names"),
    "stress": (lambda value: isinstance(value, dict), "a table of values"),
    "until": (lambda value: isinstance(value, str), "a condition in quotes"),
    "pause": (lambda value: value is True, "true"),
    "test": (lambda value: isinstance(value, str) and value in TESTS, f"one of {', '.join(TESTS)}"),
}


def read_step(entry: Table, directory: Path = Path()) -> list[Step]:
    """Read one table [[step]].

    Parameters
    ----------
    entry : dict
        The table.
    directory : path
        Where a `csv` file is looked for.

    Returns
    -------
    list of Step
        Several for cycles, otherwise one.

    Raises
    ------
    ValueError
        Names every mistake in the table.
    OSError
        If a `csv` file cannot be read.
    """
    kinds = [kind for kind in KINDS if kind in entry]
    if len(kinds) != 1:
        raise ValueError(f"must have exactly one of the keys {', '.join(KINDS)}; has {', '.join(entry) or 'none'}")
    name = kinds[0]
    kind = KINDS[name]
    allowed = kind.required + kind.optional
    faults = [f"unknown key {key!r}: allowed with {name!r} are {', '.join(allowed) or 'none'}"
              for key in entry if key not in (name, *allowed)]
    faults += [f"{key} is missing" for key in kind.required if key not in entry]
    if "control" in entry and ("free" in entry or "stress" in entry):
        faults.append("control excludes free and stress, which it sets")
    faults += [f"{key} = {entry[key]!r}: must be {words}" for key, (holds, words) in CHECKS.items()
               if key in entry and not holds(entry[key])]
    refuse("cannot be made", faults)
    return kind.make(entry[name], directory, **{key: value for key, value in entry.items() if key != name})


GRADIENTS = [f"G_{i}{j}" for i in "xyz" for j in "xyz"]


def _from_csv(filename: Path, free: tuple[str, ...], until: str) -> Step:
    """A step from a table of cumulative values: gamma or G_xx ... G_zz (grad u), and one column for each stress condition."""
    names, table = read_lines(filename)
    faults = []
    if table.shape[0] < 2 or table.shape[1:] != (len(names),):
        faults.append(f"has shape {table.shape}: must have {len(names)} columns and at least 2 rows")
    elif not np.isfinite(table).all():
        faults.append("has values that are not finite")
    if "gamma" in names and "G_xz" in names:
        faults.append("has both gamma and G_xz, which are the same")
    if len(set(names)) < len(names):
        faults.append("names a column twice")
    refuse(str(filename), faults)

    columns = dict(zip(names, table.T))
    only_shear = not any(name in GRADIENTS for name in names)
    if "gamma" in columns:
        columns["G_xz"] = columns.pop("gamma")
    zero = np.zeros(len(table))
    stresses = [name for name in columns if name not in GRADIENTS]
    values = np.column_stack([columns.get(name, zero) for name in (*GRADIENTS, *stresses)])
    return Step(f"path {filename.name}", increments=len(table) - 1, free=free, stress=dict.fromkeys(stresses, 0.0),
                until=until, shear=only_shear, table=values)


# ---- writing -----------------------------------------------------------------------------------------------------------

def write_path_file(filename: str | Path, material: Material, state: np.record | np.void, step: Step) -> None:
    """Write a path file that runs one step from a given state; numbers are written in full.

    Parameters
    ----------
    filename : path
    material : Material
    state : record of dtype STATE
        Start of the step.
    step : Step
        With a constant gradient and no condition that ends it early.
    """
    initial = {"state": "given", "phi": state["volume_fraction"], "Z2": state["coordination_number"]}
    initial |= {name: state[name] for name in ("fabric", "direction", "stress")}
    entry: dict[str, Any] = {"velocity_gradient": step.gradient, "strain": step.strain, "increments": step.increments}
    if step.free:
        entry |= {"free": step.free, "stress": step.stress}
    write_content(filename, {"material": material.definition, "initial": initial, "step": [entry]})
