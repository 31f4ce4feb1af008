#include "cycle/capacity.hpp"

#include <mpi.h>

#include <limits>

#include "base/error.hpp"
#include "cycle/layout.hpp"

namespace amrpic::cycle {

namespace {

constexpr std::int64_t most = std::numeric_limits<std::int32_t>::max();
constexpr std::int64_t line = 16;  ///< floats of a cache line, and of the widest vector

std::int64_t whole_lines(std::int64_t n) { return (n + line - 1) / line * line; }

/// The rank with the largest bound, and that.
struct Fullest {
  int rank = 0;
  std::int64_t places = 0;
};
Fullest fullest(Level const& level, int halo) {
  Fullest out;
  for (int r = 0; r < level.ranks(); ++r) {
    std::int64_t const places = padded_cells(
        {level.boxes().begin() + level.first_box(r), level.boxes().begin() + level.first_box(r + 1)}, halo);
    if (places > out.places) out = {r, places};
  }
  return out;
}

}  // namespace

std::int64_t padded_cells(std::vector<Box> const& boxes, int halo) {
  std::int64_t sum = 0;
  for (Box const& box : boxes) {
    Box const wide = box.grow(halo);
    sum += (whole_lines(wide.extent(0)) * wide.extent(1) + 2 * line) * wide.extent(2);
  }
  return sum;
}

std::string refusal_of_places(std::int64_t places, int level, int rank) {
  if (places <= most) return "";
  return "level " + std::to_string(level) + " takes " + std::to_string(places) + " padded cells on rank " +
         std::to_string(rank) + ", more than 32-bit numbers count; use more ranks, or boxes whose rows are longer";
}

void check_places(Hierarchy const& hierarchy, int halo) {
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    if (fullest(level, halo).places <= most) continue;  // as all ranks find, for they know all boxes
    // The bound counts copies that are boxes of the rank itself; so near the limit the layout itself decides.
    auto const [places, rank] = hierarchy.comm().largest_and_rank(Real(Layout(level, halo, {}).size()));
    std::string const refusal = refusal_of_places(std::int64_t(places), l, rank);
    if (!refusal.empty()) throw SolverError(refusal);
  }
}

}  // namespace amrpic::cycle
