#pragma once

#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "stencil/interface.hpp"

namespace amrpic {

/// What lies around a coarse cell behind an interface: the 3 x 3 x 3 coarse cells of which it is the middle, x fastest,
/// each as a cell of the coarser level, or as up to eight children, x fastest, of the finer one. All cells within three
/// fine widths of the places of phi* behind its face are among these.
struct GapSites {
  std::uint32_t coarse = 0;                 ///< bit n: coarse cell n is usable
  std::array<std::uint8_t, 27> children{};  ///< [n], bit c: its child c is usable

  bool operator==(GapSites const& other) const { return coarse == other.coarse && children == other.children; }
};

/// The usable cells around a coarse cell: those inside the domain that no finer level covers, `is_coarse(cell)` on the
/// coarser level and `is_fine(cell)` on the finer one.
template <class IsCoarse, class IsFine>
GapSites gap_sites(Index3 const& middle, IsCoarse&& is_coarse, IsFine&& is_fine) {
  GapSites out;
  for (int n = 0; n < 27; ++n) {
    Index3 const cell{middle[0] + n % 3 - 1, middle[1] + n / 3 % 3 - 1, middle[2] + n / 9 - 1};
    if (is_coarse(cell)) {
      out.coarse |= 1u << n;
      continue;
    }
    for (int c = 0; c < 8; ++c)
      if (is_fine(Index3{2 * cell[0] + c % 2, 2 * cell[1] + c / 2 % 2, 2 * cell[2] + c / 4}))
        out.children[std::size_t(n)] |= std::uint8_t(1 << c);
  }
  return out;
}

/// phi* behind the four fine faces of a coarse face, as sums over cells of both levels.
struct GapFit {
  struct Term {
    bool fine;                          ///< a cell of the finer level
    std::array<std::int8_t, 3> offset;  ///< from the middle cell, or from its first child
    FourStars<Real> weight;
  };
  std::vector<Term> terms;  ///< coarse cells first
};

/// The fit of phi* where none of the nine blocks of coarse cells in its plane is complete, as in gaps of few cells: by
/// moving least squares, quadratic in space, to the usable cells within three fine widths, in units of the cells, with
/// weights (1 - (r / 3)^2)^2. Where these do not determine it the fit is linear, else constant. Without fine cells, as
/// where cells are long, it is the value of the cell behind the face with a slope along each axis of the plane, from
/// one neighbour or two; the mean of the four is that cell's value then. `axis`: the normal.
GapFit gap_fit(GapSites const& sites, int axis);

/// The fits that were asked for, each made once: cells have few different surroundings. They stay where they are.
class GapFits {
 public:
  GapFit const& operator()(GapSites const& sites, int axis) {
    auto const [at, is_new] = fits_.try_emplace(Key{sites, axis});
    if (is_new) at->second = gap_fit(sites, axis);
    return at->second;
  }
  bool empty() const { return fits_.empty(); }
  std::size_t bytes() const {
    std::size_t sum = 0;
    for (auto const& [key, fit] : fits_)
      sum += sizeof(Key) + sizeof(GapFit) + fit.terms.capacity() * sizeof(GapFit::Term);
    return sum;
  }

 private:
  struct Key {
    GapSites sites;
    int axis;
    bool operator==(Key const& other) const { return axis == other.axis && sites == other.sites; }
  };
  struct Hash {
    std::size_t operator()(Key const& key) const {
      std::size_t out = key.sites.coarse + std::size_t(key.axis);
      for (std::uint8_t children : key.sites.children) out = 0x100000001b3 * (out ^ children);
      return out ^ out >> 32;
    }
  };
  std::unordered_map<Key, GapFit, Hash> fits_;
};

}  // namespace amrpic
