#pragma once

#include "base/types.hpp"

namespace amrpic {

/// The unit that solver times are told in, measured on this machine by this rank alone; best of five.
struct WorkUnit {
  Real apply_seconds;  ///< of one plain 7-point apply on one array with so many cells
  Real triad_seconds;  ///< of a = b + s c on as many
};

WorkUnit measure_work_unit(GlobalIndex cells);

}  // namespace amrpic
