#pragma once

#include "base/types.hpp"

namespace amrpic {

/// The unit that solver times are given in, measured on this machine by this rank alone, in CPU time.
///
/// It is the time of one plain 7-point apply in double precision on one array of so many cells, or, if that is less,
/// the time that memory takes for the 24 bytes per cell which such an apply moves: a value read, a value written, and
/// the line of the latter fetched, at the bandwidth of a triad a = b + s c on arrays out of cache. Some processors lose
/// the streams of an apply, which then reaches half of a triad's bandwidth; that must not make a solver look good.
struct WorkUnit {
  Real seconds;           ///< the unit
  Real apply_seconds;     ///< of the plain apply, the best of five
  Real triad_throughput;  ///< bytes per second out of cache, 32 per value, the best of three
};

/// `cells` >= 1 is the size of the array that the time belongs to; it is measured on a box of nearly as many.
WorkUnit measure_work_unit(GlobalIndex cells);

}  // namespace amrpic
