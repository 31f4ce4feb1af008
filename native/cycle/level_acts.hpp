#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "base/no_denormals.hpp"
#include "multigrid/multigrid_cycle.hpp"

namespace amrpic::cycle {

/// Whether a coarser correction is added to the finer one, or takes its place.
enum class Into { sum, place };

/// The acts of a cycle on levels in an execution's memory: `Swept` sweeps over one, `Passage` leads from one to a
/// coarser one and back.
template <class Swept, class Passage>
class LevelActs : public CycleActs {
 public:
  LevelActs(CycleLevels levels, Sweeps const& sweeps) : levels_(std::move(levels)), sweeps_(sweeps) {}
  LevelActs(LevelActs const&) = delete;  // what passes between levels refers to these
  LevelActs& operator=(LevelActs const&) = delete;

  /// The corrections from the finest level down; reads every refinement level's right-hand side. Collective.
  void run() {
    NoDenormals const guard;
    run_cycle(levels_, *this);
  }

  void pre_smooth(std::size_t l, Guess guess) override {
    swept_[l]->exchange_right_hand_sides();
    if (guess == Guess::coarser) passage_[l - 1]->prolong(Into::place);
    auto const coarser = levels_.coarser(l);
    Passage* const passage = coarser.empty() ? nullptr : passage_[coarser.front()].get();
    if (passage) passage->start();
    smooth(l, passage, levels_.pre_sweeps(l, sweeps_), guess == Guess::zero, coarser.empty());
  }
  void find_residual(std::size_t, std::size_t coarser) override { passage_[coarser]->prepare_residual(); }
  void restrict_residual(std::size_t, std::size_t coarser) override { passage_[coarser]->restrict_residual(); }
  void prolong(std::size_t coarser, std::size_t) override { passage_[coarser]->prolong(Into::sum); }
  void post_smooth(std::size_t l, std::size_t coarser) override {
    smooth(l, passage_[coarser].get(), levels_.post_sweeps(coarser, sweeps_), false,
           levels_.coarser(l).back() == coarser);
  }
  void restrict_right_hand_side(std::size_t l) override { passage_[l - 1]->restrict_right_hand_side(); }

  /// A refinement level, or the base.
  Swept& level(std::size_t l) const { return *swept_[levels_.base + l]; }
  // All of them, and what passes between such a level and that which it corrects.
  CycleLevels const& levels() const { return levels_; }
  Sweeps const& sweeps() const { return sweeps_; }
  Swept& swept(std::size_t l) const { return *swept_[l]; }
  Passage& passage(std::size_t coarser) const { return *passage_[coarser]; }

  std::size_t bytes() const {  ///< of this rank's memory, without fits in gaps
    std::size_t sum = 0;
    for (auto const& swept : swept_) sum += swept->bytes();
    for (auto const& passage : passage_) sum += passage ? passage->bytes() : 0;
    return sum;
  }

 protected:
  /// Make all of them: swept(l), and passage(finer, coarser). Collective.
  template <class MakeSwept, class MakePassage>
  void make(MakeSwept&& swept, MakePassage&& passage) {
    for (std::size_t l = 0; l < levels_.count(); ++l) swept_.push_back(swept(l));
    for (std::size_t c = 0; c < levels_.count(); ++c)
      passage_.push_back(c == levels_.finest() ? nullptr : passage(levels_.finer(c), c));
  }

 private:
  /// Sweeps; where there are gaps, their fits are taken into account in between. A residual follows unless they are the
  /// last ones. What comes from a coarser level does not vanish on surfaces, so cells beside metal are relaxed before.
  void smooth(std::size_t l, Passage* passage, int sweeps, bool from_zero, bool are_last) {
    int const further = are_last ? 0 : 1;
    if (!from_zero && sweeps > 0)
      swept_[l]->relax_beside_metal(further + 2 * (passage && passage->has_gaps() ? 1 : sweeps));
    for (; passage && passage->has_gaps() && sweeps > 1; --sweeps) {
      swept_[l]->relax(1, std::exchange(from_zero, false), further);
      passage->refresh_gaps();
    }
    swept_[l]->relax(sweeps, from_zero, further);
    if (are_last) swept_[l]->finish();
  }

  CycleLevels levels_;
  Sweeps sweeps_;
  std::vector<std::unique_ptr<Swept>> swept_;
  std::vector<std::unique_ptr<Passage>> passage_;  ///< [c] to level c; none to the finest
};

}  // namespace amrpic::cycle
