#include "mesh/hierarchy.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <string>

#include "base/error.hpp"
#include "mesh/array_on_box.hpp"

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
    GlobalIndex inside = 0;
    coarser.for_each_overlap(region, [&](int, Box const& part, Index3 const&) { inside += part.cells(); });
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
    if (first && domain.has(Boundary::open))
      throw HierarchyError(
          "axis " + std::string(1, "xyz"[d]) +
          " is periodic and another face is open; no method for that pair is built, so choose dirichlet or neumann");
  }
}

}  // namespace

void sort_along_curve(std::vector<Box>& boxes) {
  std::sort(boxes.begin(), boxes.end(),
            [](Box const& a, Box const& b) { return morton_less(twice_centre(a), twice_centre(b)); });
}

std::vector<int> distribute(std::vector<Real> const& weights, int ranks) {
  Real const total = std::accumulate(weights.begin(), weights.end(), Real(0));
  std::vector<int> first(ranks + 1, int(weights.size()));
  first[0] = 0;
  Real sum = 0;
  int rank = 1;
  for (std::size_t b = 0; b < weights.size() && rank < ranks; ++b) {
    // a box goes to the rank in whose range its middle lies
    while (rank < ranks && sum + weights[b] / 2 >= total * rank / ranks) first[rank++] = int(b);
    sum += weights[b];
  }
  return first;
}

Hierarchy::Hierarchy(Communicator const& comm, Domain const& domain, std::vector<std::vector<Box>> const& refined,
                     int max_grid_size, int blocking_factor, std::vector<std::vector<Real>> const& weights)
    : comm_(comm), domain_(domain), max_grid_size_(max_grid_size), blocking_factor_(blocking_factor) {
  check_domain(domain, max_grid_size, blocking_factor);
  int const rank = comm.rank(), ranks = comm.ranks();
  std::array<bool, 3> const periodic{domain.periodic(0), domain.periodic(1), domain.periodic(2)};
  Box region{{0, 0, 0}, {domain.cells[0] - 1, domain.cells[1] - 1, domain.cells[2] - 1}};
  Real3 spacing{domain.spacing(0), domain.spacing(1), domain.spacing(2)};

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
    std::vector<Box> asked = l == 0 ? std::vector<Box>{region} : refined[l - 1], boxes;
    if (asked.empty()) break;
    for (Box const& box : asked) {
      check_box(int(l), box, region, blocking_factor);
      check_cells(where(int(l), box), box, ranks);
      auto pieces = cut(box, max_grid_size, blocking_factor);
      boxes.insert(boxes.end(), pieces.begin(), pieces.end());
    }
    sort_along_curve(boxes);
    std::vector<Real> load(boxes.size());
    std::transform(boxes.begin(), boxes.end(), load.begin(), [](Box const& b) { return Real(b.cells()); });
    if (l < weights.size() && !weights[l].empty()) {
      if (weights[l].size() != boxes.size())
        throw HierarchyError("level " + std::to_string(l) + " has " + std::to_string(boxes.size()) + " boxes but " +
                             std::to_string(weights[l].size()) + " weights were given; give one per box");
      load = weights[l];
    }
    auto level =
        std::make_shared<Level const>(region, periodic, spacing, std::move(boxes), distribute(load, ranks), rank);
    for (int r = 0; r < ranks; ++r)
      if (level->first_cell(r + 1) - level->first_cell(r) > std::numeric_limits<LocalIndex>::max())
        throw HierarchyError("level " + std::to_string(l) + " puts " +
                             std::to_string(level->first_cell(r + 1) - level->first_cell(r)) + " cells on rank " +
                             std::to_string(r) + ", more than 32-bit numbers count; use more ranks");
    if (l > 0) {
      check_disjoint(int(l), *level);
      check_nesting(int(l), *level, *levels_.back());
    }
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
