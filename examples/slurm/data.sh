#!/bin/bash
# Data set and surrogate of a recipe: a Dask worker a core samples, training takes one machine.
#
#   sbatch examples/slurm/data.sh RECIPE
#
# Sent again, it goes on with the samples and iterations that are there.
#SBATCH --job-name=data
#SBATCH --ntasks=64
#SBATCH --cpus-per-task=1
#SBATCH --time=02:00:00
set -eu
recipe=${1:-data/bending-bar.toml}
scheduler=tcp://$(hostname):$((20000 + SLURM_JOB_ID % 40000))

dask scheduler --port "${scheduler##*:}" --no-dashboard &
trap 'kill $(jobs -p) 2> /dev/null; wait' EXIT
NUMBA_NUM_THREADS=1 srun dask worker "$scheduler" --nthreads 1 --no-dashboard --death-timeout 60 &
workers=$!
surrofe2 generate "$recipe" --scheduler "$scheduler"
kill "$workers"
surrofe2 train "$recipe"
