#pragma once

#include <memory>
#include <vector>

#include "mesh/field.hpp"
#include "mesh/remote_reads.hpp"

namespace amrpic {

/// Covered cells of a box, and their children in a box of the finer level; all on this rank.
struct Family {
  std::int32_t parent, pitch_y, pitch_z;  ///< place of the first parent among the own cells, and their distances
  Index3 child;                           ///< first child, counted from the first cell of its box
  Index3 parents;                         ///< how many along each axis
};

/// Covered cells of a box, whose children another rank has.
struct RemoteFamily {
  std::int32_t from;                      ///< place among the means that this rank reads, x fastest
  std::int32_t parent, pitch_y, pitch_z;  ///< as in Family
  Index3 parents;

  /// Call f(place among the means, place of the first parent) for each row of parents.
  template <class F>
  void for_each_row(F&& f) const {
    for (int k = 0; k < parents[2]; ++k)
      for (int j = 0; j < parents[1]; ++j)
        f(from + parents[0] * (j + parents[1] * k), parent + j * pitch_y + k * pitch_z);
  }
};

/// The covered cells of a level.
struct Families {
  std::vector<std::vector<Family>> of_box;  ///< for each of this rank's boxes of the finer level
  std::vector<RemoteFamily> remote;
  std::vector<char> is_remote;  ///< for each of this rank's boxes of the level: whether it has remote ones
  RemoteReads means;            ///< of children
};

/// What passes between covered cells and their children, on each pair of neighbouring levels; parents and children may
/// live on different ranks.
class Transfer {
 public:
  /// Local.
  explicit Transfer(std::shared_ptr<Hierarchy const> hierarchy);

  /// Set the covered cells of all levels to the mean of their children, finest level first. One message per pair of
  /// ranks and level carries all fields. The result does not depend on the ranks, not even by rounding. Collective.
  void average_down(std::vector<Field*> const& fields) const;

  /// Add the value of each covered cell to its children, coarsest level first: charge that lies on covered cells moves,
  /// in equal parts, to the cells that count. The covered cells keep their values. Collective.
  void spread(Field& field) const;

  // `average_down` in parts, for those who do more meanwhile. Of a level: means of the children in planes k and k + 1
  // of this rank's box b for parents on this rank; then those that others read go off, and those that this rank reads
  // come.
  void average_pair(int level, int b, int k, Field& field) const;
  void send_means(int level, std::vector<Field*> const& fields) const;
  void take_means(int level, std::vector<Field*> const& fields) const;
  void settle() const;

  /// The covered cells of a level that has a finer one.
  Families const& families(int level) const { return families_[std::size_t(level)]; }

  std::size_t bytes() const;  ///< of lists on this rank

 private:
  template <class F>
  void for_each_row_of_pair(int level, int b, int k, F&& f) const;

  std::shared_ptr<Hierarchy const> hierarchy_;
  std::vector<Families> families_;
};

}  // namespace amrpic
