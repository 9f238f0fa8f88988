#!/bin/sh
# Builds CalculiX and the UMAT where they are missing, runs all jobs, compares them with the driver: results/calculix.
set -eu
cd "$(dirname "$0")/../../.."
./build.sh release
demos/linking/calculix/build.sh
export PYTHONPATH=$PWD/build/release/python MPLBACKEND=Agg OMP_NUM_THREADS=1
/usr/bin/python3 demos/linking/calculix/run.py results/calculix
