#include "freespace/tree_potential.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "freespace/lattice_green.hpp"
#include "freespace/near_field.hpp"

namespace amrpic::freespace {

namespace {

constexpr double four_pi = 12.566370614359172954;
constexpr double lattice_negligible = 64;  ///< cells from a charge where its lattice adds 6e-5 of its potential
constexpr unsigned all_points = all_lanes;
constexpr int lowest_order = 2;
constexpr double order_tolerance = 2e-6;  ///< share of a box's potential that orders left out may add

/// Cells that the kernel tables must reach for charges at most `distance` away, and along long cells for the rest of a
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

/// Up to where the charges of a leaf of level 0 are summed one by one, in units of the smallest spacing.
double near_distance(Point const& shape, Options const& options) {
  double const leaf_radius = 0.5 * (block_edge - 1) * std::hypot(shape[0], shape[1], shape[2]);
  double const longest = std::max({shape[0], shape[1], shape[2]});
  return std::max(options.lattice_limit * longest, leaf_radius / options.acceptance);
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

/// Where tables have their points apart: ghosts of coarser levels lie on these, as far as they are apart themselves.
PointsApart points_for(Cell const& stride, int target_level, int level) {
  PointsApart out{stride, {}};
  Place const ghost = place_in_level(0, target_level, level);
  for (int d = 0; d < 3; ++d) out.origin[d] = ghost.point + ghost.shift;
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

/// Charges on the points of tables of wider spacing, made when first asked for.
class TreePotential::SpreadLeaves {
 public:
  explicit SpreadLeaves(KernelTables const& kernels) : kernels_(kernels) {}
  SpreadCharges const& of(int leaf, LeafCharges::Block const& charges, Leaf const& place, int table, int target_level) {
    std::array<int, 3> const key{leaf, table, target_level};
    auto const found = spread_.find(key);
    if (found != spread_.end()) return found->second;
    PointsApart const points = points_for(kernels_.stride(table), target_level, place.key.level);
    return spread_.emplace(key, SpreadCharges(charges, place.corner(), points)).first->second;
  }

 private:
  KernelTables const& kernels_;
  std::map<std::array<int, 3>, SpreadCharges> spread_;  ///< by leaf, table and level of the targets
};

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

/// What the charges nearby make at the points of one patch.
class TreePotential::NearPatch {
 public:
  NearPatch(Lattice const& lattice, GhostPatch const& patch, KernelTables& kernels)
      : patch_(patch), kernels_(kernels), normal_(patch.face / 2), axes_(plane_axes(normal_)) {
    columns_ = point_cells(patch.extent[0]), rows_ = point_cells(patch.extent[1]);
    for (int t = 0; t < patch_points; ++t) columns_[t] += patch.first[0], rows_[t] += patch.first[1];
    behind_ = patch.face % 2 == 0 ? -1 : lattice.cells[normal_] << patch.level;
  }

  /// Add the charges of a leaf at the points that `masks` has.
  void add(int number, Leaf const& leaf, LeafCharges::Block const& charges,
           std::array<unsigned, patch_points> const& masks, SpreadLeaves& spread, double* values) {
    int const level = leaf.key.level;
    Cell const corner = leaf.corner();
    double const scale = four_pi * std::ldexp(1.0, level);  // lengths are 2^level times smaller there
    auto const serving = [&](int axis, int cell) {
      int const point = place_in_level(cell, patch_.level, level).point;
      return kernels_.serving(axis, std::max(corner[axis] + block_edge - point, point + 1 - corner[axis]));
    };
    std::array<int, patch_points> by_column, by_row;
    int const across = serving(normal_, behind_);
    for (int t = 0; t < patch_points; ++t)
      by_column[t] = serving(axes_[0], columns_[t]), by_row[t] = serving(axes_[1], rows_[t]);
    for (int table = across; table < kernels_.count(); ++table) {
      std::array<unsigned, patch_points> served{};
      bool any = false;
      for (int row = 0; row < patch_points; ++row)
        for (int t = 0; t < patch_points; ++t)
          if ((masks[row] >> t & 1) && std::max({across, by_column[t], by_row[row]}) == table)
            served[row] |= 1u << t, any = true;
      if (!any) continue;
      KernelTable const& kernel = kernels_.at(table, level > patch_.level);
      NearGrid& points = grid(level, table);
      if (kernels_.stride(table) == Cell{1, 1, 1}) {
        points.add(charges, corner, kernel, served, scale, values);
      } else {
        SpreadCharges const& there = spread.of(number, charges, leaf, table, patch_.level);
        points.add(there.block, there.corner, kernel, served, scale, values);
      }
    }
  }

 private:
  NearGrid& grid(int level, int table) {
    auto const found = grids_.find({level, table});
    if (found != grids_.end()) return found->second;
    PointsApart const points = points_for(kernels_.stride(table), patch_.level, level);
    auto const stencil = [&](int axis, int cell) {
      Place const place = place_in_level(cell, patch_.level, level);
      bool const half = level > patch_.level && points.stride[axis] == 1;  // the table is
      return stencil_at(points.place(axis, place.point + (half ? 0 : place.shift)));
    };
    std::vector<Stencil> u, v;
    for (int t = 0; t < patch_points; ++t) {
      u.push_back(stencil(axes_[0], columns_[t]));
      v.push_back(stencil(axes_[1], rows_[t]));
    }
    NearGrid made(normal_, StencilRow(u), StencilRow(v), StencilRow({stencil(normal_, behind_)}));
    return grids_.emplace(std::pair(level, table), std::move(made)).first->second;
  }

  GhostPatch const& patch_;
  KernelTables& kernels_;
  int normal_, behind_;
  std::array<int, 2> axes_;
  std::array<int, patch_points> columns_, rows_;
  std::map<std::pair<int, int>, NearGrid> grids_;  ///< by level of the charges and table
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
      reach_(table_reach(lattice, finest, near_distance(shape_, options))),
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
  SpreadLeaves spread(kernels_);
  for (std::size_t n = 0; n < near.size();) {
    std::size_t const p = near[n].patch;
    std::map<int, std::array<unsigned, patch_points>> masks;  // by leaf
    for (; n < near.size() && near[n].patch == p; ++n) masks[near[n].leaf][std::size_t(near[n].row)] |= near[n].points;
    NearPatch patch(lattice_, patches[p], kernels_);
    for (auto const& [leaf, points] : masks)
      patch.add(leaf, charges.leaves[std::size_t(leaf)].leaf, fetched.of(leaf), points, spread,
                out.data() + (p - first) * patch_values);
  }
  return out;
}

}  // namespace amrpic::freespace
