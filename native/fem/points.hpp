#pragma once

#include <memory>
#include <vector>

#include "base/large_array.hpp"
#include "fem/lattice.hpp"

namespace amrpic::fem {

/// Allocates from a cache line on, so that no vector of the processor is read from two of them; what is freed goes back
/// to the system, as numbers of points change from step to step.
template <class T>
struct BlockAllocator : CacheLines<T> {
  BlockAllocator() = default;
  template <class U>
  BlockAllocator(BlockAllocator<U> const&) {}

  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(cache_line))); }
  void deallocate(T* block, std::size_t) { ::operator delete(block, std::align_val_t(cache_line)); }
};

/// Values of blocks of points, as in `Points::blocked`.
using BlockValues = std::vector<Real, BlockAllocator<Real>>;

/// The integration points of this rank's elements, sorted by element.
///
/// Kernels take as many points of an element at a time as a vector holds. So the points of an element fill whole blocks
/// of that many, the last one up with points at its centre that weigh nothing.
class Points {
 public:
  /// `element`, ascending: the element of each point among this rank's; `reference` (x, y, z each): where it lies in
  /// it, from -1 to 1. `gauss`: they are Gauss's points of all elements, degree + 1 along each axis, x fastest.
  Points(std::shared_ptr<Lattice const> lattice, std::vector<LocalIndex> const& element, Real const* reference,
         Real const* weight, bool gauss);

  /// The same points, which are kept once, for nodes of another degree on the same elements.
  Points(std::shared_ptr<Lattice const> lattice, Points const& same);

  Lattice const& lattice() const { return *lattice_; }
  std::shared_ptr<Lattice const> share_lattice() const { return lattice_; }
  bool gauss() const { return gauss_; }
  std::int64_t count() const { return sorted_->first_point.back(); }
  /// Points of a block: [first_point(b), first_point(b + 1)).
  std::int64_t first_point(std::int64_t block) const { return sorted_->first_point[std::size_t(block)]; }

  /// Blocks of an element: [first_block(e), first_block(e + 1)).
  std::int64_t first_block(LocalIndex element) const { return sorted_->first_block[std::size_t(element)]; }
  std::int64_t blocks() const { return sorted_->first_block.back(); }
  Real const* places() const { return sorted_->place.data(); }    ///< of each block all x, all y, all z
  Real const* weights() const { return sorted_->weight.data(); }  ///< of each block

  /// For each part of the lattice: its elements that have points, and where their first nodes are among the part's.
  struct Filled {
    std::vector<LocalIndex> element, corner;
  };
  std::vector<Filled> const& filled() const { return filled_; }

  /// Values of all points, `width` of each, as blocks: of each block the first value of all its lanes, and so on. Zeros
  /// in lanes without a point.
  BlockValues blocked(Real const* values, int width) const;
  std::vector<Real> unblocked(Real const* values, int width) const;  ///< the opposite

  std::size_t bytes() const;  ///< on this rank

 private:
  struct Sorted {
    std::vector<std::int64_t> first_point;  ///< blocks + 1 values
    std::vector<std::int64_t> first_block;  ///< elements + 1 values
    BlockValues place, weight;
  };
  /// Call f(point, place of its first value among blocks of so many values).
  template <class F>
  void for_each_point(int width, F&& f) const;

  std::shared_ptr<Lattice const> lattice_;
  bool gauss_;
  std::shared_ptr<Sorted const> sorted_;
  std::vector<Filled> filled_;
};

}  // namespace amrpic::fem
