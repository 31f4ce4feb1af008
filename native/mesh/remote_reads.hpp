#pragma once

#include <algorithm>
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
class RemoteReads {
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

  /// Begin to receive, and send what others read: pack(purpose, read, out) writes its values, `fields` for each cell.
  /// Collective.
  template <class Pack>
  void start(Pack&& pack, std::size_t fields = 1) const {
    exchange_.start([&](std::size_t n, Real* out) { pack(asked_[n].purpose, asked_[n].read, out); }, fields);
  }
  /// Wait for what others sent, and later for others to have what this rank sent. Collective.
  void finish() const {
    exchange_.finish([this](std::size_t n, Real const* in) {
      if (n == 0) values_ = in;
    });
  }
  void settle() const { exchange_.settle(); }

  /// The other way round: `values`, as `values()` has them, go to those who own what they were read of, where
  /// unpack(purpose, read, in) takes them. Collective.
  template <class Unpack>
  void fold(Real const* values, Unpack&& unpack) const {
    exchange_.fold([&](std::size_t n, Real* out) { std::copy(values + first_[n], values + first_[n + 1], out); },
                   [&](std::size_t n, Real const* in) { unpack(asked_[n].purpose, asked_[n].read, in); });
  }

  /// Call f(purpose, read) for what is packed, in that order.
  template <class F>
  void for_each_asked(F&& f) const {
    for (Piece const& piece : asked_) f(piece.purpose, piece.read);
  }
  std::int32_t size() const { return first_.back(); }  ///< of `values()`

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
  mutable Real const* values_ = nullptr;
  std::vector<std::int32_t> first_{0};  ///< of the values of each read; then how many there are
};

/// The same reads in cells `ratio` times coarser.
Reads coarsened(Reads reads, Index3 const& ratio);

}  // namespace amrpic
