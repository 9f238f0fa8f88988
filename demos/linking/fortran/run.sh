#!/bin/sh
# Builds and runs shear with an installation of granumat.
exec "$(dirname "$0")/../run.sh" fortran shear
