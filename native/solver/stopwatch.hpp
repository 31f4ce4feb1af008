#pragma once

#include <mpi.h>

#include <map>
#include <string>

#include "base/types.hpp"

namespace amrpic {

/// Seconds per named stage.
class Stopwatch {
 public:
  /// Run f and add its time to a stage.
  template <class F>
  void time(char const* stage, F&& f) {
    double const start = MPI_Wtime();
    f();
    seconds_[stage] += MPI_Wtime() - start;
  }
  std::map<std::string, Real> const& seconds() const { return seconds_; }
  void reset() { seconds_.clear(); }

 private:
  std::map<std::string, Real> seconds_;
};

}  // namespace amrpic
