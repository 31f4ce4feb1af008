#pragma once

#include "base/types.hpp"

namespace amrpic {

/// The unit that solver times are told in, and the roof above it, measured on this machine by this rank alone: each the
/// best of five, one apply and one triad in turns, so that what disturbs one disturbs the other.
///
/// Bytes count what memory moves: 8 for each value read, and 16 for each value written, since ordinary stores fetch the
/// line first. So an apply moves 24 bytes per cell, its neighbours coming from the cache, and a triad a = b + s c moves
/// 32 per value. The triad's three arrays take together what the apply's two take, so that both live in the same cache,
/// or in none.
struct WorkUnit {
  Real apply_seconds;     ///< of one plain 7-point apply in double precision on one array of so many cells
  Real apply_throughput;  ///< bytes per second
  Real triad_throughput;  ///< bytes per second
};

/// `cells` >= 1 is the size of the array that the time belongs to; it is measured on a box of nearly as many.
WorkUnit measure_work_unit(GlobalIndex cells);

}  // namespace amrpic
