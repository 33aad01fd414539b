#!/bin/bash
# A run of a recipe over MPI ranks:
#
#   sbatch examples/slurm/run.sh RECIPE LAW FOLDER
#
# A minute before its time is over SLURM interrupts it; it goes back into the queue and goes on.
#SBATCH --job-name=run
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=16
#SBATCH --cpus-per-task=1
#SBATCH --time=08:00:00
#SBATCH --signal=INT@60
#SBATCH --requeue
#SBATCH --open-mode=append
recipe=${1:-data/bending-bar.toml} law=${2:-rve} folder=${3:-out/rve}

srun --cpus-per-task="$SLURM_CPUS_PER_TASK" \
    surrofe2 run "$recipe" --law "$law" --threads "$SLURM_CPUS_PER_TASK" --out "$folder"
code=$?
if [[ $code == 130 ]]; then # interrupted, and all is kept
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
