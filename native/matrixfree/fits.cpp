#include "matrixfree/fits.hpp"

#include <cstdlib>
#include <vector>

#include "mesh/hierarchy.hpp"

namespace amrpic {

namespace {

constexpr int first_bilinear = int(biquadratic_corners.size());
constexpr int first_linear = first_bilinear + int(bilinear_corners.size());

/// Direction of the line that a fit of first order takes along an axis: +1, -1, or 0 for none.
int line_along(unsigned usable, int i, int j) {
  return usable & plane_bit(i, j) ? 1 : usable & plane_bit(-i, -j) ? -1 : 0;
}

int number_of(unsigned usable) {
  PlaneFit const fit = plane_fit(usable, quarter(true), quarter(true));
  if (fit.kind == PlaneFitKind::biquadratic) return fit.placement;
  if (fit.kind == PlaneFitKind::bilinear) return first_bilinear + fit.placement;
  return first_linear + (line_along(usable, 1, 0) + 1) + 3 * (line_along(usable, 0, 1) + 1);
}

NumberedFit tabulated(unsigned usable) {
  NumberedFit out{};
  for (int b = 0; b < 2; ++b)
    for (int a = 0; a < 2; ++a) {
      PlaneFit const fit = plane_fit(usable, quarter(a != 0), quarter(b != 0));
      out.count = fit.count;
      for (int t = 0; t < fit.count; ++t) {
        auto const& term = fit.terms[t];
        out.terms[t].i = term.i, out.terms[t].j = term.j;
        out.terms[t].weight[b][a] = term.weight;
        out.reach = std::max({out.reach, std::abs(term.i), std::abs(term.j)});
      }
    }
  return out;
}

/// For each fit, cells that are enough for it and for none that is tried before it.
std::vector<NumberedFit> make_table() {
  std::vector<NumberedFit> out;
  unsigned const self = plane_bit(0, 0);
  for (auto const& [i, j] : biquadratic_corners) out.push_back(tabulated(plane_block(i, j, 3)));
  for (auto const& [i, j] : bilinear_corners) out.push_back(tabulated(plane_block(i, j, 2)));
  for (int j = -1; j <= 1; ++j)
    for (int i = -1; i <= 1; ++i) out.push_back(tabulated(self | plane_bit(i, 0) | plane_bit(0, j)));
  return out;
}

/// The fit at a cell of a plane with 1 for usable cells.
FitNumber fit_at(char const* cell, std::ptrdiff_t pitch) {
  int central = 1;
  for (char const* c : {cell - pitch, cell, cell + pitch}) central &= c[-1] & c[0] & c[1];
  if (central) return central_fit;
  unsigned usable = 0;
  for (int j = -2; j <= 2; ++j)
    for (int i = -2; i <= 2; ++i)
      if (cell[i + j * pitch]) usable |= plane_bit(i, j);
  return fit_number(usable);
}

}  // namespace

FitNumber fit_number(unsigned usable) {
  constexpr unsigned central = plane_block(-1, -1, 3);
  return FitNumber((usable & central) == central ? central_fit : number_of(usable));
}

ArrayOnBox<FitNumber> fits_behind(Face const& face, int axis, std::vector<Overlap> const& coarser,
                                  std::vector<Overlap> const& refined) {
  ArrayOnBox<FitNumber> out(face.layer.coarsen(refinement_ratio), central_fit);
  for (Overlap const& o : face.neighbours) out.fill(o.part.coarsen(refinement_ratio), no_fit);
  Index3 around{2, 2, 2};
  around[axis] = 0;
  ArrayOnBox<char> usable(out.box().grow(around), 0);
  for (Overlap const& o : coarser) usable.fill(o.part, 1);
  for (Overlap const& o : refined) usable.fill(o.part.coarsen(refinement_ratio), 0);
  auto const [u, v] = tangential_axes(axis);
  std::ptrdiff_t const pitch = usable.box().extent(u);  // a plane: rows along u, one after the other
  FitNumber* fit = out.values().data();
  char const* middle = usable.values().data() + 2 + 2 * pitch;
  for (int j = 0; j < out.box().extent(v); ++j, middle += 4)
    for (int i = 0; i < out.box().extent(u); ++i, ++middle, ++fit)
      if (*fit != no_fit) *fit = fit_at(middle, pitch);
  return out;
}

NumberedFit const& numbered_fit(FitNumber number) {
  static std::vector<NumberedFit> const table = make_table();
  return table[number];
}

}  // namespace amrpic
