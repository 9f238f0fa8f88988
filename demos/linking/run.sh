#!/bin/sh
# Builds and installs granumat below build/, then builds and runs a program with find_package(granumat): ./run.sh FOLDER PROGRAM
set -eu
cd "$(dirname "$0")"
root=$PWD/../..
"$root/build.sh" >/dev/null
cmake --install "$root/build/release" --prefix "$root/build/prefix" >/dev/null
cmake -G Ninja -S "$1" -B "$root/build/linking-$1" -DCMAKE_PREFIX_PATH="$root/build/prefix" -DCMAKE_BUILD_TYPE=Release >/dev/null
cmake --build "$root/build/linking-$1" >/dev/null
"$root/build/linking-$1/$2"
