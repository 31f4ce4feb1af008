#pragma once

#include <array>
#include <cstdint>

#include "particle/lanes.hpp"

namespace amrpic {

/// Particles in memory that others own: one array per component.
struct ParticleView {
  std::int64_t count;
  std::array<Real*, 3> position;  ///< m
  std::array<Real*, 3> momentum;  ///< kg m/s, of one real particle
  Real* weight;                   ///< real particles per macroparticle
  std::int64_t* id;

  Real3 at(std::int64_t i) const { return {position[0][i], position[1][i], position[2][i]}; }
  /// Ask for positions and momenta of particles [first, first + 64) to be brought near; there may be fewer.
  void prefetch(std::int64_t first) const {
    for (auto const& columns : {position, momentum})
      for (Real const* column : columns)
        for (int line = 0; line < 8; ++line) bring_near(column + first + 8 * line);
  }
  Real3 momentum_at(std::int64_t i) const { return {momentum[0][i], momentum[1][i], momentum[2][i]}; }
};

}  // namespace amrpic
