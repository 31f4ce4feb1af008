// The formulas of native/stencil with unknowns for values: what they give are rows of operators.
#pragma once

#include "operators/regular_rows.hpp"
#include "operators/row.hpp"
#include "stencil/interface.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic {

/// A cell of a box's level, or of the next coarser or finer one, by its number there.
struct Unknown {
  enum class On : char { coarser, own, finer } level;
  GlobalIndex cell;
  bool operator==(Unknown const& other) const { return level == other.level && cell == other.cell; }
};

using Form = LinearForm<Unknown>;

inline Form own(GlobalIndex cell) { return {{Unknown::On::own, cell}, 1}; }
inline Form fine(GlobalIndex cell) { return {{Unknown::On::finer, cell}, 1}; }

/// A form as rows of three operators, by the level of the columns.
struct Terms {
  Row own_row, coarse_row, fine_row;

  void set(Form const& form) {
    own_row.clear(), coarse_row.clear(), fine_row.clear();
    for (int k = 0; k < form.size(); ++k) {
      auto const [level, cell] = form.column(k);
      if (cell == no_cell) throw std::logic_error("a stencil reached for a cell that does not exist");
      Row& row = level == Unknown::On::own ? own_row : level == Unknown::On::coarser ? coarse_row : fine_row;
      row.append(cell, form.value(k));
    }
  }
};

/// The coarse cells of the plane behind a coarse-fine face, of which phi* is made.
class PlaneBehind {
 public:
  /// The plane around a cell whose face it is; `covered` has the extent of `cells`.
  PlaneBehind(Index3 const& middle, int axis, ArrayOnBox<GlobalIndex> const& cells, ArrayOnBox<char> const& covered)
      : middle_(middle), along_(tangential_axes(axis)), cells_(cells) {
    auto look = [&](int reach) {
      for (int i = -reach; i <= reach; ++i)
        for (int j = -reach; j <= reach; ++j)
          if (cells(at(i, j)) != no_cell && !covered(at(i, j))) usable_ |= plane_bit(i, j);
    };
    look(1);
    if (usable_ != plane_block(-1, -1, 3)) look(2);  // the central block is the first to be tried
  }

  /// phi* in front of the children in the lower or upper half of the cell along either axis of the plane, whose cells
  /// are of the given level.
  Form fit(bool upper_u, bool upper_v, Unknown::On level) const {
    PlaneFit const fit = plane_fit(usable_, quarter(upper_u), quarter(upper_v));
    Form out;
    for (int t = 0; t < fit.count; ++t) {
      auto const& term = fit.terms[std::size_t(t)];
      out.append({level, cells_(at(term.i, term.j))}, term.weight);
    }
    return out;
  }

 private:
  Index3 at(int i, int j) const {
    Index3 out = middle_;
    out[along_[0]] += i;
    out[along_[1]] += j;
    return out;
  }
  Index3 middle_;
  std::array<int, 2> along_;
  ArrayOnBox<GlobalIndex> const& cells_;
  unsigned usable_ = 0;
};

/// phi across a face of a cell. Both Laplacian and field are made of it, so that every face has one flux: in
/// `composite` execution that through a face which the finer level covers on the other side is the mean of the four
/// fine fluxes.
inline Form neighbour_value(StencilCells const& n, Index3 const& cell, int axis, int side, Execution execution) {
  int const step = side == 0 ? -1 : 1;
  Index3 outer = cell, inner = cell;
  outer[axis] += step;
  inner[axis] -= step;
  Form const here = own(n.own(cell));
  auto const [u, v] = tangential_axes(axis);

  Beyond const beyond = n.faces(cell)(axis, side);
  if (beyond == Beyond::wall) return n.walls[axis][side](here, own(n.own(inner)));
  if (beyond == Beyond::coarser) {
    Index3 const behind{floor_divide(outer[0], 2), floor_divide(outer[1], 2), floor_divide(outer[2], 2)};
    PlaneBehind const plane(behind, axis, n.coarse, n.coarse_covered);
    Form const star = plane.fit(outer[u] != 2 * behind[u], outer[v] != 2 * behind[v], Unknown::On::coarser);
    return ghost_at_interface(star, here, own(n.own(inner)));
  }
  if (execution == Execution::composite && beyond == Beyond::finer) {
    PlaneBehind const plane(cell, axis, n.own, n.covered);
    Form differences;
    for (int b = 0; b < 2; ++b)
      for (int a = 0; a < 2; ++a) {
        Index3 first{2 * outer[0], 2 * outer[1], 2 * outer[2]};
        first[axis] += side == 0 ? 1 : 0;
        first[u] += a;
        first[v] += b;
        Index3 second = first;
        second[axis] += step;
        Form const phi_1 = fine(n.fine(first));
        differences +=
            phi_1 - ghost_at_interface(plane.fit(a == 1, b == 1, Unknown::On::own), phi_1, fine(n.fine(second)));
      }
    return ghost_at_fine_faces(here, differences);
  }
  if (n.level->periodic()[axis] && n.seam_width[axis] != 1)
    return neighbour_at_seam(seam_factor(cell[axis], side, n.level->domain().extent(axis), n.seam_width[axis]), here,
                             own(n.own(outer)));
  return own(n.own(outer));
}

/// L phi in a cell from the values neighbour(axis, side) across its faces; the diagonal comes first.
template <class Neighbour>
inline Form laplacian_form(Equation const& equation, GlobalIndex cell, Neighbour&& neighbour) {
  Form const here = own(cell);
  Form out({Unknown::On::own, cell}, 0);
  return out += laplacian(equation, here, neighbour(0, 0), neighbour(0, 1), neighbour(1, 0), neighbour(1, 1),
                          neighbour(2, 0), neighbour(2, 1));
}

}  // namespace amrpic
