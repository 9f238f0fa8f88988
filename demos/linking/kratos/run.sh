#!/bin/sh
# Installs Kratos and builds the library where they are missing, strains one element and compares it with the driver: results/kratos.
set -eu
cd "$(dirname "$0")/../../.."
./build.sh release
demos/linking/kratos/build.sh
PYTHONPATH=$PWD/build/release/python OMP_NUM_THREADS=1 /usr/bin/python3 -W ignore demos/linking/kratos/run.py results/kratos
