// The formulas of native/stencil with unknowns for values: what they give are rows of operators.
#pragma once

#include <array>

#include "operators/cell_shape.hpp"
#include "operators/form.hpp"
#include "stencil/interface.hpp"
#include "stencil/laplacian.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// Values near a cell of a level, as forms.
class FormsNear {
 public:
  FormsNear(Level const& level, WallGhosts const& walls) : level_(&level), walls_(&walls) {}

  /// phi of the cell, or of one that is so far from it along an axis.
  Form own(int axis = 0, int distance = 0) const { return {unknown(Unknown::On::own, along(axis, distance)), 1}; }

  /// phi across a face. Both Laplacian and field are made of it, so that every face has one flux: that through a face
  /// which the finer level covers on the other side is the mean of the four fine fluxes.
  Form across(FaceShape const& face, int axis, int side) const {
    int const step = side == 0 ? -1 : 1;
    Form const here = own(), inner = own(axis, -step);
    if (face.beyond == Beyond::wall) return (*walls_)[axis][side](here, inner);
    if (face.beyond == Beyond::coarser) {
      Form const star = fit(face, axis, face.upper_u, face.upper_v, Unknown::On::coarser, along(axis, step));
      return ghost_at_interface(star, here, inner);
    }
    if (face.beyond == Beyond::finer) {
      auto const [u, v] = tangential_axes(axis);
      Form differences;
      for (int b = 0; b < 2; ++b)
        for (int a = 0; a < 2; ++a) {
          Index3 first = along(axis, side == 0 ? -1 : 2);  // from the first child
          first[u] = a, first[v] = b;
          Index3 second = first;
          second[axis] += step;
          Form const phi_1(unknown(Unknown::On::finer, first), 1), phi_2(unknown(Unknown::On::finer, second), 1);
          Form const star = fit(face, axis, a == 1, b == 1, Unknown::On::own, {0, 0, 0});
          differences += phi_1 - ghost_at_interface(star, phi_1, phi_2);
        }
      return ghost_at_fine_faces(here, differences);
    }
    return neighbour_at_seam(face.seam, here, own(axis, step));
  }

 private:
  static Index3 along(int axis, int distance) {
    Index3 out{0, 0, 0};
    out[axis] = distance;
    return out;
  }

  /// Images of a cell around periodic axes are one unknown: the first one from two cells below on, as far as the
  /// numbers in `StencilCells` reach.
  Unknown unknown(Unknown::On level, Index3 offset) const {
    Unknown out{level, {}};
    for (int d = 0; d < 3; ++d) {
      int const cells = level_->domain().extent(d);
      int const period = level == Unknown::On::finer ? 2 * cells : level == Unknown::On::own ? cells : cells / 2;
      if (level_->periodic()[d]) offset[d] -= period * floor_divide(offset[d] + 2, period);
      out.offset[std::size_t(d)] = std::int8_t(offset[d]);
    }
    return out;
  }

  /// phi* in front of the children in the lower or upper half of the plane's middle cell along either of its axes.
  Form fit(FaceShape const& face, int axis, bool upper_u, bool upper_v, Unknown::On level, Index3 const& middle) const {
    auto const [u, v] = tangential_axes(axis);
    PlaneFit const fit = plane_fit(face.usable, quarter(upper_u), quarter(upper_v));
    Form out;
    for (int t = 0; t < fit.count; ++t) {
      auto const& term = fit.terms[std::size_t(t)];
      Index3 cell = middle;
      cell[u] += term.i, cell[v] += term.j;
      out.append(unknown(level, cell), term.weight);
    }
    return out;
  }

  Level const* level_;
  WallGhosts const* walls_;
};

/// L phi in a cell from the values across(axis, side) its faces; the diagonal comes first.
template <class Across>
inline Form laplacian_form(Equation const& equation, Form const& here, Across&& across) {
  Form out(here.terms()[0].column, 0);
  return out +=
         laplacian(equation, here, across(0, 0), across(0, 1), across(1, 0), across(1, 1), across(2, 0), across(2, 1));
}

/// L phi in a cell whose neighbours are of its level.
inline Form regular_laplacian(Equation const& equation, FormsNear const& near) {
  return laplacian_form(equation, near.own(), [&](int axis, int side) { return near.across({}, axis, side); });
}

}  // namespace amrpic
