#pragma once

#include "matrixfree/composite_ghosts.hpp"
#include "mesh/norm.hpp"

namespace amrpic {

/// What the right-hand side f = -rho / eps0 - background is made of, with the data of the walls of each level.
struct Source {
  Field const& rho;  ///< C/m^3; values in covered cells are not used
  std::vector<Walls> const& walls;
  Background background{};
};

/// Integral over uncovered cells of f less what the wall data add to the Laplacian, and of the magnitudes of its terms.
struct IntegralOfSource {
  Real net, magnitude;
};

/// Residuals and right-hand sides, plane by plane, and their norms; see CompositeLaplacian.
class CompositeResidual {
 public:
  CompositeResidual(CompositeMesh& mesh, CompositeGhosts& ghosts)
      : mesh_(mesh), ghosts_(ghosts), plane_(mesh.largest_face(2)) {}

  template <class T>
  Real residual(Source const& source, Field const& phi, Norm norm, std::vector<Real> const& scale,
                Blocks<T> const& residual);
  template <class T>
  Real residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale, Blocks<T> const& residual);
  Real right_hand_side_norm(Source const& source, Norm norm);
  IntegralOfSource integrate_right_hand_side(Source const& source);
  Real diagonal_norm(Field const& phi, Norm norm);

  std::size_t bytes() const { return plane_.capacity() * sizeof(Real); }

 private:
  void residual_plane(int l, int b, int k, Source const& source, Field const& phi);
  void right_hand_side_plane(int l, int b, int k, Source const& source);
  void term_sizes_plane(int l, int b, int k, Source const& source);
  template <class F>
  void for_each_wall_term(int l, int b, int k, Source const& source, F&& f) const;
  template <class F>
  void for_each_own_share_in_gaps(int l, int b, int face, F&& f) const;
  void diagonal_plane(int l, int b, int k, Field const& phi);
  template <class T>
  void clear_fully_covered(Blocks<T> const& blocks);
  template <class Fill, class Use>
  void for_each_plane(Fill&& fill, Use&& use);

  CompositeMesh& mesh_;
  CompositeGhosts& ghosts_;
  std::vector<Real> plane_;  ///< of the cells under way
};

}  // namespace amrpic
