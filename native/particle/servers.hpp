// Which rank serves which particle.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "mesh/domain.hpp"
#include "particle/bricks.hpp"

namespace amrpic {

/// Where bricks, and the particles of each, lie on one curve through the domain: Morton order of the lower corners in
/// space, whatever the levels, so that the order hardly changes where the mesh does. Equal on all ranks.
///
/// A place is key · 2^hash_bits + hash: the key is that of the brick, the hash that of a particle's id. So the
/// particles of a brick follow each other, in an order that has nothing to do with where they are, and any part of them
/// is cut off by a number. Where bricks are finer than 2^-14 of the domain, several share a key.
class BrickCurve {
 public:
  static constexpr int axis_bits = 14, hash_bits = 21, bits = 3 * axis_bits + hash_bits;
  static constexpr std::int64_t per_brick = std::int64_t(1) << hash_bits,
                                end = std::numeric_limits<std::int64_t>::max();
  static_assert(bits == 63);

  explicit BrickCurve(Domain const& domain) {
    std::int64_t cells = std::max({domain.cells[0], domain.cells[1], domain.cells[2]});
    for (; cells * 2 <= brick_shape[0] << axis_bits; cells *= 2) ++finest_;
    for (; cells > brick_shape[0] << axis_bits; cells /= 2) --finest_;
  }

  /// The place of a brick's first particle, of one with its lower corner in this cell of a level.
  std::int64_t place(int level, Index3 const& lower) const {
    int const finer = finest_ - level - 3;  // from cells of the level to units of the curve, eight cells wide
    std::uint64_t key = 0;
    for (int d = 0; d < 3; ++d) key |= spread(finer >= 0 ? lower[d] << finer : lower[d] >> -finer) << d;
    return std::int64_t(key) << hash_bits;
  }
  /// How far from there the particle with this id is: a part of SplitMix64 (G. L. Steele et al., "Fast splittable
  /// pseudorandom number generators", OOPSLA 2014).
  static std::int64_t hash(std::int64_t id) {
    std::uint64_t z = std::uint64_t(id) + 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return std::int64_t((z ^ (z >> 31)) >> (64 - hash_bits));
  }

 private:
  /// The bits of a number, three places apart.
  static std::uint64_t spread(std::int64_t number) {
    std::uint64_t x = std::uint64_t(number);
    x = (x | x << 16) & 0x0000ff0000ffu;
    x = (x | x << 8) & 0x00f00f00f00fu;
    x = (x | x << 4) & 0x0c30c30c30c3u;
    return (x | x << 2) & 0x249249249249u;
  }

  int finest_ = 0;  ///< level whose cells are an eighth of the curve's unit
};

/// The servers of particles: rank r serves those whose places on the curve are at least first[r] and below first[r +
/// 1], the last rank all behind. So who serves a particle follows from its brick and its id, without a message; several
/// ranks may share a brick.
class Servers {
 public:
  /// `first` has ranks + 1 values, ascending from 0 to `BrickCurve::end`; without any, particles are with the rank that
  /// owns the cells of their brick.
  Servers(Domain const& domain, std::vector<std::int64_t> first, int rank)
      : curve_(domain), first_(std::move(first)), rank_(rank) {}

  bool are_owners() const { return first_.empty(); }

  BrickCurve const& curve() const { return curve_; }
  int ranks() const { return int(first_.size()) - 1; }
  int server(std::int64_t place) const {
    return int(std::upper_bound(first_.begin() + 1, first_.end() - 1, place) - first_.begin()) - 1;
  }
  bool serves(std::int64_t place) const { return place >= first_[std::size_t(rank_)] && place <= last_of_own(); }

  enum class Part : signed char { none, some, all };
  /// Which particles of a brick, whose first place is given, this rank serves.
  Part part(std::int64_t brick) const {
    std::int64_t const begin = std::max(brick, first_[std::size_t(rank_)]);
    std::int64_t const stop = std::min(brick + (BrickCurve::per_brick - 1), last_of_own());
    if (begin > stop) return Part::none;
    return stop - begin + 1 == BrickCurve::per_brick ? Part::all : Part::some;
  }

 private:
  std::int64_t last_of_own() const {
    return rank_ + 1 == ranks() ? BrickCurve::end : first_[std::size_t(rank_) + 1] - 1;
  }

  BrickCurve curve_;
  std::vector<std::int64_t> first_;
  int rank_;
};

}  // namespace amrpic
