#pragma once

#include "composite/coarse_fluxes.hpp"
#include "composite/composite_residual.hpp"
#include "kokkos/fits.hpp"
#include "kokkos/swept_level.hpp"

namespace amrpic::kokkos {

/// Values that are copied to places side by side: from those of a level, or, where `from` is ~(place), from what other
/// ranks sent; `stride` apart there.
struct CopiedRun {
  std::int32_t from, stride, to, count;
};

/// Ghosts behind a wall: before them the first of the cells, and the next ones inwards.
struct WallRun {
  std::int32_t cell, stride, inward, ghost, datum, count;
  std::int32_t face;  ///< 2 axis + side
};

/// A side of a box with coarser cells behind it, and the step to the next row of coarse values.
struct SideBehind {
  FineSide fine;
  std::int32_t plane_v;
};
/// One of its coarse faces: the first of the four cells and ghosts before it, the coarse value behind it, and where its
/// flux belongs.
struct CoarseFace {
  std::int32_t side, cell, ghost, plane, flux;
  std::int32_t fit;  ///< its number, or ~(that of the gap)
};

/// A coarse face that metal makes other than those with fits.
struct FaceBesideMetal {
  CoarseFace face;
  GhostsBesideMetal ghosts;
};

/// A cut cell: its equation, and where the values beyond its sides and the data of the surfaces there are.
struct CutCellPlace {
  enum class In : std::int8_t { cells, ghosts, fluxes, received_fluxes };
  std::int32_t cell, special;  ///< among those of the level, and of special rows
  CutRow row;
  std::array<In, 6> in;
  std::array<std::int32_t, 6> beyond;
  std::array<std::int32_t, 6> datum;  ///< an electrode, or ~(place) among those of walls
};

/// Where a box lies in a field, among the ghosts, and in a vector of the cycle.
struct CompositeBox {
  std::int32_t first;
  Index3 extent;
  std::array<std::int32_t, 6> ghosts;
  std::int32_t origin, pitch_y, pitch_z;
};
constexpr std::int32_t all_plain = -1, all_covered = -2;  ///< solid cells count as covered
enum class CellKind : char { plain, covered, cut };
struct CompositeRow {
  std::int32_t box, j, k;
  std::int32_t special;  ///< `all_plain`, `all_covered`, or where its cells begin among those of special rows
};
/// A face of an uncovered cell with a refined cell behind it; ~(place) of the flux: of what other ranks sent.
struct RefinedFace {
  std::int32_t flux;
  std::int32_t axis, side;
};
/// Parents side by side, and the first child of the first one.
struct ParentRun {
  std::int32_t parent, child, pitch_y, pitch_z, count;
};

/// Cells that others sent, or that are sent to them.
class RemoteBuffers {
 public:
  RemoteBuffers() = default;
  explicit RemoteBuffers(RemoteReads const& reads);
  Array<Real> const& sent() const { return sent_; }
  Array<Real> const& received() const { return received_; }
  /// Exchange them. Collective.
  void pass(RemoteReads const& reads) const;

 private:
  Array<Real> sent_, received_;
  Array<Real>::HostMirror host_sent_, host_received_;
};

/// The composite residual of a potential and its corrections, as SecondOrderResidual and CompositeAverage have them, by
/// kernels over all rows of a level.
class Composite {
 public:
  /// `levels`: those of the cycle, whose right-hand sides take residuals and whose corrections are added. All must
  /// outlive this.
  Composite(CompositeMesh& mesh, std::vector<SweptLevel*> levels);

  /// Take a charge density, the data of walls, and a potential averaged down, or zero, from the host.
  void start(Source const& source, Field& phi, bool is_zero);
  /// Bring the potential of the kernels to the host.
  void potential_to_host() const;
  /// And back.
  void potential_to_device() const;

  /// See CompositeLaplacian. Collective.
  Real residual(Background const& background, Norm norm, std::vector<Real> const& scale);
  Real add(Real scale);

  std::size_t bytes() const { return bytes_; }

  /// Take the data of walls anew from the host.
  void walls_changed();

  // Parts of `residual`, and what kernels read, public because CUDA wants it to be.
  void fill_ghosts(int l);
  void fill_ghosts_beside_metal(int l);
  void residuals_of_cut_cells(int l, Background const& background);
  Real residual_of_level(int l, Background const& background, Norm norm, Real factor, Real scale);
  /// The lists of a level.
  struct OnLevel {
    Array<CompositeBox> boxes;
    Array<CompositeRow> rows;
    Array<std::int32_t> first_refined;  ///< of the cells of special rows, and the end
    Array<CellKind> kind;               ///< of these cells
    Array<Real> of_cut;                 ///< residuals of cut ones among them; none where no cell is
    Array<RefinedFace> refined;
    Array<CopiedRun> neighbours, coarse;
    Array<WallRun> walls;
    Array<SideBehind> sides;
    Array<CoarseFace> faces;
    Array<FaceBesideMetal> beside_metal;
    Array<CutCellPlace> cuts;
    GapTerms gaps_coarse, gaps_fine;
    GapTerms metal_terms;  ///< at places among `planes`, or ~(electrode)
    Array<CopiedRun> sent_cells, sent_fluxes, received_means;
    Array<ParentRun> families, sent_means;  ///< of the coarser level
    Array<Real> ghosts, planes, fluxes;
    RemoteBuffers finer_fluxes, finer_means;
    Mirrored<Real> phi, rho, datum;
  };

 private:
  void plan_faces(int l, OnLevel& level, std::vector<CompositeBox>& boxes);
  void plan_rows(int l, OnLevel& level, std::vector<CompositeBox> const& boxes);
  CutCellPlace cut_cell(int l, int b, int k, CompositeMesh::CutHere const& here, CompositeBox const& box) const;
  void plan_exchanges(int l, OnLevel& level);
  template <class T>
  Array<T> listed(std::vector<T> const& values) {
    bytes_ += values.size() * sizeof(T);
    return on_device(values);
  }

  CompositeMesh& mesh_;
  std::vector<SweptLevel*> swept_;
  std::vector<OnLevel> levels_;
  RemoteBuffers cells_;
  Array<Real> potentials_;  ///< of electrodes
  NumberedFits fits_;
  std::size_t bytes_ = 0;
};

}  // namespace amrpic::kokkos
