#include "matrixfree/local_cycle.hpp"

#include "operators/semicoarse.hpp"

namespace amrpic::matrixfree {

namespace {

/// The copies need sweeps on either side of their corrections, whatever the cycle around them does, and one more before
/// them for those that the level itself is spared, see `beside_local_cycle`.
Relaxation of_copies(Relaxation relaxation) {
  relaxation.pre_sweeps = relaxation.pre_sweeps + 1;
  relaxation.post_sweeps = std::max(1, relaxation.post_sweeps);
  return relaxation;
}

}  // namespace

LocalCycle::LocalCycle(MPI_Comm comm, SweptLevel& fine, std::shared_ptr<Level const> level, Index3 const& ratio,
                       Ends const& ends, Relaxation const& relaxation)
    : fine_(fine),
      relaxation_(of_copies(relaxation)),
      swept_(comm, std::move(level), ends, relaxation_, relaxation_.halo()),
      coarsening_(comm, fine, swept_, ratio, false, [&](Index3 const& cell, int axis, int side) {
        Box const& domain = swept_.level().domain();
        bool const at_wall =
            !swept_.level().periodic()[axis] && cell[axis] == (side == 0 ? domain.lower[axis] : domain.upper[axis]);
        return at_wall ? ends.walls[axis][side].first : ends.interface[axis].first;
      }) {}

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

std::unique_ptr<LocalCycle> make_local_cycle(MPI_Comm comm, SweptLevel& fine, Ends const& ends,
                                             std::array<std::array<Boundary, 2>, 3> const& boundary,
                                             Relaxation const& relaxation) {
  CorrectionGhosts ghosts = correction_ghosts(fine.level(), ends.walls, boundary);
  std::unique_ptr<LocalCycle> first;
  std::unique_ptr<LocalCycle>* place = &first;
  for (SweptLevel* above = &fine;;) {
    Index3 const ratio = semicoarsening_of(above->level());
    if (ratio == Index3{1, 1, 1}) return first;
    auto const level = semicoarse_level(above->level(), ratio, ghosts);
    Ends const own{ghosts.wall, ghosts.interface};
    *place = std::make_unique<LocalCycle>(comm, *above, level, ratio, own, relaxation);
    above = &(*place)->swept();
    place = &(*place)->next();
  }
}

}  // namespace amrpic::matrixfree
