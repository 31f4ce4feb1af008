#include "freespace/tree_potential.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "base/error.hpp"
#include "freespace/lattice_green.hpp"

namespace amrpic::freespace {

namespace {

constexpr double four_pi = 12.566370614359172954;
constexpr double table_limit = 1 << 26;  ///< entries of a kernel table; only very long cells come near

/// Points that a kernel table must reach for charges at most `distance` away.
Cell table_reach(Lattice const& lattice, int finest, double distance) {
  Point const shape = lattice.shape();
  Cell out;
  for (int d = 0; d < 3; ++d) {
    double const inside_domain = std::ldexp(lattice.cells[d] + 2.0 * block_edge, finest);  // and nodes beside a wall
    out[d] = int(std::min(std::ceil(distance / shape[d]), inside_domain)) + block_edge + 1;
  }
  return out;
}

double table_entries(Cell const& reach) { return (2.0 * reach[0] + 1) * (2.0 * reach[1] + 1) * (2.0 * reach[2] + 1); }

/// Up to where the charges of a leaf of level 0 are summed one by one, in units of the smallest spacing.
double near_distance(Lattice const& lattice, int finest, Options const& options) {
  Point const shape = lattice.shape();
  double const leaf_radius = 0.5 * (block_edge - 1) * std::hypot(shape[0], shape[1], shape[2]);
  double const longest = std::max({shape[0], shape[1], shape[2]});
  double const distance = std::max(options.lattice_limit * longest, leaf_radius / options.acceptance);
  if (table_entries(table_reach(lattice, finest, distance)) > table_limit)
    throw SolverError(
        "open boundary: cells are " + std::to_string(int(longest)) +
        " times longer than wide, too much for the table of the lattice Green's function; use cells closer to cubes");
  return distance;
}

/// Where a target lies among the lattice points of a level: at `point` + shift.
struct Place {
  Cell point;
  Point shift;
};

Place place_in_level(Target const& target, int level) {
  Place out;
  for (int d = 0; d < 3; ++d) {
    double const x = std::ldexp(target.cell[d] + 0.5, level - target.level) - 0.5, floor = std::floor(x);
    out.point[d] = int(floor);
    out.shift[d] = x - floor;
  }
  return out;
}

/// Positions of up to eight targets; the last one fills the lanes that are left.
struct TargetLanes {
  Lanes x[3];
  unsigned active;

  TargetLanes(Target const* targets, int count, Point const& shape) : active((1u << count) - 1) {
    for (int t = 0; t < lane_count; ++t) {
      Target const& target = targets[std::min(t, count - 1)];
      for (int d = 0; d < 3; ++d) x[d][t] = std::ldexp(target.cell[d] + 0.5, -target.level) * shape[d];
    }
  }
};

}  // namespace

TreePotential::TreePotential(Lattice const& lattice, int finest, Options const& options)
    : finest_(finest),
      options_(options),
      shape_(lattice.shape()),
      longest_spacing_(std::max({shape_[0], shape_[1], shape_[2]})),
      kernels_(shape_, table_reach(lattice, finest, near_distance(lattice, finest, options))) {}

double TreePotential::far_limit(TreeNode const& node) const {
  return std::max(options_.lattice_limit * longest_spacing_ * node.coarsest, node.radius / options_.acceptance);
}

std::vector<double> TreePotential::far_field(Octree const& tree, std::vector<Target> const& targets,
                                             std::vector<Pair>& near) const {
  struct Visit {
    int node;
    unsigned active;
  };
  Point const h2{shape_[0] * shape_[0], shape_[1] * shape_[1], shape_[2] * shape_[2]};
  std::vector<double> limit2;
  for (TreeNode const& node : tree.nodes) limit2.push_back(far_limit(node) * far_limit(node));

  std::vector<double> out(targets.size());
  std::vector<Visit> stack;
  for (std::size_t start = 0; start < targets.size(); start += lane_count) {
    int const count = int(std::min<std::size_t>(lane_count, targets.size() - start));
    TargetLanes const lanes(targets.data() + start, count, shape_);
    Lanes sum{};
    stack.assign(1, {tree.root(), lanes.active});
    while (!stack.empty()) {
      auto const [n, active] = stack.back();
      stack.pop_back();
      TreeNode const& node = tree.nodes[n];
      Lanes const x = lanes.x[0] - node.centre[0], y = lanes.x[1] - node.centre[1], z = lanes.x[2] - node.centre[2];
      Lanes const r2 = x * x + y * y + z * z;
      unsigned const far = active & bits_of(r2 > limit2[n]);
      if (far) {
        Lanes const inverse_r = inverse_root(r2);
        Lanes const value = multipole_potential(tree.expansions[n], x, y, z, inverse_r) +
                            lattice_correction(node.lattice, x, y, z, inverse_r, h2);
        sum += far == (1u << lane_count) - 1 ? value : (mask_of(far) ? value : Lanes{});
      }
      unsigned const rest = active & ~far;
      if (!rest) continue;
      if (node.leaf >= 0) {
        for (int t = 0; t < count; ++t)
          if (rest >> t & 1) near.push_back({int(start) + t, node.leaf});
      }
      for (int c = node.children; c-- > 0;) stack.push_back({node.first_child + c, rest});
    }
    for (int t = 0; t < count; ++t) out[start + t] = sum[t];
  }
  return out;
}

double TreePotential::near_field(Leaf const& leaf, double const* charges, Target const& target) const {
  Place const place = place_in_level(target, leaf.key.level);
  KernelTable const& kernel = kernels_.at(place.shift);
  Cell const corner = leaf.corner();
  Lanes sum{};
  for (int k = 0; k < leaf.extent[2]; ++k)
    for (int j = 0; j < leaf.extent[1]; ++j) {
      Lanes charge, value;
      __builtin_memcpy(&charge, charges + block_edge * (j + block_edge * k), sizeof(Lanes));
      double const* row =
          kernel.row(corner[0] - place.point[0], corner[1] + j - place.point[1], corner[2] + k - place.point[2]);
      __builtin_memcpy(&value, row, sizeof(Lanes));
      sum += charge * value;
    }
  return four_pi * std::ldexp(sum_of(sum), leaf.key.level);  // lengths are 2^level times smaller there
}

std::vector<double> TreePotential::at(MPI_Comm comm, ChargeTree const& charges, std::vector<Target> const& targets,
                                      LeafCharges& near) const {
  if (charges.tree.empty()) return std::vector<double>(targets.size(), 0.0);
  std::vector<Pair> pairs;
  std::vector<double> out = far_field(charges.tree, targets, pairs);
  std::vector<char> wanted(charges.leaves.size(), 0);
  for (Pair const& pair : pairs) wanted[pair.leaf] = 1;
  MPI_Allreduce(MPI_IN_PLACE, wanted.data(), int(wanted.size()), MPI_SIGNED_CHAR, MPI_MAX, comm);
  near.fetch(comm, charges.blocks, charges.leaves, wanted);
  for (Pair const& pair : pairs)
    out[pair.target] += near_field(charges.leaves[pair.leaf], near.of(pair.leaf), targets[pair.target]);
  return out;
}

}  // namespace amrpic::freespace
