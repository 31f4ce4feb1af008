#pragma once

#include "kokkos/coarsening.hpp"
#include "matrixfree/cycle.hpp"

namespace amrpic::kokkos {

/// A matrixfree::Cycle by kernels, one for each level and act. It makes no plans of its own.
class Cycle : public matrixfree::LevelActs<SweptLevel, Coarsening> {
 public:
  /// `plan` must outlive this. Collective.
  Cycle(Communicator const& comm, matrixfree::Cycle& plan);

  /// By the host, which has its few cells on every rank.
  void solve_coarsest() override;

 private:
  matrixfree::Cycle& plan_;
};

}  // namespace amrpic::kokkos
