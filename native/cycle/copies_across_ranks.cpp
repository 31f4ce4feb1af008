#include "cycle/copies_across_ranks.hpp"

namespace amrpic::cycle {

namespace {

std::vector<CopiedRectangle> at_edges(Level const& level, std::vector<CopiedRectangle> const& copies) {
  std::vector<CopiedRectangle> out;
  for (CopiedRectangle const& copy : copies)
    for_each_layer_at_edge(level, copy.cells, [&](Box const& layer) { out.push_back({copy.rank, layer, copy.shift}); });
  return out;
}

}  // namespace

void ReadOfBoxes::add(Read const& read) {
  auto const [at, fresh] = of_box_.emplace(std::make_tuple(read.rank, read.shift, read.owner, read.region), read.part);
  if (!fresh) at->second = at->second.hull(read.part);
}

std::vector<CopiedRectangle> ReadOfBoxes::rectangles(std::array<Seam, 3> const& seams) const {
  std::map<std::pair<int, Index3>, std::vector<Box>> of_rank;
  for (auto const& [key, part] : of_box_) {
    auto& boxes = of_rank[{std::get<0>(key), std::get<1>(key)}];
    for (Box const& piece : split({part}, seams)) boxes.push_back(piece);
  }
  std::vector<CopiedRectangle> out;
  for (auto& [key, boxes] : of_rank) {
    auto const& [rank, shift] = key;
    for (Box const& box : joined(std::move(boxes), seams)) out.push_back({rank, box.shift_back(shift), shift});
  }
  return out;
}

CopiesAcrossRanks at_edges(Level const& level, CopiesAcrossRanks const& copies) {
  return {at_edges(level, copies.asked), at_edges(level, copies.wanted)};
}

}  // namespace amrpic::cycle
