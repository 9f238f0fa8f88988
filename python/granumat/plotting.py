"""The figure of a history."""

from matplotlib.figure import Figure

from .history import History

PANELS = (
    ("p", "pressure $p\\,d/k$"), ("stress_ratio", "stress ratio $-\\sigma_{xz}/p$"), ("phi", "volume fraction $\\phi$"),
    ("Z2", "coordination number $Z_2$"), ("A_xz", "fabric $A_{xz}$"), ("sigma", "normal stresses $\\sigma\\,d/k$"),
)


def history_figure(history: History, title: str = "") -> Figure:
    """Draw a history against the accumulated strain: pressure, stress ratio, volume fraction, Z2, fabric, normal stresses.

    Parameters
    ----------
    history : granumat.driver.History
    title : str

    Returns
    -------
    matplotlib.figure.Figure
        Grey vertical lines separate the steps.
    """
    hertzian = history.material.contact == "hertzian"
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    figure.suptitle(title)
    strain = history["gamma_total"]
    boundaries = strain[1:][history["step"][1:] != history["step"][:-1]][1:]
    for axes, (name, label) in zip(figure.subplots(2, 3, sharex=True).flat, PANELS):
        if name == "sigma":
            for axis, style in (("xx", "-"), ("yy", "--"), ("zz", "-.")):
                axes.plot(strain, history[f"sigma_{axis}"], style, label=f"$\\sigma_{{{axis}}}$")
            axes.legend(frameon=False)
        else:
            axes.plot(strain, history[name])
        for boundary in boundaries:
            axes.axvline(boundary, color="0.8", linewidth=0.8, zorder=0)
        axes.set_ylabel(label.replace("\\,d/k", "/k_{Hz}") if hertzian else label)
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.grid(linewidth=0.3)
    for axes in figure.axes[3:]:
        axes.set_xlabel("accumulated strain $\\gamma$")
    return figure
