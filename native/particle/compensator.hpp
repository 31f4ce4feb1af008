// What clouds smooth, given back to the field at particles: see `Compensation`.
#pragma once

#include <vector>

#include "mesh/electric_field.hpp"
#include "particle/density_places.hpp"
#include "particle/occupied_rows.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/tile.hpp"

namespace amrpic {

/// Adds a compensation to tiles of the field: three components per cell and one of padding.
///
/// In each tile it is the difference of the density on the tile's own level, in covered cells too. A cloud, and the
/// cells on both sides of it, lie on that level as a whole but for own-level clouds within two cells of a coarse-fine
/// face. So there is no force of a particle on itself in it, as on a uniform mesh.
class Compensator {
 public:
  static constexpr int per_cell = 4;

  /// Collective.
  Compensator(Compensation const& compensation, ParticleMesh& mesh, RemoteBricks const& remote, bool matched);

  /// The tiles that follow are those of a box of this rank; `rows`: where it holds particles.
  void begin(std::size_t slot, OccupiedRows rows);
  /// `precedes`: the tile's first planes are those of the slab before, which have theirs.
  void add_to_slab(Box const& slab, bool precedes, Tile<per_cell>& tile);
  /// The tile of clouds that are r levels coarser than their box.
  void add_to_coarse(std::size_t slot, std::size_t r, CoarseCells const& at, Tile<per_cell>& tile);
  /// The tile of a window of a remote brick.
  void add_to_remote(std::size_t brick, std::size_t window, Tile<per_cell>& tile);

 private:
  void fill_plane(int k);
  void fill_run(GhostRun const& run);
  RowPart const& near(int j) const { return near_[std::size_t(j - cells_.lower[1])]; }
  Real interpolated_at(Index3 const& cell) const;
  void add(int level, OccupiedRows const& rows, int first, int last, Tile<per_cell>& tile) const;
  void reset(Box const& tile);
  Real const& at(int level, LocalIndex place) const {
    auto const& own = compensation_.density->level(level);
    return place < LocalIndex(own.size()) ? own[std::size_t(place)]
                                          : halos_[std::size_t(level)][std::size_t(place) - own.size()];
  }

  Compensation const& compensation_;
  bool matched_;
  Hierarchy const& hierarchy_;
  DensityPlaces const& places_;
  RemotePlan const& plan_;
  std::vector<std::vector<Real>> halos_;  ///< of each level
  std::vector<Real> remote_;              ///< in all windows
  // of the tile under way, or of the box whose slabs they are
  BoxGhosts const* box_ = nullptr;
  OccupiedRows rows_;
  std::vector<RowPart> near_;  ///< of the rows of the plane under way, what is near particles
  int filled_ = 0;             ///< planes of `values_` up to this one are filled
  Box cells_;                  ///< on which `values_` are
  std::vector<Real> values_;   ///< the density
};

}  // namespace amrpic
