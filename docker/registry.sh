# What builds share that need nothing of the system's Trilinos and MPI: docker/card/bundle and docker/wheel source this in the
# repository's folder. What is made once stays in build/bundle.
repo=$PWD work=$PWD/build/bundle jobs=${JOBS:-$(nproc)}
mkdir -p "$work"
say() { echo "[$(date +%H:%M:%S)] $*"; }

# Pinned where another release may need other calls; docs/machine.md says which were tried.
MPICH=mpich==5.0.2

# PYTHON=python3.13 takes another release, with an environment of its own.
base=${PYTHON:-/usr/bin/python3}
release=$("$base" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
venv=$work/venv${PYTHON:+-$release}
python=$venv/bin/python
[ -x "$python" ] || { say "a virtual environment for the build"; "$base" -m venv "$venv"; }
pip() { "$python" -m pip --disable-pip-version-check -q "$@" 2> >(grep -v '^WARNING: Location' >&2); }
once() { [ -e "$work/.$1" ] || { say "$2"; "$3"; touch "$work/.$1"; }; }

get_tools() { pip install nanobind; }
get_mpich() {  # whose wheel is unpacked, since pip leaves out libraries where it gets a folder
  rm -rf "$work/mpich" "$work/wheel"; pip download --no-deps --only-binary=:all: -d "$work/wheel" "$MPICH"
  "$python" -m zipfile -e "$work"/wheel/mpich-*.whl "$work/wheel"
  mv "$work"/wheel/mpich-*.data/data "$work/mpich"; chmod +x "$work"/mpich/bin/*
  ln -sf libmpi.so.12 "$work/mpich/lib/libmpi.so"
}
once tools${PYTHON:+-$release} "tools of the build" get_tools
once mpich MPI get_mpich
of_mpich="MPI_C_COMPILER=$work/mpich/bin/mpicc MPI_mpi_LIBRARY=$work/mpich/lib/libmpi.so"  # for CMake
