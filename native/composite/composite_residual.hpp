#pragma once

#include "composite/composite_ghosts.hpp"
#include "mesh/norm.hpp"

namespace amrpic {

/// What the right-hand side f = -rho / eps0 - background is made of, with the data of the walls of each level.
struct Source {
  Field const& rho;  ///< C/m^3; values in covered cells are not used
  std::vector<Walls> const& walls;
  Background background{};
  std::vector<Real> potentials{};  ///< of electrodes, V
};

/// Integral over uncovered cells of f less what the wall data add to the Laplacian, and of the magnitudes of its terms.
struct IntegralOfSource {
  Real net, magnitude;
};

/// Residuals and right-hand sides, plane by plane, and their norms; see CompositeLaplacian. How a plane comes about is
/// the scheme's own.
class CompositeResidual {
 public:
  explicit CompositeResidual(CompositeMesh& mesh) : mesh_(mesh), plane_(mesh.largest_face(2)) {}
  virtual ~CompositeResidual() = default;

  template <class T>
  Real residual(Source const& source, Field const& phi, Norm norm, std::vector<Real> const& scale,
                Blocks<T> const& residual);
  template <class T>
  Real residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale, Blocks<T> const& residual);
  Real right_hand_side_norm(Source const& source, Norm norm);
  IntegralOfSource integrate_right_hand_side(Source const& source);
  Real diagonal_norm(Field const& phi, Norm norm);

  /// Call f(level, place, electrode, charge in C) for the arms of uncovered cells that metal cuts: what leaves its
  /// surface through their faces. Across a very short one it is what the other faces and the charge of the cell leave
  /// for it, as the difference of nearly equal potentials has no digits. Collective.
  using OfCharge = std::function<void(int, std::size_t, int, Real)>;
  virtual void for_each_charge(Source const&, Field const&, OfCharge const&) {}

  std::size_t bytes() const { return plane_.capacity() * sizeof(Real); }

 protected:
  // Each fills `plane_` for plane k of a box, zero in covered cells.
  /// f - L phi, of the box under way in `visit`.
  virtual void residual_plane(int l, int b, int k, Source const& source, Field const& phi) = 0;
  /// f less what wall data add to the Laplacian.
  virtual void right_hand_side_plane(int l, int b, int k, Source const& source) = 0;
  /// The magnitudes of all terms of that, added up.
  virtual void term_sizes_plane(int l, int b, int k, Source const& source) = 0;
  /// The diagonal of the Laplacian times phi.
  virtual void diagonal_plane(int l, int b, int k, Field const& phi) = 0;
  /// Call f(level, box) for the boxes with uncovered cells, finest level first, with what `residual_plane` takes at
  /// hand. Collective.
  virtual void visit(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& potentials,
                     std::function<void(int, int)> const& f) = 0;

  void source_plane(int l, int b, int k, Source const& source);
  void source_sizes_plane(int l, int b, int k, Source const& source);

  CompositeMesh& mesh_;
  std::vector<Real> plane_;  ///< of the cells under way

 private:
  template <class T>
  void write_plane(int l, int b, int k, std::vector<Real> const& scale, Blocks<T> const& residual,
                   Magnitude& magnitude) const;
  template <class T>
  void clear_fully_covered(Blocks<T> const& blocks);
  template <class Fill, class Use>
  void for_each_plane(Fill&& fill, Use&& use);
};

/// In second order: the seven-point Laplacian.
class SecondOrderResidual : public CompositeResidual {
 public:
  SecondOrderResidual(CompositeMesh& mesh, CompositeGhosts& ghosts) : CompositeResidual(mesh), ghosts_(ghosts) {}

 private:
  void residual_plane(int l, int b, int k, Source const& source, Field const& phi) override;
  void right_hand_side_plane(int l, int b, int k, Source const& source) override;
  void term_sizes_plane(int l, int b, int k, Source const& source) override;
  void diagonal_plane(int l, int b, int k, Field const& phi) override;
  void for_each_charge(Source const& source, Field const& phi, OfCharge const& f) override;
  std::array<Real, 6> differences(int l, int b, CompositeMesh::CutHere const& here, Real rho, Real const* phi,
                                  Source const& source) const;
  void visit(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& potentials,
             std::function<void(int, int)> const& f) override {
    ghosts_.visit(phi, walls, potentials, FullyCovered::skip, f);
  }
  template <class F>
  void for_each_wall_term(int l, int b, int k, Source const& source, F&& f) const;
  [[gnu::noinline]] void residual_beside_metal(int l, int b, int k, Source const& source, Real const* cells);
  [[gnu::noinline]] void right_hand_side_beside_metal(int l, int b, int k, Source const& source);
  Real of_surfaces(int l, int b, CompositeMesh::CutHere const& here, Source const& source) const {
    return here.electrode >= 0 ? here.row.at_surfaces * source.potentials[std::size_t(here.electrode)]
                               : of_several_surfaces(l, b, here, source);
  }
  Real of_several_surfaces(int l, int b, CompositeMesh::CutHere const& here, Source const& source) const;
  Real of_data(int l, int b, CompositeMesh::CutHere const& here, Source const& source) const;
  template <class F>
  void for_each_own_weight_in_gaps(int l, int b, int face, F&& f) const;

  CompositeGhosts& ghosts_;
};

}  // namespace amrpic
