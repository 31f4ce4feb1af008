#pragma once

#include <mpi.h>

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// A box and the cells around it in memory of their own, `components` numbers per cell: what one box's particles touch.
template <int components>
class Tile {
 public:
  /// Take the place of another box; what the values are then is left open.
  void reset(Box const& box) {
    box_ = box.grow(tile_reach);
    values_.resize(std::size_t(box_.cells()) * components);
  }
  void clear() { std::fill(values_.begin(), values_.end(), Real(0)); }
  Real* row(int i, int j, int k) { return values_.data() + components * box_.offset({i, j, k}); }
  Real const* values() const { return values_.data(); }
  Real* values() { return values_.data(); }
  std::ptrdiff_t stride_y() const { return std::ptrdiff_t(components) * box_.extent(0); }
  std::ptrdiff_t stride_z() const { return stride_y() * box_.extent(1); }

 private:
  Box box_;
  std::vector<Real> values_;
};

/// A particle that is not where it was sorted; thrown on its rank alone, to be caught by `for_each_occupied_box`.
struct Stray {
  std::int64_t id;
};

/// One box's place in space, and what brings a particle's position into its tile.
class TileFrame {
 public:
  TileFrame(Hierarchy const& hierarchy, Locator const& locator, Surroundings const& at)
      : locator_(locator), box_(hierarchy.level(at.level).box(at.box)), level_(at.level) {}

  /// Coordinate in cell widths from the lower corner of the tile. Throws Stray if the particle lies outside the box.
  Real3 inside(ParticleView const& particles, std::int64_t n) const {
    Real3 s = locator_.coordinate(particles.at(n), level_);
    bool in = true;
    for (int d = 0; d < 3; ++d) {
      in = in && s[d] >= box_.lower[d] && s[d] < box_.upper[d] + 1;
      s[d] -= box_.lower[d] - tile_reach;
    }
    if (!in) throw Stray{particles.id[n]};
    return s;
  }

 private:
  Locator const& locator_;
  Box box_;
  int level_;
};

/// Call f(surroundings, frame, first, last) for each box of this rank that holds particles, [first, last) of them. If
/// it throws a Stray on some ranks, all throw std::out_of_range, so that none waits for another. Collective.
template <class F>
void for_each_occupied_box(ParticleMesh const& mesh, std::int64_t const* starts, F&& f) {
  constexpr std::int64_t none = std::numeric_limits<std::int64_t>::max();
  std::int64_t lowest = none;
  try {
    for (std::size_t s = 0; s < mesh.boxes().size(); ++s)
      if (starts[s] < starts[s + 1])
        f(mesh.boxes()[s], TileFrame(mesh.hierarchy(), mesh.locator(), mesh.boxes()[s]), starts[s], starts[s + 1]);
  } catch (Stray const& stray) {
    lowest = stray.id;
  }
  MPI_Allreduce(MPI_IN_PLACE, &lowest, 1, MPI_INT64_T, MPI_MIN, mesh.hierarchy().comm());
  if (lowest != none)
    throw std::out_of_range("particle " + std::to_string(lowest) +
                            " has left the box it was sorted into; migrate the particles first");
}

}  // namespace amrpic
