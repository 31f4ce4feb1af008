// Two vectors side by side: a processor works on formulas of both at a time, where one long formula would wait for
// itself.
#pragma once

#include "base/lanes.hpp"

namespace amrpic {

struct LanePair {
  Lanes low, high;

  LanePair() = default;
  LanePair(Real all) : low(all + Lanes{}), high(all + Lanes{}) {}
  LanePair(Lanes const& a, Lanes const& b) : low(a), high(b) {}

  friend LanePair operator+(LanePair const& a, LanePair const& b) { return {a.low + b.low, a.high + b.high}; }
  friend LanePair operator-(LanePair const& a, LanePair const& b) { return {a.low - b.low, a.high - b.high}; }
  friend LanePair operator*(LanePair const& a, LanePair const& b) { return {a.low * b.low, a.high * b.high}; }
  LanePair& operator+=(LanePair const& other) { return *this = *this + other; }
};

}  // namespace amrpic
