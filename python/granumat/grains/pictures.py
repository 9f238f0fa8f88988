"""The picture of a measured run with what models give for it."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..plotting import LABELS
from .predicted import Prediction
from .scores import QUANTITIES, Yardstick

NORMAL_STRESS_DIFFERENCES = {"N1/p": "$N_1/p$", "N2/p": "$N_2/p$"}
MEASURED = "0.35"           # grey of what was measured


def run_figure(yardstick: Yardstick, predictions: Mapping[str, Prediction]) -> Figure:
    """Draw a run and predictions against the accumulated shear strain.

    Parameters
    ----------
    yardstick : Yardstick
        Of the run.
    predictions : dict of str to Prediction
        By the names of the models.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each of QUANTITIES that counts. Points are measured, pale where they do not count; bands are the scatter
        of the seeds, one standard deviation to each side.
    """
    run = yardstick.run
    shown = [name for name, counted in zip(QUANTITIES, yardstick.measured.T) if not np.isnan(counted).all()]
    columns = -(-len(shown) // 2)
    figure = Figure(figsize=(3.7 * columns, 6.5), layout="constrained")
    figure.suptitle(f"{run.name}: $\\mu$ = {run.mu:g}, $\\phi$ = {run.columns['phi'][0]:.4g}")
    for axes, name in zip(figure.subplots(2, columns, squeeze=False).flat, shown):
        draw_quantity(axes, yardstick, predictions, name)
    figure.axes[0].legend(frameon=False)
    for axes in figure.axes[len(shown):]:
        axes.remove()
    return figure


def draw_quantity(axes: Axes, yardstick: Yardstick, predictions: Mapping[str, Prediction], name: str) -> None:
    """Draw one of QUANTITIES into axes, as in a panel of `run_figure`."""
    run = yardstick.run
    gamma, measured = run.columns["gamma_total"], run.columns[name]
    if run.scatter:
        scatter = run.scatter[name]
        axes.fill_between(gamma, measured - scatter, measured + scatter, color=MEASURED, alpha=0.2, linewidth=0)
    axes.plot(gamma, measured, ".", color=MEASURED, alpha=0.25, markersize=3)
    axes.plot(gamma, yardstick.measured[:, QUANTITIES.index(name)], ".", color=MEASURED, markersize=3, label="measured")
    for model, prediction in predictions.items():
        axes.plot(gamma, prediction.columns[name], linewidth=1.2, label=model)
    axes.set(xlabel=LABELS["gamma_total"], ylabel=(LABELS | NORMAL_STRESS_DIFFERENCES)[name])
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(linewidth=0.3)
