"""Scene files of small bodies, and what they leave when they are run: for the tests of `granumat.fem`."""

import numpy as np
import pytest

from granumat.fem import scene, scene_file

RING = """
[material]
elastic_strain = 0.01
[mesh]
kind = "annulus"
radii = [1, 2]
cells = [4, 12]
[initial]
state = "isotropic"
phi = 0.60
pressure = 0.01
[[condition]]
on = "inner"
rotation = [[0, 0], [10, 0.02]]
[[condition]]
on = "outer"
displacement = { circumferential = 0 }
platen = "radial"
pressure = 0.01
[run]
until = 3
increment = 1
"""

BOX = """
[material]
elastic_strain = 0.01
[mesh]
kind = "box"
size = [1, 0.5]
cells = [4, 2]
[initial]
state = "isotropic"
phi = 0.60
pressure = 0.007
[[condition]]
on = "bottom"
displacement = { x = 0, y = 0 }
[[condition]]
on = "top"
displacement = { x = [[0, 0], [3.5, 0.02], [10, -0.02]] }
platen = "y"
pressure = [[0, 0.007], [10, 0.008]]
[[condition]]
on = ["left", "right"]
periodic = true
[run]
until = 6
increment = 1
"""


def replaced(text, pairs):
    """A text with each key of pairs, which must be in it, replaced by its value."""
    for old, new in pairs.items():
        assert old in text, old
        text = text.replace(old, new)
    return text


def written(directory, text):
    """The file of a scene's text in a directory, which is made if it is not there."""
    directory.mkdir(exist_ok=True)
    (directory / "scene.toml").write_text(text)
    return directory / "scene.toml"


def faults(directory, text):
    """What is said of a scene file that is refused."""
    with pytest.raises(ValueError) as caught:
        scene_file.read_scene(written(directory, text))
    return str(caught.value)


def solved(directory, text):
    """The problem at the end of a scene that is run into directory/out, and the tables there by the names of their files."""
    problem, files = scene.solve(written(directory, text), directory / "out")
    assert all(file.exists() for file in files)
    return problem, {file.stem: read_table(file) for file in files if file.suffix == ".csv"}


def read_table(file):
    """A table with a line of names, as a record array of at least one row."""
    return np.genfromtxt(file, delimiter=",", names=True, ndmin=1)
