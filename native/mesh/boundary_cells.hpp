#pragma once

#include <vector>

#include "mesh/hierarchy.hpp"

namespace amrpic {

/// The boundary cells of this rank's boxes of a level: the outermost cells of each box, and all cells of boxes that a
/// finer level covers in part or whole. Only there must the electric field be stored; elsewhere it follows from the
/// potential of the box. Particles of other boxes read no other cells: they read within a cell of their own box, or,
/// outside the finer level or with clouds of the coarser one, within a cell of a covered one.
///
/// Cells are numbered box by box. Of a box they are its first and its last plane, the first rows of the planes between,
/// then their last ones, and what is left of their first columns, then of their last ones.
class BoundaryCells {
 public:
  explicit BoundaryCells(LevelFaces const& boxes);

  LocalIndex cells() const { return first_.back(); }  ///< of this rank

  /// Whether all cells of a box, counted from this rank's first one, count; then they are numbered as in the box.
  bool is_whole(int b) const { return whole_[std::size_t(b)]; }
  LocalIndex first(int b) const { return first_[std::size_t(b)]; }

  /// Number of an own cell of the level, which must be a boundary cell. `box`, any to begin with, is where the next
  /// search starts.
  LocalIndex number(LocalIndex place, std::size_t& box) const;
  /// Of one of box b, counted from the box's first one; -1: inside, where nothing is stored.
  LocalIndex number(int b, Index3 const& cell) const;
  LocalIndex number(LocalIndex place) const {
    std::size_t box = 0;
    return number(place, box);
  }

  /// Cells (i, j), (i + 1, j) and so on of a plane of a box, or (i, j), (i, j + 1), whose numbers follow each other.
  struct CellRun {
    int i, j, axis, count;
    LocalIndex number;
  };

  /// Call f(run) for the boundary cells of box b in plane k, counted from its first one: rows first, then columns.
  template <class F>
  void for_each_run(int b, int k, F&& f) const {
    auto const [nx, ny, nz] = extent_[std::size_t(b)];
    bool const full = whole_[std::size_t(b)] || k == 0 || k == nz - 1;
    for (int j = 0; j < ny; j += full ? 1 : ny - 1) f(CellRun{0, j, 0, nx, number(b, {0, j, k})});
    for (int i = 0; !full && i < nx; i += nx - 1) f(CellRun{i, 1, 1, ny - 2, number(b, {i, 1, k})});
  }

 private:
  std::vector<Index3> extent_;          ///< of each box
  std::vector<char> whole_;             ///< each box
  std::vector<LocalIndex> first_;       ///< boxes + 1 values
  std::vector<LocalIndex> first_cell_;  ///< among the level's own; boxes + 1 values
};

}  // namespace amrpic
