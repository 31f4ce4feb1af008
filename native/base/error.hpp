#pragma once

#include <stdexcept>

namespace amrpic {

/// A refused hierarchy: the message names the level, the box and the remedy.
struct HierarchyError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A problem that has no answer, or one the solver could not find.
struct SolverError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

}  // namespace amrpic
