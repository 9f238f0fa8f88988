"""Quantities of interest of a boundary-value problem: reactions, moments, probes, means over regions, in quantities.csv."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..checks import attempt, refuse
from ..history import column_name
from ..quantities import Quantity
from .conditions import Where
from .problem import Problem
from .symmetry import WHOLE, Symmetry
from .tables import POINT_COLUMNS, MaterialPoint, Table, point_columns, vector_as_json

PATTERNS = {"reaction": re.compile(r"reaction (?P<field>\w+) of (?P<place>.+)"),
            "moment": re.compile(r"moment (?:(?P<field>\w+) )?of (?P<place>.+)"),
            "mean": re.compile(r"mean (?P<field>\w+)(?: of (?P<place>.+))?"),
            "probe": re.compile(r"(?P<field>\w+) at (?P<place>.+)")}
FORMS = ('"reaction x of SIDE", "moment of SIDE" (in three dimensions "moment z of SIDE"), "FIELD at PROBE", "mean FIELD" or '
         '"mean FIELD of REGION"')

Region = Callable[[np.ndarray], np.ndarray]


class Source(NamedTuple):
    """What a quantity is of.

    Attributes
    ----------
    kind : str
        "reaction", "moment", "mean" or "probe".
    field : str
        Component of a reaction or moment, or column of points; "" for the moment in the plane.
    place : str
        Name of the side, probe or region; "" for the whole body.
    """

    kind: str
    field: str
    place: str


def read_source(of: str, d: int | None, sides: Collection[str] | None, probes: Collection[str] | None,
                regions: Collection[str] | None) -> Source:
    """Read what a quantity is of.

    Parameters
    ----------
    of : str
        "reaction x of SIDE", "moment of SIDE", in three dimensions "moment z of SIDE", "FIELD at PROBE", "mean FIELD" or "mean
        FIELD of REGION".
    d : int or None
        Dimension of the body; None if it is not known yet.
    sides, probes, regions : collection of str or None
        The names that there are; None if they are not known.

    Raises
    ------
    ValueError
        If there is no such quantity.
    """
    found = [(kind, match) for kind, pattern in PATTERNS.items() if (match := pattern.fullmatch(of))]
    if not found:
        raise ValueError(f"must be {FORMS}")
    kind, match = found[0]
    source = Source(kind, column_name(match["field"] or ""), match["place"] or "")
    faults: list[str] = []
    axes = "xyz"[:d]
    if kind == "moment" and d == 2 and source.field:
        faults.append("in plane strain there is one moment: moment of SIDE")
    elif kind == "moment" and d == 3 and source.field not in tuple(axes):
        faults.append("in three dimensions a moment has an axis: moment x, y or z of SIDE")
    elif source.field not in (*axes, *(("",) if kind == "moment" else ())) and kind in ("reaction", "moment"):
        faults.append(f"the component {source.field!r} must be one of {', '.join(axes)}")
    columns = (*axes, *POINT_COLUMNS) if kind == "probe" else POINT_COLUMNS
    if kind in ("probe", "mean") and source.field not in columns:
        faults.append(f"the field {source.field!r} must be one of {', '.join(columns)}")
    names, words = {"reaction": (sides, "side that a condition holds"), "moment": (sides, "side that a condition holds"),
                    "probe": (probes, "probe"), "mean": (regions, "region")}[kind]
    if source.place and names is not None and source.place not in names:
        faults.append(f"there is no {words} {source.place!r}: there are {', '.join(names) or 'none'}")
    if faults:
        raise ValueError("; ".join(faults))
    return source


class Quantities(Table):
    """An observer that writes the values of quantities of interest after every increment: columns t and the quantities' names.

    `granumat.quantities.read_values` reads them at the times that the quantities are wanted at; make these `events` of the run.

    Parameters
    ----------
    path : path
    quantities : sequence of Quantity
        `of` is one of "reaction x of SIDE", "moment of SIDE", in three dimensions "moment z of SIDE", "FIELD at PROBE", "mean
        FIELD" and "mean FIELD of REGION". FIELD is a column of Probe. Means are over the volume now.
    sides : dict of str to where, optional
        Parts of the boundary.
    probes : dict of str to sequence (d), optional
        Positions at the start, as in Probe.
    regions : dict of str to function of x (points, d), optional
        Which integration points belong to a region, by their positions at the start.
    center : sequence (d), optional
        Of the moments.
    symmetry : Symmetry, optional
        By which the problem's body is a part of the one whose quantities are wanted. Regions are those of the part.

    Raises
    ------
    ValueError
        Names every quantity that cannot be evaluated; a dimension or a region that does not fit the problem when the run begins.
    """

    def __init__(self, path: str | Path, quantities: Sequence[Quantity], sides: Mapping[str, Where] | None = None,
                 probes: Mapping[str, Sequence[float]] | None = None, regions: Mapping[str, Region] | None = None,
                 center: Sequence[float] | None = None, symmetry: Symmetry = WHOLE) -> None:
        super().__init__(path)
        self.quantities, self.sides, self.regions = tuple(quantities), dict(sides or {}), dict(regions or {})
        self.center, self.symmetry = center, symmetry
        self.probes = {name: MaterialPoint(position, symmetry) for name, position in (probes or {}).items()}
        self._sources = self._read_sources(None)
        self._points: dict[str, np.ndarray] | None = None        # this rank's points in each region

    def __call__(self, problem: Problem) -> None:
        if self._points is None:
            self._read_sources(self.symmetry.dimension(problem.d))
            self._points = self._points_of_regions(problem)
        super().__call__(problem)

    def write(self, problem: Problem) -> None:
        if problem.last is not None:                             # before that there is no reaction
            super().write(problem)

    def content(self) -> object:
        return {"of": {quantity.name: quantity.of for quantity in self.quantities}, "center": vector_as_json(self.center),
                "probes": {name: vector_as_json(probe.position) for name, probe in self.probes.items()},
                "regions": {name: repr(region) if is_dataclass(region) else "a function" for name, region in self.regions.items()}}

    def _read_sources(self, d: int | None) -> dict[str, Source]:
        faults: list[str] = []
        sources = {quantity.name: attempt(faults, f"{quantity.name}: of = {quantity.of!r}: ", read_source, quantity.of, d,
                                          self.sides, self.probes, self.regions) for quantity in self.quantities}
        if len(sources) < len(self.quantities):
            faults.append("two of them have the same name")
        refuse("the quantities cannot be evaluated", faults)
        return {name: source for name, source in sources.items() if source is not None}

    def _points_of_regions(self, problem: Problem) -> dict[str, np.ndarray]:
        x = problem.point_positions(at_start=True)
        names = {source.place for source in self._sources.values() if source.kind == "mean"}
        points = {name: np.flatnonzero(self.regions[name](x) if name else np.full(len(x), True)) for name in sorted(names)}
        refuse("the quantities cannot be evaluated", [f"the region {name!r} has no integration point"
                                                      for name, found in points.items() if problem.comm.allreduce(len(found)) == 0])
        return points

    def _write(self, problem: Problem) -> None:
        assert self._points is not None
        values: dict[tuple[str, str], Mapping[str, float]] = {}
        for kind, _, place in self._sources.values():
            if (kind, place) in values:
                continue
            if kind == "mean":
                values[kind, place] = self._means(problem, self._points[place])
            elif kind == "probe":
                values[kind, place] = self.probes[place].columns(problem)
            else:
                force, moment = self.symmetry.reaction(problem, self.sides[place], self.center)
                values["reaction", place] = dict(zip("xyz", force))
                values["moment", place] = {"": moment} if len(force) == 2 else dict(zip("xyz", moment))
        self.append_row(problem.comm, {"t": problem.t} | {
            name: values[source.kind, source.place][source.field] for name, source in self._sources.items()})

    def _means(self, problem: Problem, points: np.ndarray) -> dict[str, float]:
        """Means by volume of all columns over a region; collective."""
        volumes = problem.point_volumes()[points]
        columns = point_columns(problem, points, self.symmetry)
        sums = problem.comm.allreduce(np.array([volumes.sum(), *(volumes @ values for values in columns.values())]))
        return self.symmetry.mean(dict(zip(columns, sums[1:] / sums[0])))
