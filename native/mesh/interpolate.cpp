#include "mesh/interpolate.hpp"

#include <algorithm>

#include "mesh/box_regions.hpp"
#include "stencil/intergrid.hpp"

namespace amrpic {

namespace {

using Weights = std::array<std::array<Real, 3>, 2>;  ///< of the lower and the upper half of a parent along an axis

/// Means over the children of a parent, x fastest, one axis after the other; `v` points to the parent's among its
/// neighbours' values.
std::array<Real, 8> child_means(Real const* v, std::ptrdiff_t y, std::ptrdiff_t z, std::array<Weights, 3> const& w) {
  auto weigh = [](std::array<Real, 3> const& weight, Real left, Real middle, Real right) {
    return weight[0] * left + weight[1] * middle + weight[2] * right;
  };
  std::array<Real, 8> out;
  for (int a = 0; a < 2; ++a) {
    Real line[3][3];  // [z][y]
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j) {
        Real const* at = v + (j - 1) * y + (k - 1) * z;
        line[k][j] = weigh(w[0][a], at[-1], at[0], at[1]);
      }
    for (int b = 0; b < 2; ++b) {
      Real plane[3];
      for (int k = 0; k < 3; ++k) plane[k] = weigh(w[1][b], line[k][0], line[k][1], line[k][2]);
      for (int c = 0; c < 2; ++c) out[a + 2 * b + 4 * c] = weigh(w[2][c], plane[0], plane[1], plane[2]);
    }
  }
  return out;
}

/// Fill the newly refined cells of a box from its parents with one layer of ghost cells.
void interpolate(Level const& coarser, ArrayOnBox<Real> const& parent_values, Box const& box, char const* is_new,
                 Real* values) {
  auto exists = [&](Index3 parent, int axis, int step) {
    parent[axis] += step;
    return !coarser.is_behind_wall(parent, axis);
  };
  std::ptrdiff_t const y = parent_values.box().extent(0), z = y * parent_values.box().extent(1);
  for_each_cell(box.coarsen(refinement_ratio), [&](Index3 const& parent) {
    Box const children = Box{parent, parent}.refine(refinement_ratio);
    // blocks hold whole families, so the children of one parent are all new or all old
    if (!is_new[box.offset(children.lower)]) return;
    std::array<Weights, 3> weights;
    for (int d = 0; d < 3; ++d)
      for (int side = 0; side < 2; ++side)
        weights[d][side] = half_cell_weights(side == 1, exists(parent, d, -1), exists(parent, d, 1));
    auto const means = child_means(&parent_values(parent), y, z, weights);
    std::size_t n = 0;
    for_each_cell(children, [&](Index3 const& child) { values[box.offset(child)] = means[n++]; });
  });
}

/// Copy the cells of a level that the old hierarchy has too; 1 for each cell of this rank that it lacks. Collective.
std::vector<char> copy_former(Communicator const& comm, Level const& level, Level const& former,
                              LargeArray<Real> const& from, LargeArray<Real>& to) {
  std::vector<char> is_new(to.size(), 1);
  BoxRegions const regions(
      comm, former, level, [](Box const& o) { return o; }, [&](int b) { return level.box(b); });
  std::vector<Real> const halo = regions.halo(1, from.data());
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - level.first_local_box());
    regions.read(part, 1, from.data(), halo.data(), to.data() + level.local_offset(b));
    regions.for_each_run(part, [&](LocalIndex, LocalIndex first, LocalIndex count) {
      std::fill_n(is_new.begin() + level.local_offset(b) + first, count, 0);
    });
  }
  return is_new;
}

/// Interpolate the cells of a level that the old one, which may be null, lacks: from the finished next coarser level.
/// Collective.
void fill_new(Communicator const& comm, Level const& level, Level const* former, Level const& coarser,
              LargeArray<Real> const& from, std::vector<char> const& is_new, LargeArray<Real>& to) {
  auto const parents_of = [&](int b) {
    bool const has_new = !former || former->cells_in(level.box(b)) < level.box(b).cells();
    return has_new ? level.box(b).coarsen(refinement_ratio).grow(1) : Box{};
  };
  BoxRegions const parents(
      comm, coarser, level, [](Box const& o) { return o.grow(1).refine(refinement_ratio); }, parents_of);
  std::vector<Real> const halo = parents.halo(1, from.data());
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - level.first_local_box());
    if (parents.region(part).empty()) continue;
    LocalIndex const offset = level.local_offset(b);
    interpolate(coarser, parents.values(part, from.data(), halo), level.box(b), is_new.data() + offset,
                to.data() + offset);
  }
}

}  // namespace

void carry_over(Field const& from, Field& to) {
  Hierarchy const &old = from.hierarchy(), &hierarchy = to.hierarchy();
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    auto& values = to.level(l);
    Level const* const former = l < old.level_count() ? &old.level(l) : nullptr;
    std::vector<char> const is_new =
        former ? copy_former(hierarchy.comm(), hierarchy.level(l), *former, from.level(l), values)
               : std::vector<char>(values.size(), 1);
    if (l > 0)
      fill_new(hierarchy.comm(), hierarchy.level(l), former, hierarchy.level(l - 1), to.level(l - 1), is_new, values);
  }
}

}  // namespace amrpic
