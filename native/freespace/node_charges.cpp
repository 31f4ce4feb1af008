#include "freespace/node_charges.hpp"

#include <algorithm>
#include <tuple>

namespace amrpic::freespace {

namespace {

PointsApart const all_cells{{1, 1, 1}, {0, 0, 0}};

/// Row n: weights of the points of `to` for charge at point n of `from`.
using Weights = std::array<std::array<double, node_count>, node_count>;

Weights weights_between(Nodes const& from, Nodes const& to, PointsApart const& points, int axis) {
  Weights out;
  for (int n = 0; n < node_count; ++n) out[n] = lagrange_weights(to, points.place(axis, from[n]));
  return out;
}

/// Add charges on cells, distributed over the points of `to` among `points`: the potential far away is the same.
void add_spread(std::array<Nodes, 3> const& cells, BlockCharges const& charges, PointsApart const& points,
                std::array<int, 3> const& across, NodeCharges& to) {
  auto const [u, v, w] = across;
  int const shift = cells[u][0] - to.points[u][0];  // rows lie within those of wider nodes
  Weights const along_v = weights_between(cells[v], to.points[v], points, v);
  Weights const along_w = weights_between(cells[w], to.points[w], points, w);
  Lanes planes[block_edge][block_edge] = {};  // spread along v
  for (int k = 0; k < block_edge; ++k)
    for (int j = 0; j < block_edge; ++j) {
      std::array<double, 2 * block_edge> row{};
      std::copy_n(charges.data() + block_edge * (j + block_edge * k), block_edge, row.data() + shift);
      auto const charge = load<Lanes>(row.data());
      for (int i = 0; i < block_edge; ++i) planes[k][i] += along_v[j][i] * charge;
    }
  for (int i = 0; i < block_edge; ++i)
    for (int j = 0; j < block_edge; ++j) {
      double* const at = to.values.data() + block_edge * (j + block_edge * i);
      auto sum = load<Lanes>(at);
      for (int k = 0; k < block_edge; ++k) sum += along_w[k][i] * planes[k][j];
      store(at, sum);
    }
}

}  // namespace

void NodeCharges::find_rows() {
  row_count = 0;
  for (int row = 0; row < block_rows; ++row) {
    double const* const first = values.data() + block_edge * row;
    if (std::any_of(first, first + block_edge, [](double q) { return q != 0; }))
      rows[row_count++] = static_cast<unsigned char>(row);
  }
}

bool NodeVariant::operator<(NodeVariant const& o) const {
  return std::tie(node, table, normal, behind, target_level) <
         std::tie(o.node, o.table, o.normal, o.behind, o.target_level);
}

std::array<Nodes, 3> ChargesOfNodes::points_of(TreeNode const& node, PointsApart const& points) const {
  std::array<Nodes, 3> out;
  for (int d = 0; d < 3; ++d) {
    int const first = node.first[d], last = first + node.extent[d] - 1;
    if (points.stride[d] == 1 && node.extent[d] <= block_edge)
      for (int i = 0; i < block_edge; ++i) out[d][i] = first + i;
    else
      out[d] = nodes_between(points.place(d, first), points.place(d, last));
  }
  return out;
}

NodeCharges const& ChargesOfNodes::of(int number) {
  auto& out = made_[std::size_t(number)];
  if (out) return *out;
  TreeNode const& node = tree_.nodes[std::size_t(number)];
  out = std::make_unique<NodeCharges>();
  out->points = points_of(node, all_cells);
  if (node.leaf >= 0) out->values = leaves_.of(node.leaf);
  for (int c = node.first_child; c < node.first_child + node.children; ++c) {
    TreeNode const& child = tree_.nodes[std::size_t(c)];
    if (child.leaf >= 0) {
      add_spread(points_of(child, all_cells), leaves_.of(child.leaf), all_cells, across_, *out);
    } else {
      NodeCharges const& there = of(c);
      add_spread(there.points, there.values, all_cells, across_, *out);
    }
  }
  out->find_rows();
  return *out;
}

NodeCharges const& ChargesOfNodes::of(NodeVariant const& variant, PointsApart const& points) {
  auto const [entry, is_new] = variants_.try_emplace(variant);
  if (is_new) {
    entry->second.points = points_of(tree_.nodes[std::size_t(variant.node)], points);
    NodeCharges const& there = of(variant.node);
    add_spread(there.points, there.values, points, across_, entry->second);
    entry->second.find_rows();
  }
  return entry->second;
}

}  // namespace amrpic::freespace
