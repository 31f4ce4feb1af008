#include "mesh/hierarchy.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <string>
#include <utility>

#include "base/error.hpp"

namespace amrpic {

std::vector<Box> cut(Box const& region, int max_grid_size, int blocking_factor) {
  // Pieces of equal size to one block, so that 40 cells under a limit of 24 become 24 + 16 or 20 + 20, never 24 + 8
  // + 8. The last block, and with it the last piece, may be shorter.
  auto pieces = [&](int axis) {
    int const lower = region.lower[axis], upper = region.upper[axis];
    int const blocks = (region.extent(axis) - 1) / blocking_factor + 1;
    int const most = std::max(1, max_grid_size / blocking_factor);
    int const count = (blocks - 1) / most + 1;
    std::vector<std::array<int, 2>> out;
    for (int p = 0; p < count; ++p) {
      int const first = lower + int(std::int64_t(blocks) * p / count) * blocking_factor;
      if (first == upper && p > 0) break;  // a wall's ghosts take two cells of a box
      if (p > 0) out.back()[1] = first - 1;
      out.push_back({first, upper});
    }
    return out;
  };
  std::vector<Box> out;
  auto const x = pieces(0), y = pieces(1), z = pieces(2);
  for (auto const& c : z)
    for (auto const& b : y)
      for (auto const& a : x) out.push_back({{a[0], b[0], c[0]}, {a[1], b[1], c[1]}});
  return out;
}

namespace {

constexpr int smallest_piece = 8;     ///< cells along an axis: thinner boxes cost more than they balance
constexpr Real most_imbalance = 1.1;  ///< cells of the fullest rank over the mean

GlobalIndex cells_of(std::vector<Box> const& boxes) {
  return std::accumulate(boxes.begin(), boxes.end(), GlobalIndex(0),
                         [](GlobalIndex sum, Box const& box) { return sum + box.cells(); });
}

/// Whether point a comes before point b in Morton order (z the most significant axis); coordinates are not negative.
bool morton_less(Index3 const& a, Index3 const& b) {
  auto less_msb = [](unsigned x, unsigned y) { return x < y && x < (x ^ y); };
  int axis = 2;
  unsigned difference = unsigned(a[2]) ^ unsigned(b[2]);
  for (int d : {1, 0}) {
    unsigned const other = unsigned(a[d]) ^ unsigned(b[d]);
    if (less_msb(difference, other)) difference = other, axis = d;
  }
  return a[axis] < b[axis];
}

Index3 twice_centre(Box const& box) {
  return {box.lower[0] + box.upper[0], box.lower[1] + box.upper[1], box.lower[2] + box.upper[2]};
}

std::string where(int level, Box const& box) { return "box " + to_string(box) + " of level " + std::to_string(level); }

void check_box(int level, Box const& box, Box const& domain, int blocking_factor) {
  if (box.empty())
    throw HierarchyError(where(level, box) + " is empty; its upper corner must not lie below the lower one");
  if (!domain.contains(box))
    throw HierarchyError(where(level, box) + " leaves the domain " + to_string(domain) +
                         " of that level; clip it to the domain");
  for (int d = 0; d < 3; ++d)
    if (box.lower[d] % blocking_factor != 0 ||
        (box.extent(d) % blocking_factor != 0 && box.upper[d] != domain.upper[d]))
      throw HierarchyError(where(level, box) + " is not aligned to the blocking factor " +
                           std::to_string(blocking_factor) + " along " + "xyz"[d] +
                           "; start it on a multiple and give it a multiple of that many cells, or end it at the "
                           "domain's upper face");
}

void check_disjoint(int number, Level const& level) {
  for (int b = 0; b < level.box_count(); ++b)
    level.for_each_overlap(level.box(b), [&](int other, Box const&, Index3 const&) {
      if (other > b)
        throw HierarchyError(where(number, level.box(b)) + " overlaps " + where(number, level.box(other)) +
                             "; boxes of a level must be disjoint");
    });
}

/// Each cell of the coarser level that touches the finer one, corners included, must exist or lie outside the domain.
void check_nesting(int number, Level const& level, Level const& coarser) {
  for (int b = 0; b < level.box_count(); ++b) {
    Box const region = coarser.cut_at_walls(level.box(b).coarsen(refinement_ratio).grow(1));
    GlobalIndex const inside = coarser.cells_in(region);
    if (inside != region.cells())
      throw HierarchyError(where(number, level.box(b)) + " does not nest: level " + std::to_string(number - 1) +
                           " must surround it by at least one cell, corners included, but lacks " +
                           std::to_string(region.cells() - inside) + " of the cells in " + to_string(region) +
                           "; enlarge level " + std::to_string(number - 1));
  }
}

/// Before boxes are cut and stored: no more cells than the ranks can number, however boxes are distributed.
void check_cells(std::string const& what, Box const& box, int ranks) {
  Real const cells = Real(box.extent(0)) * box.extent(1) * box.extent(2);
  Real const most = Real(std::numeric_limits<LocalIndex>::max()) * ranks;
  if (cells > most)
    throw HierarchyError(what + " has " + std::to_string(cells) + " cells, more than the " + std::to_string(most) +
                         " that " + std::to_string(ranks) + " ranks can number; use more ranks or fewer cells");
}

void check_domain(Domain const& domain, int max_grid_size, int blocking_factor) {
  if (blocking_factor < 2 || (blocking_factor & (blocking_factor - 1)) != 0)
    throw HierarchyError("blocking_factor is " + std::to_string(blocking_factor) +
                         "; it must be a power of two, at least 2");
  if (max_grid_size < blocking_factor)
    throw HierarchyError("max_grid_size is " + std::to_string(max_grid_size) + ", less than the blocking factor " +
                         std::to_string(blocking_factor) + "; make it a multiple of the blocking factor");
  for (int d = 0; d < 3; ++d) {
    if (domain.cells[d] < 2)
      throw HierarchyError("the domain has " + std::to_string(domain.cells[d]) + " cells along " + "xyz"[d] +
                           "; give it at least 2");
    if (!(domain.upper[d] > domain.lower[d]))
      throw HierarchyError("the domain's upper corner does not lie above its lower one along " +
                           std::string(1, "xyz"[d]));
    bool const first = domain.boundary[d][0] == Boundary::periodic,
               second = domain.boundary[d][1] == Boundary::periodic;
    if (first != second)
      throw HierarchyError("one face of axis " + std::string(1, "xyz"[d]) +
                           " is periodic and the other is not; make both periodic");
  }
}

/// The boxes of a level of an earlier hierarchy, if there is such a level and they are the given ones.
std::shared_ptr<BoxTable const> same_boxes(Hierarchy const* earlier, std::size_t l, Box const& domain,
                                           std::array<bool, 3> const& periodic, std::vector<Box> const& boxes) {
  if (!earlier || l >= std::size_t(earlier->level_count())) return nullptr;
  Level const& level = earlier->level(int(l));
  bool const same = level.domain() == domain && level.periodic() == periodic && level.boxes() == boxes;
  return same ? level.share_table() : nullptr;
}

}  // namespace

void sort_along_curve(std::vector<Box>& boxes) {
  if (boxes.empty()) return;
  Box hull = boxes.front();
  std::array<std::int64_t, 3> extent{0, 0, 0};  // of all boxes
  for (Box const& box : boxes) {
    hull = hull.hull(box);
    for (int d = 0; d < 3; ++d) extent[d] += box.extent(d);
  }
  // Places are counted in mean extents of a box first, else eight boxes after each other would make up a cube only if
  // their extents were powers of two.
  auto const places = [&](std::int64_t twice, int d) {
    return int(twice * std::int64_t(boxes.size()) / (2 * extent[d]));
  };
  Index3 half, order{2, 1, 0};
  for (int d = 0; d < 3; ++d) half[d] = (places(2 * std::int64_t(hull.extent(d)), d) + 1) / 2;
  // Planes across x cut rows of cells, and shorter rows take more time for each cell.
  auto const length = [&](int d) { return std::int64_t(hull.extent(d)) * (d == 0 ? 4 : 5); };
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return length(a) > length(b); });
  struct Place {
    int part;
    Index3 in_part;
  };
  auto const place = [&](Box const& box) {
    Place out{0, {}};
    for (int d : order) {
      int const at = places(std::int64_t(box.lower[d]) + box.upper[d] + 1 - 2 * std::int64_t(hull.lower[d]), d);
      bool const upper = at >= half[d];
      out.part = 2 * out.part + upper;
      out.in_part[d] = upper ? at - half[d] : at;
    }
    return out;
  };
  std::vector<std::pair<Place, Box>> placed;
  for (Box const& box : boxes) placed.emplace_back(place(box), box);
  std::sort(placed.begin(), placed.end(), [](auto const& a, auto const& b) {
    if (a.first.part != b.first.part) return a.first.part < b.first.part;
    return a.first.in_part != b.first.in_part ? morton_less(a.first.in_part, b.first.in_part)
                                              : morton_less(twice_centre(a.second), twice_centre(b.second));
  });
  std::transform(placed.begin(), placed.end(), boxes.begin(), [](auto const& p) { return p.second; });
}

std::vector<int> distribute(std::vector<Box> const& boxes, int ranks) {
  GlobalIndex const total = cells_of(boxes);
  std::vector<int> first(std::size_t(ranks) + 1, int(boxes.size()));
  first[0] = 0;
  GlobalIndex sum = 0;
  int rank = 1;
  for (std::size_t b = 0; b < boxes.size() && rank < ranks; ++b) {
    // a box goes to the rank in whose range its middle lies
    while (rank < ranks && (2 * sum + boxes[b].cells()) * ranks >= 2 * total * rank)
      first[std::size_t(rank++)] = int(b);
    sum += boxes[b].cells();
  }
  return first;
}

namespace {

/// A box cut in halves along its longest axis, where both start on blocks and are thick enough; itself where none can
/// be cut.
std::vector<Box> halves(Box const& box, int blocking_factor) {
  int axis = -1, below = 0;
  for (int d = 2; d >= 0; --d) {  // in the order of the curve
    int const half = box.extent(d) / blocking_factor / 2 * blocking_factor;
    if (half < smallest_piece || box.extent(d) - half < smallest_piece) continue;
    if (axis < 0 || box.extent(d) > box.extent(axis)) axis = d, below = half;
  }
  if (axis < 0) return {box};
  Box lower = box, upper = box;
  upper.lower[axis] += below;
  lower.upper[axis] = upper.lower[axis] - 1;
  return {lower, upper};
}

/// Halve those boxes of overfull ranks within which the border between the equal parts of two ranks lies. Returns
/// whether there were any.
bool relieve(std::vector<Box>& boxes, std::vector<int> const& first, int blocking_factor) {
  GlobalIndex const total = cells_of(boxes), ranks = GlobalIndex(first.size()) - 1;
  std::vector<Box> out;
  GlobalIndex end = 0;  // cells up to the box
  for (std::size_t r = 0; r + 1 < first.size(); ++r) {
    std::vector<Box> const run(boxes.begin() + first[r], boxes.begin() + first[r + 1]);
    bool const is_overfull = Real(cells_of(run)) * Real(ranks) > most_imbalance * Real(total);
    for (Box const& box : run) {
      GlobalIndex const border = end * ranks / total + 1;  // the next one, in parts
      end += box.cells();
      bool const lies_across = border * total < end * ranks;
      for (Box const& piece : is_overfull&& lies_across ? halves(box, blocking_factor) : std::vector<Box>{box})
        out.push_back(piece);
    }
  }
  bool const any = out.size() > boxes.size();
  boxes = std::move(out);
  return any;
}

}  // namespace

std::vector<int> share_out(std::vector<Box>& boxes, int ranks, int blocking_factor) {
  sort_along_curve(boxes);
  auto first = distribute(boxes, ranks);
  while (relieve(boxes, first, blocking_factor)) first = distribute(boxes, ranks);
  return first;
}

Hierarchy::Hierarchy(Communicator const& comm, Domain const& domain, std::vector<std::vector<Box>> const& refined,
                     int max_grid_size, int blocking_factor, std::vector<Box> const& base, Hierarchy const* earlier)
    : comm_(comm), domain_(domain), max_grid_size_(max_grid_size), blocking_factor_(blocking_factor) {
  check_domain(domain, max_grid_size, blocking_factor);
  int const rank = comm.rank(), ranks = comm.ranks();
  std::array<bool, 3> const periodic{domain.periodic(0), domain.periodic(1), domain.periodic(2)};
  Box region{{0, 0, 0}, {domain.cells[0] - 1, domain.cells[1] - 1, domain.cells[2] - 1}};
  Real3 spacing{domain.spacing(0), domain.spacing(1), domain.spacing(2)};
  bool is_known = true;  // the level before, and with it that this one nests if it is known too

  for (std::size_t l = 0; l <= refined.size(); ++l) {
    if (l > 0) {
      for (int d = 0; d < 3; ++d)
        if (region.extent(d) > std::int64_t(1 << 20) * blocking_factor / 2)
          throw HierarchyError("level " + std::to_string(l) + " would have more than 2^20 blocks along " + "xyz"[d] +
                               "; use fewer levels");
      region = region.refine(refinement_ratio);
      for (Real& h : spacing) h /= 2;
    }
    if (l == 0) check_cells("level 0", region, ranks);
    bool const as_given = !base.empty();
    std::vector<Box> const asked = l > 0 ? refined[l - 1] : as_given ? base : std::vector<Box>{region};
    std::vector<Box> boxes;
    if (asked.empty()) break;
    for (Box const& box : asked) {
      check_box(int(l), box, region, blocking_factor);
      check_cells(where(int(l), box), box, ranks);
      auto const pieces = as_given ? std::vector<Box>{box} : cut(box, max_grid_size, blocking_factor);
      boxes.insert(boxes.end(), pieces.begin(), pieces.end());
    }
    auto first = as_given ? distribute(boxes, ranks) : share_out(boxes, ranks, blocking_factor);
    auto table = same_boxes(earlier, l, region, periodic, boxes);
    bool const was_known = std::exchange(is_known, table != nullptr);
    if (!table) table = std::make_shared<BoxTable const>(std::move(boxes));
    auto level = std::make_shared<Level const>(region, periodic, spacing, std::move(table), std::move(first), rank);
    for (int r = 0; r < ranks; ++r)
      if (level->first_cell(r + 1) - level->first_cell(r) > std::numeric_limits<LocalIndex>::max())
        throw HierarchyError("level " + std::to_string(l) + " puts " +
                             std::to_string(level->first_cell(r + 1) - level->first_cell(r)) + " cells on rank " +
                             std::to_string(r) + ", more than 32-bit numbers count; use more ranks");
    if ((l > 0 || as_given) && !is_known) check_disjoint(int(l), *level);
    if (l > 0 && !(is_known && was_known)) check_nesting(int(l), *level, *levels_.back());
    if (l == 0 && level->cells() != region.cells())
      throw HierarchyError("the boxes given for level 0 have " + std::to_string(level->cells()) + " of the domain's " +
                           std::to_string(region.cells()) + " cells; they must cover it");
    levels_.push_back(std::move(level));
  }
}

std::shared_ptr<LevelFaces const> Hierarchy::share_faces(int l) const {
  std::call_once(faces_->found, [&] {
    for (int n = 0; n < level_count(); ++n)
      faces_->levels.push_back(
          std::make_shared<LevelFaces const>(faces_of_boxes(level(n), has_finer(n) ? &level(n + 1) : nullptr)));
  });
  return faces_->levels[std::size_t(l)];
}

std::shared_ptr<Hierarchy const> Hierarchy::stretched(Real3 const& factor) const {
  auto out = std::make_shared<Hierarchy>(*this);
  for (int d = 0; d < 3; ++d) {
    out->domain_.lower[d] *= factor[d];
    out->domain_.upper[d] *= factor[d];
  }
  for (auto& level : out->levels_) level = level->stretched(factor);
  return out;
}

std::shared_ptr<Hierarchy const> Hierarchy::opened(int axis) const {
  auto out = std::make_shared<Hierarchy>(*this);
  out->domain_.boundary[axis] = {Boundary::open, Boundary::open};
  return out;
}

std::shared_ptr<Hierarchy const> Hierarchy::seen_by(int rank) const {
  if (!comm_.is_virtual())
    throw HierarchyError("the hierarchy belongs to ranks that run; make it for a virtual rank to see it as others do");
  auto out = std::make_shared<Hierarchy>(*this);
  out->comm_ = Communicator(rank, comm_.ranks());
  for (auto& level : out->levels_) level = level->seen_by(rank);
  out->faces_ = std::make_shared<Faces>();
  return out;
}

}  // namespace amrpic
