#include "freespace/tree_potential.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "base/error.hpp"
#include "base/inverse_root.hpp"
#include "freespace/near_field.hpp"

namespace amrpic::freespace {

namespace {

constexpr double four_pi = 12.566370614359172954;
constexpr double lattice_negligible = 64;  ///< cells from a charge where its lattice adds 6e-5 of its potential
constexpr unsigned all_points = all_lanes;
constexpr int lowest_order = 2;
/// Of lists of what is near to patches, which are worked off when they are so long: images may be thousands.
constexpr std::size_t most_bytes_near = std::size_t(4) << 20;
/// Up to where the charges of a node of level 0 are summed one by one, in units of the smallest spacing, from its
/// centre.
double near_distance(Point const& shape, Options const& options) {
  Cell const widest = widest_blocks(shape);
  Point half;
  for (int d = 0; d < 3; ++d) half[d] = 0.5 * (widest[d] - 1) * shape[d];
  return std::max(options.lattice_limit * longest_spacing(shape),
                  std::hypot(half[0], half[1], half[2]) / options.acceptance);
}

/// Cells that the kernel tables must reach: from a node's charges to the ghosts that it is near to, and along long
/// cells to the rest of a block of ghosts that is partly as near. Across them to the rest of a patch, which is
/// interpolated where it is far enough for its width, and may stand out from its wall.
Cell table_reach(Lattice const& lattice, int finest, bool has_images, Options const& options) {
  Point const shape = lattice.shape();
  Cell const near = near_cells(lattice, options), widest = widest_blocks(shape);
  double wall = 0;
  for (int d = 0; d < 3; ++d) wall = std::max(wall, std::ldexp(lattice.cells[d] * shape[d], finest));
  double const patch = std::min(2 * wall, 2 / options.separation * near_distance(shape, options));
  Cell out;
  for (int d = 0; d < 3; ++d) {
    double const inside_domain =
        has_images ? double(near[d])                                           // images lie outside
                   : std::ldexp(lattice.cells[d] + 2.0 * block_edge, finest);  // and nodes beside a wall
    double const block = shape[d] > 2 ? 2 * block_edge : block_edge;
    double const interpolated = widest[d] > block_edge ? std::max(block, patch / shape[d]) : block;
    out[d] = int(std::ceil(std::min(double(near[d]), inside_domain) + interpolated)) + 1;
  }
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

/// Squared distances of a patch's centre, and of its points, from the centre of a node, and of these from its charges.
double between_centres2(PatchBox const& box, TreeNode const& node) {
  double out = 0;
  for (int d = 0; d < 3; ++d) out += (box.centre[d] - node.centre[d]) * (box.centre[d] - node.centre[d]);
  return out;
}
double to_centre2(PatchBox const& box, TreeNode const& node) { return box.distance2(node.centre, {0, 0, 0}); }
double to_charges2(PatchBox const& box, TreeNode const& node) {
  double out = 0;
  for (int d = 0; d < 3; ++d) {
    double const g = gap(box.centre[d] - node.centre[d], box.half[d] + node.half[d]);
    out += g * g;
  }
  return out;
}

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

void add_cells(OfCells const& cells, Point const& centre, Rows const& rows, Point const& h2,
               std::array<Lanes, patch_points>& sums) {
  if (cells.has_lattice)
    for_rows(centre, rows, [&](int row, Lanes const& x, Lanes const& y, Lanes const& z, Lanes const& inverse_r) {
      sums[row] += lattice_correction(cells.lattice, x, y, z, inverse_r, h2);
    });
  if (cells.has_means)
    for_rows(centre, rows, [&](int row, Lanes const& x, Lanes const& y, Lanes const& z, Lanes const& inverse_r) {
      sums[row] += means_correction(cells.means, x, y, z, inverse_r, h2);
    });
}

void add_lanes(Lanes const& value, double* to) {
  for (int t = 0; t < lane_count; ++t) to[t] += value[t];
}

/// What a closed form makes at the points of a patch.
void add_closing(Closing const& closing, PatchPoints const& points, double* values) {
  auto const axes = plane_axes(points.normal);
  for (int n = 0; n < patch_values; ++n) {
    Point place;
    place[points.normal] = points.place;
    for (int t = 0; t < 2; ++t)
      place[axes[t]] = points.along[std::size_t(t)][std::size_t(t == 0 ? n % patch_points : n / patch_points)];
    values[n] += closing.at(place);
  }
}

}  // namespace

/// What the charges nearby make at the points of one patch.
class TreePotential::NearPatch {
 public:
  NearPatch(TreePotential const& potential, GhostPatch const& patch, Image const& image)
      : potential_(potential),
        patch_(patch),
        kernels_(potential.kernels_),
        normal_(patch.face / 2),
        axes_(plane_axes(normal_)) {
    for (int t : {0, 1}) {
      cells_[t] = chebyshev_points(patch.extent[t]);
      for (int& cell : cells_[t]) cell = image.cell(axes_[t], patch.first[t] + cell, patch.level);
    }
    behind_ = image.cell(normal_, patch.behind(potential.lattice_.cells[normal_] << patch.level), patch.level);
  }

  /// Add the charges of a node at the points that `masks` has.
  void add(int number, TreeNode const& node, PointMasks const& masks, ChargesOfNodes& charges, double* values) {
    double const scale = four_pi * std::ldexp(1.0, node.level);  // lengths are 2^level times smaller there
    auto const by_column = tables_along(0, node), by_row = tables_along(1, node);
    int const across = table_serving(node, normal_, behind_);
    for (int table = across; table < kernels_.count(); ++table) {
      PointMasks served{};
      bool any = false;
      for (int row = 0; row < patch_points; ++row)
        for (int t = 0; t < patch_points; ++t)
          if ((masks[row] >> t & 1) && std::max({across, by_column[t], by_row[row]}) == table)
            served[row] |= std::uint8_t(1u << t), any = true;
      if (!any) continue;
      bool const all = kernels_.stride(table) == Cell{1, 1, 1};
      NodeCharges const& there = all ? charges.of(number)
                                     : charges.of({number, table, normal_, behind_, patch_.level},
                                                  points_apart(kernels_.stride(table), node.level));
      grid(node.level, table).add(there, kernels_.at(table, node.level > patch_.level), served, scale, values);
    }
  }

 private:
  int table_serving(TreeNode const& node, int axis, int cell) const {
    int const point = place_in_level(cell, patch_.level, node.level).point;
    int const end = node.first[axis] + std::max(node.extent[axis], block_edge);
    return kernels_.serving(axis, std::max(end - point, point + 1 - node.first[axis]));
  }

  /// For each point along an axis of the plane; the same for all where the patch is interpolated from points of a
  /// table.
  std::array<int, patch_points> tables_along(int t, TreeNode const& node) const {
    std::array<int, patch_points> out;
    for (int i = 0; i < patch_points; ++i) out[i] = table_serving(node, axes_[t], cells_[t][i]);
    if (patch_.extent[t] > patch_points && potential_.widest_[axes_[t]] > block_edge)
      out.fill(*std::max_element(out.begin(), out.end()));
    return out;
  }

  /// The points of a table of that stride, so that the wall's ghosts lie on them, and along it all that are as far
  /// apart themselves.
  PointsApart points_apart(Cell const& stride, int level) const {
    PointsApart out{stride, {}};
    for (int d = 0; d < 3; ++d) {
      LatticePlace const ghost = place_in_level(d == normal_ ? behind_ : 0, patch_.level, level);
      if (stride[d] > 1) out.origin[d] = ghost.point + ghost.shift;
    }
    return out;
  }

  NearGrid& grid(int level, int table) {
    auto const found = grids_.find({level, table});
    if (found != grids_.end()) return found->second;
    PointsApart const points = points_apart(kernels_.stride(table), level);
    std::array<StencilRow, 3> places;
    for (int t : {0, 1}) places[axes_[t]] = StencilRow(stencils(t, level, points));
    places[normal_] = StencilRow({stencil(normal_, behind_, level, points)});
    NearGrid made(normal_, std::move(places), axes_of_rows(potential_.shape_));
    return grids_.emplace(std::pair(level, table), std::move(made)).first->second;
  }

  InterpolationStencil stencil(int axis, int cell, int level, PointsApart const& points) const {
    LatticePlace const place = place_in_level(cell, patch_.level, level);
    bool const half = level > patch_.level && points.stride[axis] == 1;  // the table is
    return stencil_at(
        points.place(axis, place.point + (half ? 0 : place.shift)),
        potential_.options_.operator_order == 4 ? between_means(level, patch_.level, half) / stride2(points, axis) : 0);
  }

  static double stride2(PointsApart const& points, int axis) {
    return double(points.stride[axis]) * points.stride[axis];
  }

  /// Of the points along an axis of the plane. Between points of a table of wider spacing, which are far away in its
  /// short cells, means and values along these are the same.
  std::vector<InterpolationStencil> stencils(int t, int level, PointsApart const& points) const {
    int const axis = axes_[t];
    std::vector<InterpolationStencil> out;
    if (points.stride[axis] == 1 || std::ldexp(1.0, level - patch_.level) >= points.stride[axis]) {
      for (int cell : cells_[t]) out.push_back(stencil(axis, cell, level, points));
      return out;
    }
    auto const place = [&](int cell) {
      LatticePlace const ghost = place_in_level(cell, patch_.level, level);
      return points.place(axis, ghost.point + ghost.shift);
    };
    auto const [first, last] = std::minmax_element(cells_[t].begin(), cells_[t].end());
    Nodes const nodes = nodes_between(place(*first), place(*last));
    for (int cell : cells_[t]) out.push_back(stencil_of(nodes, place(cell)));
    return out;
  }

  TreePotential const& potential_;
  GhostPatch const& patch_;
  KernelTables& kernels_;
  int normal_, behind_;
  std::array<int, 2> axes_;
  std::array<Nodes, 2> cells_;
  std::map<std::pair<int, int>, NearGrid> grids_;  ///< by level of the charges and table
};

Cell near_cells(Lattice const& lattice, Options const& options) {
  Point const shape = lattice.shape();
  Cell out;
  Cell const widest = widest_blocks(shape);
  for (int d = 0; d < 3; ++d) {
    int const beside_centre = widest[d] > block_edge ? widest[d] / 2 : 0;
    out[d] = int(std::ceil(near_distance(shape, options) / shape[d])) + beside_centre;
  }
  return out;
}

TreePotential::TreePotential(Lattice const& lattice, int finest, bool has_images, Options const& options)
    : lattice_(lattice),
      finest_(finest),
      options_(options),
      shape_(lattice.shape()),
      longest_spacing_(longest_spacing(shape_)),
      widest_(widest_blocks(shape_)),
      kernels_(shape_, options.operator_order, table_reach(lattice, finest, has_images, options)) {}

/// Charge of a node over what as large a part of all has on average, rounded up to a power of two, so that rounding
/// rarely chooses; at most one.
double TreePotential::weakness(Octree const& tree, TreeNode const& node) const {
  if (options_.of_weak <= options_.acceptance || node.copies > 0) return 1;
  TreeNode const& all = tree.nodes.front();
  auto const size = [&](TreeNode const& of) { return std::pow(of.radius + longest_spacing_, 3); };
  double const share = node.magnitude / all.magnitude * size(all) / size(node);
  return std::min(1.0, std::ldexp(1.0, std::ilogb(share) + 1));
}

/// From where on a node is a multipole. The error of that is the power order + 1 of its radius over the distance, so
/// nodes with less charge may be nearer.
double TreePotential::far_limit(Octree const& tree, TreeNode const& node) const {
  if (node.copies > 0)
    return past_ties *
           std::max(options_.lattice_limit * longest_spacing_ * node.coarsest, node.radius / options_.of_images);
  double const least = options_.acceptance / options_.of_weak;
  double const factor = std::max(least, std::pow(weakness(tree, node), 1.0 / (order + 1)));
  return factor * freespace::far_limit(options_, node.radius, longest_spacing_ * node.coarsest);
}

void TreePotential::for_each_patch(
    Octree const& tree, std::vector<GhostPatch> const& patches, std::vector<char> const& is_own,
    std::function<void(std::size_t, std::vector<Interactions> const&)> const& use) const {
  if (tree.empty()) return;
  std::vector<double> limits;
  for (TreeNode const& node : tree.nodes) limits.push_back(far_limit(tree, node));
  struct Visit {
    int node, image;  ///< the latter by number
  };
  std::vector<Image> images;
  std::map<Image, int> numbers;
  std::vector<Visit> tops, stack;
  auto const number = [&](Image const& image) {
    auto const [at, is_new] = numbers.try_emplace(image, int(images.size()));
    if (is_new) images.push_back(image);
    return at->second;
  };
  for (auto const& [node, image] : tree.tops) tops.push_back({node, number(image)});
  std::vector<std::vector<Visit>> left(patches.size());  // to the children
  std::vector<Interactions> interactions;
  for (std::size_t p = patches.size(); p-- > 0;) {
    GhostPatch const& patch = patches[p];
    interactions.clear();
    PatchBox const here(lattice_.cells, shape_, patch);
    double const separation = options_.separation * here.width;
    stack = patch.parent < 0 ? tops : left[std::size_t(patch.parent)];
    PatchBox box = here;
    int seen_by = -1, place = -1;  // the latter of what is seen by it
    std::vector<int> places;       // by image
    auto const found = [&]() -> Interactions& {
      if (place < 0) {
        if (int(places.size()) <= seen_by) places.resize(images.size(), -1);
        place = places[std::size_t(seen_by)];
        if (place < 0) {
          place = places[std::size_t(seen_by)] = int(interactions.size());
          interactions.push_back({images[std::size_t(seen_by)], {}, {}});
        }
      }
      return interactions[std::size_t(place)];
    };
    while (!stack.empty()) {
      auto const [n, image] = stack.back();
      stack.pop_back();
      TreeNode const& node = tree.nodes[std::size_t(n)];
      if (image != seen_by) {
        box = here.seen_by(images[std::size_t(image)], shape_);
        seen_by = image, place = -1;
      }
      double const limit2 = limits[std::size_t(n)] * limits[std::size_t(n)];
      auto const width = summed_width(node);
      double const distance2 = to_centre2(box, node);
      bool const is_far = distance2 > limit2;
      bool const is_mostly_near = !is_far && between_centres2(box, node) < mostly_near2 * limit2;
      if (is_far && to_charges2(box, node) >= separation * separation) {
        if (is_own[p]) found().far.push_back(multipole(tree, n, distance2));
      } else if (!is_far && node.copies > 0) {
        for (int c = node.copies; c-- > 0;) {
          Octree::Copy const& copy = tree.copies[std::size_t(node.first_copy + c)];
          stack.push_back({copy.node, number(copy.image.after(images[std::size_t(image)]))});
        }
      } else if (!is_far && is_summed(node, box)) {
        if (is_own[p]) found().mixed.push_back(n);
      } else if (!is_far && node.leaf < 0 &&
                 (width ? *width > box.width : node.radius > box.radius || is_mostly_near)) {
        // What is closed on this rank has nothing that its own patches, here or below, are near to.
        if (is_own[p] && node.is_closed()) fail_alone("TreePotential: a node near a wall is not known on its rank");
        for (int c = node.children; c-- > 0;) stack.push_back({node.first_child + c, image});
      } else if (patch.is_block()) {
        if (is_own[p]) found().mixed.push_back(n);
      } else {
        left[p].push_back({n, image});
      }
    }
    if (is_own[p]) use(p, interactions);
  }
}

/// Half the width over which the charges of a node are interpolated where they are summed one by one; nothing for nodes
/// with too many for that.
std::optional<double> TreePotential::summed_width(TreeNode const& node) const {
  if (node.level < 0) return {};
  double out = 0;
  for (int d = 0; d < 3; ++d) {
    if (node.extent[d] > widest_[d]) return {};
    if (node.extent[d] > block_edge) out = std::max(out, node.half[d]);
  }
  return out;
}

/// Whether the charges of a node are summed one by one at the points of a patch: where both are as far from each other
/// as the interpolation over their half widths asks for, also where the lattice counts.
bool TreePotential::is_summed(TreeNode const& node, PatchBox const& patch_box) const {
  auto const width = summed_width(node);
  if (!width) return false;
  double const apart = options_.separation * std::max(*width, patch_box.width);
  double distance2 = 0;
  for (int d = 0; d < 3; ++d) {
    double const spacing = shape_[d] * node.coarsest;
    double const between = gap(patch_box.centre[d] - node.centre[d], patch_box.half[d] + node.half[d]);
    double const distance = smoothing_distance(between, spacing, shape_[d]);
    distance2 += distance * distance;
  }
  return distance2 >= apart * apart;
}

/// How a node counts at points no nearer than this.
Interactions::Far TreePotential::multipole(Octree const& tree, int n, double distance2) const {
  TreeNode const& node = tree.nodes[n];
  Interactions::Far out{n, order, true};
  if (node.copies > 0) return out;  // those of both signs leave little of the potential
  double const distance = std::sqrt(distance2);
  double const negligible_order = options_.negligible * node.magnitude / weakness(tree, node);
  double left_out = 0, power = std::pow(distance, -order);
  for (int l = order; l > lowest_order; --l, power *= distance) {
    left_out += degree_strength(tree.moments[n], l) * power;
    if (left_out > negligible_order) break;
    out.highest = l - 1;
  }
  double const negligible = lattice_negligible * longest_spacing_ * node.coarsest;
  out.on_lattice = !tree.copies.empty() || distance2 < negligible * negligible;
  return out;
}

/// In fourth order nothing of the lattice is left where multipoles serve, but means over cells of the charges' level
/// are not those over ghosts of another one, unless cells are cubes.
OfCells TreePotential::of_cells(Octree const& tree, int n, int level) const {
  TreeNode const& node = tree.nodes[std::size_t(n)];
  if (options_.operator_order == 2) return {node.lattice, {}, true, false};
  bool const cubes = shape_[0] == shape_[1] && shape_[1] == shape_[2];
  if (cubes || node.level == level) return {};
  OfCells out{{}, plain_moments(tree.moments[std::size_t(n)]), false, true};
  double const of_ghost = std::ldexp(1.0, -2 * level);
  out.means.charge = (of_ghost * out.means.charge - node.lattice.charge) / 24;
  for (int d = 0; d < 3; ++d) out.means.dipole[d] = (of_ghost * out.means.dipole[d] - node.lattice.dipole[d]) / 24;
  return out;
}

void TreePotential::add_far(Octree const& tree, std::vector<Interactions::Far> const& nodes, PatchPoints const& points,
                            int level, double* values) const {
  Point const h2{shape_[0] * shape_[0], shape_[1] * shape_[1], shape_[2] * shape_[2]};
  Rows const rows(points);
  std::array<Lanes, patch_points> sums{};
  for (auto const& [n, highest, on_lattice] : nodes) {
    TreeNode const& node = tree.nodes[n];
    Expansion const& expansion = tree.expansions[n];
    if (on_lattice) add_cells(of_cells(tree, n, level), node.centre, rows, h2, sums);
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

/// The multipoles of nodes, or of parts of them, at the points that they are far from. Returns the nodes that are near
/// to the others, and those points.
std::map<int, PointMasks> TreePotential::add_mixed(Octree const& tree, std::vector<int> const& nodes,
                                                   PatchPoints const& points, int level, double* values) const {
  struct Visit {
    int node;
    unsigned active;
  };
  Point const h2{shape_[0] * shape_[0], shape_[1] * shape_[1], shape_[2] * shape_[2]};
  std::vector<Visit> stack;
  std::map<int, PointMasks> near;
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
        double const limit = far_limit(tree, node);
        unsigned const far = active & bits_of(r2 > limit * limit);
        if (far) {
          Lanes const inverse_r = inverse_root(r2);
          OfCells const cells = of_cells(tree, n, level);
          Lanes value = multipole_potential<order>(tree.expansions[n], x, y, z, inverse_r) +
                        lattice_correction(cells.lattice, x, y, z, inverse_r, h2);  // one expression: rounded as ever
          if (cells.has_means) value += means_correction(cells.means, x, y, z, inverse_r, h2);
          sum += far == all_points ? value : select(mask_of(far), value, Lanes{});
        }
        unsigned const rest = active & ~far;
        if (!rest) continue;
        if (node.leaf >= 0 || is_summed(node, points.box)) {
          near[n][std::size_t(row)] |= std::uint8_t(rest);
          continue;
        }
        if (node.is_closed()) fail_alone("TreePotential: a node near a wall is not known on its rank");
        for (int c = node.children; c-- > 0;) stack.push_back({node.first_child + c, rest});
      }
    }
    add_lanes(sum, values + row * patch_points);
  }
  return near;
}

std::vector<double> TreePotential::at(Charges const& charges, Closing const& closing,
                                      std::vector<GhostPatch> const& patches, std::vector<char> const& is_own) const {
  Octree const& tree = charges.tree;
  auto const across = axes_of_rows(shape_);
  std::vector<double> out(patches.size() * patch_values, 0.0);
  struct NearNodes {
    std::size_t patch;
    Image image;
    std::vector<std::pair<int, PointMasks>> nodes;
    std::size_t bytes() const { return sizeof(*this) + nodes.size() * sizeof(nodes.front()); }
  };
  std::vector<NearNodes> near;  // not the maps themselves, which take five times their memory
  std::size_t bytes_near = 0;
  std::array<double, patch_values> values;
  auto const add = [&](std::size_t p, int sign) {
    for (int n = 0; n < patch_values; ++n) out[p * patch_values + std::size_t(n)] += sign * values[std::size_t(n)];
  };
  auto const sum_near = [&] {
    std::vector<int> nodes;
    for (NearNodes const& group : near)
      for (auto const& [node, points] : group.nodes) nodes.push_back(node);
    LeafCharges const leaves(tree, charges.own, charges.received, std::move(nodes), across);
    ChargesOfNodes of_nodes(tree, leaves, across);
    for (NearNodes const& group : near) {
      NearPatch patch(*this, patches[group.patch], group.image);
      values.fill(0);
      for (auto const& [node, points] : group.nodes)
        patch.add(node, tree.nodes[std::size_t(node)], points, of_nodes, values.data());
      add(group.patch, group.image.sign);
    }
    near.clear();
    bytes_near = 0;
  };
  for_each_patch(tree, patches, is_own, [&](std::size_t p, std::vector<Interactions> const& interactions) {
    for (auto const& [image, far, mixed] : interactions) {
      PatchPoints const points(lattice_, patches[p], image);
      values.fill(0);
      add_far(tree, far, points, patches[p].level, values.data());
      auto const nodes = add_mixed(tree, mixed, points, patches[p].level, values.data());
      if (!nodes.empty()) bytes_near += near.emplace_back(NearNodes{p, image, {nodes.begin(), nodes.end()}}).bytes();
      add(p, image.sign);
    }
    if (patches[p].parent < 0 && !closing.is_empty()) {
      values.fill(0);
      add_closing(closing, PatchPoints(lattice_, patches[p]), values.data());
      add(p, 1);
    }
    // All of a patch at a time, in an order that does not depend on what other patches the rank has.
    if (bytes_near > most_bytes_near) sum_near();
  });
  sum_near();
  kernels_.trim();
  return out;
}

}  // namespace amrpic::freespace
