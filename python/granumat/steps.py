"""The steps of a load path: what is deformed, what is left free, what is held, and the usual tests of this field.

Axes are x (flow), y (vorticity), z (gradient). Stresses in a step have the paper's sign, compression positive, and are in k/d
(k_Hz for Hertzian contacts).
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import tensors
from .checks import COUNT, attempt, is_finite_number, is_positive_integer, real_array, refuse
from .history import stop_condition

TOLERANCE = 1e-6            # default error of what evolves in a substep where stresses are held

# Controls: the deformations that each leaves free and the stresses that it holds instead.
CONTROLS = {
    "volume": ((), ()),
    "pressure": (("volume_strain",), ("p",)),
    "normal-stresses": (("e_xx", "e_yy", "e_zz"), ("sigma_xx", "sigma_yy", "sigma_zz")),
    "normal-load": (("e_zz",), ("sigma_zz",)),
}

# ---- names of strains and stresses ---------------------------------------------------------------------------------

SHEAR = np.zeros((3, 3))
SHEAR[0, 2] = 1.0           # du_x/dz

STRAINS = {f"e_{axis}": tensors.to_matrix(np.eye(6)[i]) for i, axis in enumerate(tensors.AXES)}       # displacement gradients
STRAINS |= {"volume_strain": np.eye(3) / 3, "gamma": SHEAR}
STRESSES = {f"sigma_{axis}": np.eye(6)[i] for i, axis in enumerate(tensors.AXES)}     # weights of the stress's Voigt components
STRESSES["p"] = tensors.IDENTITY / 3

TERM = re.compile(r"\s*([+-]?)\s*(?:([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*\*\s*)?([A-Za-z]\w*)")


def linear_combination(text: str, names: Mapping[str, np.ndarray]) -> np.ndarray:
    """Read a linear combination of named vectors.

    Parameters
    ----------
    text : str
        Such as "0.5*e_xx - e_zz".
    names : mapping of str to array (3, 3) or (6,)
        STRAINS or STRESSES.

    Returns
    -------
    array (3, 3) or (6,)

    Raises
    ------
    ValueError
        If the text is no linear combination of these names, or is zero.
    """
    total, position = np.zeros_like(next(iter(names.values()))), 0
    while position < len(text.rstrip()):
        match = TERM.match(text, position)
        if not match or match[3] not in names or (position > 0 and not match[1]):
            raise ValueError(f"{text!r}: must be a linear combination of {', '.join(names)}, such as \"2*{next(iter(names))}\"")
        total += float(match[2] or 1) * (-1 if match[1] == "-" else 1) * names[match[3]]
        position = match.end()
    if not total.any():
        raise ValueError(f"{text!r}: is zero; must be a linear combination of {', '.join(names)}")
    return total


# ---- a step ------------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Step:
    """A part of a load path: a prescribed deformation, and free deformations that are found so that stresses are as prescribed.

    Attributes
    ----------
    name : str
        Name of the step in messages.
    gradient : array (3, 3), or function of the strain measure that returns one
        Velocity gradient per unit of `strain`; a function is evaluated in the middle of each increment.
    strain : float
        Strain measure over which the gradient acts: grad u = strain * gradient.
    increments : int
        Number of equal increments.
    free : tuple of str
        Deformations that are found: "e_xx" ... "e_yz", "volume_strain", "gamma", or a linear combination such as "e_xx - e_zz".
        "gamma" is the simple shear du_x/dz, "e_xz" a shear without rotation.
    stress : dict of str to float or "hold"
        As many conditions: "sigma_xx" ... "sigma_yz", "p", or a linear combination, and the value in k/d (compression positive)
        that it reaches, linearly, at the end of the step.
    until : str
        Condition that ends the step early: "steady", or a column compared with a number, such as "p < 0.001".
    shear : bool
        Whether the strain is a signed shear strain in x-z; otherwise gamma grows by 2 abs(D) per increment.
    table : array (n + 1, 9 + m), optional
        Rows of the cumulative displacement gradient and of the values of the m stress conditions; replaces gradient, strain and
        the values in `stress`.

    Raises
    ------
    ValueError
        Names every mistake.
    """

    name: str
    gradient: Any = field(default_factory=lambda: np.zeros((3, 3)))
    strain: float = 1.0
    increments: int = 200
    free: tuple[str, ...] = ()
    stress: dict[str, Any] = field(default_factory=dict)
    until: str = ""
    shear: bool = False
    table: np.ndarray | None = None

    def __post_init__(self) -> None:
        faults: list[str] = []
        if not is_positive_integer(self.increments):
            faults.append(f"increments = {self.increments!r}: must be {COUNT}")
        if not is_finite_number(self.strain):
            faults.append(f"strain = {self.strain!r}: must be a finite number")
        if not callable(self.gradient) and not _is_gradient(self.gradient):
            faults.append(f"velocity_gradient = {self.gradient!r}: must be a 3 x 3 matrix of finite numbers, or a function")
        self._check_conditions(faults)
        if self.until:
            attempt(faults, "", stop_condition, self.until)
        refuse(f"the step {self.name!r} cannot be made", faults)

    def _check_conditions(self, faults: list[str]) -> None:
        """Append what is wrong with the free deformations and the stress conditions."""
        modes = [attempt(faults, "", linear_combination, text, STRAINS) for text in self.free]
        functionals = []
        for text, value in self.stress.items():
            functionals.append(attempt(faults, "", linear_combination, text, STRESSES))
            if value != "hold" and not is_finite_number(value):
                faults.append(f"stress {text!r} = {value!r}: must be a finite number or \"hold\"")
        if len(self.free) != len(self.stress):
            faults.append(f"{len(self.free)} free deformations ({', '.join(self.free)}) against {len(self.stress)} stress "
                          f"conditions ({', '.join(self.stress)}): must be as many")
        strains = [tensors.symmetric(mode) for mode in modes if mode is not None]
        for kind, names, found in (("free deformations", self.free, strains), ("stress conditions", self.stress, functionals)):
            vectors = [vector for vector in found if vector is not None]
            if vectors and np.linalg.matrix_rank(vectors) < len(vectors):
                faults.append(f"{kind} {', '.join(names)}: not independent")

    def __len__(self) -> int:
        """The number of increments."""
        return self.increments if self.table is None else len(self.table) - 1

    @property
    def modes(self) -> np.ndarray:
        """Free displacement gradients (m, 3, 3)."""
        return np.array([linear_combination(text, STRAINS) for text in self.free]).reshape(-1, 3, 3)

    @property
    def functionals(self) -> np.ndarray:
        """Weights (m, 6) of the stress components (tension positive) whose sums are prescribed."""
        return -np.array([linear_combination(text, STRESSES) for text in self.stress]).reshape(-1, 6)

    def gradients(self) -> np.ndarray:
        """Prescribed displacement gradients (n, 3, 3) of the n increments."""
        if self.table is not None:
            return np.diff(self.table[:, :9], axis=0).reshape(-1, 3, 3)
        size = self.strain / self.increments
        if not callable(self.gradient):
            return np.tile(size * np.asarray(self.gradient, float), (self.increments, 1, 1))
        middles = (np.arange(self.increments) + 0.5) * size
        return size * np.array([real_array("gradient", self.gradient(s)) for s in middles])

    def targets(self, stress: np.ndarray) -> np.ndarray:
        """Values of the stress conditions at the start and after each increment.

        Parameters
        ----------
        stress : array (6,)
            At the start of the step, tension positive, in k/d.

        Returns
        -------
        array (n + 1, m)
        """
        start = self.functionals @ stress
        if self.table is not None and self.stress:
            return np.vstack([start, self.table[1:, 9:]])
        end = [now if value == "hold" else value for now, value in zip(start, self.stress.values())]
        return np.linspace(start, np.array(end, float).reshape(start.shape), self.increments + 1)


def _is_gradient(value: ArrayLike) -> bool:
    try:
        gradient = real_array("gradient", value)
    except TypeError:
        return False
    return gradient.shape == (3, 3) and bool(np.isfinite(gradient).all())


# ---- the usual tests ---------------------------------------------------------------------------------------------------

AXIAL = np.diag([0.0, 0.0, -1.0])
AXIAL_DEVIATOR = "sigma_zz - 0.5*sigma_xx - 0.5*sigma_yy"
MEAN_OF_SIDES = "0.5*sigma_xx + 0.5*sigma_yy"


def controlled(control: str) -> dict[str, Any]:
    """What a control of CONTROLS leaves free and holds, as the arguments `free` and `stress` of Step."""
    if not isinstance(control, str) or control not in CONTROLS:
        raise ValueError(f"control {control!r}: must be one of {', '.join(CONTROLS)}")
    free, held = CONTROLS[control]
    return {"free": free, "stress": dict.fromkeys(held, "hold")}


def shear(strain: float, control: str = "volume", increments: int = 200, until: str = "") -> Step:
    """Simple shear du_x/dz.

    Parameters
    ----------
    strain : float
        Signed shear strain.
    control : str
        What is held, from CONTROLS: "volume", "pressure", "normal-stresses" or "normal-load".
    increments : int
    until : str
        As in Step.

    Returns
    -------
    Step
    """
    name = f"shear {strain:g}" if is_finite_number(strain) else "shear"
    return Step(name, SHEAR, strain, increments, until=until, shear=True, **controlled(control))


def cycles(amplitude: float, number: int, control: str = "volume", increments: int = 100) -> list[Step]:
    """Cyclic simple shear in which the shear strain runs between 0 and an amplitude, as in figure 10.

    Parameters
    ----------
    amplitude : float
        Shear strain.
    number : int
        Number of cycles, each of a step by +amplitude and a step by -amplitude.
    control : str
        What is held, from CONTROLS.
    increments : int
        Of each step.

    Returns
    -------
    list of Step
    """
    refuse("the cycles cannot be made", _faults_of_cycles(number))
    return [shear(sign * amplitude, control, increments) for _ in range(number) for sign in (1, -1)]


def _faults_of_cycles(number: object, **amplitudes: object) -> list[str]:
    faults = [] if is_positive_integer(number) else [f"number of cycles = {number!r}: must be {COUNT}"]
    return faults + [f"{name} = {value!r}: must be a finite number other than 0" for name, value in amplitudes.items()
                     if not is_finite_number(value) or value == 0]


def deform(velocity_gradient: ArrayLike | Callable[[float], ArrayLike], strain: float = 1.0, control: str = "volume",
           increments: int = 200, until: str = "") -> Step:
    """Any deformation, grad u = strain * velocity_gradient.

    Parameters
    ----------
    velocity_gradient : array (3, 3), or function of the strain measure that returns one
    strain : float
        Strain measure over which the gradient acts.
    control : str
        What is held, from CONTROLS.
    increments : int
    until : str
        As in Step.

    Returns
    -------
    Step
    """
    return Step("deformation", velocity_gradient, strain, increments, until=until, **controlled(control))


def pause() -> Step:
    """No deformation in one increment: the state stays as it is."""
    return Step("pause", increments=1)


def isotropic_compression(compression: float | None = None, pressure: float | None = None, increments: int = 100,
                          until: str = "") -> Step:
    """Isotropic compression by a strain or to a pressure.

    Parameters
    ----------
    compression : float, optional
        Logarithmic volume strain, compression positive.
    pressure : float, optional
        Mean pressure at the end, in k/d; give either this or the compression.
    increments : int
    until : str
        As in Step.

    Returns
    -------
    Step
    """
    if (compression is None) == (pressure is None):
        raise ValueError("isotropic compression: give either compression or pressure")
    if compression is None:
        return Step("isotropic compression", increments=increments, free=("volume_strain",), stress={"p": pressure}, until=until)
    return Step("isotropic compression", -np.eye(3) / 3, compression, increments, until=until)


def biaxial(compression: float, drained: bool = True, increments: int = 200, until: str = "") -> Step:
    """Plane-strain biaxial compression along z, e_yy = 0.

    Parameters
    ----------
    compression : float
        Logarithmic strain along z, compression positive.
    drained : bool
        True holds sigma_xx, False the volume.
    increments : int
    until : str
        As in Step.

    Returns
    -------
    Step
    """
    if drained:
        return Step("drained biaxial", AXIAL, compression, increments, ("e_xx",), {"sigma_xx": "hold"}, until)
    return Step("undrained biaxial", np.diag([1.0, 0, -1]), compression, increments, until=until)


def triaxial(compression: float, drained: bool = True, increments: int = 200, until: str = "") -> Step:
    """Triaxial compression along z, e_xx = e_yy.

    Parameters
    ----------
    compression, increments, until
        As in biaxial.
    drained : bool
        True holds (sigma_xx + sigma_yy)/2, False the volume.

    Returns
    -------
    Step
    """
    if drained:
        return Step("drained triaxial", AXIAL, compression, increments, ("e_xx + e_yy",), {MEAN_OF_SIDES: "hold"}, until)
    return Step("undrained triaxial", np.diag([0.5, 0.5, -1]), compression, increments, until=until)


def cyclic_triaxial(number: int, stress_amplitude: float, drained: bool = True, increments: int = 100,
                    until: str = "") -> list[Step]:
    """Triaxial cycles under controlled stress: sigma_zz - (sigma_xx + sigma_yy)/2 goes to and fro between + and - an amplitude.

    Parameters
    ----------
    number : int
        Number of cycles, each of a step to the compression and a step to the extension.
    stress_amplitude : float
        In k/d.
    drained : bool
        True holds (sigma_xx + sigma_yy)/2, False the volume.
    increments : int
        Of each step.
    until : str
        As in Step, of each step.

    Returns
    -------
    list of Step
        Give the material an elastic strain: with e_r = 0 the stress jumps at each reversal.
    """
    refuse("the triaxial cycles cannot be made", _faults_of_cycles(number, stress_amplitude=stress_amplitude))
    free = ("e_zz", "e_xx + e_yy") if drained else ("2*e_zz - e_xx - e_yy",)
    held = {MEAN_OF_SIDES: "hold"} if drained else {}
    name = "drained" if drained else "undrained"
    return [Step(f"{name} triaxial to q = {q:g}", increments=increments, free=free, stress={AXIAL_DEVIATOR: q} | held, until=until)
            for q in (stress_amplitude, -stress_amplitude) * number]


def oedometer(compression: float | None = None, sigma_zz: float | None = None, increments: int = 100, until: str = "") -> Step:
    """Compression along z without strain along x and y, by a strain or to a vertical stress.

    Parameters
    ----------
    compression : float, optional
        Logarithmic strain along z, compression positive.
    sigma_zz : float, optional
        Vertical stress at the end, in k/d; give either this or the compression.
    increments, until
        As in Step.

    Returns
    -------
    Step
    """
    if (compression is None) == (sigma_zz is None):
        raise ValueError("oedometer: give either compression or sigma_zz")
    if compression is None:
        return Step("oedometer", increments=increments, free=("e_zz",), stress={"sigma_zz": sigma_zz}, until=until)
    return Step("oedometer", AXIAL, compression, increments, until=until)


def direct_shear(strain: float, control: str = "normal-load", increments: int = 200, until: str = "") -> Step:
    """Direct simple shear (DSS): shear du_x/dz without strain along x and y, drained or undrained.

    Parameters
    ----------
    strain : float
        Signed shear strain.
    control : str
        From CONTROLS: "normal-load" is the drained test, "volume" the undrained one.
    increments, until
        As in Step.

    Returns
    -------
    Step
    """
    return shear(strain, control, increments, until)


def cyclic_direct_shear(number: int, amplitude: float | None = None, stress_amplitude: float | None = None,
                        control: str = "volume", increments: int = 100, until: str = "") -> list[Step]:
    """Cyclic direct simple shear to both sides, of controlled strain or stress.

    Parameters
    ----------
    number : int
        Number of cycles, each of a step to one side and a step to the other.
    amplitude : float, optional
        Shear strain on either side of where the test begins.
    stress_amplitude : float, optional
        Shear stress -sigma_xz on either side of 0, in k/d; give either this or the amplitude.
    control : str
        From CONTROLS: "volume" is the undrained test, "normal-load" the drained one.
    increments : int
        Of each step.
    until : str
        As in Step, of each step.

    Returns
    -------
    list of Step
    """
    if (amplitude is None) == (stress_amplitude is None):
        raise ValueError("cyclic direct simple shear: give either amplitude or stress_amplitude")
    if amplitude is not None:
        refuse("cyclic direct simple shear cannot be made", _faults_of_cycles(number, amplitude=amplitude))
        strains = (amplitude, *((-2 * amplitude, 2 * amplitude) * number)[:2 * number - 1])
        return [shear(strain, control, increments, until) for strain in strains]
    refuse("cyclic direct simple shear cannot be made", _faults_of_cycles(number, stress_amplitude=stress_amplitude))
    assert stress_amplitude is not None
    held = controlled(control)
    return [Step(f"shear to a stress of {stress:g}", increments=increments, free=("gamma", *held["free"]),
                 stress={"-sigma_xz": stress} | held["stress"], until=until, shear=True)
            for stress in (stress_amplitude, -stress_amplitude) * number]
