#!/bin/sh
# Builds granumat, installs it under /usr/local and draws the figures into results/figures.
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
