#include "matrixfree/local_cycle.hpp"

namespace amrpic::matrixfree {

namespace {

Relaxation of_copy(Level const& level, Real shift, Relaxation relaxation) {
  Sweeps const sweeps = sweeps_of_copies({relaxation.pre_sweeps, relaxation.post_sweeps});
  relaxation.pre_sweeps = sweeps.before;
  relaxation.post_sweeps = sweeps.after;
  relaxation.factor = relaxation_on(level, shift, true, relaxation.factor);
  return relaxation;
}

GhostRules ghost_rules_of(LevelCopy const& copy) {
  GhostRules out;
  out.walls = copy.walls;
  out.inside = copy.ghost;
  out.seam_width = seam_widths(copy.level->periodic(), copy.upper);
  return out;
}

}  // namespace

LocalCycle::LocalCycle(Communicator const& comm, SweptLevel& fine, LevelCopy const& copy, Faces const& boundary,
                       Real shift, Relaxation const& relaxation)
    : fine_(fine),
      relaxation_(of_copy(*copy.level, shift, relaxation)),
      swept_(comm, copy.level, ghost_rules_of(copy), boundary, shift, relaxation_, relaxation_.halo()),
      coarsening_(comm, fine, swept_, copy.ratio, {},
                  CoarseGhosts{copy.prolonged, copy.children, seam_widths(copy.level->periodic(), copy.upper)}) {}

std::vector<PlaneStage> LocalCycle::improve(std::vector<PlaneStage> const& stages) {
  coarsening_.sweep_and_restrict(stages);
  swept_.exchange_right_hand_sides();
  auto own = swept_.relaxations(relaxation_.pre_sweeps, true, next_ ? 1 : 0);
  if (next_) own = next_->improve(own);
  swept_.run(own);
  auto out = coarsening_.prolongation(Coarsening::Into::sum);
  for (auto& stage : fine_.relaxations(relaxation_.post_sweeps, false, 0)) out.push_back(stage);
  return out;
}

void LocalCycle::rehearse(SweepWork* work) {
  swept_.rehearse(work);
  if (next_) next_->rehearse(work);
}

std::unique_ptr<LocalCycle> make_local_cycle(Communicator const& comm, SweptLevel& fine,
                                             std::vector<LevelCopy> const& copies, Faces const& boundary, Real shift,
                                             Relaxation const& relaxation) {
  std::unique_ptr<LocalCycle> first;
  std::unique_ptr<LocalCycle>* place = &first;
  SweptLevel* above = &fine;
  for (LevelCopy const& copy : copies) {
    *place = std::make_unique<LocalCycle>(comm, *above, copy, boundary, shift, relaxation);
    above = &(*place)->swept();
    place = &(*place)->next();
  }
  return first;
}

}  // namespace amrpic::matrixfree
