#include "mpm/damage.hpp"

#include "mpm/point_kernels.hpp"

namespace amrpic::mpm {

std::unique_ptr<fem::Operator> damage_operator(DamageEquation const& e) {
  Real3 const scale = fem::slope_scale(e.points->lattice());
  Blocks state(*e.points, Damage::width);
  for (std::int64_t block = 0; block < e.points->blocks(); ++block)
    for_each_place(*e.points, block, [&](Place const& at) {
      std::size_t const p = at.point;
      Real own[Damage::width] = {e.surface[p] > 0 ? e.volume[p] * (e.driving[p] + e.surface[p]) : 0};
      for (std::size_t d = 0; d < 3; ++d)
        own[1 + d] = e.volume[p] * e.surface[p] * e.length[p] * e.length[p] * scale[d] * scale[d];
      state.write(own, at.block, at.lane);
    });
  return std::make_unique<fem::OperatorOf<Damage, 1>>(e.points, Damage(std::move(state)));
}

}  // namespace amrpic::mpm
