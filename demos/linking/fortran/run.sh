#!/bin/sh
# Builds and installs granumat below build/, then builds and runs this program with find_package(granumat).
set -eu
cd "$(dirname "$0")"
root=$PWD/../../..
"$root/build.sh" >/dev/null
cmake --install "$root/build/release" --prefix "$root/build/prefix" >/dev/null
cmake -G Ninja -S . -B "$root/build/linking-fortran" -DCMAKE_PREFIX_PATH="$root/build/prefix" -DCMAKE_BUILD_TYPE=Release >/dev/null
cmake --build "$root/build/linking-fortran" >/dev/null
"$root/build/linking-fortran/shear"
