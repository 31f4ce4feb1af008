// What clouds smooth, given back to the field at particles: see `Compensation`.
#pragma once

#include <vector>

#include "mesh/electric_field.hpp"
#include "particle/density_places.hpp"
#include "particle/difference_rows.hpp"
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
  static constexpr int per_cell = lanes;

  /// Collective.
  Compensator(Compensation const& compensation, ParticleMesh& mesh, RemoteBricks const& remote, bool matched);

  /// The tiles that follow are those of a box of this rank; `rows`: where it holds particles, as long as they follow.
  /// `others_add_inside`: rows inside the box, in which there are no boundary cells but at the ends, get theirs
  /// otherwise.
  void begin(std::size_t slot, OccupiedRows const& rows, bool others_add_inside);
  /// Write a row inside the box, which starts at cell `row` of it, with what is added.
  void write_row(DifferenceRow const& phi, std::ptrdiff_t row, std::ptrdiff_t y, std::ptrdiff_t z, int count,
                 Real* out) const;
  /// Plane k of such a tile, later ones after earlier ones.
  void add_to_plane(int k, Tile<per_cell>& tile);
  /// The tile of clouds that are r levels coarser than their box.
  void add_to_coarse(std::size_t slot, std::size_t r, CoarseCells const& at, Tile<per_cell>& tile);
  /// The tile of a region of a remote brick.
  void add_to_remote(std::size_t brick, std::size_t region, Tile<per_cell>& tile);

 private:
  void begin(int level, Box const& tile, OccupiedRows const& rows);
  void fill_plane(int k);
  void fill_own_rows(int k);
  void bring_plane_near(int k) const;
  bool is_inside(int j, int k) const {
    return j >= inside_.lower[1] && j <= inside_.upper[1] && k >= inside_.lower[2] && k <= inside_.upper[2];
  }
  void fill_run(GhostRun const& run, int k);
  void interpolate_row(RowPart const& part, int j, int k, Real* out);
  void interpolate_whole_row(RowPart const& part, int j, int k, Real* out);
  void read_coarse();
  void add_to_whole(Tile<per_cell>& tile);
  void add(int k, Tile<per_cell>& tile);
  Real const* own() const {  ///< the density of the box
    return compensation_.density->level(level_).data() + hierarchy_.level(level_).local_offset(box_->box);
  }
  Real const& at(int level, LocalIndex place) const {
    auto const& own = compensation_.density->level(level);
    return place < LocalIndex(own.size()) ? own[std::size_t(place)]
                                          : halos_[std::size_t(level)][std::size_t(place) - own.size()];
  }
  /// Where the density in the first cell of a plane is. Of a box it is kept in so many planes at a time.
  static constexpr int planes_kept = 4;
  Real* cell(int i, int j, int k) {
    return plane(k) + (j - cells_.lower[1]) * cells_.stride(1) + (i - cells_.lower[0]);
  }
  Real* plane(int k) { return values_.data() + cells_.stride(2) * ((k - cells_.lower[2]) % planes_); }

  Compensation const& compensation_;
  bool matched_;
  Hierarchy const& hierarchy_;
  DensityPlaces const& places_;
  RemotePlan const& plan_;
  std::vector<std::vector<Real>> halos_;  ///< of each level
  std::vector<Real> remote_;              ///< in all regions
  // of the tile under way, or of the box whose slabs they are
  BoxGhosts const* box_ = nullptr;
  bool is_whole_ = false;  ///< see DensityPlaces
  int level_ = 0;
  NearRows near_tile_, near_;  ///< where the tile, and where the density is wanted
  int filled_ = 0;             ///< planes up to this one have been filled
  Box inside_;                 ///< cells of rows that get theirs otherwise
  Box cells_;                  ///< on which the density is kept
  int planes_ = 1;             ///< as many planes of them at a time
  std::vector<Real> values_;   ///< it
  bool has_coarse_ = false;    ///< whether what follows is of this box
  std::vector<Real> coarse_;   ///< the density of the coarser level on the parents of a box
  std::vector<Real> row_;      ///< of children of parents in a row
};

}  // namespace amrpic
