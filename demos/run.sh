#!/bin/sh
# Builds granumat, installs it under /usr/local, draws the figures into results/figures and runs a scene on two ranks.
set -eu
cd "$(dirname "$0")/.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
./build.sh release

sudo=
[ "$(id -u)" = 0 ] || sudo=sudo
echo "Installing granumat under /usr/local${sudo:+ (with sudo)}"
$sudo /usr/bin/cmake --install build/release --prefix /usr/local

export MPLBACKEND=Agg OMP_NUM_THREADS=1
/usr/local/bin/granumat figures --out results/figures

export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
mpirun --oversubscribe --mca mpi_yield_when_idle 1 -n 2 /usr/local/bin/granumat solve demos/scenes/annulus-coarse.toml --out results/annulus
