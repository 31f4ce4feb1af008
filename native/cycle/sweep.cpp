#include "cycle/sweep.hpp"

#include <algorithm>

namespace amrpic::cycle {

void wavefront(Layout const& layout, std::vector<PlaneStage> const& stages, std::function<void(int)> const& before) {
  int const first = layout.first_plane(), count = layout.planes(), depth = int(stages.size());
  for (int step = 0; step < count + depth - 1; ++step) {
    if (step < count) before(first + step);
    for (int s = std::max(0, step - count + 1); s < std::min(depth, step + 1); ++s)
      for (int b : layout.on_plane(first + step - s)) stages[std::size_t(s)].act(std::size_t(b), first + step - s, {});
  }
}

Sweep::Sweep(Layout const& layout, Stencil const& stencil)
    : layout_(layout), stencil_(stencil), table_(stencil.table()) {
  for (Vector& row : buffer_) row.resize(std::size_t(table_.composed_pitch) + 96);
}

/// A composed row, in a buffer for its side.
float const* Sweep::composed(std::size_t side, std::int32_t number, float const* e, bool differences) const {
  float* const row = buffer_[side].data();
  for (std::int32_t n = table_.first_run[number]; n < table_.first_run[number + 1]; ++n)
    table_.runs[n].compose(e, differences, row + (table_.runs[n].place - number * table_.composed_pitch), Thread{});
  return row;
}

/// Call f(row, j) for rows of a plane.
template <class F>
void Sweep::for_each_row(std::size_t block, int k, RowChoice const& rows, F&& f) const {
  Box const& box = layout_.blocks()[block].box;
  Row const* const row = stencil_.rows(block) + box.extent(1) * (k - box.lower[2]);
  for (int j = 0; j < box.extent(1); ++j)
    if (rows.contains(j)) f(row[j], j);
}

void Sweep::relax(std::size_t block, int k, int colour, bool from_zero, RowChoice const& rows, Vector const& r,
                  Vector& e) const {
  auto const composed = composer(e.data(), false);
  with_kind(layout_.blocks()[block].lanes, table_.isotropic, [&](auto lanes, auto isotropic) {
    auto const act = [&](auto with_metal) {
      if (from_zero)
        return for_each_row(block, k, rows, [&](Row const& row, int) {
          cycle::relax_from_zero<lanes(), with_metal()>(table_, row, colour, r.data(), e.data(), Thread{});
        });
      for_each_row(block, k, rows, [&](Row const& row, int) {
        cycle::relax<lanes(), isotropic(), with_metal()>(table_, row, colour, composed, r.data(), e.data(), Thread{});
      });
    };
    table_.metal_of ? act(std::true_type()) : act(std::false_type());
  });
}

template <bool of_residual>
void Sweep::restrict_to(std::size_t block, int k, Vector const& r, Vector& e, Parents const& parents, float weight,
                        Vector& coarse) const {
  Box const& box = layout_.blocks()[block].box;
  int const plane = k - box.lower[2], z = parents.parent(2, plane);
  if (z >= parents.extent[2] || plane + 1 < parents.end_of_children(2, z, box.extent(2))) return;
  auto const composed = composer(e.data(), table_.in_differences);
  auto const act = [&](auto with_metal) {
    for (int y = 0; y < parents.extent[1]; ++y)
      cycle::restrict_to<of_residual, with_metal()>(parents, y, z, table_, stencil_.rows(block), box.extent(1),
                                                    box.extent(2), weight, composed, r.data(), e.data(), coarse.data(),
                                                    Thread{});
  };
  table_.metal_of ? act(std::true_type()) : act(std::false_type());
}
template void Sweep::restrict_to<true>(std::size_t, int, Vector const&, Vector&, Parents const&, float, Vector&) const;
template void Sweep::restrict_to<false>(std::size_t, int, Vector const&, Vector&, Parents const&, float, Vector&) const;

void Sweep::prolong(std::size_t block, int k, RowChoice const& rows, Parents const& parents, Vector const& coarse,
                    bool set, Vector const& r, Vector& e) const {
  CellBlock const& b = layout_.blocks()[block];
  with_kind(b.lanes, true, [&](auto lanes, auto) {
    for_each_row(block, k, rows, [&](Row const& row, int j) {
      cycle::prolong<lanes()>(parents, j, k - b.box.lower[2], row, coarse.data(), set, r.data(), e.data(), Thread{});
    });
    if (table_.metal_of)
      for_each_row(block, k, rows,
                   [&](Row const& row, int) { clear_solid(table_, row, e.data() + row.place, Thread{}); });
  });
}

}  // namespace amrpic::cycle
