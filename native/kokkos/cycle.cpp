#include "kokkos/cycle.hpp"

#include "base/no_denormals.hpp"

namespace amrpic::kokkos {

Cycle::Cycle(Communicator const& comm, matrixfree::Cycle& plan) : plan_(plan) {
  for (auto& of_plan : plan.levels_) {
    CycleLevel level;
    level.swept = std::make_unique<SweptLevel>(comm, *of_plan.swept);
    if (of_plan.coarsening)
      level.coarsening = std::make_unique<Coarsening>(comm, *of_plan.coarsening, *level.swept, *levels_.back().swept);
    SweptLevel* finer = level.swept.get();
    for (auto* local = of_plan.local.get(); local != nullptr; local = local->next().get()) {
      Copy copy{std::make_unique<SweptLevel>(comm, local->swept_), nullptr, local->relaxation_};
      copy.coarsening = std::make_unique<Coarsening>(comm, local->coarsening_, *finer, *copy.swept);
      finer = copy.swept.get();
      level.local.push_back(std::move(copy));
    }
    levels_.push_back(std::move(level));
  }
}

void Cycle::run() {
  NoDenormals const guard;
  run_cycle(plan_.multigrid_, {[this](std::size_t l) { levels_[l].coarsening->restrict_right_hand_side(); },
                               [this](std::size_t l, Guess guess) { pre_smooth_and_restrict(l, guess); },
                               [this](std::size_t l) { prolong_and_post_smooth(l); }, [this] { solve_coarsest(); }});
}

/// Sweeps; where there are gaps, their fits are taken into account in between.
void Cycle::relax(CycleLevel& level, int sweeps, bool from_zero, int further) {
  for (; level.coarsening->has_gaps() && sweeps > 1; --sweeps) {
    level.swept->relax(1, from_zero, further);
    level.coarsening->refresh_gaps();
    from_zero = false;
  }
  level.swept->relax(sweeps, from_zero, further);
}

void Cycle::pre_smooth_and_restrict(std::size_t l, Guess guess) {
  CycleLevel& level = levels_[l];
  level.swept->exchange_right_hand_sides();
  if (guess == Guess::coarser) level.coarsening->prolong(matrixfree::Coarsening::Into::place);
  level.coarsening->start();
  relax(level, plan_.sweeps_beside(plan_.levels_[l], plan_.relaxation_.pre_sweeps), guess == Guess::zero, 1);
  level.coarsening->restrict_residual();
}

void Cycle::prolong_and_post_smooth(std::size_t l) {
  CycleLevel& level = levels_[l];
  level.coarsening->prolong(matrixfree::Coarsening::Into::sum);
  bool const has_copies = !level.local.empty();
  relax(level, plan_.sweeps_beside(plan_.levels_[l], plan_.relaxation_.post_sweeps), false, has_copies ? 1 : 0);
  if (has_copies) improve(level, 0);
}

/// See LocalCycle.
void Cycle::improve(CycleLevel& level, std::size_t n) {
  Copy& copy = level.local[n];
  bool const is_last = n + 1 == level.local.size();
  copy.coarsening->restrict_residual();
  copy.swept->exchange_right_hand_sides();
  copy.swept->relax(copy.relaxation.pre_sweeps, true, is_last ? 0 : 1);
  if (!is_last) improve(level, n + 1);
  copy.coarsening->prolong(matrixfree::Coarsening::Into::sum);
  SweptLevel& finer = n == 0 ? *level.swept : *level.local[n - 1].swept;
  finer.relax(copy.relaxation.post_sweeps, false, 0);
}

/// By the host, which has its few cells on every rank.
void Cycle::solve_coarsest() {
  SweptLevel const& coarsest = *levels_[0].swept;
  coarsest.right_hand_side().to_host();
  plan_.solve_coarsest();
  coarsest.correction().to_device();
}

std::size_t Cycle::bytes() const {
  std::size_t sum = 0;
  for (auto const& level : levels_) {
    sum += level.swept->bytes() + (level.coarsening ? level.coarsening->bytes() : 0);
    for (auto const& copy : level.local) sum += copy.swept->bytes() + copy.coarsening->bytes();
  }
  return sum;
}

}  // namespace amrpic::kokkos
