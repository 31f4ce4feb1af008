#pragma once

#include <cstdint>
#include <map>
#include <tuple>
#include <vector>

#include "mesh/exchange.hpp"
#include "mesh/reads.hpp"

namespace amrpic {

/// Rectangles of values that boxes of this rank read of boxes of others: of cells, or of what their owners make of them
/// when they send.
///
/// All that passes between two ranks is one message.
class Imports {
 public:
  /// Values of a rectangle: the first, and the distances between neighbours along y and z.
  struct Values {
    std::int32_t from;
    std::int32_t pitch_y, pitch_z;
  };

  /// Add reads for a purpose of the caller's, a number of which there is one value per cell of their parts. Before
  /// `plan`, for the same purposes in the same order on all ranks.
  void add(int purpose, Reads const& reads);

  /// Once, after the last `add`. Local.
  void plan(Communicator const& comm);

  /// Where the values of a part of a read are among `values()`: the part lies in that of a region of a box that a box
  /// of another rank owns.
  Values find(int purpose, int reader, int region, int owner, Index3 const& shift, Box const& part) const;

  /// Begin to receive, and send what others read: pack(purpose, read, out) writes its values, x fastest; of several
  /// `fields` those of a cell side by side. Collective.
  template <class Pack>
  void start(Pack&& pack, std::size_t fields = 1) {
    exchange_.start([&](std::size_t n, Real* out) { pack(asked_[n].purpose, asked_[n].read, out); }, fields);
  }
  /// Wait for what others sent, and later for others to have what this rank sent. Collective.
  void finish() {
    exchange_.finish([this](std::size_t n, Real const* in) {
      if (n == 0) values_ = in;
    });
  }
  void settle() { exchange_.settle(); }

  /// Call f(purpose, read) for what is packed, in that order.
  template <class F>
  void for_each_asked(F&& f) const {
    for (Piece const& piece : asked_) f(piece.purpose, piece.read);
  }
  std::int32_t size() const { return size_; }  ///< of `values()`

  Real const* values() const { return values_; }

  std::size_t memory() const;  ///< of plan and buffers on this rank, in bytes

 private:
  struct Piece {
    int purpose;
    Read read;
  };
  using Key = std::tuple<int, int, int, int, Index3>;
  struct Place {
    std::int32_t from;
    Box part;
  };
  std::vector<Piece> asked_, wanted_;  ///< the latter until `plan`
  std::map<Key, Place> places_;
  Exchange<Real> exchange_;
  Real const* values_ = nullptr;
  std::int32_t size_ = 0;
};

/// The same reads in cells `ratio` times coarser.
Reads coarsened(Reads reads, Index3 const& ratio);

}  // namespace amrpic
