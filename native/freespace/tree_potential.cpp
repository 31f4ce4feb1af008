#include "freespace/tree_potential.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "base/error.hpp"
#include "freespace/lattice_green.hpp"

namespace amrpic::freespace {

namespace {

constexpr double four_pi = 12.566370614359172954;
constexpr double lattice_negligible = 64;  ///< cells from a charge where its lattice adds 6e-5 of its potential
constexpr unsigned all_points = all_lanes;
constexpr int lowest_order = 2;
constexpr double order_tolerance = 2e-6;  ///< share of a box's potential that orders left out may add
constexpr double table_limit = 1 << 26;   ///< entries of a kernel table; only very long cells come near

/// Points that a kernel table must reach for charges at most `distance` away, and along long cells for the rest of a
/// block of ghosts that is partly as near.
Cell table_reach(Lattice const& lattice, int finest, double distance) {
  Point const shape = lattice.shape();
  Cell out;
  for (int d = 0; d < 3; ++d) {
    double const inside_domain = std::ldexp(lattice.cells[d] + 2.0 * block_edge, finest);  // and nodes beside a wall
    int const beyond = shape[d] > 2 ? 2 * block_edge : block_edge;
    out[d] = int(std::min(std::ceil(distance / shape[d]), inside_domain)) + beyond + 1;
  }
  return out;
}

double table_entries(Cell const& reach) { return (2.0 * reach[0] + 1) * (2.0 * reach[1] + 1) * (2.0 * reach[2] + 1); }

/// Up to where the charges of a leaf of level 0 are summed one by one, in units of the smallest spacing.
double near_distance(Point const& shape, Options const& options) {
  double const leaf_radius = 0.5 * (block_edge - 1) * std::hypot(shape[0], shape[1], shape[2]);
  double const longest = std::max({shape[0], shape[1], shape[2]});
  return std::max(options.lattice_limit * longest, leaf_radius / options.acceptance);
}

/// The reach of the kernel tables.
Cell checked_reach(Lattice const& lattice, int finest, Options const& options) {
  Point const shape = lattice.shape();
  Cell const out = table_reach(lattice, finest, near_distance(shape, options));
  if (table_entries(out) > table_limit)
    throw SolverError(
        "open boundary: cells are " + std::to_string(int(std::max({shape[0], shape[1], shape[2]}))) +
        " times longer than wide, too much for the table of the lattice Green's function; use cells closer "
        "to cubes");
  return out;
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

/// Sums of the charges of a leaf times the kernel, for some targets. `kernels`: at the first charge.
template <std::size_t count>
std::array<double, count> direct_sums(LeafCharges::Block const& charges,
                                      std::array<double const*, count> const& kernels, KernelTable const& table) {
  Lanes sum[count] = {};
  for (int n = 0; n < charges.row_count; ++n) {
    int const row = charges.rows[n];
    std::ptrdiff_t const offset = row % block_edge * table.stride(1) + row / block_edge * table.stride(2);
    auto const charge = load<Lanes>(charges.values.data() + block_edge * row);
    for (std::size_t t = 0; t < count; ++t) {
      auto const value = load<Lanes>(kernels[t] + offset);
      sum[t] += charge * value;
    }
  }
  std::array<double, count> out;
  for (std::size_t t = 0; t < count; ++t) out[t] = sum_of(sum[t]);
  return out;
}

/// Distance along an axis, as far as it smooths the potential: across the first layers of long cells the lattice
/// smooths as if they were short, since short waves fade by 1 / (k h)^2 per layer there, not by exp(-k h). `aspect`: of
/// a cell.
double smoothing_distance(double distance, double spacing, double aspect) {
  constexpr double layers = 3;
  return distance - std::min(distance, layers * spacing) * (1 - 1 / aspect);
}

double gap(double distance, double half) { return std::max(0.0, std::abs(distance) - half); }

/// The points of a patch, row after row.
struct Rows {
  std::array<std::array<Lanes, 3>, patch_points> at;

  explicit Rows(PatchPoints const& points) {
    auto const axes = plane_axes(points.normal);
    for (int row = 0; row < patch_points; ++row) {
      at[row][points.normal] = Lanes{} + points.place;
      at[row][axes[0]] = load<Lanes>(points.along[0].data());
      at[row][axes[1]] = Lanes{} + points.along[1][row];
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

/// The ghosts of a patch as a box, flat along the normal.
struct TreePotential::Rectangle {
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

  /// Squared distances between the centres, from the centre of a node, and from the box of its charges.
  double between_centres2(TreeNode const& node) const {
    double out = 0;
    for (int d = 0; d < 3; ++d) out += (centre[d] - node.centre[d]) * (centre[d] - node.centre[d]);
    return out;
  }
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

/// The points of a patch among the lattice points of a level with charge.
struct TreePotential::NearPoints {
  struct Ghost {
    KernelTable const* kernel;
    Cell point;
  };
  std::array<Ghost, patch_values> at;

  NearPoints() = default;
  NearPoints(Lattice const& lattice, GhostPatch const& patch, int level, KernelTables& kernels) {
    int const normal = patch.face / 2;
    auto const axes = plane_axes(normal);
    Ghost ghost{};
    Point shift{}, made_for{};
    auto const put = [&](int d, int cell) {
      Place const place = place_in_level(cell, patch.level, level);
      ghost.point[d] = place.point;
      shift[d] = place.shift;
    };
    auto const columns = point_cells(patch.extent[0]), rows = point_cells(patch.extent[1]);
    put(normal, patch.face % 2 == 0 ? -1 : lattice.cells[normal] << patch.level);
    for (int row = 0; row < patch_points; ++row) {
      put(axes[1], patch.first[1] + rows[row]);
      for (int t = 0; t < patch_points; ++t) {
        put(axes[0], patch.first[0] + columns[t]);
        if (!ghost.kernel || shift != made_for) ghost.kernel = &kernels.at(shift), made_for = shift;
        at[row * patch_points + t] = ghost;
      }
    }
  }
};

Cell near_cells(Lattice const& lattice, Options const& options) {
  Point const shape = lattice.shape();
  Cell out;
  for (int d = 0; d < 3; ++d) out[d] = int(std::ceil(near_distance(shape, options) / shape[d]));
  return out;
}

TreePotential::TreePotential(Lattice const& lattice, int finest, Options const& options)
    : lattice_(lattice),
      finest_(finest),
      options_(options),
      shape_(lattice.shape()),
      longest_spacing_(std::max({shape_[0], shape_[1], shape_[2]})),
      reach_(checked_reach(lattice, finest, options)),
      kernels_(shape_, reach_) {}

double TreePotential::far_limit(TreeNode const& node) const {
  return std::max(options_.lattice_limit * longest_spacing_ * node.coarsest, node.radius / options_.acceptance);
}

std::vector<Interactions> TreePotential::interactions(Octree const& tree,
                                                      std::vector<GhostPatch> const& patches) const {
  std::vector<Interactions> out(patches.size());
  if (tree.empty()) return out;
  std::vector<double> limits;
  for (TreeNode const& node : tree.nodes) limits.push_back(far_limit(node));
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
      bool const is_far = distance2 > limits[n] * limits[n];
      bool const is_mostly_near = !is_far && rectangle.between_centres2(node) < 0.5 * limits[n] * limits[n];
      if (is_far && rectangle.to_charges2(node) >= separation * separation)
        out[p].far.push_back(multipole(tree, n, distance2));
      else if (!is_far && node.leaf < 0 && (node.radius > rectangle.radius || is_mostly_near))
        for (int c = node.children; c-- > 0;) stack.push_back(node.first_child + c);
      else if (patch.is_block())
        out[p].mixed.push_back(n);
      else if (!is_far && is_summed(node, rectangle, separation))
        out[p].near.push_back(n);
      else
        left[p].push_back(n);
    }
  }
  return out;
}

/// Whether the charges of a leaf are to be summed at the points of a patch, and interpolated: where it is far enough
/// for that, but too near for multipoles to most parts of the patch. It comes to that where cells are long.
bool TreePotential::is_summed(TreeNode const& node, Rectangle const& rectangle, double separation) const {
  if (node.leaf < 0) return false;
  double distance2 = 0;
  for (int d = 0; d < 3; ++d) {
    double const apart = rectangle.centre[d] - node.centre[d], spacing = shape_[d] * node.coarsest;
    if ((std::abs(apart) + rectangle.half[d]) / spacing + block_edge > reach_[d]) return false;
    double const distance = smoothing_distance(gap(apart, rectangle.half[d] + node.half[d]), spacing, shape_[d]);
    distance2 += distance * distance;
  }
  return distance2 >= separation * separation;
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
  Point const h2{shape_[0] * shape_[0], shape_[1] * shape_[1], shape_[2] * shape_[2]};
  std::vector<Visit> stack;
  Rows const rows(points);
  for (int row = 0; row < patch_points; ++row) {
    auto const& at = rows.at[row];
    Lanes sum{};
    for (int start : nodes) {
      stack.assign(1, {start, all_points});
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
          sum += far == all_points ? value : select(mask_of(far), value, Lanes{});
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

/// The charges of a leaf one by one, at the points of a row that it is near to.
void TreePotential::add_near(Leaf const& leaf, LeafCharges::Block const& charges, NearPoints const& points,
                             NearRow const& row, double* values) const {
  constexpr std::size_t at_once = 4;
  std::array<double const*, at_once> kernels;
  std::array<int, at_once> numbers;
  Cell const corner = leaf.corner();
  double const scale = four_pi * std::ldexp(1.0, leaf.key.level);  // lengths are 2^level times smaller there
  unsigned left = row.points;
  while (left) {
    std::size_t count = 0;
    KernelTable const* table = nullptr;
    for (; left && count < at_once; left &= left - 1) {
      int const number = row.row * patch_points + __builtin_ctz(left);
      auto const& [kernel, point] = points.at[number];
      table = kernel;
      kernels[count] = kernel->row(corner[0] - point[0], corner[1] - point[1], corner[2] - point[2]);
      numbers[count++] = number;
    }
    for (std::size_t t = count; t < at_once; ++t) kernels[t] = kernels[0];
    auto const sums = direct_sums(charges, kernels, *table);
    for (std::size_t t = 0; t < count; ++t) values[numbers[t]] += scale * sums[t];
  }
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
    for (int n : interactions[p].near)
      for (int row = 0; row < patch_points; ++row) near.push_back({p, row, all_points, charges.tree.nodes[n].leaf});
  }
  std::vector<char> wanted(charges.leaves.size(), 0);
  for (NearRow const& row : near) wanted[row.leaf] = 1;
  MPI_Allreduce(MPI_IN_PLACE, wanted.data(), int(wanted.size()), MPI_SIGNED_CHAR, MPI_MAX, comm);
  LeafCharges const fetched(comm, charges.blocks, charges.leaves, wanted);
  std::map<int, NearPoints> points;  // of one patch, by the level of the charge
  for (std::size_t n = 0; n < near.size(); ++n) {
    NearRow const& row = near[n];
    if (n > 0 && near[n - 1].patch != row.patch) points.clear();
    Leaf const& leaf = charges.leaves[row.leaf].leaf;
    auto const [entry, is_new] = points.try_emplace(leaf.key.level);
    if (is_new) entry->second = NearPoints(lattice_, patches[row.patch], leaf.key.level, kernels_);
    add_near(leaf, fetched.of(row.leaf), entry->second, row, out.data() + (row.patch - first) * patch_values);
  }
  return out;
}

}  // namespace amrpic::freespace
