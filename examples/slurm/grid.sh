#!/bin/bash
# A parameter study: a job array with one value a job, then one job that makes table and picture.
#
#   job=$(sbatch --parsable --array=0-8 examples/slurm/grid.sh RECIPE)
#   sbatch --dependency=afterok:"$job" examples/slurm/grid.sh RECIPE
#
# A job that SLURM interrupts a minute before its time is over goes back into the queue.
#SBATCH --job-name=grid
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=8
#SBATCH --time=04:00:00
#SBATCH --signal=INT@60
#SBATCH --requeue
#SBATCH --open-mode=append
recipe=${1:-data/bending-bar.toml} laws=${2:-rve} folder=${3:-out/grid}
key=cell.wall_stiffness
values=(3000 3250 3500 3750 4000 4250 4500 4750 5000)

if [[ -n ${SLURM_ARRAY_TASK_ID-} ]]; then
    job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
    chosen=${values[SLURM_ARRAY_TASK_ID]} out=$folder/part-$SLURM_ARRAY_TASK_ID
else
    job=$SLURM_JOB_ID chosen=$(IFS=,; echo "${values[*]}") out=$folder
    for part in "$folder"/part-*; do
        cp -rlf "$part"/. "$folder" # links: what is finished is not done again
    done
fi
srun --cpus-per-task="$SLURM_CPUS_PER_TASK" \
    surrofe2 grid "$recipe" --set "$key=$chosen" --law "$laws" \
    --threads "$SLURM_CPUS_PER_TASK" --out "$out"
code=$?
if [[ $code == 130 ]]; then
    scontrol requeue "$job"
fi
exit "$code"
