// Which fit of phi* the ghosts before coarser cells take, and what those in narrow gaps read.
#pragma once

#include <algorithm>
#include <cstdint>

#include "mesh/reads.hpp"
#include "stencil/gap_fit.hpp"

namespace amrpic {

/// Which block of the coarse plane the four ghosts in front of a coarse cell take, see `plane_placement`: which cells
/// are usable does not depend on the ghost, only the weights do. Nearly all faces have the first one.
using FitNumber = std::uint8_t;
constexpr FitNumber central_fit = 0;
constexpr FitNumber fit_in_gap = 254;  ///< no block is complete
constexpr FitNumber no_fit = 255;      ///< the cell has no ghosts in front of it

/// The fits behind a face, one for each coarse cell of its layer, `no_fit` where the level goes on. `coarser`,
/// `refined`: parts that the coarser level has and the level refines, in the layer and two coarse cells around it in
/// its plane.
ArrayOnBox<FitNumber> fits_behind(Face const& face, int axis, std::vector<Overlap> const& coarser,
                                  std::vector<Overlap> const& refined);

/// 1 for the usable cells of a region: those of `cells`, parts of it that a level has, without the parents of
/// `refined`, parts that the next finer level has.
ArrayOnBox<char> usable_cells(Box const& region, std::vector<Overlap> const& cells,
                              std::vector<Overlap> const& refined);

/// The fit at a coarse cell behind fine faces across an axis. `usable`: of the coarser level, two cells further in the
/// plane of the cell.
FitNumber fit_at(ArrayOnBox<char> const& usable, Index3 const& middle, int axis);

/// The smallest box of coarse cells that holds all fits of a kind, `of(fit)`; empty if there are none.
template <class Of>
Box hull_of_fits(ArrayOnBox<FitNumber> const& fits, Of&& of) {
  Box out;
  auto const& values = fits.values();
  if (std::none_of(values.begin(), values.end(), of)) return out;
  if (std::all_of(values.begin(), values.end(), of)) return fits.box();
  for_each_cell(fits.box(), [&](Index3 const& cell) {
    if (of(fits(cell))) out = out.empty() ? Box{cell, cell} : out.hull({cell, cell});
  });
  return out;
}

/// Whether fits in gaps take cells of the finer level, too: not where cells are long. There such fits would couple
/// cells along the long axes as strongly as along the short ones, which no cycle is made for.
inline bool gap_fits_take_fine_cells(Level const& level) { return !has_long_cells(level); }

/// The usable cells of both levels around gaps.
class GapCells {
 public:
  /// `coarse`: coarser cells around the gaps; `coarser`, `refined`: parts of them that the coarser level has, and of
  /// their children that the level has; `finer`: the next finer level, null if there is none.
  GapCells(Level const& level, Box const& coarse, std::vector<Overlap> const& coarser,
           std::vector<Overlap> const& refined, Level const* finer);

  /// Around a coarse cell behind fine faces.
  GapSites around(Index3 const& middle) const { return gap_sites(middle, coarse_, fine_); }

 private:
  ArrayOnBox<char> coarse_, fine_;
};

/// For each face of a box the smallest box of coarse cells with fits in gaps, empty where there are none: such fits
/// take values of that box grown by one coarse cell, of both levels.
std::array<Box, 6> gaps_behind(BoxFaces const& faces, Level const& level, Level const& coarser);

/// The cells of the coarser level, and of the level itself, that the fits in gaps of boxes of a level read. `own`: the
/// faces of this rank's boxes. The region is the number of the face.
Reads coarse_reads_in_gaps(Level const& level, LevelFaces const& own, Level const& coarser);
Reads fine_reads_in_gaps(Level const& level, LevelFaces const& own, Level const& coarser);

/// The finer cells that those fits read which coarse cells, behind the same faces, share.
Reads fine_reads_before_gaps(Level const& coarser, Level const& level);

/// The cells of this rank's boxes of the coarser level behind fine faces with fits in gaps. Local.
std::vector<Index3> cells_behind_gaps(Level const& coarser, Level const& level);

}  // namespace amrpic
