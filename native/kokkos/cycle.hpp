#pragma once

#include "cycle/cycle.hpp"
#include "kokkos/coarsening.hpp"

namespace amrpic::kokkos {

/// A cycle::Cycle by kernels, one for each level and act. It makes no plans of its own.
class Cycle : public cycle::LevelActs<SweptLevel, Coarsening> {
 public:
  /// `plan` must outlive this. Collective.
  Cycle(Communicator const& comm, cycle::Cycle& plan);

  /// By the host, which has its few cells on every rank.
  void solve_coarsest() override;

 private:
  cycle::Cycle& plan_;
};

}  // namespace amrpic::kokkos
