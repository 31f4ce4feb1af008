// Communicators from Python.
#pragma once

#include <nanobind/stl/array.h>
#include <nanobind/stl/variant.h>

#include <array>
#include <variant>

#include "base/communicator.hpp"

namespace amrpic::bind {

/// The Fortran handle of a communicator, or, as tests have it, a rank that need not exist and the number of ranks.
using Ranks = std::variant<int, std::array<int, 2>>;

inline Communicator communicator(Ranks const& ranks) {
  if (auto const* handle = std::get_if<int>(&ranks)) return Communicator(MPI_Comm_f2c(*handle));
  auto const& [rank, count] = std::get<1>(ranks);
  return Communicator(rank, count);
}

}  // namespace amrpic::bind
