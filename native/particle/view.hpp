#pragma once

#include <array>
#include <cstdint>

#include "particle/lane_groups.hpp"

namespace amrpic {

/// Particles in memory that others own: one array per component.
struct ParticleView {
  std::int64_t count;
  std::array<Real*, 3> position;  ///< m
  std::array<Real*, 3> momentum;  ///< kg m/s, of one real particle; null if all are at rest
  Real* weight;                   ///< real particles per macroparticle
  bool equal_weights;             ///< one value for all, else one for each
  std::int64_t* id;

  Real weight_of(std::int64_t i) const { return weight[equal_weights ? 0 : i]; }

  Real3 at(std::int64_t i) const { return {position[0][i], position[1][i], position[2][i]}; }
  Real3 momentum_at(std::int64_t i) const {
    return momentum[0] ? Real3{momentum[0][i], momentum[1][i], momentum[2][i]} : Real3{};
  }
};

/// Ask for the values of a block of particles to be brought near; there may be fewer.
template <std::size_t count>
void bring_block_near(std::int64_t first, std::array<Real*, count> const& columns) {
  for (Real const* column : columns)
    for (int n = 0; n < block_size; n += lane_count) bring_near(column + first + n);
}

}  // namespace amrpic
