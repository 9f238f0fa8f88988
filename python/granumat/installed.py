"""Where the files for other codes are, in a wheel, below a prefix, or in the build tree."""

from pathlib import Path

PACKAGE = Path(__file__).parent
FILES = {
    "source": ("share/granumat/granumat_umat.f90", "the UMAT as one Fortran source"),
    "library": ("lib/libGRANUMAT.so", "the UMAT as a shared library"),
    "header": ("include/granumat.h", "the C header"),
    "cmake": ("lib/cmake/granumat", "the folder for find_package: cmake -Dgranumat_DIR="),
    "pkg-config": ("lib/pkgconfig", "the folder for pkg-config: PKG_CONFIG_PATH="),
}
"""Name -> path below the prefix, what it is."""


def find(name: str) -> Path:
    """Absolute path of one of FILES.

    In a wheel the package's own folder is the prefix. In the build tree, which is not laid out as a prefix, only the source and
    the library are there, beside the folder of the Python package.

    Raises
    ------
    FileNotFoundError
        It is not there.
    """
    path = Path(FILES[name][0])
    for prefix in (PACKAGE, *PACKAGE.parents[:4]):
        if (prefix / path).exists():
            return prefix / path
    in_build = PACKAGE.parents[1] / path.name
    if in_build.suffix and in_build.exists():
        return in_build
    raise FileNotFoundError(f"there is no {path} with the package in {PACKAGE}: a build tree has only the UMAT's source "
                            "and library; `cmake --install build/release --prefix DIR`, or `pip install .`, installs the rest")
