#!/bin/bash
# All of a recipe on one machine: data set, training, true run, cached run, comparison.
#
#   sbatch examples/slurm/study.sh RECIPE FOLDER
#
# A minute before its time is over SLURM interrupts it; it goes back into the queue and goes on.
#SBATCH --job-name=study
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=16
#SBATCH --time=08:00:00
#SBATCH --signal=INT@60
#SBATCH --requeue
#SBATCH --open-mode=append
recipe=${1:-data/bending-bar.toml} folder=${2:-out/study}

srun --cpus-per-task="$SLURM_CPUS_PER_TASK" \
    surrofe2 study "$recipe" --threads "$SLURM_CPUS_PER_TASK" --out "$folder"
code=$?
if [[ $code == 130 ]]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
