#include "solver/net_charge.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

namespace amrpic {

namespace {

constexpr int digits = std::numeric_limits<Real>::digits;
constexpr int largest_unit = -30;    ///< exponent: the last digit of numbers of about 1e7
constexpr Real units_missed = 1024;  ///< by a mean, at most

/// The exponent of the last binary digit of a number that is not zero.
int last_digit(Real value) {
  int exponent = 0;
  auto const mantissa = std::int64_t(std::ldexp(std::frexp(std::abs(value), &exponent), digits));
  return exponent - digits + __builtin_ctzll(static_cast<unsigned long long>(mantissa));
}

}  // namespace

Real rounding_of_subtraction(Field const& rho) {
  Hierarchy const& hierarchy = *rho.share_hierarchy();
  int unit = std::numeric_limits<int>::max();
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Real const* value = rho.level(l).data();
    for (BoxFaces const& faces : hierarchy.faces(l)) {
      auto const covered = faces.covered_cells();
      for (char const is_covered : covered.values()) {
        if (!is_covered && *value != 0) unit = std::min(unit, last_digit(*value));
        ++value;
      }
    }
  }
  unit = hierarchy.comm().smallest(unit);
  return unit > largest_unit ? 0 : std::ldexp(units_missed, unit);
}

}  // namespace amrpic
