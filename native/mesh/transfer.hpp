#pragma once

#include <memory>
#include <vector>

#include "mesh/field.hpp"
#include "mesh/halo.hpp"

namespace amrpic {

/// What passes between covered cells and their children, on each pair of neighbouring levels; parents and children may
/// live on different ranks.
class Transfer {
 public:
  /// Collective.
  explicit Transfer(std::shared_ptr<Hierarchy const> hierarchy);

  /// Set the covered cells of all levels to the mean of their children, finest level first. One message per pair of
  /// ranks and level carries all fields. The result does not depend on the ranks, not even by rounding. Collective.
  void average_down(std::vector<Field*> const& fields) const;

  /// Add the value of each covered cell to its children, coarsest level first: charge that lies on covered cells moves,
  /// in equal parts, to the cells that count. The covered cells keep their values. Collective.
  void spread(Field& field) const;

 private:
  struct LevelPair {
    Halo parents;                   ///< on the coarser level; halo: parents of own fine cells that others own
    std::vector<LocalIndex> place;  ///< of each parent of own fine cells in [own | halo], fine box by fine box
    std::vector<LocalIndex> children_elsewhere;  ///< own covered cells whose children live on other ranks
  };
  LevelPair make_pair(int coarse) const;

  std::shared_ptr<Hierarchy const> hierarchy_;
  std::vector<LevelPair> pairs_;  ///< pairs_[l]: levels l and l + 1
};

}  // namespace amrpic
