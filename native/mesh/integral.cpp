#include "mesh/integral.hpp"

#include <algorithm>

#include "mesh/window.hpp"

namespace amrpic {

namespace {

/// Sum of value(n) for n < count: eight sums side by side, which do not wait for each other.
template <class Value>
Real sum(LocalIndex count, Value const& value) {
  constexpr int width = 8;
  Real parts[width] = {};
  LocalIndex n = 0;
  for (; n + width <= count; n += width)
    for (int i = 0; i < width; ++i) parts[i] += value(n + i);
  for (; n < count; ++n) parts[n % width] += value(n);
  for (int half = width / 2; half > 0; half /= 2)
    for (int i = 0; i < half; ++i) parts[i] += parts[i + half];
  return parts[0];
}

/// Integral of value(n) over the cells n of this rank's part of a level.
template <class Value>
Real integral_on_level(Hierarchy const& hierarchy, int l, Value const& value) {
  Level const& level = hierarchy.level(l);
  Real total = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    Box const& box = level.box(b);
    LocalIndex const first = level.local_offset(b), plane = box.extent(0) * box.extent(1);
    bool const refined = hierarchy.has_finer(l) && hierarchy.level(l + 1).intersects(box.refine(refinement_ratio));
    auto const of_box = [&](auto const& of_cell) {
      Real out = 0;
      for (int k = 0; k < box.extent(2); ++k) out += sum(plane, [&](LocalIndex n) { return of_cell(k * plane + n); });
      return out;
    };
    if (refined) {
      auto const covered = covered_cells(hierarchy.level(l + 1), refinement_ratio, box);
      char const* const mask = covered.values().data();
      total += of_box([&](LocalIndex n) { return mask[n] ? 0 : value(first + n); });
    } else {
      total += of_box([&](LocalIndex n) { return value(first + n); });
    }
  }
  return level.cell_volume() * total;
}

/// Integral of value(l)(n) over the cells n of all levels and ranks.
template <class Value>
Real integral_on_all(Hierarchy const& hierarchy, Value const& value) {
  Real total = 0;
  for (int l = 0; l < hierarchy.level_count(); ++l) total += integral_on_level(hierarchy, l, value(l));
  MPI_Allreduce(MPI_IN_PLACE, &total, 1, MPI_DOUBLE, MPI_SUM, hierarchy.comm());
  return total;
}

}  // namespace

Real integral(Field const& field) {
  return integral_on_all(field.hierarchy(), [&](int l) {
    Real const* const values = field.level(l).data();
    return [=](LocalIndex n) { return values[n]; };
  });
}

Real integral(Field const& a, Field const& b) {
  return integral_on_all(a.hierarchy(), [&](int l) {
    Real const *const first = a.level(l).data(), *const second = b.level(l).data();
    return [=](LocalIndex n) { return first[n] * second[n]; };
  });
}

}  // namespace amrpic
