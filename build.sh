#!/bin/sh
# Installs the Debian packages that are missing (Debian 12, 13), then builds: ./build.sh [release] [debug]
set -eu
cd "$(dirname "$0")"
export PATH=/usr/sbin:/usr/bin:/sbin:/bin  # Debian's own tools, whatever else is on PATH

for preset in "$@"; do
  case $preset in
    release | debug) ;;
    *) echo "usage: ./build.sh [release] [debug]" >&2; exit 2 ;;
  esac
done

# openssh-client: Open MPI looks for ssh even on one machine. MORE_PACKAGES: what the caller needs.
./install-packages.sh gfortran gcc libc6-dev cmake ninja-build python3 python3-dev \
  python3-numpy python3-scipy python3-matplotlib python3-pytest \
  python3-dolfinx libopenblas0 openssh-client ${MORE_PACKAGES-}

for preset in "${@:-release}"; do
  echo "Building granumat into build/$preset, at most a minute"
  cmake --preset "$preset" >/dev/null
  cmake --build --preset "$preset" -- --quiet
done
