#!/bin/bash
#SBATCH --job-name=amrpic --nodes=4 --ntasks-per-node=36 --time=04:00:00 --signal=USR1@300
# Runs a scene to its end, in as many jobs as that takes: sbatch examples/slurm/job.sh first.toml
# Five minutes before its time is over Slurm sends USR1, and the run stops after a checkpoint, with the status 75.
export OMP_NUM_THREADS=1
status=0
srun amrpic run "$1" --restart auto || status=$?
[ $status -ne 75 ] || sbatch "$0" "$1"
exit $status
