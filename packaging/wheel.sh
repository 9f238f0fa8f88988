#!/bin/sh
# Builds the wheel, puts the compiler's libraries into it and tests it in a virtual environment of its own: build/wheel/*.whl
#   packaging/wheel.sh [PYTHON]    path of the Python to build for, /usr/bin/python3 unless given; with its headers
set -eu
cd "$(dirname "$0")/.."
python=${1:-/usr/bin/python3}
export PATH=/usr/sbin:/usr/bin:/sbin:/bin  # Debian's own tools, whatever else is on PATH
export PIP_DISABLE_PIP_VERSION_CHECK=1
./install-packages.sh gfortran gcc libc6-dev cmake ninja-build python3 python3-dev python3-venv patchelf

place=$PWD/build/wheel
rm -rf "$place"
"$python" -m venv "$place/tools"
"$place/tools/bin/pip" install --quiet auditwheel
echo "Building the wheel"
"$place/tools/bin/pip" wheel --quiet --no-deps --wheel-dir "$place/unrepaired" .
"$place/tools/bin/auditwheel" repair --wheel-dir "$place" "$place"/unrepaired/granumat-*.whl

packaging/test-wheel.sh "$place"/granumat-*.whl "$python"
