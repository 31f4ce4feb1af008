// Samples and targets: linear functionals of polynomials, each a sum of means of derivatives over boxes and their
// sides.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "base/lane_types.hpp"
#include "gmls/polynomials.hpp"

namespace amrpic::gmls {

/// How many targets a `V` has in work: of `double` one, of a vector one per lane.
template <class V>
constexpr int width = int(sizeof(V) / sizeof(Real));
template <class V>
using Each = std::array<std::size_t, std::size_t(width<V>)>;  ///< a number for each of them

/// Values at places of an array, one for each lane.
template <class V>
V gathered(Real const* from, Each<V> const& at) {
  if constexpr (width<V> == 1) {
    return from[at[0]];
  } else {
    std::array<Real, std::size_t(width<V>)> values;
    for (int l = 0; l < width<V>; ++l) values[std::size_t(l)] = from[at[std::size_t(l)]];
    return load<V>(values.data());
  }
}

/// A derivative of a component, averaged over the box around a place, times a coefficient.
struct Term {
  int row, place, component;
  Powers derivative;
};

/// `count` groups of `rows` functionals that differ in places, half widths and coefficients alone; one group serves all
/// if `count` is 1.
struct Functionals {
  int dimension = 0, rows = 0, places = 0;
  std::vector<Term> terms;  ///< those of a place side by side
  std::size_t count = 0;
  Real const* place = nullptr;        ///< (count, places, dimension)
  Real const* half = nullptr;         ///< the same, or none: points
  Real const* coefficient = nullptr;  ///< (count, terms)

  /// Values for the polynomials' coefficients, (rows, components * monomials), of one group per lane, in coordinates
  /// (x - origin) * inverse.
  template <class V>
  void evaluate(Monomials const& monomials, int components, Each<V> of, std::array<V, 3> const& origin,
                std::array<V, 3> const& inverse, V* out) const {
    int const full = components * monomials.count();
    std::fill(out, out + rows * full, V{});
    if (count == 1) of.fill(0);
    for (std::size_t t = 0; t < terms.size(); ++t) {
      Term const& term = terms[t];
      auto const at = [&](std::size_t stride, std::size_t offset) {
        Each<V> place;
        for (std::size_t l = 0; l < of.size(); ++l) place[l] = of[l] * stride + offset;
        return place;
      };
      V scale = gathered<V>(coefficient, at(terms.size(), t));
      std::array<std::array<V, highest_order + 1>, 3> along;
      for (std::size_t d = 0; d < std::size_t(dimension); ++d) {
        auto const where = at(std::size_t(places * dimension), std::size_t(term.place * dimension) + d);
        V const u = (gathered<V>(place, where) - origin[d]) * inverse[d];
        V const a = half ? gathered<V>(half, where) * inverse[d] : V{};
        along[d] = means_along_axis(u, a, term.derivative[d], monomials.order());
        for (int r = 0; r < term.derivative[d]; ++r) scale = scale * inverse[d];
      }
      V* const row = out + term.row * full + term.component * monomials.count();
      for (int i = 0; i < monomials.count(); ++i) {
        V product = scale;
        for (std::size_t d = 0; d < std::size_t(dimension); ++d)
          product = product * along[d][std::size_t(monomials.exponents()[std::size_t(i)][d])];
        row[i] += product;
      }
    }
  }
};

}  // namespace amrpic::gmls
