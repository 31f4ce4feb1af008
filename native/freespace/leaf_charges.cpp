#include "freespace/leaf_charges.hpp"

#include <map>

#include "base/error.hpp"

namespace amrpic::freespace {

LeafCharges::LeafCharges(Octree const& tree, ChargeBlocks const& own, std::vector<LeafRecord> const& received,
                         std::vector<int> nodes, std::array<int, 3> const& across) {
  auto const own_leaves = own.leaves().size();
  std::map<BlockKey, BlockCharges const*> of_others;
  for (LeafRecord const& record : received) of_others[record.key] = &record.charges;
  std::vector<char> is_visited(tree.nodes.size(), 0);
  while (!nodes.empty()) {
    auto const n = std::size_t(nodes.back());
    nodes.pop_back();
    if (is_visited[n]) continue;
    is_visited[n] = 1;
    TreeNode const& node = tree.nodes[n];
    if (node.is_closed()) fail_alone("LeafCharges: a node near a wall is not known on its rank");
    for (int c = 0; c < node.children; ++c) nodes.push_back(node.first_child + c);
    if (node.leaf < 0) continue;
    auto const leaf = std::size_t(node.leaf);
    BlockKey key{node.level, {}};
    for (int d = 0; d < 3; ++d) key.place[d] = node.first[d] / block_edge;
    auto const found = of_others.find(key);
    bool const is_here = leaf < own_leaves ? own.has_charges(leaf) : found != of_others.end();
    if (!is_here) fail_alone("LeafCharges: no rank gave the charges of a leaf near a wall");
    if (place_.size() <= leaf) place_.resize(leaf + 1, -1);
    place_[leaf] = int(blocks_.size());
    add(node, leaf < own_leaves ? own.charges(leaf) : *found->second, across);
  }
}

void LeafCharges::add(TreeNode const& node, BlockCharges const& charges, std::array<int, 3> const& across) {
  std::array<int, 3> step;
  for (int t = 0, width = 1; t < 3; ++t, width *= block_edge) step[std::size_t(across[std::size_t(t)])] = width;
  BlockCharges out{};
  Cell first;
  for (int d = 0; d < 3; ++d) first[d] = node.first[d] % block_edge;
  for (int k = 0; k < node.extent[2]; ++k)
    for (int j = 0; j < node.extent[1]; ++j) {
      double const* from = charges.data() + first[0] + block_edge * (first[1] + j + block_edge * (first[2] + k));
      for (int i = 0; i < node.extent[0]; ++i) out[std::size_t(step[0] * i + step[1] * j + step[2] * k)] = *from++;
    }
  blocks_.push_back(out);
}

}  // namespace amrpic::freespace
