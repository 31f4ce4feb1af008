#include <nanobind/stl/string.h>

#include "base/runtime.hpp"
#include "bind/bind.hpp"

namespace nb = nanobind;

void bind_machine(nb::module_& m) {
  m.def("initialize", &amrpic::initialize, "Start Kokkos and Tpetra on MPI_COMM_WORLD, once; MPI must be up.");
  m.def("finalize", &amrpic::finalize, "Release what solvers hold of Trilinos, then stop it; MPI must still be up.");
  m.def("trilinos_version", &amrpic::trilinos_version, "Version of the Trilinos headers, such as '13.2'.");
  m.def("kokkos_backend", &amrpic::kokkos_backend, "Name of the Kokkos execution space Tpetra runs on.");
  m.def("mpi_library", &amrpic::mpi_library, "Version line of the MPI library this module calls.");
}
