#include "freespace/free_space.hpp"

#include <algorithm>
#include <stdexcept>

#include "base/communicator.hpp"
#include "base/error.hpp"

namespace amrpic::freespace {

namespace {

/// The patches of this rank: consecutive ones, with an equal part of the work.
std::array<std::size_t, 2> patches_of_rank(Communicator const& comm, std::vector<Interactions> const& interactions) {
  int const rank = comm.rank(), ranks = comm.ranks();
  double total = 0;
  for (Interactions const& of_patch : interactions) total += of_patch.cost();
  std::array<std::size_t, 2> out{interactions.size(), interactions.size()};
  double before = 0;
  for (std::size_t p = 0; p < interactions.size(); ++p) {
    for (int end : {0, 1})
      if (before >= total * (rank + end) / ranks && rank + end < ranks) out[end] = std::min(out[end], p);
    before += interactions[p].cost();
  }
  return out;
}

}  // namespace

FreeSpace::FreeSpace(Communicator const& comm, Lattice const& lattice, Options const& options)
    : comm_(comm),
      lattice_(lattice),
      options_(options),
      charges_{ChargeBlocks(lattice, near_cells(lattice, options)), {}, {}},
      evaluate_(std::make_unique<TreePotential const>(lattice, 0, options)) {}

void FreeSpace::set_charges(std::vector<PointCharge> const& local) {
  bool outside = false;
  for (PointCharge const& charge : local) {
    Cell const cell = lattice_.cell_at(charge.position, charge.level);
    for (int d = 0; d < 3; ++d)
      outside = outside || (charge.charge != 0 && (cell[d] < 0 || cell[d] >= (lattice_.cells[d] << charge.level)));
  }
  if (comm_.any(outside))
    throw SolverError("open boundary: a charge lies outside the domain; remove lost particles before the solve");
  charges_.blocks.assign(local);
  build_tree();
}

void FreeSpace::set_charges(std::vector<ChargeBox> const& local) {
  charges_.blocks.assign(local);
  build_tree();
}

void FreeSpace::build_tree() {
  Point const shape = lattice_.shape();
  charges_.leaves = agree_on_leaves(comm_, charges_.blocks, shape, options_.dropped);
  charges_.tree = build_octree(charges_.leaves, shape);
  int const finest = charges_.leaves.empty() ? 0 : charges_.leaves.back().leaf.key.level;
  if (evaluate_->finest() < finest) evaluate_ = std::make_unique<TreePotential const>(lattice_, finest, options_);
}

std::array<std::vector<double>, 6> FreeSpace::wall_planes(std::array<bool, 6> const& open) const {
  std::array<std::vector<double>, 6> out;
  std::vector<GhostBlock> blocks;
  auto const count = [](int cells) { return (cells + patch_points - 1) / patch_points; };
  for (int face = 0; face < 6; ++face) {
    if (!open[face]) continue;
    auto const [u, v] = plane_axes(face / 2);
    out[face].resize(std::size_t(lattice_.cells[u]) * lattice_.cells[v]);
    for (int j = 0; j < count(lattice_.cells[v]); ++j)
      for (int i = 0; i < count(lattice_.cells[u]); ++i) blocks.push_back({face, 0, {i, j}});
  }
  auto const values = ghosts(blocks);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    auto const [u, v] = plane_axes(blocks[b].face / 2);
    int const width = lattice_.cells[u], i = blocks[b].place[0] * patch_points;
    for (int row = 0; row < patch_points; ++row) {
      int const j = blocks[b].place[1] * patch_points + row;
      if (j >= lattice_.cells[v]) break;
      std::copy_n(values.data() + b * patch_values + row * patch_points, std::min(patch_points, width - i),
                  out[blocks[b].face].data() + std::size_t(width) * j + i);
    }
  }
  return out;
}

std::vector<double> FreeSpace::potential(std::vector<PointTarget> const& local) const {
  struct NumberedGhost {
    GhostBlock block;
    int number;  ///< in the block
  };
  std::vector<NumberedGhost> places;
  std::vector<GhostBlock> mine;
  bool is_no_ghost = false;
  for (PointTarget const& target : local) {
    places.push_back({});
    auto& [block, number] = places.back();
    Cell const cell = lattice_.cell_at(target.position, target.level);
    block.level = target.level;
    block.face = -1;
    for (int d = 0; d < 3; ++d)
      for (int side : {0, 1})
        if (cell[d] == (side == 0 ? -1 : lattice_.cells[d] << target.level)) block.face = 2 * d + side;
    if (block.face < 0) {
      is_no_ghost = true;
      break;
    }
    auto const [u, v] = plane_axes(block.face / 2);
    block.place = {cell[u] / patch_points, cell[v] / patch_points};
    number = cell[u] % patch_points + patch_points * (cell[v] % patch_points);
    if (mine.empty() || !(mine.back() == block)) mine.push_back(block);
  }
  if (comm_.any(is_no_ghost)) throw std::invalid_argument("FreeSpace: a target is no ghost behind a wall");
  auto blocks = comm_.gather(mine).values;
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
  auto const values = ghosts(blocks);
  std::vector<double> out;
  for (auto const& [block, number] : places) {
    auto const b = std::size_t(std::lower_bound(blocks.begin(), blocks.end(), block) - blocks.begin());
    out.push_back(values[b * patch_values + number]);
  }
  return out;
}

/// Potential at all ghosts of each block, which all ranks give in the same order, sorted. Collective.
std::vector<double> FreeSpace::ghosts(std::vector<GhostBlock> const& blocks) const {
  auto const patches = patches_around(lattice_, blocks);
  auto const interactions = evaluate_->interactions(charges_.tree, patches);
  auto const [first, last] = patches_of_rank(comm_, interactions);
  auto values = comm_.gather(evaluate_->at(comm_, charges_, patches, interactions, first, last)).values;
  interpolate_down(patches, values);
  values.resize(blocks.size() * patch_values);
  for (double& value : values) value *= scale();
  return values;
}

double FreeSpace::scale() const { return 1 / (12.566370614359172954 * lattice_.unit()); }

}  // namespace amrpic::freespace
