#!/bin/sh
# Installs the Debian packages that are missing (Debian 12, 13), then builds: ./build.sh [release] [debug]
set -eu
cd "$(dirname "$0")"
export PATH=/usr/sbin:/usr/bin:/sbin:/bin  # Debian's own tools, whatever else is on PATH

# openssh-client: Open MPI looks for ssh even on one machine.
./install-packages.sh gfortran gcc libc6-dev cmake ninja-build python3 python3-dev \
  python3-numpy python3-scipy python3-matplotlib python3-pytest \
  python3-dolfinx libopenblas0 openssh-client

for preset in "${@:-release}"; do
  cmake --workflow --preset "$preset"
done
