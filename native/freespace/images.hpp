// Images of charge: walls and periodic axes beside open faces, as charge in free space.
//
// The potential between them is that of free space, summed over the maps of a group: for each, what the charge makes at
// the mapped place, times a sign. So the tree of charge is one for all, and images only add places. On an axis with an
// open face that is one reflection, at a wall on the other one; between two walls, and where space repeats, a lattice
// of them, which is summed by ever wider blocks of copies and ends in a closed form (`Closing`).
#pragma once

#include <optional>
#include <vector>

#include "freespace/acceptance.hpp"
#include "freespace/octree.hpp"

namespace amrpic::freespace {

/// The images along one axis: copies within a period, and that, in cells of the base; 0: no lattice.
struct AxisImages {
  struct Copy {
    bool reflects;
    int shift, sign;
  };
  std::vector<Copy> copies{{false, 0, 1}};
  int period = 0;

  /// Whether those of a period have both signs, so that their potential fades along other axes.
  bool alternates() const;
};

/// A wall across an axis: at half of `twice` cells of the base from the lower end; it reflects charge with a sign.
struct Mirror {
  int twice, sign;
};

class Images {
 public:
  /// None: all faces are open.
  Images() = default;
  /// Of walls at the lower and the upper side of each axis, or periods. `across`: the axis that charge moves along, or
  /// -1.
  Images(Lattice const& lattice, std::array<std::array<std::optional<Mirror>, 2>, 3> const& walls,
         std::array<bool, 3> const& periodic, int across = -1);

  /// Whether there are none.
  bool are_none() const;
  AxisImages const& axis(int d) const { return axes_[std::size_t(d)]; }
  /// The copies within a period of an axis.
  std::vector<AxisImages::Copy> copies_along(int d, Which which) const;
  /// The maps within a period of each axis, those together that differ on lattice axes alone.
  std::vector<std::vector<Image>> copies(Which which) const;
  /// About how many of the copies along lattices lie within a distance, in units of the smallest spacing.
  double copies_within(double distance) const;
  /// The longest period, and 0 without any; in units of the smallest spacing.
  double longest_period() const;
  /// How often a block of copies doubles along an axis, `fewest` times where the mesh is nowhere wider than that; 0
  /// where there is no lattice. What closes the lattice must lie beyond the widest patches, which stand out from the
  /// mesh.
  int doublings(int d, int fewest) const;
  Point const& shape() const { return shape_; }
  /// So many cells of the base and fewer from an open face across an axis, charge is seen there: further away its
  /// potential has faded, between walls some of which are conductors. Nothing where it does not fade so.
  std::optional<int> cells_seen(int axis, int operator_order) const;
  /// Whether the potential between walls, some of them conductors, fades within the longest cells of the base.
  bool are_narrow() const;
  /// The number of axes along which they repeat, at most two.
  int lattices() const { return int(axes_[0].period > 0) + int(axes_[1].period > 0) + int(axes_[2].period > 0); }
  /// Distance along an axis between a place and the nearest image of another one; in units of the smallest spacing.
  double apart(int d, double place, double other) const;

 private:
  /// Between closed sides, some of whose walls are conductors, the images along an axis are as many as are seen.
  void list_copies(std::size_t axis);
  /// Of the modes of the lattice across walls that leave out `axis`: the least eigenvalue of -Laplace, 0 where there is
  /// no conductor.
  double least_eigenvalue(int axis) const;

  Point shape_{1, 1, 1};
  double widest_ = 0;  ///< extent or period
  std::array<AxisImages, 3> axes_;
  int across_ = -1;
};

/// Let a tree begin with its images: `tops`. Of charge that is far longer across lattices than these repeat after each
/// part has its own one. All ranks have the same ones, since all know the nodes at the top.
void add_images(Octree& tree, Images const& images, Which which, Options const& options);

/// What the copies of a lattice that are further away than its blocks reach make: these as a uniform continuation, with
/// the deviation of each copy from it (Euler and Maclaurin), to second order.
///
/// The zero of the potential, where no wall at a given one fixes it, is that of the lattice alone: around one lattice
/// axis phi tends to -lambda / (2 pi) ln(distance / period), beside a plane of two to -sigma |distance| / 2.
class Closing {
 public:
  /// `tree`: with its images.
  Closing(Octree const& tree, Images const& images, Which which, Options const& options);

  bool is_empty() const { return copies_.empty(); }
  /// 4 pi times the potential, lengths in units of the smallest spacing.
  double at(Point const& place) const;

 private:
  /// A copy of all charge: its moments about the centre.
  struct Copy {
    Point centre, dipole;
    double charge, of_lattice;                    ///< as `LatticeMoments`
    std::array<std::array<double, 3>, 3> second;  ///< sum q x x, without trace, less what a uniform period has
  };
  void add(Member const& member);
  double around_axis(Copy const& copy, Point const& from_centre) const;
  double beside_plane(Copy const& copy, Point const& from_centre) const;

  std::vector<Copy> copies_;
  std::array<int, 2> along_{-1, -1};  ///< the lattice axes
  int normal_ = -1;                   ///< of a plane of two
  Point period_{}, reach_{}, h2_{};   ///< reach: of blocks to either side
};

}  // namespace amrpic::freespace
