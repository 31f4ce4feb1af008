#include "freespace/plates.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace amrpic::freespace {

namespace {

constexpr Real pi = 3.14159265358979323846;
constexpr Real step = 0.24;  ///< of the logarithm of time

/// What is left of a unit at a time, and the rates at which the plate at 0 and the other one are met, times the time.
struct Meeting {
  Real left;
  std::array<Real, 2> rate;
};

Real rate_of(Real distance, Real width) {
  Real const x = distance / width;
  return x / std::sqrt(pi) * std::exp(-x * x);
}

/// Of a place `x` from a plate, with another one at `length` if that is not zero; by images while few of them count,
/// and then by the modes between the plates.
Meeting meeting(Real x, Real length, Real time) {
  Real const width = std::sqrt(4 * time);
  if (length == 0) return {std::erf(x / width), {rate_of(x, width), 0}};
  Meeting out{0, {0, 0}};
  Real const periods = time / (length * length);
  if (periods < 0.1) {
    out.left = 1;
    for (int n = 0; n < 5; ++n)
      out.left -=
          (n % 2 == 0 ? 1 : -1) * (std::erfc((x + n * length) / width) + std::erfc(((n + 1) * length - x) / width));
    for (int n = -4; n <= 4; ++n) {
      out.rate[0] += rate_of(x + 2 * n * length, width);
      out.rate[1] += rate_of(length - x + 2 * n * length, width);
    }
    return out;
  }
  for (int n = 1; n <= 8; ++n) {
    Real const fades = std::exp(-n * n * pi * pi * periods), mode = std::sin(n * pi * x / length) * fades;
    if (n % 2 == 1) out.left += 4 / (n * pi) * mode;
    out.rate[0] += 2 * pi * n * periods * mode;
    out.rate[1] += 2 * pi * n * periods * (n % 2 == 1 ? mode : -mode);
  }
  return out;
}

}  // namespace

Plates::Plates(Domain const& domain, PerFace const& potentials, Real nearest) {
  Real widest = 0, shortest = 0;
  bool is_first = true;
  for (int d = 0; d < 3; ++d) {
    auto const& kinds = domain.boundary[d];
    Real const width = domain.upper[d] - domain.lower[d];
    widest = std::max(widest, width);
    Axis& axis = axes_[d];
    for (int side = 1; side >= 0; --side) {
      if (kinds[side] != Boundary::dirichlet) continue;
      Boundary const other = kinds[1 - side];
      Real const potential = potentials[d][side];
      axis = {true,
              side == 0 ? domain.lower[d] : domain.upper[d],
              side == 0 ? 1.0 : -1.0,
              other == Boundary::open      ? 0
              : other == Boundary::neumann ? 2 * width
                                           : width,
              {potential, other == Boundary::dirichlet ? potentials[d][1] : potential}};
      lowest_ = is_first ? potential : std::min(lowest_, potential);
      highest_ = is_first ? potential : std::max(highest_, potential);
      is_first = false;
    }
    if (axis.length > 0) shortest = shortest == 0 ? axis.length : std::min(shortest, axis.length);
  }
  if (lowest_ == highest_) return;
  // Before the first time nothing has come to a plate, and after the last one all has: between two of them soon, else
  // as the inverse of time.
  Real const first = nearest * nearest / 150, last = shortest > 0 ? 4 * shortest * shortest : 1e14 * widest * widest;
  int const count = int(std::log(last / first) / step) + 1;
  for (int n = 0; n <= count; ++n) times_.push_back(first * std::exp(n * step));
}

Plates::Spread Plates::spread(Axis const& axis, Real x, Real from_centre) const {
  Spread out{std::vector<Real>(times_.size()), std::vector<Real>(times_.size())};
  for (std::size_t n = 0; n < times_.size(); ++n)
    for (int side : {-1, 1}) {
      Real const distance = axis.direction * (x + side * from_centre - axis.origin);
      Meeting const m = meeting(distance, axis.length, times_[n]);
      out.left[n] += 0.5 * m.left;
      for (std::size_t plate = 0; plate < 2; ++plate)
        out.met[n] += 0.5 * step * (axis.potential[plate] - lowest_) * m.rate[plate];
    }
  return out;
}

std::vector<Real> Plates::at(std::vector<Real3> const& places, Real3 const& from_centre) const {
  std::vector<Real> out(places.size(), lowest_);
  if (lowest_ == highest_) return out;
  std::array<std::map<Real, Spread>, 3> spreads;
  for (std::size_t p = 0; p < places.size(); ++p) {
    std::vector<Spread const*> along;
    for (std::size_t d = 0; d < 3; ++d) {
      if (!axes_[d].has_plates) continue;
      auto const [known, is_new] = spreads[d].try_emplace(places[p][d]);
      if (is_new) known->second = spread(axes_[d], places[p][d], from_centre[d]);
      along.push_back(&known->second);
    }
    for (Spread const* axis : along)
      for (std::size_t n = 0; n < times_.size(); ++n) {
        Real product = axis->met[n];
        for (Spread const* other : along)
          if (other != axis) product *= other->left[n];
        out[p] += product;
      }
  }
  return out;
}

}  // namespace amrpic::freespace
