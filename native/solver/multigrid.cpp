#include "solver/multigrid.hpp"

#include "multigrid/metal_on_levels.hpp"

namespace amrpic {

namespace {

std::unique_ptr<Smoother> smoother_of(LevelOperators const& operators, bool v_cycle, SolverOptions options, int before,
                                      int after, MetalCells const* metal) {
  options.pre_sweeps = before;
  options.post_sweeps = after;
  return make_smoother(operators, v_cycle, options, metal);
}

}  // namespace

Multigrid::Multigrid(Communicator const& comm, MultigridLevels const& multigrid, MultigridOperators const& operators,
                     std::shared_ptr<Bottom> bottom, int max_grid_size, SolverOptions const& options,
                     Metal const* metal)
    : cycle_levels_(multigrid, max_grid_size), bottom_(std::move(bottom)) {
  MultigridOperators all = operators;
  auto const own_metal = [&](std::size_t l) {
    Level const& level = *cycle_levels_.level(l);
    std::vector<Box> own;
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) own.push_back(level.box(b));
    return metal ? metal_on(*metal, cycle_levels_, l, own) : MetalCells{};
  };
  for (auto const& level : cycle_levels_.semicoarsened) {
    semicoarse_.push_back(semicoarse_operators(comm, all[level.finer]->level, level, shift_of(options),
                                               {own_metal(all.size()), own_metal(level.finer)}));
    all.push_back(semicoarse_.back().level);
  }
  Sweeps const sweeps{options.pre_sweeps, options.post_sweeps};
  for (std::size_t l = 0; l < all.size(); ++l) {
    MultigridLevel level{
        all[l], nullptr, nullptr, nullptr, nullptr, {}, LevelVector(all[l]->cells), LevelVector(all[l]->cells)};
    auto const coarser = cycle_levels_.coarser(l);
    auto const smoother_on = [&](std::size_t of, bool v_cycle, int before, int after) {
      MetalCells const cells = own_metal(of);
      return smoother_of(*all[of], v_cycle, options, before, after, metal ? &cells : nullptr);
    };
    if (l > 0)
      level.smoother = smoother_on(l, cycle_levels_.halves_at_most(l), cycle_levels_.pre_sweeps(l, sweeps),
                                   coarser.empty() ? 0 : cycle_levels_.post_sweeps(coarser.front(), sweeps));
    if (l != cycle_levels_.finest()) {
      LevelOperators const& finer = *all[cycle_levels_.finer(l)];
      auto const* own = cycle_levels_.semicoarse(l) ? &semicoarse_[l - operators.size()] : nullptr;
      level.prolongation = own ? &own->prolongation : &finer.prolongation;
      level.coarse_boundary = own ? nullptr : &finer.coarse_boundary;
      level.residual.emplace(own ? own->finer : finer.cells);
      if (cycle_levels_.coarser(cycle_levels_.finer(l)).front() != l)
        level.after = smoother_on(cycle_levels_.finer(l), true, 0, cycle_levels_.post_sweeps(l, sweeps));
    }
    levels_.push_back(std::move(level));
  }
}

void Multigrid::pre_smooth(std::size_t l, Guess guess) {
  MultigridLevel& level = levels_[l];
  if (guess == Guess::zero) {
    level.smoother->smooth_from_zero(level.right_hand_side, level.correction);
  } else {
    levels_[l - 1].prolongation->multiply(levels_[l - 1].correction, level.correction);
    level.smoother->smooth(Side::before, level.right_hand_side, level.correction);
  }
  level.correction.update_halo();
}

void Multigrid::find_residual(std::size_t l, std::size_t coarser) {
  MultigridLevel const& level = levels_[l];
  level.operators->no_fine.subtract(level.right_hand_side, level.correction, *levels_[coarser].residual);
}

void Multigrid::restrict_residual(std::size_t l, std::size_t c) {
  MultigridLevel& coarser = levels_[c];
  coarser.residual->update_halo();
  coarser.operators->restriction.set_rows(*coarser.residual, coarser.right_hand_side);
  coarser.operators->fine_boundary.add(-1, levels_[l].correction, coarser.right_hand_side);
}

void Multigrid::restrict_right_hand_side(std::size_t l) {
  MultigridLevel& coarser = levels_[l - 1];
  coarser.residual->assign(levels_[l].right_hand_side);
  coarser.residual->update_halo();
  coarser.operators->restriction.set_rows(*coarser.residual, coarser.right_hand_side);
}

void Multigrid::prolong(std::size_t c, std::size_t l) {
  MultigridLevel const& coarser = levels_[c];
  coarser.prolongation->add(1, coarser.correction, levels_[l].correction);
  if (coarser.coarse_boundary) coarser.coarse_boundary->add(-1, coarser.correction, levels_[l].right_hand_side);
}

void Multigrid::post_smooth(std::size_t l, std::size_t coarser) {
  MultigridLevel& level = levels_[l];
  Smoother& smoother = levels_[coarser].after ? *levels_[coarser].after : *level.smoother;
  smoother.smooth(Side::after, level.right_hand_side, level.correction);
  level.correction.update_halo();
}

void Multigrid::solve_coarsest() {
  bottom_->solve(levels_[0].right_hand_side, levels_[0].correction);
  levels_[0].correction.update_halo();
}

}  // namespace amrpic
