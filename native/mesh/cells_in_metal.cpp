#include "mesh/cells_in_metal.hpp"

namespace amrpic {

void mark(Stretches const& stretches, std::int32_t electrode, std::uint8_t axis, std::int32_t* owner,
          std::uint8_t* axes) {
  for (std::size_t n = 0; n < stretches.size; ++n) {
    std::int64_t cell = stretches.first[n];
    for (std::int64_t i = 0; i < stretches.count[n]; ++i, cell += stretches.stride[n])
      owner[cell] = electrode, axes[cell] = std::uint8_t(axes[cell] | axis);
  }
}

Runs runs_in(std::vector<Box> const& boxes, std::int32_t const* owner) {
  Runs out;
  for (Box const& box : boxes) {
    Box const around = box.grow(1);
    int const nx = box.extent(0);
    for_each_row(box, [&](Index3 const& start) {
      std::int32_t const* const row = owner + around.offset(start);
      for (int i = 0, first; i < nx; ++i) {
        if (row[i] < 0) continue;
        for (first = i; i + 1 < nx && row[i + 1] == row[first];) ++i;
        out.first.insert(out.first.end(), {start[0] + first, start[1], start[2]});
        out.count.push_back(i + 1 - first);
        out.electrode.push_back(row[first]);
      }
    });
    owner += around.cells();
  }
  return out;
}

}  // namespace amrpic
