#pragma once

#include <mpi.h>

#include <cstdint>
#include <vector>

#include "mesh/box.hpp"

namespace amrpic {

/// A rectangle of numbers that another rank has: of the cells of a box, or of one of its faces.
struct Piece {
  int level, box;
  int face;  ///< 2 axis + side where it belongs to a face of the box, else -1
  Box part;  ///< in the indices of its level, or of its parents where the owner makes means or fluxes of it
};

/// The plan by which a rank reads pieces of what other ranks own.
///
/// All pieces that pass between two ranks are one message. The owner packs them when it sends, so that they may be
/// computed on the way.
class Imports {
 public:
  /// Plan to read a piece; returns its place in `values(owner)`, x fastest.
  std::int32_t ask(int owner, Piece const& piece);

  /// Tell the owners what is asked of them. Once, after the last `ask`. Collective.
  void connect(MPI_Comm comm);

  /// Begin to receive, and send what others ask for: pack(piece, out) writes the values of a piece, x fastest.
  template <class Pack>
  void start(Pack&& pack) {
    for (auto& n : readers_) {
      Real* out = n.values.data();
      for (Piece const& piece : n.pieces) {
        pack(piece, out);
        out += piece.part.cells();
      }
    }
    post();
  }

  /// Wait for what was started.
  void finish();

  Real const* values(int owner) const { return sources_[std::size_t(slot_[std::size_t(owner)])].values.data(); }

  std::int64_t messages() const { return messages_; }  ///< sent by this rank so far
  std::int64_t bytes() const { return bytes_; }
  std::size_t memory() const;  ///< of plan and buffers on this rank, in bytes

 private:
  struct Neighbour {
    int rank = 0;
    std::vector<Piece> pieces;
    std::vector<Real> values;
  };
  void post();

  MPI_Comm comm_ = MPI_COMM_NULL;
  std::vector<int> slot_;            ///< of each rank in `sources_`, or -1
  std::vector<Neighbour> sources_;   ///< ranks that own what this one reads
  std::vector<Neighbour> readers_;   ///< ranks that read what this one owns
  std::vector<std::int32_t> asked_;  ///< values asked of each source so far
  std::vector<MPI_Request> requests_;
  std::int64_t messages_ = 0, bytes_ = 0;
};

}  // namespace amrpic
