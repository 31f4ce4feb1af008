#pragma once

#include "base/types.hpp"

namespace amrpic {

/// A component of E at the centre of a cell between two values along its axis; `factor` is one over twice the distance
/// of the centres.
template <class Value>
inline Value field_between(Real factor, Value const& below, Value const& above) {
  return factor * (below - above);
}
inline Real field_factor(Real spacing) { return 0.5 / spacing; }

}  // namespace amrpic
