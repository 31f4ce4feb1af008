#pragma once

#include <utility>

#include "base/communicator.hpp"
#include "cycle/rectangle_exchange.hpp"
#include "kokkos/arrays.hpp"

namespace amrpic::kokkos {

/// Which values are copied where, or added up there: each place that takes some, and whence these come.
class Gather {
 public:
  Gather() = default;
  /// Pairs (to, from). Those of one place are added in their order if it `adds_up`; else they are the same value, and
  /// the first one is taken.
  Gather(std::vector<std::pair<std::int32_t, std::int32_t>> pairs, bool adds_up);

  void set(Array<float> const& from, Array<float> const& to) const { run(from, to, false); }
  void add(Array<float> const& from, Array<float> const& to) const { run(from, to, true); }
  std::size_t bytes() const { return (to_.extent(0) + first_.extent(0) + from_.extent(0)) * sizeof(std::int32_t); }

  /// The act of both, public because CUDA wants members with kernels to be.
  void run(Array<float> const& from, Array<float> const& to, bool add) const;

 private:
  Array<std::int32_t> to_, first_, from_;
};

/// A RectangleExchange whose values are packed and unpacked by kernels, in one of its two directions; what passes
/// between ranks goes by the host, and directly, without relays.
class CellCopies {
 public:
  enum class Use { update, add };
  CellCopies() = default;
  CellCopies(Communicator const& comm, cycle::RectangleExchange const& plan, Use use);

  /// Fill the copies. Collective.
  void update(Array<float> const& cells, Array<float> const& copies) const;
  /// Add the copies to the cells. Collective.
  void add(Array<float> const& copies, Array<float> const& cells) const;

  std::size_t bytes() const;

 private:
  /// What passes in one direction.
  struct Side {
    std::vector<std::size_t> first, values;  ///< of each parcel
    Array<float> buffer;
    Array<float>::HostMirror host;
  };
  static Side side(std::vector<Parcel> const& parcels);
  Gather local_, pack_, unpack_;
  Side sent_, received_;
  Exchange<float> exchange_;
};

}  // namespace amrpic::kokkos
