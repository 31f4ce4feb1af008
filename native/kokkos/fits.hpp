#pragma once

#include <unordered_map>

#include "kokkos/arrays.hpp"
#include "matrixfree/fits.hpp"
#include "stencil/gap_fit.hpp"

namespace amrpic::kokkos {

/// phi* behind the four fine faces of a coarse face, or weights for it: [upper half along v][upper half along u].
template <class T>
using Four = std::array<std::array<T, 2>, 2>;

/// A term of a sum that makes up phi*: the value at a place.
template <class T>
struct FitTerm {
  std::int32_t place;
  Four<T> weight;
};

template <class T, class Weight>
Four<T> rounded(Weight const& weight) {
  Four<T> out;
  for (std::size_t b = 0; b < 2; ++b)
    for (std::size_t a = 0; a < 2; ++a) out[b][a] = T(weight[b][a]);
  return out;
}

template <class T>
KOKKOS_INLINE_FUNCTION void add_term(Four<T>& stars, Four<T> const& weight, T value) {
  for (std::size_t b = 0; b < 2; ++b)
    for (std::size_t a = 0; a < 2; ++a) stars[b][a] += weight[b][a] * value;
}

/// The numbered fits as kernels read them.
template <class T>
struct NumberedFits {
  struct Term {
    std::int32_t i, j;
    Four<T> weight;
  };
  static constexpr int terms_of_one = 9;
  Array<Term> terms;

  static NumberedFits made() {
    std::vector<Term> out;
    for (std::size_t number = 0; number < plane_corners.size(); ++number)
      for (auto const& term : numbered_fit(FitNumber(number)).terms)
        out.push_back({term.i, term.j, rounded<T>(term.weight)});
    return {on_device(out)};
  }
  /// By the coarse values of a plane, `middle` being that behind the face.
  KOKKOS_INLINE_FUNCTION Four<T> stars(int number, T const* middle, std::int32_t u, std::int32_t v) const {
    Four<T> out{};
    for (int t = number * terms_of_one; t < (number + 1) * terms_of_one; ++t)
      add_term(out, terms(t).weight, middle[terms(t).i * u + terms(t).j * v]);
    return out;
  }
};

/// Fits in gaps, each with its terms.
template <class T>
class GapTerms {
 public:
  struct Lists {
    std::vector<FitTerm<T>> terms;
    std::vector<std::int32_t> first{0};
    void end_gap() { first.push_back(std::int32_t(terms.size())); }
  };
  GapTerms() = default;
  explicit GapTerms(Lists const& lists) : terms_(on_device(lists.terms)), first_(on_device(lists.first)) {}

  /// Add the terms of a gap, value(place) each.
  template <class Value>
  KOKKOS_INLINE_FUNCTION void add(std::int32_t gap, Four<T>& stars, Value const& value) const {
    for (std::int32_t t = first_(gap); t < first_(gap + 1); ++t)
      add_term(stars, terms_(t).weight, value(terms_(t).place));
  }
  std::size_t bytes() const { return terms_.extent(0) * sizeof(FitTerm<T>) + first_.extent(0) * sizeof(std::int32_t); }

 private:
  Array<FitTerm<T>> terms_;
  Array<std::int32_t> first_;
};

}  // namespace amrpic::kokkos
