"""Pictures of fields on the deformed mesh."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import refuse
from ..files import replacing
from .cellwise import VertexMesh, on_rank_0
from .fields import SCALAR_FIELDS, cell_fields, check_fields, field_label
from .output import Output
from .problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNJAMMED_GREY = "0.75"


class Pictures(Output):
    """A field on the deformed mesh (in three dimensions on its surface) as PNG, one a record, FIELD-INCREMENT.png.

    Where the mesh does not follow the material, cells that are unjammed (p = 0) are grey: what they have is no result.

    Parameters
    ----------
    directory : path
    field : str
        A scalar field or a component of cell_fields, such as "p" or "sigma_xx".
    every, times
        As in Fields.

    Raises
    ------
    ValueError
        There is no such field.
    """

    def __init__(self, directory: str | Path, field: str = "p", every: int | None = None, times: Sequence[float] = ()) -> None:
        super().__init__(Path(directory) / field, every, times)
        faults: list[str] = []
        check_fields([field], SCALAR_FIELDS, faults)
        refuse("the picture cannot be drawn", faults)
        self.field = field
        self._mesh: VertexMesh | None = None

    def _write(self, problem: Problem) -> None:
        if self._mesh is None:
            self._mesh = VertexMesh(problem.body)
        mesh = self._mesh
        positions = mesh.gather(problem.positions + problem.displacement)
        fields = cell_fields(problem, [self.field, "unjammed"])
        values = mesh.order.gather(fields[self.field])
        unjammed = mesh.order.gather(fields["unjammed"] > 0.5) if problem.moving_mesh is not None else None

        def draw() -> None:
            polygons, cells = mesh.polygons()
            hertzian = problem.material.contact == "hertzian"
            label = field_label(self.field).replace("\\,d/k", "/k_{Hz}" if hertzian else "\\,d/k")
            shown = values if unjammed is None else np.ma.masked_array(values, unjammed)
            figure = field_figure(positions[polygons], shown[cells], label, f"t = {problem.t:.6g}")
            with replacing(f"{self.path}-{problem.increments:06d}.png") as partial:
                figure.savefig(partial, dpi=130, format="png")
        on_rank_0(problem.comm, draw)


def field_figure(polygons: np.ndarray, values: np.ndarray, label: str, title: str = "") -> "Figure":
    """Polygons (n, corners, d) in the colours of their values (n), with a colour bar; grey where they are masked.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.collections import PolyCollection  # here, as few ranks and runs draw
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection
    in_space = polygons.shape[-1] == 3
    low, high = polygons.min(axis=(0, 1)), polygons.max(axis=(0, 1))
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.add_subplot(projection="3d" if in_space else None)
    collection = (Poly3DCollection if in_space else PolyCollection)(polygons, cmap="viridis", linewidths=0, antialiaseds=False)
    collection.set_array(values)
    collection.set_cmap(collection.get_cmap().with_extremes(bad=UNJAMMED_GREY))
    if in_space:
        axes.add_collection3d(collection)
        axes.set_box_aspect(high - low)
        axes.locator_params(axis="z", nbins=3)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), zlabel="z")
    else:
        axes.add_collection(collection)
        axes.autoscale_view()
        axes.set_aspect("equal")
    axes.set(xlabel="x", ylabel="y", title=title)
    figure.colorbar(collection, ax=axes, label=label, shrink=0.8)
    return figure
