#pragma once

#include "kokkos/arrays.hpp"
#include "mesh/fits.hpp"

namespace amrpic::kokkos {

/// The numbered fits as kernels read them.
struct NumberedFits {
  static constexpr int terms_of_one = 9;
  Array<NumberedFit::Term> terms;

  static NumberedFits made() {
    std::vector<NumberedFit::Term> out;
    for (std::size_t number = 0; number < plane_corners.size(); ++number) {
      auto const& of_one = numbered_fit(FitNumber(number)).terms;
      out.insert(out.end(), of_one.begin(), of_one.end());
    }
    return {on_device(out)};
  }
  /// By the coarse values of a plane, `middle` being that behind the face.
  template <class T>
  KOKKOS_INLINE_FUNCTION FourStars<T> stars(int number, T const* middle, std::int32_t u, std::int32_t v) const {
    FourStars<T> out{};
    for (int t = number * terms_of_one; t < (number + 1) * terms_of_one; ++t)
      add_to_stars(out, terms(t).weight, middle[terms(t).i * u + terms(t).j * v]);
    return out;
  }
};

/// Fits in gaps, each with its terms: the weights of values at places.
class GapTerms {
 public:
  struct Term {
    std::int32_t place;
    FourStars<Real> weight;
  };
  struct Lists {
    std::vector<Term> terms;
    std::vector<std::int32_t> first{0};
    void end_gap() { first.push_back(std::int32_t(terms.size())); }
  };
  GapTerms() = default;
  explicit GapTerms(Lists const& lists) : terms_(on_device(lists.terms)), first_(on_device(lists.first)) {}

  /// Add the terms of a gap, value(place) each.
  template <class T, class Value>
  KOKKOS_INLINE_FUNCTION void add(std::int32_t gap, FourStars<T>& stars, Value const& value) const {
    for (std::int32_t t = first_(gap); t < first_(gap + 1); ++t)
      add_to_stars(stars, terms_(t).weight, value(terms_(t).place));
  }
  std::size_t bytes() const { return terms_.extent(0) * sizeof(Term) + first_.extent(0) * sizeof(std::int32_t); }

 private:
  Array<Term> terms_;
  Array<std::int32_t> first_;
};

}  // namespace amrpic::kokkos
