#pragma once

#include "composite/composite_residual.hpp"
#include "composite/fourth_order_ghosts.hpp"

namespace amrpic {

/// Residuals in fourth order, of means of cells.
class FourthOrderResidual : public CompositeResidual {
 public:
  FourthOrderResidual(CompositeMesh& mesh, FourthOrderGhosts& ghosts);

 private:
  void residual_plane(int l, int b, int k, Source const& source, Field const& phi) override;
  void right_hand_side_plane(int l, int b, int k, Source const& source) override;
  void term_sizes_plane(int l, int b, int k, Source const& source) override;
  /// Of the cells far from walls: those behind walls count no more than these.
  void diagonal_plane(int l, int b, int k, Field const& phi) override;
  void visit(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const&,
             std::function<void(int, int)> const& f) override {
    ghosts_.visit(phi, &walls, FourthOrderGhosts::Ends::ghosts, FullyCovered::skip, f);
  }

  void plane_of(int l, int b, int k, Source const& source, Real const* cells);
  struct RowsOfPlane {
    Real const* first;
    std::ptrdiff_t pitch;
    Real const* row(int j) const { return first + j * pitch; }
  };
  RowsOfPlane rows_of(Box const& own, int k, Real const* cells) const;
  Real const* fill_line(Box const& own, int j, int k, Real const* row);
  void subtract_walls(int l, int b, int k);
  bool has_wall(int l, int b) const;
  bool has_walls_alone(int l, int b) const;

  static constexpr int layers = FourthOrderGhosts::layers;

  FourthOrderGhosts& ghosts_;
  std::array<std::vector<Real>, 3> across_;  ///< of the plane under way, by axis: what wall data add
  std::array<std::vector<Real>, 2> lines_;   ///< the row under way and the next one, with the ghosts before and behind
  std::vector<Real> zeros_;                  ///< a row of them
};

}  // namespace amrpic
