#!/bin/sh
# Tests the debug build, then the release build; arguments go to the last pytest.
set -eu
cd "$(dirname "$0")/.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
./install-packages.sh python3-gmsh
./build.sh release debug

export PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 MPLBACKEND=Agg
pytest="/usr/bin/python3 -m pytest -p no:cacheprovider"
status=0
PYTHONPATH=$PWD/build/debug/python $pytest || status=$?
PYTHONPATH=$PWD/build/release/python $pytest "$@" || status=$?
exit $status
