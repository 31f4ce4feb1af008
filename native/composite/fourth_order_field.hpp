#pragma once

#include "composite/composite_average.hpp"
#include "composite/fourth_order_ghosts.hpp"
#include "mesh/electric_field.hpp"
#include "mesh/walls.hpp"

namespace amrpic {

/// What a field holds in each cell.
enum class Holds {
  points,  ///< the value at the centre
  means    ///< the mean over the cell
};

/// What follows from a potential's means, and the way from points to means and back.
class FourthOrderField {
 public:
  FourthOrderField(CompositeMesh& mesh, FourthOrderGhosts& ghosts, CompositeAverage& average)
      : mesh_(mesh), ghosts_(ghosts), average_(average) {}

  /// The means over cells of E = -grad phi (V/m; over the stretch along each axis once more), or its values at their
  /// centres. `potential` must be averaged down. In covered cells stands what follows from the means of the children,
  /// or, as asked, from the level's own potentials. Collective.
  ElectricField electric_field(Field const& potential, std::vector<Walls> const& walls, CoveredField covered,
                               Holds holds);

  /// Values at centres, those of covered cells included, from means, which must be averaged down for that, with an
  /// error of fourth order also where levels end. Collective.
  void to_points(Field const& means, Field& points);

  /// Means from values at the centres; those in covered cells are not read. The error is of fourth order, of third in
  /// cells where a level ends or a finer one begins: in a density that counts as one of fourth order. Collective.
  void to_means(Field const& points, Field& means);

  /// Charge of cells, counted from the lowest one of the domain, that wall potentials take beside their own.
  struct AddedDensity {
    Box cells;
    std::vector<Real> density;  ///< x fastest
  };
  /// What makes point charges in the cells' centres act from afar as the density does, by [level][box of this rank].
  ///
  /// For a harmonic f the integral of rho f over cells of one size is the sum of their charges times f, and h^2/12 of
  /// the integral of rho df/dn over the ends of these cells: nothing where rho ends before, but beside a coarse-fine
  /// face (h_c^2 - h_f^2)/12 is left over. As much of a dipole is added, without a quadrupole about the face, on the
  /// coarse cell and the first two fine ones. What covered cells hold is not read. Collective.
  std::vector<std::vector<std::vector<AddedDensity>>> beside_coarse_faces(Field const& density);

  /// truncation = scale[level] * the truncation error of the Laplacian in uncovered cells, zero in covered ones,
  /// from sixth differences: -h^4/90 times the sixth derivatives. Nothing is known of cells where a level
  /// ends. Returns the largest magnitude, without the scale. Collective.
  Real truncation(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& scale,
                  Blocks<float> const& truncation);

 private:
  void second_differences(Box const& own, Real const* cells, bool four_points, Real* out) const;
  void add_second_differences(Field& field, Real factor, bool four_points);
  template <class F>
  void for_each_row_in_line(int l, int b, int axis, Field const& field, F&& f);

  CompositeMesh& mesh_;
  FourthOrderGhosts& ghosts_;
  CompositeAverage& average_;
};

/// The way from points to means and back by itself, without a solver.
class Means {
 public:
  /// Collective.
  explicit Means(std::shared_ptr<Hierarchy const> hierarchy) : mesh_(std::move(hierarchy), 0, {1, 1, 1}) {}
  Means(Means const&) = delete;
  Means& operator=(Means const&) = delete;

  void to_points(Field const& means, Field& points) { field_.to_points(means, points); }
  void to_means(Field const& points, Field& means) { field_.to_means(points, means); }

 private:
  CompositeMesh mesh_;
  CompositeAverage average_{mesh_};
  FourthOrderGhosts ghosts_{mesh_};
  FourthOrderField field_{mesh_, ghosts_, average_};
};

}  // namespace amrpic
