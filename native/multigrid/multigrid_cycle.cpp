#include "multigrid/multigrid_cycle.hpp"

namespace amrpic {

namespace {

/// The step of level l, for any execution. It is corrected by the next coarser level, and where its cells are long by
/// a semicoarsened one too; correct(c) finds the correction of level c.
template <class Correct>
void level_step(CycleLevels const& levels, CycleActs& acts, std::size_t l, Guess guess, Correct&& correct) {
  acts.pre_smooth(l, guess);
  for (std::size_t coarser : levels.coarser(l)) {
    acts.find_residual(l, coarser);
    acts.restrict_residual(l, coarser);
    correct(coarser);
    acts.prolong(coarser, l);
    acts.post_smooth(l, coarser);
  }
}

void v_cycle(CycleLevels const& levels, CycleActs& acts, std::size_t l, Guess guess) {
  if (l == 0) return acts.solve_coarsest();
  level_step(levels, acts, l, guess, [&](std::size_t coarser) { v_cycle(levels, acts, coarser, Guess::zero); });
}

void f_cycle(CycleLevels const& levels, CycleActs& acts, std::size_t finest) {
  for (std::size_t l = finest; l > 0; --l) acts.restrict_right_hand_side(l);
  acts.solve_coarsest();
  for (std::size_t l = 1; l <= finest; ++l) v_cycle(levels, acts, l, Guess::coarser);
}

void cycle(CycleLevels const& levels, CycleActs& acts, std::size_t l) {
  if (!levels.halves_at_most(l)) return f_cycle(levels, acts, l);
  level_step(levels, acts, l, Guess::zero, [&](std::size_t coarser) { cycle(levels, acts, coarser); });
}

}  // namespace

void run_cycle(CycleLevels const& levels, CycleActs& acts) { cycle(levels, acts, levels.finest()); }

}  // namespace amrpic
