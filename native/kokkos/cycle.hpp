#pragma once

#include <memory>

#include "kokkos/coarsening.hpp"
#include "matrixfree/cycle.hpp"

namespace amrpic::kokkos {

/// A matrixfree::Cycle by kernels, one for each level and act. It makes no plans of its own.
class Cycle {
 public:
  /// `plan` must outlive this. Collective.
  Cycle(Communicator const& comm, matrixfree::Cycle& plan);
  Cycle(Cycle const&) = delete;  // what passes between levels refers to these
  Cycle& operator=(Cycle const&) = delete;

  /// See matrixfree::Cycle. Collective.
  void run();

  SweptLevel& level(std::size_t l) { return *levels_[plan_.multigrid_.base + l].swept; }
  std::size_t bytes() const;

 private:
  /// A level, and what passes between it and the level that it was made of, or that is made of it.
  struct Copy {
    std::unique_ptr<SweptLevel> swept;
    std::unique_ptr<Coarsening> coarsening;
    matrixfree::Relaxation relaxation;
  };
  struct CycleLevel {
    std::unique_ptr<SweptLevel> swept;
    std::unique_ptr<Coarsening> coarsening;  ///< to the level below; none for the coarsest
    std::vector<Copy> local;                 ///< of a LocalCycle, the finest first
  };
  void pre_smooth_and_restrict(std::size_t l, Guess guess);
  void prolong_and_post_smooth(std::size_t l);
  void relax(CycleLevel& level, int sweeps, bool from_zero, int further);
  void improve(CycleLevel& level, std::size_t copy);
  void solve_coarsest();

  matrixfree::Cycle& plan_;
  std::vector<CycleLevel> levels_;
};

}  // namespace amrpic::kokkos
