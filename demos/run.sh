#!/bin/sh
# Builds granumat, installs it under /usr/local, or PREFIX, draws the figures into results/figures and runs a scene on two ranks.
set -eu
cd "$(dirname "$0")/.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
prefix=${PREFIX:-/usr/local}

sudo=
if ! { mkdir -p "$prefix" && [ -w "$prefix" ]; } 2>/dev/null; then
  sudo=sudo
  if ! { type sudo && sudo -v; } >/dev/null; then
    cat >&2 <<END
Nothing was built: to install granumat under $prefix takes root or sudo. Without them give a folder of your own, as in

  PREFIX=\$HOME/.local ./demos/run.sh

or use it from the build tree: docs/installing.md.
END
    exit 1
  fi
fi

./build.sh release
echo "Installing granumat under $prefix${sudo:+ with sudo}"
$sudo /usr/bin/cmake --install build/release --prefix "$prefix" >/dev/null
rm -f build/release/install_manifest.txt    # root's, if sudo wrote it: the next installation by another could not

export MPLBACKEND=Agg OMP_NUM_THREADS=1
"$prefix/bin/granumat" figures --out results/figures

export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
mpirun --oversubscribe --mca mpi_yield_when_idle 1 -n 2 \
  "$prefix/bin/granumat" solve demos/scenes/annulus-coarse.toml --out results/annulus --overwrite
