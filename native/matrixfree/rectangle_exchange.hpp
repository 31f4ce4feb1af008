#pragma once

#include <mpi.h>

#include "matrixfree/layout.hpp"

namespace amrpic::matrixfree {

/// Some cells of one box of a level, and where a copy of them belongs.
struct Wanted {
  int box;    ///< number of the box on the level
  Box cells;  ///< in the indices of that box
  Placement copy;
};

/// The plan by which copies of cells are updated from the cells, whichever rank owns these, and are added to them. All
/// that passes between two ranks in a call is one message. Where all cells are in this rank's memory there is none.
class RectangleExchange {
 public:
  RectangleExchange() = default;

  /// `layout` holds the boxes of `level`. Collective, unless every rank holds the whole level.
  RectangleExchange(MPI_Comm comm, Level const& level, Layout const& layout, std::vector<Wanted> const& wanted);

  /// Fill the copies, which may lie in the vector of the cells. Collective.
  void update(float const* cells, float* copies) const {
    start(cells, copies);
    finish(copies);
    settle();
  }
  /// The same in three steps: after `start` the cells may change, after `finish` the copies are there, and after
  /// `settle` others have what this rank sent. Messages of other plans may pass meanwhile. Whoever computes in between
  /// calls `poll` at times, since messages may not move by themselves.
  void start(float const* cells, float* copies) const;
  void poll() const;
  void finish(float* copies) const;
  void settle() const;

  /// Add the copies to the cells. Collective.
  void add(float const* copies, float* cells) const;

  std::int64_t messages() const { return messages_; }  ///< sent by this rank so far
  std::int64_t bytes() const { return bytes_; }

 private:
  struct PackedBox {
    Index3 extent;
    Placement at, packed;  ///< in memory, and in the message
  };
  struct Neighbour {
    int rank;
    std::vector<PackedBox> boxes;
    std::size_t cells = 0;
    mutable std::vector<float> buffer;
  };
  struct Local {
    Index3 extent;
    Placement cells, copy;
  };
  static void pack(std::vector<Neighbour> const& neighbours, float const* values);
  void pass(std::vector<Neighbour> const& from, std::vector<Neighbour> const& to) const;

  MPI_Comm comm_ = MPI_COMM_NULL;
  std::vector<Local> local_;
  std::vector<Neighbour> sources_, readers_;
  mutable std::vector<MPI_Request> receiving_, sending_;
  mutable std::int64_t messages_ = 0, bytes_ = 0;
};

}  // namespace amrpic::matrixfree
