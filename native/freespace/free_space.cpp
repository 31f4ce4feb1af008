#include "freespace/free_space.hpp"

#include <algorithm>
#include <utility>

#include "base/all_gather.hpp"
#include "freespace/wall_planes.hpp"

namespace amrpic::freespace {

namespace {

/// Values at all targets, computed by all ranks in turn, eight targets at a time. Collective.
std::vector<double> share_out(MPI_Comm comm, TreePotential const& evaluate, ChargeTree const& charges,
                              std::vector<Target> const& targets, LeafCharges& near) {
  int rank = 0, ranks = 1;
  MPI_Comm_rank(comm, &rank);
  MPI_Comm_size(comm, &ranks);
  auto const chunks = std::ptrdiff_t((targets.size() + lane_count - 1) / lane_count);
  auto const for_each_of = [&](int owner, auto&& f) {
    for (std::ptrdiff_t chunk = owner; chunk < chunks; chunk += ranks)
      for (auto n = std::size_t(chunk) * lane_count;
           n < std::min<std::size_t>((chunk + 1) * lane_count, targets.size()); ++n)
        f(n);
  };
  std::vector<Target> mine;
  for_each_of(rank, [&](std::size_t n) { mine.push_back(targets[n]); });
  auto const all = all_gather(comm, evaluate.at(comm, charges, mine, near)).values;
  std::vector<double> out(targets.size());
  double const* next = all.data();
  for (int r = 0; r < ranks; ++r) for_each_of(r, [&](std::size_t n) { out[n] = *next++; });
  return out;
}

}  // namespace

FreeSpace::FreeSpace(MPI_Comm comm, Lattice const& lattice, Options const& options)
    : comm_(comm),
      lattice_(lattice),
      options_(options),
      evaluate_(std::make_unique<TreePotential const>(lattice, 0, options)) {}

void FreeSpace::set_charges(std::vector<PointCharge> const& local) {
  charges_.blocks.assign(lattice_, local);
  build_tree();
}

void FreeSpace::set_charges(std::vector<ChargeBox> const& local) {
  charges_.blocks.assign(local);
  build_tree();
}

void FreeSpace::build_tree() {
  Point const shape = lattice_.shape();
  charges_.leaves = agree_on_leaves(comm_, charges_.blocks, options_.dropped);
  charges_.tree = build_octree(charges_.leaves, gather_moments(comm_, charges_.blocks, charges_.leaves, shape), shape);
  int const finest = charges_.leaves.empty() ? 0 : charges_.leaves.back().key.level;
  if (evaluate_->finest() < finest) evaluate_ = std::make_unique<TreePotential const>(lattice_, finest, options_);
}

std::array<std::vector<double>, 6> FreeSpace::wall_planes(std::array<bool, 6> const& open) const {
  double const tolerance = options_.plane_tolerance * greatest_potential(charges_.tree, lattice_.shape());
  std::vector<PlaneFill> planes;
  for (int face = 0; face < 6; ++face)
    if (open[face]) planes.emplace_back(lattice_, face, charges_.leaves, charges_.tree, tolerance);

  LeafCharges near;
  for (;;) {
    std::vector<Target> targets;
    for (PlaneFill const& plane : planes)
      for (Cell const& cell : plane.wanted()) targets.push_back({cell, 0});
    if (targets.empty()) break;
    auto const values = share_out(comm_, *evaluate_, charges_, targets, near);
    double const* next = values.data();
    for (PlaneFill& plane : planes) {
      std::size_t const count = plane.wanted().size();
      if (count > 0) plane.give(next);
      next += count;
    }
  }

  std::array<std::vector<double>, 6> out;
  for (PlaneFill const& plane : planes) {
    out[plane.face()] = plane.values();
    for (double& value : out[plane.face()]) value *= scale();
  }
  return out;
}

std::vector<double> FreeSpace::potential(std::vector<PointTarget> const& local) const {
  std::vector<Target> targets;
  for (PointTarget const& target : local)
    targets.push_back({lattice_.cell_at(target.position, target.level), target.level});
  LeafCharges near;
  std::vector<double> out = evaluate_->at(comm_, charges_, targets, near);
  for (double& value : out) value *= scale();
  return out;
}

double FreeSpace::scale() const { return 1 / (12.566370614359172954 * lattice_.unit()); }

}  // namespace amrpic::freespace
