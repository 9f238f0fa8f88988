"""How the modules of the Python package depend on each other: downward only, and through public names only."""

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.release_only

PACKAGE = Path(__file__).parents[1] / "python" / "granumat"
FILES = sorted(PACKAGE.rglob("*.py"))
OF_NAMED_TUPLES = {"_replace", "_asdict", "_fields", "_make"}         # public, with an underscore for lack of better names


def module_name(file):
    """granumat.fem.problem, or granumat.fem for its __init__.py."""
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(file): ast.parse(file.read_text(encoding="utf-8")) for file in FILES}
PACKAGES = {module_name(file) for file in FILES if file.name == "__init__.py"}


def imports(name):
    """All that a module imports, also inside functions: modules of the package by their full names, others by their first."""
    found = set()
    for node in ast.walk(MODULES[name]):
        if isinstance(node, ast.Import):
            found |= {full_name(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = name.split(".") if name in PACKAGES else name.split(".")[:-1]
            base = base[:len(base) - node.level + 1] if node.level else []
            source = ".".join(base + ([node.module] if node.module else []))
            members = {f"{source}.{alias.name}" for alias in node.names}
            modules = {member for member in members if member in MODULES or member == "granumat._core"}
            found |= {full_name(module) for module in modules} | ({full_name(source)} if members - modules else set())
    return found


def full_name(module):
    """The name of a module of the package, or the package of another."""
    return module if module.split(".")[0] == "granumat" else module.split(".")[0]


def test_the_import_graph_has_no_circle():
    graph = {name: imports(name) & set(MODULES) for name in MODULES}
    assert "granumat.core" in graph["granumat.material"]                       # the graph is not empty by mistake
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_only_core_imports_the_compiled_module():
    assert [name for name in MODULES if "granumat._core" in imports(name)] == ["granumat.core"]


def test_only_the_command_imports_studies():
    users = {name for name in MODULES if any(found.startswith("granumat.studies") for found in imports(name))}
    assert {name for name in users if not name.startswith("granumat.studies")} == {"granumat.cli"}


def test_nothing_outside_fem_needs_dolfinx():
    needy = {name for name in MODULES if imports(name) & {"dolfinx", "mpi4py", "petsc4py", "basix", "ufl"}}
    assert {name for name in needy if not name.startswith("granumat.fem")} == {
        "granumat.cli", "granumat.studies.bench_fem"}                          # the command imports them where it solves a scene


@pytest.mark.parametrize("module", ["granumat", "granumat.cli"])
def test_what_starts_quickly_loads_neither_matplotlib_nor_scipy_nor_dolfinx(module):
    program = f"import sys, {module}; print({{'matplotlib', 'scipy', 'dolfinx', 'mpi4py'}} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "set()\n"


@pytest.mark.parametrize("name", MODULES)
def test_no_private_name_crosses_a_file(name):
    tree = MODULES[name]
    own = {node.name for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    own |= {node.attr for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and is_self(node.value)}
    foreign = [f"line {node.lineno}: {ast.unparse(node)}" for node in ast.walk(tree)
               if isinstance(node, ast.Attribute) and is_private(node.attr) and not is_self(node.value)
               and node.attr not in own | OF_NAMED_TUPLES]
    foreign += [f"line {node.lineno}: imports {alias.name}" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
                for alias in node.names if is_private(alias.name) and alias.name not in ("_core", "_compat")]
    assert not foreign


def is_private(name):
    return name.startswith("_") and not name.endswith("__")


def is_self(node):
    """self, cls or super()."""
    return ast.unparse(node) in ("self", "cls", "super()")
