#!/bin/sh
# Tests a wheel in a new virtual environment, away from the source: packaging/test-wheel.sh WHEEL [PYTHON]
set -eu
wheel=$(realpath "$1")
python=${2:-/usr/bin/python3}
cd "$(dirname "$0")/.."
export PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 MPLBACKEND=Agg PIP_DISABLE_PIP_VERSION_CHECK=1

environment=$(mktemp -d)
trap 'rm -r "$environment"' EXIT
"$python" -m venv "$environment"
"$environment/bin/pip" install --quiet "$wheel[test]"
"$environment/bin/python" -m pytest -p no:cacheprovider -m "not slow" tests/test_installation.py tests/test_umat.py tests/test_driver.py
