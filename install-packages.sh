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

echo "Installing Debian packages${sudo:+ with sudo}, at most some minutes:$missing"
log=$(mktemp)
trap 'rm "$log"' EXIT
apt() {
  $sudo env LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive apt-get -y --no-install-recommends "$@" 2>&1
}
quietly() {
  apt "$@" >"$log" || { cat "$log" >&2; exit 1; }
}
quietly update
apt --download-only install $missing | sed -nu '/^Need to get /p; /^After this operation, /p'
quietly install $missing
