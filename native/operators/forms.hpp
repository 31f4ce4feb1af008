// The formulas of native/stencil with unknowns for values: what they give are rows of operators.
#pragma once

#include <array>
#include <cstdint>
#include <stdexcept>

#include "operators/cell_shape.hpp"
#include "operators/row.hpp"
#include "stencil/interface.hpp"
#include "stencil/laplacian.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// A cell near that of a row, on its level or on the next coarser or finer one, by its offset there: from the row's
/// cell, its parent or its first child.
struct Unknown {
  enum class On : std::int8_t { coarser, own, finer } level;
  std::array<std::int8_t, 3> offset;
  bool operator==(Unknown const& other) const { return level == other.level && offset == other.offset; }
};

using Form = LinearForm<Unknown>;

/// A form as rows of three operators, by the level of the columns.
struct Terms {
  Row own_row, coarse_row, fine_row;

  /// The row of a cell that has the form.
  void set(Form const& form, StencilCells const& n, Index3 const& cell) {
    own_row.clear(), coarse_row.clear(), fine_row.clear();
    Index3 const parent = parent_of(cell), child = first_child_of(cell);
    bool const images_meet = has_images_in_reach(*n.level);
    for (auto const& [unknown, weight] : form.terms()) {
      auto append = [&, w = weight, o = unknown.offset](Row& row, ArrayOnBox<GlobalIndex> const& numbers,
                                                        Index3 const& from) {
        GlobalIndex const number = numbers({from[0] + o[0], from[1] + o[1], from[2] + o[2]});
        if (number == no_cell) throw std::logic_error("a stencil reached for a cell that does not exist");
        images_meet ? row.add(number, w) : row.append(number, w);
      };
      if (unknown.level == Unknown::On::own) append(own_row, n.own_numbers(), cell);
      if (unknown.level == Unknown::On::coarser) append(coarse_row, n.coarse, parent);
      if (unknown.level == Unknown::On::finer) append(fine_row, n.fine, child);
    }
  }

 private:
  /// Whether a fit in a narrow gap may name several images of a cell around a periodic axis.
  static bool has_images_in_reach(Level const& level) {
    bool out = false;
    for (int d = 0; d < 3; ++d) out = out || (level.periodic()[d] && level.domain().extent(d) < 10);
    return out;
  }
};

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
          Form const star =
              fit(face, axis, a == 1, b == 1, {Unknown::On::own, {0, 0, 0}, Unknown::On::finer, {0, 0, 0}});
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

  /// The coarse cell behind fine faces, and its first child, as unknowns.
  struct Behind {
    Unknown::On coarse;
    Index3 middle;
    Unknown::On fine;
    Index3 first_child;
  };

  /// phi* in front of the children in the lower or upper half of the middle cell along either axis of its plane.
  Form fit(FaceShape const& face, int axis, bool upper_u, bool upper_v, Behind const& behind) const {
    Form out;
    if (face.gap) {
      for (auto const& term : face.gap->terms) {
        Real const weight = term.weight[upper_v][upper_u];
        if (weight == 0) continue;
        Unknown cell{term.fine ? behind.fine : behind.coarse, term.offset};
        Index3 const& from = term.fine ? behind.first_child : behind.middle;
        for (std::size_t d = 0; d < 3; ++d) cell.offset[d] = std::int8_t(cell.offset[d] + from[d]);
        out.append(cell, weight);
      }
      return out;
    }
    auto const [u, v] = tangential_axes(axis);
    for (auto const& term : plane_fit(face.placement, quarter(upper_u), quarter(upper_v)).terms) {
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

}  // namespace amrpic
