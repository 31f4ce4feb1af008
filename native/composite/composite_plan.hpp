#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "base/range.hpp"
#include "mesh/fits.hpp"
#include "mesh/hierarchy.hpp"
#include "mesh/remote_reads.hpp"
#include "stencil/gap_fit.hpp"

namespace amrpic {

/// A rectangle of values of a box, in its memory or as another rank sent it. Along u and v, the lower and the higher
/// axis in the plane.
struct Rectangle {
  bool here;            ///< in this rank's memory
  std::int32_t from;    ///< place of the first value among the cells (or fluxes) of its level, own or remote
  std::int32_t pu, pv;  ///< distance between neighbours
  int u, v, nu, nv;     ///< where it lies, and how far it goes

  /// Copy it to where it lies in a plane, from its level's `own` values or those of other ranks.
  void copy(Real const* own, Real const* remote, Real* to, std::ptrdiff_t pitch) const;
};

/// Cells of a box, in its memory or as another rank sent them: a part of a region that another box reads.
struct RegionPart {
  bool here;                            ///< in this rank's memory
  std::int32_t from, pitch_y, pitch_z;  ///< place of the first value as in Rectangle, and distances
  Box part;                             ///< in the region's indices

  /// The same in a plane across an axis, placed from `origin`.
  Rectangle across(int axis, Index3 const& origin) const;
};

/// The cells of an overlap of `level`, which `reader` reads for a purpose in one of its regions.
RegionPart part_of(RemoteReads const& cells, int purpose, Level const& level, int reader, int region, Overlap const& o);

/// Where the values beyond a face of a box come from.
struct FacePlan {
  Range neighbours;    ///< rectangles of the level
  int wall = -1;       ///< place of the face's data among the wall data of the level
  int interface = -1;  ///< in the level's list of interfaces
};

/// Where coarser cells lie beyond a face of a box: the smallest rectangle, in coarse cells, that holds them.
struct Interface {
  int u, v, nu, nv;     ///< first coarse cell, from the first one beyond the face
  int margin;           ///< coarse cells around the rectangle that the fits reach
  Range coarse;         ///< rectangles of the coarser level that make up the rectangle with its margin
  std::int32_t fits;    ///< place of the fits of the rectangle's cells, u fastest
  std::int32_t fluxes;  ///< place of what the level sends through the coarse faces, u fastest
  int gaps = -1;        ///< in the level's list of gaps
};

/// The gaps behind a face of a box, see `GapFit`.
struct Gaps {
  Box coarse;                 ///< coarse cells around them; their children are the finer ones
  Range coarse_parts, parts;  ///< of the coarser level, and of the level itself
  std::int32_t fits;          ///< place of the fits of those cells of the interface that have such, u fastest
};

inline Index3 counted_from_first(Box const& box, Index3 const& cell) {
  return {cell[0] - box.lower[0], cell[1] - box.lower[1], cell[2] - box.lower[2]};
}

/// Uncovered cells of a box with a refined cell beyond one of their faces.
struct RefinedSide {
  int axis, side;
  Box cells;         ///< in the box, counted from its first cell; one layer along `axis`
  Rectangle fluxes;  ///< of the finer level

  /// Place of the flux beside one of the cells, own or remote.
  std::int32_t flux_at(Index3 const& cell) const {
    auto const [u, v] = tangential_axes(axis);
    return fluxes.from + (cell[u] - cells.lower[u]) * fluxes.pu + (cell[v] - cells.lower[v]) * fluxes.pv;
  }
};

/// The lists of a box.
struct BoxPlan {
  std::array<FacePlan, 6> faces;  ///< 2 axis + side
  Range covered;                  ///< parts covered by finer boxes
  Range refined;                  ///< refined sides
  bool is_fully_covered = false;  ///< covered whole
  bool remote = false;            ///< a face, the plane behind it, or a refined side takes values from other ranks
};

/// The lists of one level.
struct LevelPlan {
  std::vector<BoxPlan> boxes;         ///< of this rank
  std::vector<Rectangle> neighbours;  ///< cells of the level
  std::vector<Interface> interfaces;
  std::vector<Rectangle> coarse;  ///< cells of the coarser level
  std::vector<FitNumber> fits;
  std::vector<Gaps> gaps;
  std::vector<RegionPart> region_parts;
  std::vector<GapFit const*> fits_in_gaps;
  std::int32_t fluxes = 0;   ///< number of coarse faces for which the level has places
  std::vector<Box> covered;  ///< counted from the first cell of the box
  std::vector<RefinedSide> refined;
  RemoteReads finer_fluxes;  ///< from the next finer level

  /// Call f(place of the coarse cell along u, along v, fit) for the fits in gaps behind an interface, u fastest.
  template <class F>
  void for_each_gap(Interface const& i, F&& f) const {
    if (i.gaps < 0) return;
    auto fit = fits_in_gaps.begin() + gaps[std::size_t(i.gaps)].fits;
    for (int v = 0; v < i.nv; ++v)
      for (int u = 0; u < i.nu; ++u)
        if (fits[std::size_t(i.fits + u + v * i.nu)] == fit_in_gap) f(u, v, **fit++);
  }
};

/// All that the composite Laplacian must know of a hierarchy besides the formulas: made of faces and rectangles, so
/// that it costs far less than a pass over the cells.
struct CompositePlan {
  /// `margin`: the least of interfaces, in coarse cells.
  explicit CompositePlan(Hierarchy const& hierarchy, int margin = 0);

  std::vector<LevelPlan> levels;
  std::shared_ptr<GapFits> gap_fits = std::make_shared<GapFits>();  ///< of all levels

  RemoteReads cells;  ///< of other ranks, of all levels
  /// Their purposes: cells of level l as ghosts of that level, or for those of the next finer one, or around gaps
  /// beside the next finer level or beside the level itself.
  static int as_neighbours(int l) { return 4 * l; }
  static int behind_edges(int l) { return 4 * l + 1; }
  static int behind_gaps(int l) { return 4 * l + 2; }
  static int around_gaps(int l) { return 4 * l + 3; }
  static int level_of(int purpose) { return purpose / 4; }

  std::size_t bytes() const;  ///< of this rank's lists
};

}  // namespace amrpic
