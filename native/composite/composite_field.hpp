#pragma once

#include "composite/composite_average.hpp"
#include "composite/composite_ghosts.hpp"
#include "mesh/box_regions.hpp"
#include "mesh/electric_field.hpp"

namespace amrpic {

/// E from the differences of phi across the cells, with one flux through each face; see CompositeLaplacian.
class CompositeField {
 public:
  CompositeField(CompositeMesh& mesh, CompositeGhosts& ghosts)
      : mesh_(mesh), ghosts_(ghosts), planes_(2 * 3 * mesh.largest_face(2)), rows_(3 * mesh.largest_row()) {}

  ElectricField electric_field(std::shared_ptr<Field const> potential, std::vector<Walls> const& walls,
                               CoveredField covered);
  /// The same beside metal: components in all cells. Those of a cut cell are slopes of the parabolas through the
  /// surfaces at its arms; the first cells in metal go on as those before it do, for clouds that reach into them, and
  /// deeper there is none. Collective.
  ElectricField beside_metal(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& potentials,
                             CoveredField covered, CompositeAverage& average);

  std::size_t bytes() const { return (planes_.capacity() + rows_.capacity()) * sizeof(Real); }

 private:
  enum class Where { everywhere, at_faces };

  void continue_into_metal(int l, std::array<std::shared_ptr<Field>, 3> const& e);
  void field_plane(int l, int b, int k, Where where, Field const& phi, std::array<Real*, 3> const& e);
  void average_field(int l, int b, int k, Real* means);
  void send_means(int l, Real const* means);
  void take_means(int l, Real const* means, ElectricField& field);

  CompositeMesh& mesh_;
  CompositeGhosts& ghosts_;
  std::vector<Real> planes_;                         ///< of three components, of a pair of planes of cells
  std::vector<Real> rows_;                           ///< of means of these
  std::vector<std::unique_ptr<BoxRegions>> around_;  ///< of each level, beside metal; none until first used
};

}  // namespace amrpic
