// From which distance on charges may be taken together.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "freespace/lattice.hpp"
#include "stencil/first_layers.hpp"

namespace amrpic::freespace {

struct Options {
  double acceptance =
      0.5;  ///< a box is a multipole from where its radius looks smaller than this fraction of the distance
  double lattice_limit = 10;    ///< and from this many of its cells on, where the lattice is a small correction
  double dropped = 1e-7;        ///< fraction of all |q| that may be left out with the weakest boxes
  double separation = 1.25;     ///< charge this many half widths from a patch of ghosts is interpolated on it
  double negligible = 2e-6;     ///< fraction of a box's potential that orders left out may add
  int operator_order = 2;       ///< 4: potentials are means over cells, see `fourth_order.hpp`
  double of_weak = acceptance;  ///< the largest acceptance, of boxes with next to no charge
  double of_images = 0.25;      ///< the acceptance of blocks of copies: hundreds of charges of one sign, perhaps
  int doublings = 3;            ///< of such a block, as long as all else is wide, to where a lattice is closed
  /// So many ranks and more let all know the nodes right below the top, should that take no larger message than the top
  /// does: else each that has one sends it to most of the others. Fewer messages than that take no longer than a sum
  /// over all. The same on all ranks.
  int fewest_sharing_ranks = 33;

  /// What goes with an operator, and with images, which repeat along so many axes: where conductors leave little of the
  /// potential, what is neglected counts for more of it, so that boxes have to be further away; those with less charge
  /// than others need not. `narrow`: next to nothing is left, as `Images::are_narrow` tells. In fourth order the
  /// lattice fades by the fourth power of the distance and is left out from `lattice_limit` on, where it is 8e-6 of the
  /// potential; the rest is about as exact.
  static Options of(int order, bool has_images = false, int lattices = 0, bool narrow = false) {
    if (order == 4) return {0.3, 16, 1e-7, 2, 2e-7, 4, 0.6, 0.15, 5};
    Options out;
    if (!has_images) return out;
    out.acceptance = std::array{0.45, 0.39, 0.3}[std::size_t(lattices)];
    out.of_weak = std::array{0.5, 0.5, 0.3}[std::size_t(lattices)];
    if (narrow) out.acceptance = out.of_weak = 0.2, out.separation = 3;
    out.lattice_limit = (narrow ? 8 : 6) / out.acceptance;
    return out;
  }
  /// What charge in the first layers of cells at a Dirichlet wall counts at ghosts of open faces beside it, where that
  /// reflects it: the wall's row, which is not that of an odd image, gives it so much of the image's dipole.
  std::vector<double> at_dirichlet_walls() const {
    auto const& of = operator_order == 4 ? of_image_in_fourth_order : of_image;
    return {of.begin(), of.end()};
  }
  /// Of ghosts behind a wall.
  int layers() const { return operator_order == 4 ? 2 : 1; }
};

/// A factor of limits: places on a lattice often lie at a limit exactly, and rounding must not choose.
constexpr double past_ties = 1 + 1e-9;

/// From where on a box of charge of some radius, its coarsest cells `spacing` long, is a multipole.
inline double far_limit(Options const& options, double radius, double spacing) {
  return past_ties * std::max(options.lattice_limit * spacing, radius / options.acceptance);
}

/// Part of that limit within which a box counts as next to the centre of a patch, and is opened there whatever its
/// size, squared.
constexpr double mostly_near2 = 0.5;

inline double longest_spacing(Point const& shape) { return std::max({shape[0], shape[1], shape[2]}); }

}  // namespace amrpic::freespace
