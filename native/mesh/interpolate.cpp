#include "mesh/interpolate.hpp"

#include <algorithm>

#include "mesh/array_on_box.hpp"
#include "mesh/exchange.hpp"
#include "stencil/intergrid.hpp"

namespace amrpic {

namespace {

/// Values of a level in chosen regions, whichever ranks own the cells.
class Reader {
 public:
  /// Collective.
  Reader(MPI_Comm comm, Level const& level, std::vector<Box> const& regions, LargeArray<Real> const& own)
      : level_(level), exchange_(comm, level, remote(level, regions)), own_(own) {
    halo_.resize(std::size_t(exchange_.halo_size()));
    exchange_.update({own_.data()}, {halo_.data()});
  }

  /// Call `f(values, count, first cell)` for each row along x of the level's cells in one of the regions; periodic
  /// images included.
  template <class F>
  void for_each_row(Box const& region, F&& f) const {
    level_.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
      amrpic::for_each_row(level_, b, part, shift, [&](GlobalIndex first, LocalIndex count, Index3 const& cell) {
        // the halo is in the order of its numbers, so the cells of a row are side by side as own cells are
        LocalIndex const place = exchange_.local(first), owned = exchange_.owned();
        f(place < owned ? &own_[std::size_t(place)] : &halo_[std::size_t(place - owned)], count, cell);
      });
    });
  }

 private:
  static std::vector<GlobalIndex> remote(Level const& level, std::vector<Box> const& regions) {
    std::vector<GlobalIndex> cells;
    for (Box const& region : regions) append_remote(level, region, cells);
    return remote_cells(level, std::move(cells));
  }

  Level const& level_;
  Exchange exchange_;
  LargeArray<Real> const& own_;
  std::vector<Real> halo_;
};

std::vector<Box> local_boxes(Level const& level) {
  return {level.boxes().begin() + level.first_local_box(), level.boxes().begin() + level.last_local_box()};
}

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
std::vector<char> copy_former(MPI_Comm comm, Level const& level, Level const& former, LargeArray<Real> const& from,
                              LargeArray<Real>& to) {
  std::vector<char> is_new(to.size(), 1);
  Reader const read(comm, former, local_boxes(level), from);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    read.for_each_row(level.box(b), [&](Real const* values, LocalIndex count, Index3 const& first) {
      auto const place = level.local_offset(b) + level.box(b).offset(first);
      std::copy_n(values, count, to.begin() + place);
      std::fill_n(is_new.begin() + place, count, 0);
    });
  return is_new;
}

/// Interpolate the cells of a level that the old hierarchy lacks, from the finished next coarser level. Collective.
void fill_new(MPI_Comm comm, Level const& level, Level const& coarser, LargeArray<Real> const& from,
              std::vector<char> const& is_new, LargeArray<Real>& to) {
  std::vector<int> boxes;  // of this rank, with newly refined cells
  std::vector<Box> parents;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const first = is_new.begin() + level.local_offset(b), last = first + level.box(b).cells();
    if (std::find(first, last, 1) == last) continue;
    boxes.push_back(b);
    parents.push_back(level.box(b).coarsen(refinement_ratio).grow(1));
  }
  Reader const read(comm, coarser, parents, from);
  for (std::size_t n = 0; n < boxes.size(); ++n) {
    ArrayOnBox<Real> parent_values(parents[n], 0);
    read.for_each_row(parents[n], [&](Real const* values, LocalIndex count, Index3 const& first) {
      std::copy_n(values, count, &parent_values(first));
    });
    LocalIndex const offset = level.local_offset(boxes[n]);
    interpolate(coarser, parent_values, level.box(boxes[n]), is_new.data() + offset, to.data() + offset);
  }
}

}  // namespace

void carry_over(Field const& from, Field& to) {
  Hierarchy const &old = from.hierarchy(), &hierarchy = to.hierarchy();
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    auto& values = to.level(l);
    std::vector<char> const is_new =
        l < old.level_count() ? copy_former(hierarchy.comm(), hierarchy.level(l), old.level(l), from.level(l), values)
                              : std::vector<char>(values.size(), 1);
    if (l > 0) fill_new(hierarchy.comm(), hierarchy.level(l), hierarchy.level(l - 1), to.level(l - 1), is_new, values);
  }
}

}  // namespace amrpic
