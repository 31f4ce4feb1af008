#include "freespace/tree_potential.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "base/error.hpp"
#include "freespace/lattice_green.hpp"

namespace amrpic::freespace {

namespace {

constexpr double four_pi = 12.566370614359172954;
constexpr double lattice_negligible = 64;  ///< cells from a charge where its lattice adds 6e-5 of its potential
constexpr int lowest_order = 2;
constexpr double order_tolerance = 2e-6;  ///< share of a box's potential that orders left out may add
constexpr double table_limit = 1 << 26;   ///< entries of a kernel table; only very long cells come near

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

/// Where the cells of one level lie along an axis, among the lattice points of another one: at `point` + shift.
struct Place {
  int point;
  double shift;
};

Place place_in_level(int cell, int cell_level, int level) {
  double const x = std::ldexp(cell + 0.5, level - cell_level) - 0.5, floor = std::floor(x);
  return {int(floor), x - floor};
}

/// Sums of eight charges in a row times the kernel, for up to `count` targets, over all rows of a leaf.
template <int count>
void sum_rows(Leaf const& leaf, double const* charges, std::array<double const*, count> kernel, std::ptrdiff_t stride_y,
              std::ptrdiff_t stride_z, std::array<double, count>& out) {
  Lanes sum[count] = {};
  for (int k = 0; k < leaf.extent[2]; ++k)
    for (int j = 0; j < leaf.extent[1]; ++j) {
      Lanes charge;
      __builtin_memcpy(&charge, charges + block_edge * (j + block_edge * k), sizeof(Lanes));
      for (int t = 0; t < count; ++t) {
        Lanes value;
        __builtin_memcpy(&value, kernel[t] + j * stride_y + k * stride_z, sizeof(Lanes));
        sum[t] += charge * value;
      }
    }
  for (int t = 0; t < count; ++t) out[t] = sum_of(sum[t]);
}

double gap(double distance, double half) { return std::max(0.0, std::abs(distance) - half); }

/// The ghosts of a patch as a box, flat along the normal.
struct Rectangle {
  Point centre, half;
  double radius;

  explicit Rectangle(PatchPoints const& points) {
    auto const axes = plane_axes(points.normal);
    centre[points.normal] = points.place;
    half[points.normal] = 0;
    for (int t = 0; t < 2; ++t) {
      centre[axes[t]] = points.centre[t];
      half[axes[t]] = points.half[t];
    }
    radius = std::hypot(points.half[0], points.half[1]);
  }

  /// Squared distance from the centre of a node, and from the box of its charges.
  double to_centre2(TreeNode const& node) const {
    double out = 0;
    for (int d = 0; d < 3; ++d) {
      double const g = gap(centre[d] - node.centre[d], half[d]);
      out += g * g;
    }
    return out;
  }
  double to_charges2(TreeNode const& node) const {
    double out = 0;
    for (int d = 0; d < 3; ++d) {
      double const g = gap(centre[d] - node.centre[d], half[d] + node.half[d]);
      out += g * g;
    }
    return out;
  }
};

/// The points of a patch, row after row.
struct Rows {
  std::array<std::array<Lanes, 3>, patch_points> at;

  explicit Rows(PatchPoints const& points) {
    auto const axes = plane_axes(points.normal);
    for (int row = 0; row < patch_points; ++row) {
      at[row][points.normal] = broadcast(points.place);
      __builtin_memcpy(&at[row][axes[0]], points.along[0].data(), sizeof(Lanes));
      at[row][axes[1]] = broadcast(points.along[1][row]);
    }
  }
};

/// Call f(row, x, y, z, inverse_r) with the vectors from a node to the points, and one over their lengths.
template <class F>
void for_rows(Point const& centre, Rows const& rows, F&& f) {
  for (int row = 0; row < patch_points; ++row) {
    auto const& at = rows.at[row];
    Lanes const x = at[0] - centre[0], y = at[1] - centre[1], z = at[2] - centre[2];
    f(row, x, y, z, inverse_root(x * x + y * y + z * z));
  }
}

template <int highest>
void add_multipole(Point const& centre, Expansion const& expansion, Rows const& rows,
                   std::array<Lanes, patch_points>& sums) {
  for_rows(centre, rows, [&](int row, Lanes const& x, Lanes const& y, Lanes const& z, Lanes const& inverse_r) {
    sums[row] += multipole_potential<highest>(expansion, x, y, z, inverse_r);
  });
}

void add_lattice(TreeNode const& node, Rows const& rows, Point const& h2, std::array<Lanes, patch_points>& sums) {
  for_rows(node.centre, rows, [&](int row, Lanes const& x, Lanes const& y, Lanes const& z, Lanes const& inverse_r) {
    sums[row] += lattice_correction(node.lattice, x, y, z, inverse_r, h2);
  });
}

void add_lanes(Lanes const& value, double* to) {
  for (int t = 0; t < lane_count; ++t) to[t] += value[t];
}

}  // namespace

TreePotential::TreePotential(Lattice const& lattice, int finest, Options const& options)
    : lattice_(lattice),
      finest_(finest),
      options_(options),
      shape_(lattice.shape()),
      longest_spacing_(std::max({shape_[0], shape_[1], shape_[2]})),
      kernels_(shape_, table_reach(lattice, finest, near_distance(lattice, finest, options))) {}

double TreePotential::far_limit(TreeNode const& node) const {
  return std::max(options_.lattice_limit * longest_spacing_ * node.coarsest, node.radius / options_.acceptance);
}

std::vector<Interactions> TreePotential::interactions(Octree const& tree,
                                                      std::vector<GhostPatch> const& patches) const {
  std::vector<Interactions> out(patches.size());
  if (tree.empty()) return out;
  std::vector<double> limit2;
  for (TreeNode const& node : tree.nodes) limit2.push_back(far_limit(node) * far_limit(node));
  std::vector<std::vector<int>> left(patches.size());  // to the children
  std::vector<int> stack;
  for (std::size_t p = patches.size(); p-- > 0;) {
    GhostPatch const& patch = patches[p];
    PatchPoints const points(lattice_, patch);
    Rectangle const rectangle(points);
    double const separation = options_.separation * points.width;
    if (patch.parent < 0)
      stack.assign(1, tree.root());
    else
      stack = left[patch.parent];
    while (!stack.empty()) {
      int const n = stack.back();
      stack.pop_back();
      TreeNode const& node = tree.nodes[n];
      double const distance2 = rectangle.to_centre2(node);
      bool const is_far = distance2 > limit2[n];
      if (is_far && rectangle.to_charges2(node) >= separation * separation)
        out[p].far.push_back(multipole(tree, n, distance2));
      else if (!is_far && node.leaf < 0 && node.radius > rectangle.radius)
        for (int c = node.children; c-- > 0;) stack.push_back(node.first_child + c);
      else if (patch.is_block())
        out[p].mixed.push_back(n);
      else
        left[p].push_back(n);
    }
  }
  return out;
}

/// How a node counts at points no nearer than this.
Interactions::Far TreePotential::multipole(Octree const& tree, int n, double distance2) const {
  TreeNode const& node = tree.nodes[n];
  Interactions::Far out{n, order, true};
  double const distance = std::sqrt(distance2);
  double left_out = 0, power = std::pow(distance, -order);
  for (int l = order; l > lowest_order; --l, power *= distance) {
    left_out += degree_strength(tree.moments[n], l) * power;
    if (left_out > order_tolerance * node.magnitude) break;
    out.highest = l - 1;
  }
  double const negligible = lattice_negligible * longest_spacing_ * node.coarsest;
  out.on_lattice = distance2 < negligible * negligible;
  return out;
}

void TreePotential::add_far(Octree const& tree, std::vector<Interactions::Far> const& nodes, PatchPoints const& points,
                            double* values) const {
  Point const h2{shape_[0] * shape_[0], shape_[1] * shape_[1], shape_[2] * shape_[2]};
  Rows const rows(points);
  std::array<Lanes, patch_points> sums{};
  for (auto const& [n, highest, on_lattice] : nodes) {
    TreeNode const& node = tree.nodes[n];
    Expansion const& expansion = tree.expansions[n];
    if (on_lattice) add_lattice(node, rows, h2, sums);
    switch (highest) {
      case 2:
        add_multipole<2>(node.centre, expansion, rows, sums);
        break;
      case 3:
        add_multipole<3>(node.centre, expansion, rows, sums);
        break;
      case 4:
        add_multipole<4>(node.centre, expansion, rows, sums);
        break;
      case 5:
        add_multipole<5>(node.centre, expansion, rows, sums);
        break;
      default:
        add_multipole<order>(node.centre, expansion, rows, sums);
    }
  }
  for (int row = 0; row < patch_points; ++row) add_lanes(sums[row], values + row * patch_points);
}

/// The multipoles of nodes, or of parts of them, at the ghosts that they are far from; the rest goes to `near`.
void TreePotential::add_mixed(Octree const& tree, std::vector<int> const& nodes, PatchPoints const& points,
                              std::size_t patch, double* values, std::vector<NearRow>& near) const {
  struct Visit {
    int node;
    unsigned active;
  };
  constexpr unsigned all = (1u << lane_count) - 1;
  Point const h2{shape_[0] * shape_[0], shape_[1] * shape_[1], shape_[2] * shape_[2]};
  std::vector<Visit> stack;
  Rows const rows(points);
  for (int row = 0; row < patch_points; ++row) {
    auto const& at = rows.at[row];
    Lanes sum{};
    for (int start : nodes) {
      stack.assign(1, {start, all});
      while (!stack.empty()) {
        auto const [n, active] = stack.back();
        stack.pop_back();
        TreeNode const& node = tree.nodes[n];
        Lanes const x = at[0] - node.centre[0], y = at[1] - node.centre[1], z = at[2] - node.centre[2];
        Lanes const r2 = x * x + y * y + z * z;
        double const limit = far_limit(node);
        unsigned const far = active & bits_of(r2 > limit * limit);
        if (far) {
          Lanes const inverse_r = inverse_root(r2);
          Lanes const value = multipole_potential<order>(tree.expansions[n], x, y, z, inverse_r) +
                              lattice_correction(node.lattice, x, y, z, inverse_r, h2);
          sum += far == all ? value : (mask_of(far) ? value : Lanes{});
        }
        unsigned const rest = active & ~far;
        if (!rest) continue;
        if (node.leaf >= 0) near.push_back({patch, row, rest, node.leaf});
        for (int c = node.children; c-- > 0;) stack.push_back({node.first_child + c, rest});
      }
    }
    add_lanes(sum, values + row * patch_points);
  }
}

/// The charges of a leaf one by one, at the ghosts of a row that it is near to.
void TreePotential::add_near(Leaf const& leaf, double const* charges, GhostPatch const& patch, NearRow const& row,
                             double* values) const {
  int const normal = patch.face / 2, level = leaf.key.level;
  auto const axes = plane_axes(normal);
  Cell const corner = leaf.corner();
  Cell offset;
  Point shift;
  auto const put = [&](int d, int cell) {
    Place const place = place_in_level(cell, patch.level, level);
    offset[d] = corner[d] - place.point;
    shift[d] = place.shift;
  };
  put(normal, patch.face % 2 == 0 ? -1 : lattice_.cells[normal] << patch.level);
  put(axes[1], patch.first[1] + row.row);

  constexpr int at_once = 4;
  std::array<double const*, at_once> rows;
  std::array<int, at_once> ghosts;
  int count = 0;
  KernelTable const* kernel = nullptr;
  Point made_for{};
  double const scale = four_pi * std::ldexp(1.0, level);  // lengths are 2^level times smaller there
  auto const sum = [&] {
    std::array<double, at_once> sums;
    for (int t = count; t < at_once; ++t) rows[t] = rows[0];
    sum_rows<at_once>(leaf, charges, rows, kernel->stride(1), kernel->stride(2), sums);
    for (int t = 0; t < count; ++t) values[row.row * patch_points + ghosts[t]] += scale * sums[t];
    count = 0;
  };
  for (int t = 0; t < patch_points; ++t) {
    if (!(row.ghosts >> t & 1)) continue;
    put(axes[0], patch.first[0] + t);
    if (!kernel || shift != made_for) kernel = &kernels_.at(shift), made_for = shift;
    rows[count] = kernel->row(offset[0], offset[1], offset[2]);
    ghosts[count++] = t;
    if (count == at_once) sum();
  }
  if (count > 0) sum();
}

std::vector<double> TreePotential::at(MPI_Comm comm, ChargeTree const& charges, std::vector<GhostPatch> const& patches,
                                      std::vector<Interactions> const& interactions, std::size_t first,
                                      std::size_t last) const {
  std::vector<double> out((last - first) * patch_values, 0.0);
  std::vector<NearRow> near;
  for (std::size_t p = first; p < last; ++p) {
    PatchPoints const points(lattice_, patches[p]);
    double* const values = out.data() + (p - first) * patch_values;
    add_far(charges.tree, interactions[p].far, points, values);
    add_mixed(charges.tree, interactions[p].mixed, points, p, values, near);
  }
  std::vector<char> wanted(charges.leaves.size(), 0);
  for (NearRow const& row : near) wanted[row.leaf] = 1;
  MPI_Allreduce(MPI_IN_PLACE, wanted.data(), int(wanted.size()), MPI_SIGNED_CHAR, MPI_MAX, comm);
  LeafCharges fetched;
  fetched.fetch(comm, charges.blocks, charges.leaves, wanted);
  for (NearRow const& row : near)
    add_near(charges.leaves[row.leaf], fetched.of(row.leaf), patches[row.patch], row,
             out.data() + (row.patch - first) * patch_values);
  return out;
}

}  // namespace amrpic::freespace
