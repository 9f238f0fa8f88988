"""Path files: a material, an initial state and steps, as TOML."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import driver
from .checks import is_number, refuse
from .material import Material

INITIAL = {
    "steady": ("phi",), "isotropic": ("phi", "pressure", "Z2"), "given": ("phi", "Z2", "fabric", "direction", "stress"),
}
CONTROL = ("control", "free", "stress")
TESTS = {
    "isotropic": lambda step: driver.isotropic_compression(**step),
    "biaxial-drained": lambda step: driver.biaxial(drained=True, **step),
    "biaxial-undrained": lambda step: driver.biaxial(drained=False, **step),
    "triaxial-drained": lambda step: driver.triaxial(drained=True, **step),
    "triaxial-undrained": lambda step: driver.triaxial(drained=False, **step),
}
# The key that says what a step is, the keys that it needs, and those that it may have.
STEPS = {
    "shear": ((), (*CONTROL, "increments", "until")),
    "pause": ((), ()),
    "velocity_gradient": ((), ("strain", *CONTROL, "increments", "until")),
    "cycles": (("amplitude",), ("control", "increments")),
    "test": ((), ("compression", "pressure", "increments", "until")),
    "csv": ((), ("free", "until")),
}


@dataclass(frozen=True)
class PathFile:
    """What a path file says."""

    material: Material
    state: np.record
    steps: list
    tolerance: float = driver.TOLERANCE
    acoustic: bool = False


def read_path_file(path):
    """Reads a path file.

    Raises
    ------
    ValueError
        Names everything that is wrong with it at once.
    """
    path = Path(path)
    content = read_toml(path)
    faults = [f"unknown table or key {name!r}: allowed are material, initial, step, tolerance, output"
              for name in content if name not in ("material", "initial", "step", "tolerance", "output")]
    material = attempt(faults, "", read_material, content)
    state = attempt(faults, "", read_initial, material, content)
    entries = content.get("step", [])
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        faults.append("no steps: give at least one [[step]]")
        entries = []
    steps = []
    for number, entry in enumerate(entries, 1):
        steps += attempt(faults, f"step {number}: ", read_step, entry, path.parent) or []
    tolerance = content.get("tolerance", driver.TOLERANCE)
    if not is_number(tolerance) or not 0 < tolerance < 1:
        faults.append(f"tolerance = {tolerance!r}: must be a number in (0, 1)")
    output = attempt(faults, "", table_of, content, "output") or {}
    faults += [f"[output]: unknown key {key!r}: allowed is acoustic" for key in output if key != driver.ACOUSTIC]
    acoustic = output.get(driver.ACOUSTIC, False)
    if not isinstance(acoustic, bool):
        faults.append(f"[output]: acoustic = {acoustic!r}: must be true or false")
    refuse(f"{path} cannot be run", faults)
    return PathFile(material, state, steps, tolerance, acoustic)


def read_toml(path):
    """What a TOML file says; ValueError where it is none."""
    with open(path, "rb") as file:
        try:
            return tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: not a TOML file: {error}") from None


def attempt(faults, prefix, function, *arguments):
    """The result, or None and one more fault."""
    try:
        return function(*arguments)
    except (ValueError, OSError) as error:
        faults.append(prefix + str(error).replace("\n", "\n  "))
        return None


def table_of(content, name):
    table = content.get(name, {})
    if not isinstance(table, dict):
        raise ValueError(f"{name}: must be a table [{name}]")
    return table


def read_material(content):
    return Material(**table_of(content, "material"))


def read_initial(material, content):
    table = table_of(content, "initial")
    kind = table.get("state")
    if kind not in INITIAL:
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
        return None                                      # its own faults are told already
    if kind == "steady":
        return material.steady(values["phi"])
    if kind == "isotropic":
        return material.isotropic(values["phi"], values.get("pressure"), values.get("Z2"))
    return material.state(values["phi"], values["Z2"], *(values.get(name) for name in ("fabric", "direction", "stress")))


def read_step(entry, directory=Path()):
    """The Steps of one [[step]] table: several for cycles."""
    kinds = [kind for kind in STEPS if kind in entry]
    if len(kinds) != 1:
        raise ValueError(f"must have exactly one of the keys {', '.join(STEPS)}; has {', '.join(entry) or 'none'}")
    kind = kinds[0]
    required, optional = STEPS[kind]
    faults = [f"unknown key {key!r}: allowed with {kind!r} are {', '.join(required + optional) or 'none'}"
              for key in entry if key not in (kind, *required, *optional)]
    faults += [f"{key} is missing" for key in required if key not in entry]
    if "control" in entry and ("free" in entry or "stress" in entry):
        faults.append("control excludes free and stress, which it sets")
    if entry.get("control", "volume") not in driver.CONTROLS:
        faults.append(f"control = {entry['control']!r}: must be one of {', '.join(driver.CONTROLS)}")
    numbers = ("shear", "strain", "amplitude", "compression", "pressure")
    faults += [f"{key} = {entry[key]!r}: must be a finite number" for key in numbers
               if key in entry and not (is_number(entry[key]) and np.isfinite(entry[key]))]
    if "free" in entry and not (isinstance(entry["free"], list) and all(isinstance(name, str) for name in entry["free"])):
        faults.append(f"free = {entry['free']!r}: must be a list of names")
    if "stress" in entry and not isinstance(entry["stress"], dict):
        faults.append(f"stress = {entry['stress']!r}: must be a table of values")
    if kind == "pause" and entry["pause"] is not True:
        faults.append(f"pause = {entry['pause']!r}: must be true")
    if kind == "test" and entry["test"] not in TESTS:
        faults.append(f"test = {entry['test']!r}: must be one of {', '.join(TESTS)}")
    refuse("cannot be made", faults)

    values = {key: value for key, value in entry.items() if key != kind}
    if kind == "shear":
        return [_with_control("shear {:g}".format(entry["shear"]), driver.SHEAR, entry["shear"], values, shear=True)]
    if kind == "velocity_gradient":
        return [_with_control("deformation", entry["velocity_gradient"], values.pop("strain", 1.0), values)]
    if kind == "cycles":
        return driver.cycles(values.pop("amplitude"), entry["cycles"], **values)
    if kind == "csv":
        return [_from_csv(directory / str(entry["csv"]), tuple(values.get("free", ())), values.get("until", ""))]
    if kind == "test":
        if entry["test"] != "isotropic" and "compression" not in values:
            raise ValueError("compression is missing")
        if entry["test"] != "isotropic" and "pressure" in values:
            raise ValueError("pressure belongs to test = \"isotropic\"")
        return [TESTS[entry["test"]](values)]
    return [driver.pause()]


def _with_control(name, gradient, strain, values, shear=False):
    if "free" in values or "stress" in values:
        control = {"free": tuple(values.pop("free", ())), "stress": values.pop("stress", {})}
    else:
        control = driver.controlled(values.pop("control", "volume"))
    return driver.Step(name, gradient, strain, shear=shear, **values, **control)


GRADIENTS = [f"G_{i}{j}" for i in "xyz" for j in "xyz"]


def _from_csv(path, free, until):
    """A step from a table of cumulative values: gamma or G_xx ... G_zz (grad u), and one column per stress condition."""
    try:
        with open(path, encoding="utf-8") as file:
            names = [name.strip() for name in file.readline().split(",")]
            table = np.loadtxt(file, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ValueError(f"{path}: not a table of numbers with one line of names: {error}") from None
    stresses = [name for name in names if name not in GRADIENTS and name != "gamma"]
    faults = []
    if table.shape[0] < 2 or table.shape[1:] != (len(names),):
        faults.append(f"has shape {table.shape}: must have {len(names)} columns and at least 2 rows")
    elif not np.isfinite(table).all():
        faults.append("has values that are not finite")
    if "gamma" in names and "G_xz" in names:
        faults.append("has both gamma and G_xz, which are the same")
    if len(set(names)) < len(names):
        faults.append("names a column twice")
    refuse(str(path), faults)
    values = np.zeros((len(table), 9 + len(stresses)))
    for i, name in enumerate(GRADIENTS):
        column = "gamma" if name == "G_xz" and "gamma" in names else name
        if column in names:
            values[:, i] = table[:, names.index(column)]
    for i, name in enumerate(stresses):
        values[:, 9 + i] = table[:, names.index(name)]
    only_shear = not any(name in names for name in GRADIENTS)
    return driver.Step(f"path {path.name}", increments=len(table) - 1, free=free, stress=dict.fromkeys(stresses, 0.0),
                       until=until, shear=only_shear, table=values)


def write_path_file(path, material, state, step):
    """Writes a path file that runs one step from a given state, number for number."""
    lines = ["[material]", *(f"{name} = {_toml(value)}" for name, value in material.definition.items()), "", "[initial]",
             'state = "given"', f"phi = {_toml(state['volume_fraction'])}", f"Z2 = {_toml(state['coordination_number'])}"]
    lines += [f"{name} = {_toml(state[name])}" for name in ("fabric", "direction", "stress")]
    lines += ["", "[[step]]", f"velocity_gradient = {_toml(step.gradient)}", f"strain = {_toml(step.strain)}",
              f"increments = {step.increments}"]
    if step.free:
        conditions = ", ".join(f'"{name}" = {_toml(value)}' for name, value in step.stress.items())
        lines += [f"free = {_toml(step.free)}", f"stress = {{ {conditions} }}"]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _toml(value):
    if isinstance(value, str):
        return f'"{value}"'
    if is_number(value):
        return repr(float(value))
    return "[" + ", ".join(_toml(item) for item in value) + "]"

