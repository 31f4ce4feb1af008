#pragma once

#include <memory>

#include "base/communicator.hpp"
#include "cycle/coarsening.hpp"
#include "cycle/direct.hpp"
#include "cycle/level_acts.hpp"
#include "multigrid/open_walls.hpp"

namespace amrpic::cycle {

/// What one cycle takes of a rank on one level. It follows from the boxes, also for a virtual rank.
struct LevelWork {
  int level;            ///< 0: the base; negative below it
  std::int64_t cells;   ///< of this rank
  std::int64_t stored;  ///< with copies of others' cells
  Real relaxed;         ///< cells relaxed, both colours being one; without copies: `cells` times the sweeps
  std::int64_t sweeps;  ///< over the level, in all visits
  int neighbours;       ///< ranks with which this one exchanges values
  Traffic traffic;      ///< what this rank sends for the level, and for what passes to and from the next coarser one
};

/// The cycle over refinement levels and multigrid levels (see run_cycle) for corrections in residual form, in single
/// precision and without matrices.
class Cycle : public LevelActs<SweptLevel, Coarsening> {
 public:
  /// `shift`: of the Equation. `order`: of the residual that corrections are for. `gap_fits`: what is known of fits in
  /// gaps, and is added to. `most_direct`: see `most_direct_readers`. Collective.
  Cycle(Communicator const& comm, Hierarchy const& hierarchy, Real shift, Relaxation const& relaxation, int order = 2,
        std::shared_ptr<GapFits> gap_fits = std::make_shared<GapFits>(), int most_direct = most_direct_readers,
        Metal const* metal = nullptr)
      : Cycle(comm, levels_of(hierarchy, shift, order), hierarchy.max_grid_size(), relaxation, std::move(gap_fits),
              most_direct, nullptr, metal) {}
  /// What all ranks know of who reads whose corrections, by levels.
  using Known = std::vector<KnownReads>;
  /// On levels of `levels_of`. `known`, if given, is what the cycles of other virtual ranks found, and is added to.
  /// Collective.
  Cycle(Communicator const& comm, MultigridLevels multigrid, int max_grid_size, Relaxation const& relaxation,
        std::shared_ptr<GapFits> gap_fits, int most_direct, Known* known = nullptr, Metal const* metal = nullptr);

  /// The levels of a hierarchy and those below the base. Local.
  static MultigridLevels levels_of(Hierarchy const& hierarchy, Real shift, int order = 2);

  /// Gathered on every rank where it is not yet there.
  void solve_coarsest() override;

  /// The work of a cycle, by levels, the coarsest first. The cycle is rehearsed: it exchanges values, but sweeps over
  /// none, and leaves corrections without meaning. Local for a virtual rank, else collective.
  std::vector<LevelWork> work();

  /// Cells of the base per cell of the multigrid level below it, along each axis; ones if there is none.
  Index3 ratio_below_base() const { return levels().base > 0 ? levels().ratio[levels().base] : Index3{1, 1, 1}; }

 private:
  Communicator comm_;
  std::unique_ptr<Direct> direct_;
  std::vector<Real> values_;
};

/// What one cycle takes of each of any number of ranks that need not exist: what all have in common is found once.
class CyclePlans {
 public:
  /// `hierarchy`: of a virtual rank. `shift`: of the Equation. Local.
  CyclePlans(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Relaxation const& relaxation)
      : hierarchy_(std::move(hierarchy)),
        multigrid_(Cycle::levels_of(*hierarchy_, shift)),
        relaxation_(relaxation),
        known_(multigrid_.levels.size()) {}

  /// The work of a rank; see Cycle::work. Local.
  std::vector<LevelWork> work(int rank) {
    auto const there = hierarchy_->seen_by(rank);
    return Cycle(there->comm(), seen_by(multigrid_, *there), there->max_grid_size(), relaxation_,
                 std::make_shared<GapFits>(), most_direct_readers, &known_)
        .work();
  }

 private:
  std::shared_ptr<Hierarchy const> hierarchy_;
  MultigridLevels multigrid_;
  Relaxation relaxation_;
  Cycle::Known known_;
};

}  // namespace amrpic::cycle
