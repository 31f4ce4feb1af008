#include "mesh/fits.hpp"

#include <cstdlib>
#include <vector>

namespace amrpic {

namespace {

NumberedFit tabulated(int placement) {
  NumberedFit out{};
  for (int b = 0; b < 2; ++b)
    for (int a = 0; a < 2; ++a) {
      PlaneFit const fit = plane_fit(placement, quarter(a != 0), quarter(b != 0));
      for (std::size_t t = 0; t < fit.terms.size(); ++t) {
        auto const& term = fit.terms[t];
        out.terms[t].i = term.i, out.terms[t].j = term.j;
        out.terms[t].weight[b][a] = term.weight;
        out.reach = std::max({out.reach, std::abs(term.i), std::abs(term.j)});
      }
    }
  return out;
}

}  // namespace

NumberedFit const& numbered_fit(FitNumber number) {
  static std::vector<NumberedFit> const table = [] {
    std::vector<NumberedFit> out;
    for (std::size_t placement = 0; placement < plane_corners.size(); ++placement)
      out.push_back(tabulated(int(placement)));
    return out;
  }();
  return table[number];
}

}  // namespace amrpic
