#include <mpi.h>

#include "base/runtime.hpp"

namespace amrpic {

std::string mpi_library() {
  char text[MPI_MAX_LIBRARY_VERSION_STRING];
  int length = 0;
  MPI_Get_library_version(text, &length);
  const std::string all(text, length);
  return all.substr(0, all.find('\n'));
}

}  // namespace amrpic
