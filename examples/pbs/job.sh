#!/bin/bash
#PBS -N amrpic -l select=4:ncpus=36:mpiprocs=36 -l walltime=04:00:00
# Runs a scene to its end, in as many jobs as that takes: qsub -v SCENE=first.toml examples/pbs/job.sh
# PBS warns nobody: the run is told its time, and stops before it is over, after a checkpoint, with the status 75.
cd "$PBS_O_WORKDIR" || exit 1
export OMP_NUM_THREADS=1
status=0
mpiexec amrpic run "$SCENE" --restart auto --walltime 03:50:00 || status=$?
[ $status -ne 75 ] || qsub -v "SCENE=$SCENE" "$0"
exit $status
