#!/bin/sh
# Tests the debug build in what depends on the build, then the release build in everything; arguments go to the last pytest.
# ./tests/run.sh --quick: the release build only, without slow tests. There are as many processes as processors, at most 8, each of
# which takes a file of tests at a time.
set -eu
cd "$(dirname "$0")/.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
export PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 MPLBACKEND=Agg
export MORE_PACKAGES="python3-pytest-xdist python3-gmsh python3-sphinx python3-myst-parser python3-numpydoc furo libjs-katex"

tests_of() {
  build=$1
  shift
  PYTHONPATH=$PWD/build/$build/python /usr/bin/python3 -m pytest -p no:cacheprovider -n auto --maxprocesses 8 --dist loadfile "$@"
}

if [ "${1-}" = --quick ]; then
  shift
  ./build.sh release
  tests_of release -m "not slow" "$@"
else
  ./build.sh release debug
  status=0
  tests_of debug -m "not release_only" || status=$?
  tests_of release "$@" || status=$?
  exit $status
fi
