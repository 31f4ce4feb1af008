#pragma once

#include <array>
#include <cmath>
#include <deque>
#include <utility>
#include <vector>

#include "base/communicator.hpp"

namespace amrpic {

/// x = g(x) for a function that is nearly linear, by the latest few values of it (Anderson, J. ACM 12, 547, 1965):
/// where x -> g(x) by itself diverges along a few directions, these are found and taken out.
class FixedPoint {
 public:
  void clear() { kept_.clear(), has_before_ = false; }

  /// What to try next after g(x) = `value`; returns the 2-norm of g(x) - x over that of g(x). Vectors are shared out
  /// over ranks. Collective.
  Real next(std::vector<Real>& x, std::vector<Real> const& value, Communicator const& comm) {
    std::vector<Real> change = value;
    add(-1, x, change);
    std::array<Real, 2> sizes{dot(change, change), dot(value, value)};
    comm.sum_each(sizes);
    if (std::exchange(has_before_, true)) {  // on all ranks, also on those without a part of the vectors
      kept_.push_front({x, change});
      add(-1, argument_, kept_.front().step), add(-1, change_, kept_.front().image);
      if (kept_.size() > most) kept_.pop_back();
    }
    argument_ = x, change_ = change;
    Pair total{x, change};
    for (Pair const& direction : directions(comm))
      remove(direction, comm.sum(dot(total.image, direction.image)), total);
    x = total.step;
    add(1, total.image, x);
    return sizes[1] > 0 ? std::sqrt(sizes[0] / sizes[1]) : 0;
  }

 private:
  static constexpr std::size_t most = 6;
  struct Pair {
    std::vector<Real> step, image;  ///< of x, and what g(x) - x changes with it
  };
  /// What was learnt, with images of length one across each other. The latest come first: what g was near its fixed
  /// point counts more than what it was before.
  std::vector<Pair> directions(Communicator const& comm) const {
    std::vector<Pair> out;
    for (Pair pair : kept_) {
      Real const whole = comm.sum(dot(pair.image, pair.image));
      for (Pair const& known : out) remove(known, comm.sum(dot(pair.image, known.image)), pair);
      Real const size = std::sqrt(comm.sum(dot(pair.image, pair.image)));
      if (size <= 1e-3 * std::sqrt(whole)) continue;
      for (auto* v : {&pair.step, &pair.image})
        for (Real& n : *v) n /= size;
      out.push_back(std::move(pair));
    }
    return out;
  }
  static Real dot(std::vector<Real> const& a, std::vector<Real> const& b) {
    Real sum = 0;
    for (std::size_t n = 0; n < a.size(); ++n) sum += a[n] * b[n];
    return sum;
  }
  static void add(Real factor, std::vector<Real> const& a, std::vector<Real>& to) {
    for (std::size_t n = 0; n < a.size(); ++n) to[n] += factor * a[n];
  }
  static void remove(Pair const& old, Real share, Pair& from) {
    add(-share, old.step, from.step), add(-share, old.image, from.image);
  }

  std::deque<Pair> kept_;  ///< differences between steps, the latest first
  bool has_before_ = false;
  std::vector<Real> argument_, change_;  ///< x and g(x) - x before
};

}  // namespace amrpic
