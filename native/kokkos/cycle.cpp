#include "kokkos/cycle.hpp"

namespace amrpic::kokkos {

Cycle::Cycle(Communicator const& comm, cycle::Cycle& plan) : LevelActs(plan.levels(), plan.sweeps()), plan_(plan) {
  make([&](std::size_t l) { return std::make_unique<SweptLevel>(comm, plan.swept(l)); },
       [&](std::size_t l, std::size_t c) {
         return std::make_unique<Coarsening>(comm, plan.passage(c), swept(l), swept(c));
       });
}

void Cycle::solve_coarsest() {
  SweptLevel const& coarsest = swept(0);
  coarsest.right_hand_side().to_host();
  plan_.solve_coarsest();
  coarsest.correction().to_device();
}

}  // namespace amrpic::kokkos
