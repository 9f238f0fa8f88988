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

"$root/install-packages.sh" dpkg-dev gcc make tcc gfortran libarpack2-dev liblapack-dev

# Static, so that what is linked from it needs no MPI; where the compilers and the linker look.
dpkg --extract libspooles-dev_*.deb spooles
rm spooles/usr/lib/*/libspooles.so
CPATH=$work/spooles/usr/include/spooles
LIBRARY_PATH=$(echo "$work"/spooles/usr/lib/*-linux-gnu)
export CPATH LIBRARY_PATH

# For these small jobs optimisation costs more than it saves, but in what is called at every integration point. The C compiler is
# tcc, seven times as fast as gcc, which takes the few files that tcc does not, those with arrays of variable length.
cat > cc <<'END'
#!/bin/sh
tcc "$@" 2>/dev/null || exec gcc -O0 -std=gnu99 -Wno-implicit-function-declaration -Wno-incompatible-pointer-types "$@"
END
chmod +x cc

echo "Building CalculiX, a minute or two; the log is $place/log"
dpkg-source --extract calculix-ccx_*.dsc source > "$place/log" 2>&1
cd source/ccx_2.20/src
hot="anisonl.f e_c3d.f resultsmech.f umat_abaqusnl.f"
# The other Fortran files 32 at a time: they are so many that to start the compiler for each takes longer than to compile them.
grep -o '[A-Za-z0-9_]*\.f\b' Makefile.inc | grep -vxF "$(printf '%s\n' $hot)" | split -l 32 --additional-suffix=.list - part-
for list in part-*.list; do
  xargs cat < "$list" > "${list%.list}.f"
done
{
  fortran="-std=legacy -fopenmp -w"
  make -j "$(nproc)" FFLAGS="$fortran -O1" $(echo $hot | sed 's/\.f\b/.o/g')
  make -j "$(nproc)" CC="$work/cc" FFLAGS="$fortran -O0" SCCXF="$hot $(echo part-*.f)" \
    CFLAGS="-w -DARCH=Linux -DSPOOLES -DARPACK -DMATRIXSTORAGE -DUSE_MT=1 -DCALCULIX_EXTERNAL_BEHAVIOURS_SUPPORT" \
    LDFLAGS="-no-pie $(tcc -print-search-dirs | grep -o '/.*/libtcc1\.a')"
} >> "$place/log" 2>&1
mv ccx_2.20 "$place/ccx"
