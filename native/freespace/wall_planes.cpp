#include "freespace/wall_planes.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "freespace/interpolation.hpp"

namespace amrpic::freespace {

namespace {

constexpr int coarsest_stride = 16;

/// Nodes along an axis: from half a stride before the first cell to at least half a stride behind the last one.
int node_count(int cells, int stride) { return stride == 1 ? cells : (cells + 2 * stride - 2) / stride + 1; }

/// The widest stride, a power of two, that is no longer than `length`.
int stride_within(double length, double spacing) {
  int stride = 1;
  while (2 * stride * spacing <= length) stride *= 2;
  return stride;
}

/// How much of a charge's distance along the plane counts: its peak is felt over the width of the stencil.
constexpr double along_plane = 0.3;
/// Beside the rim of a grid the stencil is one-sided: it reaches two strides further and errs more.
constexpr double rim_reach = 2, rim_factor = 2.4;

/// Where an error is this many times too great, the squares around are not trusted either: beside rough charge an error
/// may pass through zero just where it is probed.
constexpr double distrust = 5;

/// A square of a grid, as the bound on its error sees it. Along an axis where all cells are nodes it has no width.
struct Square {
  std::array<double, 2> centre, half;
  double stride = 0;
  std::array<double, 2> reach{};  ///< distance along the plane that does not count
  double factor = 1;

  Square(PlaneGrids const& plane, PlaneGrids::Grid const& grid, std::array<int, 2> const& corner) {
    for (int t = 0; t < 2; ++t) {
      double const width = grid.stride[t] > 1 ? grid.stride[t] * plane.spacing[t] : 0;
      centre[t] = (plane.first[t] + corner[t] * grid.stride[t] + 0.5) * plane.spacing[t] + 0.5 * width;
      half[t] = 0.5 * width;
      if (width == 0) continue;
      stride = std::max(stride, width);
      if (corner[t] < stencil / 2 - 1 || corner[t] > grid.size[t] - 1 - stencil / 2) {
        reach[t] = rim_reach * width;
        factor = rim_factor;
      }
    }
  }
};

/// Distance along an axis, as far as it smooths the potential. Across the first layers of long cells the lattice
/// smooths as if they were short: short waves fade by 1 / (k h)^2 per layer there, not by exp(-k h).
double smoothing_distance(double distance, double spacing) {
  constexpr double layers = 3;
  return distance - std::min(distance, layers * spacing) * (1 - 1 / spacing);
}

/// What a node of the tree may add to the error inside a square, and whether that is known well enough.
struct Part {
  double error;
  bool is_known;
};

Part error_from(TreeNode const& node, PlaneGrids const& plane, Square const& square, double negligible) {
  double const above = smoothing_distance(std::abs(plane.place - node.centre[plane.normal]), plane.depth);
  double distance2 = above * above, radius2 = node.half[plane.normal] * node.half[plane.normal];
  for (int t = 0; t < 2; ++t) {
    int const d = plane.axes[t];
    double const gap = std::abs(square.centre[t] - node.centre[d]) - square.half[t] - square.reach[t];
    double const beside = smoothing_distance(std::max(0.0, gap), plane.spacing[t]);
    distance2 += along_plane * beside * beside;
    radius2 += along_plane * node.half[d] * node.half[d];
  }
  double const distance = std::sqrt(distance2), radius = std::sqrt(radius2);
  bool const is_small = radius < 0.5 * distance;
  // Among the charges of a node the near ones count most: half a radius before its centre, or for a leaf all of it.
  double const counted = node.leaf < 0 && is_small ? distance - 0.5 * radius : std::max(0.0, distance - radius);
  double const error = square.factor * node.magnitude / square.stride * interpolation_error(counted / square.stride);
  return {error, is_small || node.leaf >= 0 || error < negligible};
}

/// Whether the charges of the tree may make the interpolation inside a square err by more than `tolerance`.
bool may_err(PlaneGrids const& plane, Octree const& tree, Square const& square, double tolerance,
             std::vector<int>& stack) {
  double error = 0;
  stack.assign(1, tree.root());
  while (!stack.empty()) {
    TreeNode const& node = tree.nodes[stack.back()];
    stack.pop_back();
    Part const part = error_from(node, plane, square, 0.02 * tolerance);
    if (part.is_known) {
      error += part.error;
      if (error > tolerance) return true;
    } else {
      for (int c = 0; c < node.children; ++c) stack.push_back(node.first_child + c);
    }
  }
  return false;
}

/// Bits of both indices in turn, so that sorted places are neighbours in the plane.
std::uint64_t interleave(std::array<int, 2> const& place) {
  std::uint64_t out = 0;
  for (int bit = 0; bit < 31; ++bit)
    for (int t = 0; t < 2; ++t) out |= std::uint64_t(place[t] >> bit & 1) << (2 * bit + t);
  return out;
}

void sort_by_neighbourhood(std::vector<std::array<int, 2>>& places) {
  std::sort(places.begin(), places.end(), [](auto const& a, auto const& b) { return interleave(a) < interleave(b); });
  places.erase(std::unique(places.begin(), places.end()), places.end());
}

}  // namespace

PlaneGrids::PlaneGrids(Lattice const& lattice, int face_number)
    : face(face_number),
      normal(face_number / 2),
      ghost(face_number % 2 == 0 ? -1 : lattice.cells[normal]),
      axes(plane_axes(normal)) {
  Point const shape = lattice.shape();
  depth = shape[normal];
  place = (ghost + 0.5) * depth;
  for (int t = 0; t < 2; ++t) {
    cells[t] = lattice.cells[axes[t]];
    spacing[t] = shape[axes[t]];
  }
  auto const stride_at = [&](int t, double length) { return stride_within(length, spacing[t]); };
  double length = coarsest_stride;  // of the strides of a grid; halved along both axes, until all cells are nodes
  for (int t = 0; t < 2; ++t)
    while (stride_at(t, length) > 1 && node_count(cells[t], stride_at(t, length)) < stencil) length /= 2;
  Grid grid;
  for (int t = 0; t < 2; ++t) {
    grid.stride[t] = stride_at(t, length);
    grid.size[t] = node_count(cells[t], grid.stride[t]);
    first[t] = -(grid.stride[t] / 2);
  }
  grids.push_back(grid);
  while (grid.stride[0] > 1 || grid.stride[1] > 1) {
    for (int t = 0; t < 2; ++t) {
      if (grid.stride[t] == 1) continue;
      grid.stride[t] /= 2;
      grid.size[t] = 2 * grid.size[t] - 1;
    }
    grids.push_back(grid);
  }
}

Cell PlaneGrids::cell(std::array<int, 2> const& in_plane) const {
  Cell out;
  out[normal] = ghost;
  out[axes[0]] = in_plane[0];
  out[axes[1]] = in_plane[1];
  return out;
}

PlaneFill::PlaneFill(Lattice const& lattice, int face, std::vector<Leaf> const& leaves, Octree const& tree,
                     double tolerance)
    : plane_(lattice, face), leaves_(leaves), tree_(tree), tolerance_(tolerance) {
  values_.assign(std::size_t(grid().size[0]) * grid().size[1], 0.0);
  if (tree.empty()) return;
  std::vector<Place> squares;
  for (int j = 0; j < grid().size[1]; ++j)
    for (int i = 0; i < grid().size[0]; ++i) {
      nodes_.push_back({i, j});
      if (i < grid().squares(0) && j < grid().squares(1)) squares.push_back({i, j});
    }
  sort_by_neighbourhood(nodes_);
  want_probes(squares);
}

/// Fill `probes_` for those of the candidates that may err, and `wanted_` from nodes and probes.
void PlaneFill::want_probes(std::vector<Place> const& candidates) {
  probes_.clear();
  if (!is_last()) {
    std::vector<int> stack;
    std::vector<char> doubtful(values_.size(), 0);
    auto const number = [&](Place const& square) { return square[0] + std::size_t(grid().size[0]) * square[1]; };
    for (Place const& square : candidates) {
      Place middle;
      bool is_outside = false;  // of the wall: only stencils see it
      for (int t = 0; t < 2; ++t) {
        int const low = plane_.first[t] + square[t] * grid().stride[t];
        middle[t] = low + grid().stride[t] / 2;
        is_outside = is_outside || low + grid().stride[t] < -1 || low > plane_.cells[t];
      }
      if (is_outside || !may_err(plane_, tree_, {plane_, grid(), square}, tolerance_, stack)) continue;
      doubtful[number(square)] = 1;
      probes_.push_back({square, middle, true});
    }
    for (TreeNode const& node : tree_.nodes) {
      if (node.leaf < 0 || probes_.empty()) continue;
      Leaf const& leaf = leaves_[node.leaf];
      Place cell, square;
      for (int t = 0; t < 2; ++t) {
        int const d = plane_.axes[t];
        cell[t] = std::clamp((leaf.key.place[d] * block_edge + leaf.peak[d]) >> leaf.key.level, 0, plane_.cells[t] - 1);
        square[t] = std::min((cell[t] - plane_.first[t]) / grid().stride[t], grid().squares(t) - 1);
      }
      if (!doubtful[number(square)]) continue;
      if (error_from(node, plane_, {plane_, grid(), square}, 0).error > 0.25 * tolerance_)
        probes_.push_back({square, cell, false});
    }
  }
  wanted_.clear();
  for (Place const& node : nodes_)
    wanted_.push_back(
        plane_.cell({plane_.first[0] + node[0] * grid().stride[0], plane_.first[1] + node[1] * grid().stride[1]}));
  for (Probe const& probe : probes_) wanted_.push_back(plane_.cell(probe.cell));
}

void PlaneFill::give(double const* values) {
  for (Place const& node : nodes_) values_[node[0] + std::size_t(grid().size[0]) * node[1]] = *values++;
  std::map<Place, double> middles;  // value in the middle of each probed square
  std::map<Place, double> errors;   // the greatest of its probes
  for (Probe const& probe : probes_) {
    double const x = double(probe.cell[0] - plane_.first[0]) / grid().stride[0];
    double const y = double(probe.cell[1] - plane_.first[1]) / grid().stride[1];
    double const value = *values++;
    if (probe.is_middle) middles[probe.square] = value;
    double& error = errors[probe.square];
    error = std::max(error, std::abs(interpolate(values_, grid().size, x, y) - value));
  }
  std::map<Place, double> squares;  // those to halve, and the value in the middle
  for (auto const& [square, error] : errors) {
    if (error > tolerance_) squares[square] = middles[square];
    if (error < distrust * tolerance_) continue;
    for (int j = -1; j <= 1; ++j)
      for (int i = -1; i <= 1; ++i) {
        auto const beside = middles.find({square[0] + i, square[1] + j});
        if (beside != middles.end()) squares.insert(*beside);
      }
  }
  wanted_.clear();
  if (!squares.empty()) refine(squares);
}

/// Go to the next grid, where all new nodes of these squares are to be computed and their parts may be halved again.
void PlaneFill::refine(std::map<Place, double> const& squares) {
  auto const &coarse = grid(), &fine = plane_.grids[std::size_t(grid_) + 1];
  Place ratio{1, 1}, width{0, 0}, last{0, 0};  // new grid: steps per old one, across a square, and to its last part
  auto size = coarse.size;
  for (int t = 0; t < 2; ++t) {
    if (coarse.stride[t] == 1) continue;
    ratio[t] = width[t] = 2;
    last[t] = fine.stride[t] > 1 ? 1 : 2;
  }
  if (ratio[0] > 1) values_ = double_rows(values_, size[0], size[1]), size[0] = fine.size[0];
  if (ratio[1] > 1) values_ = double_columns(values_, size[0], size[1]);
  ++grid_;
  nodes_.clear();
  std::vector<Place> parts;
  for (auto const& [square, value] : squares)
    for (int b = 0; b <= width[1]; ++b)
      for (int a = 0; a <= width[0]; ++a) {
        Place const node{square[0] * ratio[0] + a, square[1] * ratio[1] + b};
        if (a <= last[0] && b <= last[1]) parts.push_back(node);
        if (a == width[0] / 2 && b == width[1] / 2)
          values_[node[0] + std::size_t(fine.size[0]) * node[1]] = value;
        else if (a % 2 != 0 || b % 2 != 0)
          nodes_.push_back(node);
      }
  sort_by_neighbourhood(nodes_);
  sort_by_neighbourhood(parts);
  want_probes(parts);
}

std::vector<double> PlaneFill::values() const {
  std::vector<double> all = values_;
  auto size = grid().size;
  for (std::size_t g = std::size_t(grid_) + 1; g < plane_.grids.size(); ++g) {
    auto const& fine = plane_.grids[g].size;
    if (fine[0] > size[0]) all = double_rows(all, size[0], size[1]), size[0] = fine[0];
    if (fine[1] > size[1]) all = double_columns(all, size[0], size[1]), size[1] = fine[1];
  }
  std::vector<double> out;
  for (int j = 0; j < plane_.cells[1]; ++j) {
    double const* row = all.data() + (std::size_t(size[0]) * (j - plane_.first[1]) - plane_.first[0]);
    out.insert(out.end(), row, row + plane_.cells[0]);
  }
  return out;
}

double greatest_potential(Octree const& tree, Point const& shape) {
  double const cell =
      0.315 * std::cbrt(shape[0] * shape[1] * shape[2]);  // 1 / (4 pi 0.315 h): a charge in its own cell
  double out = 0;
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    TreeNode const& node = tree.nodes[n];
    double const smallest = cell * node.coarsest;
    out = std::max(out, std::abs(tree.moments[n][0].re) / std::max(node.radius, smallest));
    // Charges may cancel in sum: then at least one of the cells of a leaf holds this much.
    if (node.leaf >= 0) out = std::max(out, node.magnitude / (block_cells * smallest));
  }
  return out;
}

}  // namespace amrpic::freespace
