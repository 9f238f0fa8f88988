"""The figure of a history, whose panels are those of the test."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from . import tensors
from .history import History

LABELS = {
    "p": "pressure $p\\,d/k$", "phi": "volume fraction $\\phi$", "Z2": "coordination number $Z_2$",
    "stress_ratio": "stress ratio $-\\sigma_{xz}/p$", "tau_over_sigma_n": "stress ratio $-\\sigma_{xz}/\\sigma_{zz}$",
    "q_over_p": "stress ratio $q/p$", "axial_q": "$q\\,d/k$ (extension negative)", "axial_ratio": "$q/p$ (extension negative)",
    "volume_strain": "volume strain (extension positive)", "A_xz": "fabric $A_{xz}$", "A": "fabric $A$",
    "sigma": "normal stresses $\\sigma\\,d/k$",
    "gamma_total": "accumulated shear strain $\\gamma$", "compression": "compression $-e_{zz}$",
    "volume_compression": "compression $-(e_{xx}+e_{yy}+e_{zz})$",
}
SEVERAL = ("A", "sigma")    # panels of the components xx, yy, zz
NEGLIGIBLE = 1e-8           # over the largest: strains and stresses below are not there, changes below are none (held: 1e-9)
MOST_PANELS = 6

# Abscissa, and the panels in order, by kind of test: of those in which something changes the first six are drawn.
PANELS = {
    "shear": ("gamma_total", ("stress_ratio", "p", "phi", "Z2", "A_xz", "sigma")),
    "shear under a normal load": ("gamma_total", ("tau_over_sigma_n", "p", "phi", "Z2", "A_xz", "sigma")),
    "axial": ("compression", ("axial_q", "axial_ratio", "volume_strain", "Z2", "A", "sigma", "p")),
    "isotropic": ("volume_compression", ("p", "phi", "Z2", "A", "sigma")),
    "other": ("gamma_total", ("p", "q_over_p", "phi", "Z2", "A", "sigma")),
}


def kind_of(history: History) -> str:
    """The kind of test that a history is of, a key of PANELS, from the strains and stresses that it has.

    In shear there is no shear strain but in x-z; it is under a normal load where sigma_zz stays and p does not. In axial tests the
    axes x, y, z are principal ones of strain and stress and the shape changes; in isotropic ones it does not. All else is "other".
    """
    deviator = tensors.deviator(np.column_stack([history[f"e_{axis}"] for axis in tensors.AXES]))
    largest, volume = np.abs(deviator).max(axis=0), np.abs(history["volume_strain"]).max()
    present = largest > NEGLIGIBLE * max(largest.max(), volume)
    if present[4] and not present[[3, 5]].any() and largest[4] >= largest[:3].max():
        held = [np.ptp(history[name]) <= NEGLIGIBLE * np.abs(history[name]).max() for name in ("sigma_zz", "p")]
        return "shear under a normal load" if held == [True, False] else "shear"
    stresses = np.abs([history[f"sigma_{axis}"] for axis in ("xy", "xz", "yz")])
    if present[3:].any() or stresses.max() > NEGLIGIBLE * np.abs(history["p"]).max():
        return "other"
    return "axial" if present.any() else "isotropic"


def history_figure(history: History, title: str = "") -> Figure:
    """Draw a history: up to six panels, chosen by the kind of test (PANELS), of what changes in it.

    Parameters
    ----------
    history : granumat.driver.History
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Shear is drawn against the accumulated shear strain, axial tests against the compression along z. Grey points are the ends
        of the steps.
    """
    abscissa, candidates = PANELS[kind_of(history)]
    curves = {name: _curves(history, name) for name in (abscissa, *candidates)}
    x, = curves[abscissa].values()
    panels = [name for name in candidates if any(np.ptp(y) > NEGLIGIBLE * np.abs(y).max() for y in curves[name].values())]
    panels = panels[:MOST_PANELS] or list(candidates[:1])
    columns = -(-len(panels) // 2)
    ends = np.flatnonzero(history["step"][1:] != history["step"][:-1])[1:]
    figure = Figure(figsize=(3.7 * columns, 6.5), layout="constrained")
    figure.suptitle(title)
    for axes, name in zip(figure.subplots(2, columns, squeeze=False).flat, panels):
        _draw_panel(axes, x, curves[name], ends)
        axes.set(xlabel=_label(history, abscissa), ylabel=_label(history, name))
    for axes in figure.axes[len(panels):]:
        axes.remove()
    return figure


def _curves(history: History, name: str) -> dict[str, np.ndarray]:
    """The curves of a panel, or its abscissa, by the axes of the component."""
    if name in SEVERAL:
        return {axis: history[f"{name}_{axis}"] for axis in ("xx", "yy", "zz")}
    if name in ("axial_q", "axial_ratio"):
        is_extension = 2 * history["sigma_zz"] < history["sigma_xx"] + history["sigma_yy"]
        return {"": np.where(is_extension, -1, 1) * history["q" if name == "axial_q" else "q_over_p"]}
    if name in ("compression", "volume_compression"):
        return {"": -history["e_zz" if name == "compression" else "volume_strain"]}
    return {"": history[name]}


def _label(history: History, name: str) -> str:
    label = LABELS[name]
    return label.replace("\\,d/k", "/k_{Hz}") if history.material.contact == "hertzian" else label


def _draw_panel(axes: Axes, x: np.ndarray, curves: dict[str, np.ndarray], ends: np.ndarray) -> None:
    for (component, y), style in zip(curves.items(), ("-", "--", "-.")):
        axes.plot(x, y, style, label=component)
        axes.plot(x[ends], y[ends], ".", color="0.6", markersize=4)
    if len(curves) > 1:
        axes.legend(frameon=False)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(linewidth=0.3)
