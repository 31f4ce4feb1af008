#pragma once

#include <functional>

#include "base/communicator.hpp"
#include "cycle/interface_cells.hpp"
#include "cycle/level_acts.hpp"
#include "cycle/swept_level.hpp"

namespace amrpic::kokkos {
class Coarsening;  // the same on Kokkos, by the same lists
}

namespace amrpic::cycle {

/// How prolongation and restriction treat the ends of the coarser level.
struct CoarseGhosts {
  /// Factor of a cell in the ghost cell next to it: cell, axis, side.
  std::function<Real(Index3 const&, int, int)> factor;
  std::array<LastChildren, 3> weight;  ///< of the finer level's last cells in their parents' means
  Real3 seam_width{1, 1, 1};           ///< of the coarser level's last cells along periodic axes
};

/// What passes between a level and the next coarser one in a cycle.
class Coarsening {
 public:
  /// How the finer level lies on the coarser one.
  struct Pair {
    bool refines = false;                         ///< the coarser right-hand side is its own elsewhere
    bool parents_in_place = false;                ///< see MultigridLevels
    bool has_gaps = false;                        ///< somewhere, on any rank, see `GapFit`
    Level const* finer = nullptr;                 ///< the level after the finer one
    std::shared_ptr<GapFits> gap_fits = nullptr;  ///< to take fits in gaps from and put them in; if `refines`
    int most_direct = most_direct_readers;        ///< of its parents
    KnownReads* known = nullptr;      ///< what is known of those that read parents, and is added to; else none
    Metal const* metal = nullptr;     ///< null if there is none
    Level const* coarsest = nullptr;  ///< the level before the coarser one, if that refines it
  };
  /// Collective.
  Coarsening(Communicator const& comm, SweptLevel& fine, SweptLevel& coarse, Index3 const& ratio, Pair const& pair,
             CoarseGhosts const& ghosts);

  /// Bring what the finer level's residual is evaluated from, and have fits in gaps in its right-hand side. Collective.
  void prepare_residual();
  /// Leave the coarser right-hand side, in one pass with what the finer level put off. Collective.
  ///
  /// Parents receive the mean of the remaining residual; cells beside the finer level lose what its correction sends
  /// through the common faces.
  void restrict_residual();
  /// The same for a finer correction of zero, whose values are not read. Collective.
  void restrict_right_hand_side();

  /// Where there are gaps: begin with a finer correction of zero; and take what its fits have of it after sweeps into
  /// its right-hand side, since sweeps do not see that. Collective.
  bool has_gaps() const { return has_gaps_; }
  void start() { interface_.start(); }
  void refresh_gaps();

  /// Fetch the coarser correction, take its part of the ghosts into the finer right-hand side, and add it to the finer
  /// correction, or put it in its place. Planes that other ranks copy have it at once, and are on their way to them;
  /// the rest is put off to the sweeps that follow. Collective.
  void prolong(Into into);

  std::set<int> const& neighbours() const { return parents_.neighbours(); }

  std::size_t bytes() const;

 private:
  friend class kokkos::Coarsening;
  struct Copy {
    std::int32_t from, to;
    float factor;
  };
  void lay_out_coarse_patches(Communicator const& comm, CoarseGhosts const& ghosts, int most_direct, KnownReads* known);
  Vector& clear_target();
  void update_gaps();
  /// The parents that take the residuals of an own block.
  Parents const& taking(std::size_t b) const { return in_place_ ? targets_[b] : sources_[b]; }
  float weight() const;
  void add_to_coarse_level();
  void plan_gathering();
  void gather_from_others(Vector& r);
  struct GatheredPart {
    Box parents;        ///< of cells of one rank
    std::size_t first;  ///< place among what is gathered
  };
  template <class F>
  void for_each_row(GatheredPart const& part, F&& f) const;
  void add_ghosts(CoarsePatch const& patch, ArrayOnBox<char>& known, CoarseGhosts const& ghosts);

  Communicator comm_;
  SweptLevel& fine_;
  SweptLevel& coarse_;
  Index3 ratio_;
  bool refines_, has_gaps_;
  bool in_place_;                            ///< whether all parents lie in this rank's memory, block by block
  std::vector<CoarsePatch> coarse_patches_;  ///< of each own block
  Vector values_;                            ///< what they hold
  std::vector<Parents> sources_;             ///< of each own block: parents in `values_`
  std::vector<Parents> targets_;             ///< the same on the coarser level, if `in_place_`
  std::vector<Copy> ghosts_;                 ///< in `values_`
  RectangleExchange parents_;                ///< with all cells around them that corrections are read of
  RectangleExchange targets_of_residuals_;   ///< with those that take fluxes; none if `in_place_`
  // Of a level of which every rank with cells of the finer one holds all:
  std::vector<GatheredPart> parts_;  ///< by rank
  std::size_t first_own_part_ = 0, own_parts_ = 0;
  std::vector<float> gathered_;
  Exchange<float> gathering_;
  InterfaceCells interface_;
};

}  // namespace amrpic::cycle
