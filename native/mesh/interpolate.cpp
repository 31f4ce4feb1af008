#include "mesh/interpolate.hpp"

#include <algorithm>

#include "mesh/exchange.hpp"
#include "mesh/window.hpp"

namespace amrpic {

namespace {

/// Values of a level at chosen cells, whoever owns them.
class Reader {
 public:
  /// `cells`: numbers of the cells that will be read, in any order; entries `no_cell` are passed over. Collective.
  Reader(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> const& cells, std::vector<Real> const& own)
      : exchange_(comm, level, remote_cells(level, cells)), own_(own), ghosts_(std::size_t(exchange_.ghosts())) {
    exchange_.update({own_.data()}, {ghosts_.data()});
  }

  Real operator()(GlobalIndex cell) const {
    LocalIndex const place = exchange_.local(cell), owned = exchange_.owned();
    return place < owned ? own_[std::size_t(place)] : ghosts_[std::size_t(place - owned)];
  }

 private:
  Exchange exchange_;
  std::vector<Real> const& own_;
  std::vector<Real> ghosts_;
};

/// For each cell of this rank on a new level its number on the old one, `no_cell` where it is newly refined.
std::vector<GlobalIndex> former_numbers(Level const& level, Level const* former) {
  std::vector<GlobalIndex> out(std::size_t(level.local_cells()), no_cell);
  if (!former) return out;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const numbers = cell_numbers(*former, level.box(b));
    std::copy(numbers.values().begin(), numbers.values().end(), out.begin() + level.local_offset(b));
  }
  return out;
}

/// Shares that the left, the middle and the right parent have in the mean over the upper (`side` = 1) or lower (-1)
/// half of the middle one, by a parabola through the three means; beyond a wall the slope is that towards the other
/// side.
std::array<Real, 3> half_cell_weights(int side, bool has_left, bool has_right) {
  Real const s = side / 8.0;
  if (has_left && has_right) return {-s, 1, s};
  if (has_left) return {-2 * s, 1 + 2 * s, 0};
  if (has_right) return {0, 1 - 2 * s, 2 * s};
  return {0, 1, 0};
}

/// The mean over a child of `parent`; `has` tells on which sides the parent has neighbours.
Real child_mean(Window<Real> const& around, Index3 const& child, Index3 const& parent,
                std::array<std::array<bool, 2>, 3> const& has) {
  std::array<std::array<Real, 3>, 3> w;
  for (int d = 0; d < 3; ++d) w[d] = half_cell_weights(child[d] % 2 == 0 ? -1 : 1, has[d][0], has[d][1]);
  Real sum = 0;
  for_each_cell(Box{parent, parent}.grow(1), [&](Index3 const& c) {
    sum += w[0][c[0] - parent[0] + 1] * w[1][c[1] - parent[1] + 1] * w[2][c[2] - parent[2] + 1] * around(c);
  });
  return sum;
}

/// Fill the newly refined cells of a box from the parents in `around`, which reaches one parent beyond it.
void interpolate(Level const& coarser, Window<Real> const& around, Box const& box, GlobalIndex const* former,
                 Real* values) {
  auto exists = [&](Index3 parent, int axis, int step) {
    parent[axis] += step;
    return coarser.periodic()[axis] || coarser.domain().contains(parent);
  };
  for_each_cell(box.coarsen(refinement_ratio), [&](Index3 const& parent) {
    Box const children = Box{parent, parent}.refine(refinement_ratio);
    // blocks hold whole families, so the children of one parent are all new or all old
    if (former[box.offset(children.lower)] != no_cell) return;
    std::array<std::array<bool, 2>, 3> has;
    for (int d = 0; d < 3; ++d) has[d] = {exists(parent, d, -1), exists(parent, d, 1)};
    for_each_cell(children,
                  [&](Index3 const& child) { values[box.offset(child)] = child_mean(around, child, parent, has); });
  });
}

/// Copy the cells of a level that the old hierarchy has too. Collective.
void copy_former(MPI_Comm comm, Level const& former, std::vector<Real> const& from,
                 std::vector<GlobalIndex> const& numbers, std::vector<Real>& to) {
  Reader const read(comm, former, numbers, from);
  for (std::size_t i = 0; i < to.size(); ++i)
    if (numbers[i] != no_cell) to[i] = read(numbers[i]);
}

/// Interpolate the cells of a level that the old hierarchy lacks, from the finished next coarser level. Collective.
void fill_new(MPI_Comm comm, Level const& level, Level const& coarser, std::vector<Real> const& from,
              std::vector<GlobalIndex> const& numbers, std::vector<Real>& to) {
  std::vector<int> boxes;  // of this rank, with newly refined cells
  std::vector<Window<GlobalIndex>> parents;
  std::vector<GlobalIndex> wanted;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const first = numbers.begin() + level.local_offset(b), last = first + level.box(b).cells();
    if (std::find(first, last, no_cell) == last) continue;
    boxes.push_back(b);
    parents.push_back(cell_numbers(coarser, level.box(b).coarsen(refinement_ratio).grow(1)));
    wanted.insert(wanted.end(), parents.back().values().begin(), parents.back().values().end());
  }
  Reader const read(comm, coarser, wanted, from);
  for (std::size_t n = 0; n < boxes.size(); ++n) {
    Window<Real> around(parents[n].box(), 0);
    std::transform(parents[n].values().begin(), parents[n].values().end(), around.values().begin(),
                   [&](GlobalIndex cell) { return cell == no_cell ? 0 : read(cell); });
    LocalIndex const offset = level.local_offset(boxes[n]);
    interpolate(coarser, around, level.box(boxes[n]), numbers.data() + offset, to.data() + offset);
  }
}

}  // namespace

void carry_over(Field const& from, Field& to) {
  Hierarchy const &old = from.hierarchy(), &hierarchy = to.hierarchy();
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    bool const existed = l < old.level_count();
    auto const numbers = former_numbers(hierarchy.level(l), existed ? &old.level(l) : nullptr);
    if (existed) copy_former(hierarchy.comm(), old.level(l), from.level(l), numbers, to.level(l));
    if (l > 0)
      fill_new(hierarchy.comm(), hierarchy.level(l), hierarchy.level(l - 1), to.level(l - 1), numbers, to.level(l));
  }
}

}  // namespace amrpic
