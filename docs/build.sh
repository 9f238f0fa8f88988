#!/bin/sh
# Builds the site of the documentation into build/docs, or the directory given: docs/build.sh [DIRECTORY]
set -eu
cd "$(dirname "$0")/.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin  # Debian's own tools, whatever else is on PATH
./install-packages.sh python3-sphinx python3-myst-parser python3-numpydoc furo libjs-katex
[ -d build/release/python ] || ./build.sh release
export PYTHONPATH="${PYTHONPATH:+$PYTHONPATH:}$PWD/build/release/python"
/usr/bin/python3 -m sphinx -q -W --keep-going -E -b html docs "${1:-build/docs}"
