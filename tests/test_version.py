"""The version stands in python/granumat/__init__.py; what repeats it, repeats it."""

import re
from pathlib import Path

import granumat

ROOT = Path(__file__).parents[1]
BUILD = Path(granumat.__file__).parents[2]


def test_the_citation_names_the_version():
    assert re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1] == granumat.__version__


def test_the_newest_entry_of_the_changelog_is_of_the_version():
    assert re.search(r"^## (\S+) \(", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1] == granumat.__version__


def test_cmake_packages_carry_the_version():
    written = (BUILD / "granumat-config-version.cmake").read_text()
    assert re.search(r'PACKAGE_VERSION "(\S+)"', written)[1] == granumat.__version__
