#pragma once

#include "cycle/coarsening.hpp"
#include "kokkos/interface_cells.hpp"
#include "kokkos/swept_level.hpp"

namespace amrpic::kokkos {

/// What passes between a level and the next coarser one: the acts of a cycle::Coarsening, each one kernel over all
/// rows.
class Coarsening {
 public:
  /// All must outlive this. Collective.
  Coarsening(Communicator const& comm, cycle::Coarsening& plan, SweptLevel& fine, SweptLevel& coarse);

  /// Leave the coarser level's right-hand side: see cycle::Coarsening. All are collective.
  void prepare_residual();
  void restrict_residual();
  void restrict_right_hand_side();

  bool has_gaps() const { return plan_.has_gaps(); }
  void start() { interface_.start(); }
  void refresh_gaps();

  /// Fetch the coarser correction, take its part of the ghosts into the finer right-hand side, and add it to the finer
  /// correction, or put it in its place.
  void prolong(cycle::Into into);

  std::size_t bytes() const;

  // Parts of the acts, and what kernels read, public because CUDA wants it to be.
  template <bool of_residual, bool with_metal>
  void restrict_rows();
  void prolong_rows(bool set);
  struct ParentRow {
    std::int32_t block, y, z;
  };
  struct Block {
    std::int32_t first_row, ny, nz;
  };
  struct Ghost {
    std::int32_t from, to;
    float factor;
  };
  struct Lists {
    Array<cycle::Parents> sources, taking;
    Array<ParentRow> parent_rows;
    Array<Block> blocks;
    Array<Ghost> ghosts;
  };

 private:
  void update_gaps();
  void add_to_coarse_level();
  Array<float> const& target() const;

  cycle::Coarsening& plan_;
  SweptLevel& fine_;
  SweptLevel& coarse_;
  Mirrored<float> values_;
  Lists lists_;
  CellCopies parents_, targets_of_residuals_;
  InterfaceCells interface_;
};

}  // namespace amrpic::kokkos
