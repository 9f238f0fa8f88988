#!/bin/sh
# Installs those Debian packages that are missing: ./install-packages.sh PACKAGE ...
set -eu
missing=
for package in "$@"; do
  dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed || missing="$missing $package"
done
[ -n "$missing" ] || exit 0

sudo=
[ "$(id -u)" = 0 ] || sudo=sudo
if [ -n "$sudo" ] && ! { type sudo && sudo -v; } >/dev/null; then
  cat >&2 <<END
Debian packages are missing, which takes root or sudo to install, so nothing was built. An administrator may run

  apt-get update && apt-get install --no-install-recommends$missing

after which this goes on without root. Or install granumat with pip, without root where there is a compiler: docs/installing.md.
END
  exit 1
fi

echo "Installing Debian packages${sudo:+ with sudo}:$missing"
log=$(mktemp)
trap 'rm "$log"' EXIT
quietly() {
  $sudo env LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive apt-get -qq --no-install-recommends "$@" >"$log" 2>&1 || {
    cat "$log" >&2
    exit 1
  }
}
quietly update
env LC_ALL=C.UTF-8 apt-get --assume-no --no-install-recommends install $missing 2>&1 |
  sed -n 's/^\(Need to get .*\)\.$/\1, /p; s/^After this operation, \(.*\) of additional .*/\1 on disk; this takes some minutes/p' | tr -d '\n'
echo
quietly -y install $missing
