#include "cycle/sweep.hpp"

#include <algorithm>

#include "cycle/row_acts.hpp"

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

void Sweep::relax(std::size_t block, int k, int colour, bool from_zero, bool is_last, RowChoice const& rows,
                  Vector const& r, Vector& e) const {
  auto const composed = composer(e.data(), false);
  CellBlock const& of = layout_.blocks()[block];
  bool const by_plane = table_.metal_of && !rows.number;
  MetalPlane const* const plane = by_plane ? &stencil_.metal_plane(block, k - of.box.lower[2]) : nullptr;
  if (by_plane && !from_zero) keep_inner(*plane, colour, e), find_outer(*plane, colour, r, e);
  with_kind(of.lanes, table_.isotropic, [&](auto lanes, auto isotropic) {
    auto const act = [&](auto with_metal) {
      if (from_zero)
        return for_each_row(block, k, rows, [&](Row const& row, int) {
          cycle::relax_from_zero<lanes(), with_metal()>(table_, row, colour, r.data(), e.data(), Thread{});
        });
      for_each_row(block, k, rows, [&](Row const& row, int) {
        if (by_plane && table_.has_metal(row) && table_.metal(row).is_solid) return;
        cycle::relax<lanes(), isotropic(), with_metal()>(table_, row, colour, composed, r.data(), e.data(), Thread{});
      });
    };
    table_.metal_of && !by_plane ? act(std::true_type()) : act(std::false_type());
  });
  if (!by_plane) return;
  if (from_zero)
    relax_cut_from_zero(*plane, colour, r, e);
  else
    relax_inner<true>(*plane, colour, of.cells, r, e), place_outer(*plane, colour, e);
  if (is_last || stencil_.reads_solids()) clear_solids(*plane, e);
}

void Sweep::relax_beside_metal(std::size_t block, int k, int colour, RowChoice const& rows, Vector const& r,
                               Vector& e) const {
  if (!table_.metal_of) return;
  if (rows.number) {
    auto const composed = composer(e.data(), false);
    return for_each_row(block, k, rows, [&](Row const& row, int) {
      cycle::relax_beside_metal(table_, row, colour, composed, r.data(), e.data(), Thread{});
    });
  }
  CellBlock const& of = layout_.blocks()[block];
  MetalPlane const& plane = stencil_.metal_plane(block, k - of.box.lower[2]);
  find_outer(plane, colour, r, e);
  relax_inner<false>(plane, colour, of.cells, r, e);
  place_outer(plane, colour, e);
}

/// Keep the values of the inner cut cells of one colour of a plane before a step of all its cells.
void Sweep::keep_inner(MetalPlane const& plane, int colour, Vector const& e) const {
  auto const [first, last] = plane.inner[std::size_t(colour)];
  inner_.resize(std::size_t(last - first));
  std::int32_t const* const places = stencil_.inner_places() + first;
  for (std::size_t n = 0; n < inner_.size(); ++n) inner_[n] = e[std::size_t(places[n])];
}

/// The values of outer ones after it: beside them a ring of odd length has cells of their own colour.
void Sweep::find_outer(MetalPlane const& plane, int colour, Vector const& r, Vector const& e) const {
  auto const [first, last] = plane.outer[std::size_t(colour)];
  OuterCut const* const outer = stencil_.outer_cuts() + first;
  outer_.resize(std::size_t(last - first));
  for (std::size_t n = 0; n < outer_.size(); ++n) {
    auto const at = [&](std::size_t side) { return e[std::size_t(outer[n].beside[side])]; };
    std::size_t const place = std::size_t(outer[n].place);
    float const sum = sum_beside(outer[n].weight, at(0), at(1), at(2), at(3), at(4), at(5));
    outer_[n] = relaxed(table_.keep, e[place], outer[n].step, sum, r[place]);
  }
}

/// Inner ones relaxed, from the values that were kept or are there.
template <bool were_kept>
void Sweep::relax_inner(MetalPlane const& plane, int colour, Placement const& cells, Vector const& r, Vector& e) const {
  auto const [first, last] = plane.inner[std::size_t(colour)];
  InnerCut const* const inner = stencil_.inner_cuts() + first;
  std::int32_t const* const places = stencil_.inner_places() + first;
  float const *const right = r.data(), keep = table_.keep;
  std::ptrdiff_t const y = cells.pitch_y, z = cells.pitch_z;
  for (std::size_t n = 0; n < std::size_t(last - first); ++n) {
    float* const at = e.data() + places[n];
    float const sum = sum_beside(inner[n].weight, at[-1], at[1], at[-y], at[y], at[-z], at[z]);
    at[0] = relaxed(keep, were_kept ? inner_[n] : at[0], inner[n].step, sum, right[places[n]]);
  }
}

void Sweep::place_outer(MetalPlane const& plane, int colour, Vector& e) const {
  OuterCut const* const outer = stencil_.outer_cuts() + plane.outer[std::size_t(colour)].first;
  for (std::size_t n = 0; n < outer_.size(); ++n) e[std::size_t(outer[n].place)] = outer_[n];
}

/// The same where all values were zero.
void Sweep::relax_cut_from_zero(MetalPlane const& plane, int colour, Vector const& r, Vector& e) const {
  for (int n = plane.inner[std::size_t(colour)].first; n < plane.inner[std::size_t(colour)].last; ++n) {
    std::size_t const place = std::size_t(stencil_.inner_places()[n]);
    e[place] = relaxed_from_zero(stencil_.inner_cuts()[n].step, r[place]);
  }
  for (int n = plane.outer[std::size_t(colour)].first; n < plane.outer[std::size_t(colour)].last; ++n) {
    OuterCut const& outer = stencil_.outer_cuts()[n];
    std::size_t const place = std::size_t(outer.place);
    e[place] = relaxed_from_zero(outer.step, r[place]);
  }
}

void Sweep::clear_solids(MetalPlane const& plane, Vector& e) const {
  for (int n = plane.solids.first; n < plane.solids.last; ++n) {
    SolidRun const& run = stencil_.solids_in_planes()[std::size_t(n)];
    std::fill_n(&e[std::size_t(run.place)], run.count, 0.0f);
  }
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
    if (table_.metal_of && rows.number)
      for_each_row(block, k, rows,
                   [&](Row const& row, int) { clear_solid(table_, row, e.data() + row.place, Thread{}); });
  });
  if (table_.metal_of && !rows.number) clear_solids(stencil_.metal_plane(block, k - b.box.lower[2]), e);
}

}  // namespace amrpic::cycle
