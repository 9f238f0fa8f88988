"""Reading of the XDMF series that `granumat.fem.Fields` writes."""

import xml.etree.ElementTree as ElementTree

import numpy as np


def records(path):
    """The records of an XDMF series: time, and arrays by name."""
    def array(item):
        kind = {"Int": "<i4", "Float": "<f8"}[item.get("NumberType")]
        assert np.dtype(kind).itemsize == int(item.get("Precision")) and item.get("Endian") == "Little"
        shape = [int(n) for n in item.get("Dimensions").split()]
        return np.fromfile(path.parent / item.text, kind, int(np.prod(shape)), offset=int(item.get("Seek"))).reshape(shape)

    for grid in ElementTree.parse(path).getroot().iter("Grid"):
        if grid.find("Time") is not None:
            arrays = {attribute.get("Name"): array(attribute.find("DataItem")) for attribute in grid.findall("Attribute")}
            arrays |= {name: array(grid.find(f"{name}/DataItem")) for name in ("Topology", "Geometry")}
            yield float(grid.find("Time").get("Value")), grid.find("Topology").get("TopologyType"), arrays
