#!/bin/sh
# Builds the CalculiX that can load a UMAT, from Debian's source with one flag more: build/calculix/ccx. Debian's binary has no
# loader, and Debian 13 has neither CalculiX nor its solver SPOOLES, so both come from the part of the mirror that is Debian 12.
# Once built, it stays. Exit status 69: nothing could be downloaded.
set -eu
cd "$(dirname "$0")/../../.."
export PATH=/usr/sbin:/usr/bin:/sbin:/bin  # Debian's own tools, whatever else is on PATH
root=$PWD
place=$root/build/calculix
[ ! -x "$place/ccx" ] || exit 0

# The mirror that apt has, in an apt configuration of its own.
work=$(mktemp -d)  # its makefiles take no path with a blank
trap 'rm -rf "$work"' EXIT
mkdir -p "$place" "$work/lists/partial" "$work/cache/archives/partial"
cd "$work"
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Component: main' | grep -m1 '/debian/$') || exit 69
for type in deb deb-src; do
  echo "$type [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $mirror bookworm main"
done > sources.list
apt() {
  apt-get -qq -o APT::Sandbox::User=root -o Dir::Etc::sourcelist="$work/sources.list" -o Dir::Etc::sourceparts=/dev/null \
    -o Dir::State::lists="$work/lists" -o Dir::Cache="$work/cache" "$@"
}
echo "Downloading CalculiX's source and SPOOLES of Debian 12 from $mirror"
{ apt update && apt source --download-only calculix-ccx && apt download libspooles-dev; } || exit 69

"$root/install-packages.sh" dpkg-dev debhelper gfortran libarpack2-dev liblapack-dev

# Static, so that what is linked from it needs no MPI; where the compiler and the linker look.
dpkg --extract libspooles-dev_*.deb spooles
rm spooles/usr/lib/*/libspooles.so
CPATH=$work/spooles/usr/include/spooles
LIBRARY_PATH=$(echo "$work"/spooles/usr/lib/*-linux-gnu)
export CPATH LIBRARY_PATH

# Without optimisation: for these small jobs the compiler costs more than it saves.
echo "Building CalculiX, some minutes; the log is $place/log"
dpkg-source --extract calculix-ccx_*.dsc source > "$place/log" 2>&1
cd source
flag=-DCALCULIX_EXTERNAL_BEHAVIOURS_SUPPORT
DEB_BUILD_OPTIONS="parallel=$(nproc)" DEB_CFLAGS_STRIP=-g DEB_FFLAGS_STRIP=-g DEB_FFLAGS_APPEND="-w -O0 -fopenmp" \
  DEB_CFLAGS_APPEND="-w -O0 -std=gnu99 -Wno-implicit-function-declaration -Wno-incompatible-pointer-types $flag" \
  debian/rules build >> "$place/log" 2>&1
mv ccx_2.20/src/ccx_2.20 "$place/ccx"
