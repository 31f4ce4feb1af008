// The formulas of native/stencil with unknowns for values: what they give are rows of operators.
#pragma once

#include "matrices/cell_shape.hpp"
#include "matrices/form.hpp"
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
      Index3 first_child = along(axis, side == 0 ? -2 : 1);  // of the cell behind the face
      auto const [u, v] = tangential_axes(axis);
      first_child[u] = face.upper_u ? -1 : 0, first_child[v] = face.upper_v ? -1 : 0;
      Behind const behind{Unknown::On::coarser, along(axis, step), Unknown::On::own, first_child};
      Form const star = fit(face, axis, face.upper_u, face.upper_v, behind);
      return ghost(face, face.upper_u, face.upper_v, star, here, inner);
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
          if (face.metal && !face.metal->linked[std::size_t(b)][std::size_t(a)]) continue;
          Form const star =
              fit(face, axis, a == 1, b == 1, {Unknown::On::own, {0, 0, 0}, Unknown::On::finer, {0, 0, 0}});
          differences += phi_1 - ghost(face, a == 1, b == 1, star, phi_1, phi_2);
        }
      return ghost_at_fine_faces(here, face.metal ? face.metal->of_links() * differences : differences);
    }
    return neighbour_at_seam(face.seam, here, own(axis, step));
  }

 private:
  static Index3 along(int axis, int distance) {
    Index3 out{0, 0, 0};
    out[axis] = distance;
    return out;
  }

  /// Images of a cell around periodic axes are one unknown: the first one from two cells below on, but of those beyond
  /// four cells, which no fit in a narrow gap reaches, the one before.
  Unknown unknown(Unknown::On level, Index3 offset) const {
    Unknown out{level, {}};
    for (int d = 0; d < 3; ++d) {
      int const cells = level_->domain().extent(d);
      int const period = level == Unknown::On::finer ? 2 * cells : level == Unknown::On::own ? cells : cells / 2;
      if (level_->periodic()[d]) {
        offset[d] -= period * floor_divide(offset[d] + 2, period);
        if (offset[d] > 4) offset[d] -= period;
      }
      out.offset[std::size_t(d)] = std::int8_t(offset[d]);
    }
    return out;
  }

  /// The coarse cell behind fine faces, and its first child, as unknowns.
  struct Behind {
    Unknown::On coarse;
    Index3 middle;
    Unknown::On fine;
    Index3 first_child;
  };

  /// The ghost by phi*, the cell before it and the next one.
  static Form ghost(FaceShape const& face, bool upper_u, bool upper_v, Form const& star, Form const& first,
                    Form const& second) {
    if (!face.metal) return ghost_at_interface(star, first, second);
    MetalFace const& metal = *face.metal;
    return metal.star(upper_u, upper_v) * star + metal.first(upper_u, upper_v) * first +
           metal.second(upper_u, upper_v) * second;
  }

  /// phi* in front of the children in the lower or upper half of the middle cell along either axis of its plane.
  Form fit(FaceShape const& face, int axis, bool upper_u, bool upper_v, Behind const& behind) const {
    Form out;
    if (face.metal) {
      auto const [u, v] = tangential_axes(axis);
      for (auto const& term : face.metal->cells) {
        Index3 cell = behind.middle;
        cell[u] += term.i, cell[v] += term.j;
        out.add(unknown(behind.coarse, cell), term.weight[upper_v][upper_u]);
      }
      return out;
    }
    if (face.gap) {
      for (auto const& term : face.gap->terms) {
        Real const weight = term.weight[upper_v][upper_u];
        if (weight == 0) continue;
        Index3 cell = term.fine ? behind.first_child : behind.middle;
        for (std::size_t d = 0; d < 3; ++d) cell[d] += term.offset[d];
        out.add(unknown(term.fine ? behind.fine : behind.coarse, cell), weight);  // images may meet
      }
      return out;
    }
    auto const [u, v] = tangential_axes(axis);
    for (auto const& term : plane_fit(face.fit, quarter(upper_u), quarter(upper_v)).terms) {
      Index3 cell = behind.middle;
      cell[u] += term.i, cell[v] += term.j;
      out.append(unknown(behind.coarse, cell), term.weight);
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

/// The same in a cut cell, its equation scaled, see CutRow. is_parabola(axis, side): of walls.
template <class Parabola, class Across>
inline Form cut_laplacian_form(Equation const& equation, Form const& here, CutCell const& cut, Parabola&& is_parabola,
                               Across&& across) {
  std::array<Arm, 6> arms;
  for (std::size_t n = 0; n < 6; ++n) {
    arms[n] = arm_of(cut, n);
    arms[n].is_parabola = is_parabola(int(n) / 2, int(n) % 2);
  }
  CutRow const row = cut_row(equation, arms, cut.hold);
  Form out(here.terms()[0].column, -row.diagonal);
  for (std::size_t n = 0; n < 6; ++n)
    if (row.neighbour(n) != 0) out += row.neighbour(n) * across(int(n) / 2, int(n) % 2);
  return out;
}

/// L phi in a cell whose neighbours are of its level.
inline Form regular_laplacian(Equation const& equation, FormsNear const& near) {
  return laplacian_form(equation, near.own(), [&](int axis, int side) { return near.across({}, axis, side); });
}

}  // namespace amrpic
