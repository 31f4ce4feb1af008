#pragma once

#include <array>
#include <map>
#include <tuple>
#include <vector>

#include "mesh/box_set.hpp"
#include "mesh/faces.hpp"
#include "mesh/reads.hpp"

namespace amrpic::cycle {

/// Cells that pass between this rank and another one.
struct CopiedRectangle {
  int rank;
  Box cells;     ///< in the indices of the owner's boxes
  Index3 shift;  ///< added, gives the indices of the copy
};

/// What others have copies of, and what this rank has copies of: by rank, and for each pair of ranks in the same order
/// on both.
struct CopiesAcrossRanks {
  std::vector<CopiedRectangle> asked, wanted;
};

/// What is read of each box of a level: by rank and shift, one rectangle for each region, which holds all of it.
class ReadOfBoxes {
 public:
  void add(Read const& read);
  /// In few rectangles, which are not joined across seams of the copies.
  std::vector<CopiedRectangle> rectangles(std::array<Seam, 3> const& seams) const;

 private:
  std::map<std::tuple<int, Index3, int, int>, Box> of_box_;  ///< by rank, shift, box, and region
};

/// The cells that are read across ranks (see `for_each_read_across_ranks`), in few rectangles. Reads are not listed: of
/// small boxes there may be a hundred times as many.
template <class Near, class Regions>
CopiesAcrossRanks copies_across_ranks(Level const& readers, Level const& owners, Near&& near, Regions&& regions,
                                      std::array<Seam, 3> const& seams = {}) {
  ReadOfBoxes asked, wanted;
  for_each_read_across_ranks(
      readers, owners, near, regions, [&](Read const& read) { wanted.add(read); },
      [&](Read const& read) { asked.add(read); });
  return {asked.rectangles(seams), wanted.rectangles(seams)};
}

/// What all others read of a rank: `asked` as that one has it. Local.
template <class Near, class Regions>
std::vector<CopiedRectangle> copies_asked_of(int owner, Level const& readers, Level const& owners, Near&& near,
                                             Regions&& regions) {
  ReadOfBoxes asked;
  for_each_read_by_others(*readers.seen_by(owner), *owners.seen_by(owner), near, regions,
                          [&](Read const& read) { asked.add(read); });
  return asked.rectangles({});
}

/// The layers of copied cells beyond which the level ends.
CopiesAcrossRanks at_edges(Level const& level, CopiesAcrossRanks const& copies);

/// Call f(layer) for those of some cells of a level.
template <class F>
void for_each_layer_at_edge(Level const& level, Box const& cells, F&& f) {
  BoxFaces const faces(level, cells);
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side)
      if (faces.sides[std::size_t(2 * d + side)].has_coarser) f(cells.layer(d, side, 0));
}

}  // namespace amrpic::cycle
