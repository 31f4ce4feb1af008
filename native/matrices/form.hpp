#pragma once

#include <array>
#include <cstdint>

#include "stencil/linear_form.hpp"

namespace amrpic {

/// A cell near that of a row, on its level or on the next coarser or finer one, by its offset there: from the row's
/// cell, its parent or its first child.
struct Unknown {
  enum class On : std::int8_t { coarser, own, finer } level;
  std::array<std::int8_t, 3> offset;
  bool operator==(Unknown const& other) const { return level == other.level && offset == other.offset; }
};

using Form = LinearForm<Unknown>;

/// A cell by its offset from another one of its level, for forms of which only the offsets count.
inline Unknown from_anchor(Index3 const& cell, Index3 const& anchor) {
  Unknown out{Unknown::On::own, {}};
  for (std::size_t d = 0; d < 3; ++d) out.offset[d] = std::int8_t(cell[d] - anchor[d]);
  return out;
}

}  // namespace amrpic
