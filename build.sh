#!/bin/sh
# Installs the Debian packages that are missing (Debian 12, 13), then builds: ./build.sh [release] [debug]
set -eu
cd "$(dirname "$0")"
export PATH=/usr/sbin:/usr/bin:/sbin:/bin  # Debian's own tools, whatever else is on PATH

packages="gfortran gcc libc6-dev cmake ninja-build python3 python3-dev
  python3-numpy python3-scipy python3-matplotlib python3-pytest
  python3-dolfinx libopenblas0 openssh-client"  # the last: Open MPI looks for ssh even on one machine
missing=
for package in $packages; do
  dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed || missing="$missing $package"
done
if [ -n "$missing" ]; then
  sudo=
  [ "$(id -u)" = 0 ] || sudo=sudo
  echo "Installing Debian packages${sudo:+ with sudo}:$missing"
  $sudo apt-get -qq update
  $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq -y --no-install-recommends install $missing >/dev/null
fi

for preset in "${@:-release}"; do
  cmake --workflow --preset "$preset"
done
