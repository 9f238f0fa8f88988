"""Scenes of which a part is modelled: a ring as one sector, a periodic box as a layer, three dimensions as plane strain.

The mesh's keys `sector`, `layer` and `plane` are the user's word that the solution has the symmetry; what can be checked of the
scene is checked.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .scene_data import Function, Region, Resting, Scene, SideConditions
from .symmetry import TENSORS, Symmetry, exchange_y_z

PLANE_CELLS = {"hexahedron": "quadrilateral", "tetrahedron": "triangle", None: None}
LAYER_COLUMNS = 2                   # so that a solution that does not stay uniform along x can show it


def modelled(scene: Scene) -> tuple[Scene, Symmetry]:
    """The scene of the part that is modelled, and how results of the whole body follow from it; the scene itself if it is all.

    Parameters
    ----------
    scene : Scene
        Without faults. Output and quantities stay those of the whole body.
    """
    symmetry = Symmetry()
    mesh = scene.mesh
    if mesh.get("plane"):
        across = _across(mesh)
        symmetry = Symmetry(across=across, thickness=mesh["size"][1] if across == 1 else mesh["height"])
        scene = _in_plane(scene, across)
    mesh = {name: value for name, value in scene.mesh.items() if name not in ("plane", "sector", "layer")}
    if scene.mesh.get("sector"):
        sectors = mesh["cells"][1]
        symmetry = replace(symmetry, sectors=sectors)
        mesh |= {"cells": [mesh["cells"][0], 1, *mesh["cells"][2:]], "angle": 2 * np.pi / sectors}
    if scene.mesh.get("layer"):
        width = LAYER_COLUMNS * mesh["size"][0] / mesh["cells"][0]
        symmetry = replace(symmetry, widths=(width, mesh["size"][0]))
        mesh |= {"size": [width, *mesh["size"][1:]], "cells": [LAYER_COLUMNS, *mesh["cells"][1:]]}
        scene = replace(scene, regions=[_of_any_x(region) for region in scene.regions])
    return replace(scene, mesh=mesh), symmetry


def _across(mesh: dict[str, Any]) -> int:
    """The axis that plane strain leaves out: y of a box, z of a hollow cylinder."""
    return 1 if mesh["kind"] == "box" else 2


def _sides_across(mesh: dict[str, Any]) -> tuple[str, str]:
    return ("front", "back") if mesh["kind"] == "box" else ("bottom", "top")


def _in_plane(scene: Scene, across: int) -> Scene:
    """The scene in plane strain, without the axis across."""
    mesh = dict(scene.mesh)
    for name in {"size", "grading", "cells"} & set(mesh):
        if mesh["kind"] == "box" or name == "cells":
            mesh[name] = _without(mesh[name], across)
    mesh.pop("height", None)
    mesh["cell"] = PLANE_CELLS[mesh.get("cell")]
    settings = dict(scene.settings)
    if "gravity" in settings:
        settings["gravity"] = _without(settings["gravity"], across)
    initial = scene.initial
    if across == 1 and not isinstance(initial, Resting):
        initial = exchange_y_z(np.array(initial).reshape(1))[0]
    sides = [_side_in_plane(side, across) for side in scene.conditions if side.on not in _sides_across(mesh)]
    regions = [region if region.box is None else replace(region, box=(_without(region.box[0], across),
                                                                      _without(region.box[1], across)))
               for region in scene.regions]
    return replace(scene, mesh=mesh, settings=settings, initial=initial, conditions=sides, regions=regions)


def _without(values: Sequence[float], axis: int) -> list[float]:
    return [value for i, value in enumerate(values) if i != axis]


def _side_in_plane(side: SideConditions, across: int) -> SideConditions:
    """A side of the scene in plane strain, whose components are numbered without the axis across."""
    def component(i: int) -> int:
        return i - (i > across)

    return replace(side, displacement={component(i): function for i, function in side.displacement.items() if i != across},
                   gradient={(component(i), component(j)): function for (i, j), function in side.gradient.items()},
                   traction={component(i): function for i, function in side.traction.items() if i != across},
                   platen=None if side.platen is None else component(side.platen),
                   periodic=None if side.periodic is None else component(side.periodic))


def _of_any_x(region: Region) -> Region:
    """A region that is a box, extended over all x, along which the body is uniform."""
    assert region.box is not None
    lowest, highest = region.box
    return replace(region, box=([-np.inf, *lowest[1:]], [np.inf, *highest[1:]]))


# ---- what a scene must be like ---------------------------------------------------------------------------------------

def reduction_faults(mesh: dict[str, Any], settings: dict[str, Any] | None, initial: np.void | Resting | None,
                     sides: Sequence[SideConditions] | None, regions: Sequence[Region], quantities: Sequence[str]) -> list[str]:
    """What of a scene contradicts the keys `sector`, `layer` and `plane` of its mesh; what is None has faults of its own."""
    faults: list[str] = []
    gravity = (settings or {}).get("gravity", [0.0])
    state = None if isinstance(initial, Resting) else initial
    if mesh.get("plane"):
        faults += [f"plane = true: {fault}" for fault in _plane_faults(mesh, gravity, state, sides, quantities)]
    if mesh.get("sector"):
        faults += [f"sector = true: {fault}" for fault in _sector_faults(gravity, state, sides, regions)]
    if mesh.get("layer"):
        faults += [f"layer = true: {fault}" for fault in _layer_faults(mesh, sides, regions)]
    return faults


def _plane_faults(mesh: dict[str, Any], gravity: Sequence[float], state: np.void | None,
                  sides: Sequence[SideConditions] | None, quantities: Sequence[str]) -> list[str]:
    if len(mesh["cells"]) == 2:
        return ["the scene is one of the plane already"]
    across, names = _across(mesh), _sides_across(mesh)
    axis, faults = "xyz"[across], []
    left_out = [side for side in sides or () if side.on in names]
    slips = all(any(side.on == name for side in left_out) for name in names) and all(_slips(side, across) for side in left_out)
    if sides is not None and not slips and not (len(left_out) == 1 and left_out[0].periodic == across):
        faults.append(f"{' and '.join(names)} must have displacement = {{ {axis} = 0 }} and nothing else"
                      + (", or be periodic" if across == 1 else ""))
    for side in sides or ():
        if side.on in names:
            continue
        if not _is_zero(side.displacement.get(across)) or not _is_zero(side.traction.get(across)) or side.platen == across:
            faults.append(f"{side.on} must not move and not be loaded along {axis}, which is left out")
        if any(across in axes for axes in side.gradient):
            faults.append(f"gradient of {side.on} must have nothing to do with {axis}, which is left out")
        if side.rotation is not None and across != 2:
            faults.append(f"rotation of {side.on} in the plane x y is none of the plane x z")
    if len(gravity) == 3 and gravity[across]:
        faults.append(f"gravity must have no component along {axis}")
    shears = {1: [3, 5], 2: [4, 5]}[across]
    if state is not None and any(np.any(state[name][shears]) for name in TENSORS):
        faults.append(f"the initial state must have no shear with {axis}")
    return faults + [f"there is no reaction of {name} in the plane" for name in names if any(
        of.endswith(f" of {name}") and of.startswith(("reaction", "moment")) for of in quantities)]


def _slips(side: SideConditions, component: int) -> bool:
    """Whether a side has a displacement of 0 across it, and nothing else."""
    return (list(side.displacement) == [component] and _is_zero(side.displacement[component]) and side.rotation is None
            and side.platen is None and side.pressure is None and not side.traction and not side.gradient)


def _is_zero(function: Function | None) -> bool:
    return function is None or not any(function.values)


def _sector_faults(gravity: Sequence[float], state: np.void | None, sides: Sequence[SideConditions] | None,
                   regions: Sequence[Region]) -> list[str]:
    faults = [f"rotation of {side.on} must be about [0, 0]" for side in sides or ()
              if side.rotation is not None and any(side.center)]
    if any(gravity[:2]):
        faults.append("gravity must be along the axis of the ring")
    if state is not None and any(np.any(state[name][3:]) or state[name][0] != state[name][1]
                                 for name in TENSORS):
        faults.append("the initial state must be the same in all directions about the axis of the ring")
    return faults + [f"region {region.name!r} must be a ring" for region in regions if region.box is not None]


def _layer_faults(mesh: dict[str, Any], sides: Sequence[SideConditions] | None, regions: Sequence[Region]) -> list[str]:
    faults = []
    if sides is not None and [side.periodic for side in sides if side.on in ("left", "right")] != [0]:
        faults.append("left and right must be periodic, and nothing else")
    if mesh["cells"][0] < LAYER_COLUMNS:
        faults.append(f"there must be at least {LAYER_COLUMNS} columns of cells")
    if mesh.get("grading", [1.0])[0] != 1:
        faults.append("columns must have the same width: no grading along x")
    faults += [f"rotation of {side.on} is not uniform along x" for side in sides or () if side.rotation is not None]
    faults += [f"gradient of {side.on} along x is not uniform along it" for side in sides or ()
               if any(j == 0 for _, j in side.gradient)]
    return faults + [f"region {region.name!r} must be a box, whose extent along x is disregarded" for region in regions
                     if region.ring is not None]
