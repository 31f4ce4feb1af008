#pragma once

#include <stdexcept>
#include <string>

namespace amrpic {

/// A refused hierarchy: the message names the level, the box and the remedy.
struct HierarchyError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A problem that has no answer, or one the solver could not find.
struct SolverError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Of a promise that the code itself breaks, as one rank alone finds: others may wait for that rank, so a job of
/// several ends with one sentence. Of a single rank, throws std::logic_error. Local; does not return.
[[noreturn]] void fail_alone(std::string const& what);

}  // namespace amrpic
