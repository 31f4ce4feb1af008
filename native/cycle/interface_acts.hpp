// The acts of a cycle on one coarse face of an interface, and the four fine faces that it consists of.
#pragma once

#include <cstdint>

#include "stencil/interface.hpp"

namespace amrpic::cycle {

/// Steps on a side of a block on which ghosts lie in coarser cells, the lower tangential axis first.
struct InterfaceSteps {
  std::int32_t cell_u, cell_v, inward;  ///< from a fine cell before the side to the next ones
  std::int32_t parent_u, parent_v;      ///< from a coarse cell behind it to the next ones
  float weight, flux_weight;

  /// Take what the four ghosts have from the cells beside them, of which `cell` is the first.
  KOKKOS_INLINE_FUNCTION void subtract_ghosts(FourStars<float> const& stars, float* cell) const {
    for (int b = 0; b < 2; ++b)
      for (int a = 0; a < 2; ++a) cell[a * cell_u + b * cell_v] -= weight * stars[std::size_t(b)][std::size_t(a)];
  }
  /// The same less what was `taken` before, which they become.
  KOKKOS_INLINE_FUNCTION void change_ghosts(FourStars<float> const& stars, FourStars<float>& taken, float* cell) const {
    FourStars<float> change;
    for (std::size_t b = 0; b < 2; ++b)
      for (std::size_t a = 0; a < 2; ++a) change[b][a] = stars[b][a] - taken[b][a];
    subtract_ghosts(change, cell);
    taken = stars;
  }
  /// What the fine corrections from `cell` on send through the four faces, with nothing in the coarse cell.
  KOKKOS_INLINE_FUNCTION float flux(float const* cell) const {
    auto const through = [&](std::int32_t at) { return difference_at_interface(cell[at], cell[at + inward]); };
    return flux_weight * (through(0) + through(cell_u) + through(cell_v) + through(cell_u + cell_v));
  }
  /// What of that passes back where ghosts have values by fits in gaps.
  KOKKOS_INLINE_FUNCTION float flux_of_ghosts(FourStars<float> const& ghosts) const {
    return flux_weight * float(interface_ghost::coarse) * (ghosts[0][0] + ghosts[0][1] + ghosts[1][0] + ghosts[1][1]);
  }
};

/// A coarse face beside metal: its four fine cells, what these take of phi*, and what they send through it of their own
/// values and of the next ones, see MetalFace.
struct MetalSteps {
  std::int32_t cell, parent;            ///< the first of the fine cells, and the coarse one
  std::int32_t cell_u, cell_v, inward;  ///< from a fine cell to the next ones
  FourStars<float> star{}, first{}, second{};

  KOKKOS_INLINE_FUNCTION void subtract_ghosts(FourStars<float> const& stars, float* r) const {
    for_each([&](std::int32_t at, std::size_t a, std::size_t b) { r[at] -= star[b][a] * stars[b][a]; });
  }
  /// What the fine corrections send, with nothing in the coarse cell.
  KOKKOS_INLINE_FUNCTION float flux(float const* e) const {
    float sum = 0;
    for_each([&](std::int32_t at, std::size_t a, std::size_t b) {
      sum += first[b][a] * e[at] + second[b][a] * e[at + inward];
    });
    return sum;
  }

 private:
  template <class F>
  KOKKOS_INLINE_FUNCTION void for_each(F const& f) const {
    for (int b = 0; b < 2; ++b)
      for (int a = 0; a < 2; ++a) f(cell + a * cell_u + b * cell_v, std::size_t(a), std::size_t(b));
  }
};

}  // namespace amrpic::cycle
