// What lies beyond faces: of boxes as rectangles, and of cells.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "mesh/array_on_box.hpp"

namespace amrpic {

/// What lies beyond a face of a cell.
enum class Beyond : std::uint8_t {
  same_level,  ///< a cell of the level
  wall,        ///< nothing, the face lies on a wall
  coarser,     ///< a cell of the coarser level, where the level ends inside the domain
  finer        ///< a cell of the level that the finer one covers, seen from a cell that it does not cover
};

/// A part of a level's box that meets a region: `part` in the region's indices, `part` minus `shift` inside the box.
struct Overlap {
  int box;
  Box part;
  Index3 shift;

  Box in_box() const { return part.shift_back(shift); }
};
std::vector<Overlap> overlaps(Level const& level, Box const& region);

/// A face of a box.
struct Face {
  Box layer;                        ///< the cells just beyond it
  bool is_wall = false;             ///< the layer lies behind a wall
  std::vector<Overlap> neighbours;  ///< parts of the layer that the level has
  bool has_coarser = false;         ///< the level lacks the rest of it, inside the domain
};

/// Uncovered cells of a box with covered ones beyond one of their faces, a rectangle of them in front of a finer box.
struct FinerNeighbour {
  int axis, side;
  Overlap cells;  ///< in cells of the level; they lie beside that box, not inside
};

/// The faces of a box of cells of a level, which need not be one of the level's boxes.
struct BoxFaces {
  /// `finer`: the next finer level, null if none is or none matters.
  BoxFaces(Level const& level, Box const& box, Level const* finer = nullptr);

  Box box;
  std::array<Face, 6> sides;           ///< 2 axis + side
  std::vector<Overlap> covered;        ///< parts that boxes of the finer level cover, in cells of the level
  std::vector<FinerNeighbour> beside;  ///< by axis and side, the upper first, then by `overlaps` of the finer level

  bool is_fully_covered() const;
  ArrayOnBox<char> covered_cells() const;  ///< 1 for covered cells of the box
  bool ends_level() const;                 ///< whether coarser cells lie beyond a face

 private:
  void find_finer(Level const& finer);
};

/// Call f(box, axis, side, number of the first wall face) for each face of this rank's boxes of a level that lies on a
/// wall. Wall faces of cells, and the data given on them, are numbered in this order: by axis and side, then box by
/// box, x fastest in each box.
template <class F>
void for_each_wall(Level const& level, F&& f) {
  GlobalIndex first = 0;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side)
      for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
        if (!level.is_at_wall(level.box(b), axis, side)) continue;
        f(b, axis, side, first);
        first += level.box(b).layer(axis, side, 0).cells();
      }
}

/// The faces of this rank's boxes of a level, box after box.
using LevelFaces = std::vector<BoxFaces>;
LevelFaces faces_of_boxes(Level const& level, Level const* finer);

/// What lies beyond the six faces of a cell, two bits each, and whether the finer level covers the cell.
class CellFaces {
 public:
  Beyond operator()(int axis, int side) const { return Beyond(bits_ >> place(axis, side) & 3); }
  bool is_covered() const { return bits_ >> 12; }
  bool any_finer() const { return bits_ & bits_ >> 1 & lower_bits; }
  bool any_wall_or_coarser() const { return (bits_ ^ bits_ >> 1) & lower_bits; }

  void set(int axis, int side, Beyond what) {
    bits_ = std::uint16_t((bits_ & ~(3 << place(axis, side))) | int(what) << place(axis, side));
  }
  void set_covered() { bits_ |= 1 << 12; }

 private:
  static constexpr unsigned lower_bits = 0x555;
  static int place(int axis, int side) { return 2 * (2 * axis + side); }

  std::uint16_t bits_ = 0;
};

/// Of each cell of a box.
ArrayOnBox<CellFaces> cell_faces(BoxFaces const& faces);

}  // namespace amrpic
