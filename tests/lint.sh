#!/bin/sh
# Checks the style: ruff (Python), mypy (types) and fortitude (Fortran), configured in pyproject.toml, installed into build/lint.
set -eu
cd "$(dirname "$0")/.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
./install-packages.sh python3 python3-venv python3-numpy

wanted="ruff==0.17.6 mypy==2.4.1 fortitude-lint==0.10.0"
lint=$PWD/build/lint
if [ "$(cat "$lint/installed" 2>/dev/null)" != "$wanted" ]; then
  echo "Installing $wanted into build/lint"
  /usr/bin/python3 -m venv --clear "$lint"
  "$lint/bin/pip" install --quiet --disable-pip-version-check $wanted
  echo "$wanted" > "$lint/installed"
fi

status=0
"$lint/bin/ruff" check --quiet . || status=$?
"$lint/bin/mypy" --no-error-summary || status=$?
"$lint/bin/fortitude" check --quiet fortran || status=$?
exit $status
