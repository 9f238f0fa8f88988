#!/bin/sh
# Builds and runs points with an installation of granumat.
exec "$(dirname "$0")/../run.sh" c points
