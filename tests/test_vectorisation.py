"""Loops over the lanes are vector instructions, which GCC gives up silently for small things: counted in the built libraries.

Only floating-point arithmetic counts. What is scalar by nature is little: the bounds that depend on the constants alone.
"""

import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

import granumat

LIBRARIES = sorted(Path(granumat.__file__).parent.glob("lib/glibc-hwcaps/x86-64-v[34]/libgranumat_core.so"))
MODULES = "law|stress|state|fabric|coordination|relaxation|substeps|tangent|update|quadrature|tensors"
ROUTINE = re.compile(rf"^[0-9a-f]+ <__granumat_({MODULES})_MOD_(\w+).*>:$")
ARITHMETIC = re.compile(r"^ +[0-9a-f]+:\s+v(?:add|sub|mul|div|fn?m(?:add|sub)\d+)([ps])d\s(.*)$")
COUNTED_FROM = 50                    # instructions of a routine: smaller ones are not where the time goes
SCALAR, SCALAR_SHARE = 10, 0.01      # allowed: so many and this share

pytestmark = [pytest.mark.release_only, pytest.mark.skipif(not LIBRARIES, reason="no libraries of x86-64-v3 and v4 in this build")]


def count(library):
    """routine -> how many arithmetic instructions are "scalar", "vector" (of at least four numbers) and "short" (of two)."""
    listing = subprocess.run(["objdump", "-d", "--no-show-raw-insn", library], capture_output=True, text=True, check=True).stdout
    routines, current = {}, Counter()
    for line in listing.splitlines():
        if line.endswith(">:"):
            name = ROUTINE.match(line)
            current = routines.setdefault("_".join(name.groups()), Counter()) if name else Counter()
        elif found := ARITHMETIC.match(line):
            current["scalar" if found[1] == "s" else "vector" if re.search("%[yz]mm", found[2]) else "short"] += 1
    return routines


@pytest.mark.parametrize("library", LIBRARIES, ids=[library.parent.name for library in LIBRARIES])
def test_the_exact_update_and_its_tangent_are_vector_instructions(library):
    routines = {name: found for name, found in count(library).items() if found.total() >= COUNTED_FROM}
    assert sum(found["vector"] for found in routines.values()) > 1000
    for name, found in routines.items():
        assert found["scalar"] + found["short"] <= SCALAR + SCALAR_SHARE * found.total(), (name, found)
