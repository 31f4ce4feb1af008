#pragma once

#include <memory>
#include <vector>

#include "base/large_array.hpp"
#include "mesh/hierarchy.hpp"

namespace amrpic {

/// One number per cell of this rank, on every level; boxes contiguous, x fastest.
class Field {
 public:
  /// Zeros, or whatever memory holds, for callers that write all cells.
  explicit Field(std::shared_ptr<Hierarchy const> hierarchy, bool zero = true) : hierarchy_(std::move(hierarchy)) {
    for (int l = 0; l < hierarchy_->level_count(); ++l) {
      auto const cells = std::size_t(hierarchy_->level(l).local_cells());
      if (zero)
        values_.emplace_back(cells, 0.0);
      else
        values_.emplace_back().resize(cells);
    }
  }
  Hierarchy const& hierarchy() const { return *hierarchy_; }
  std::shared_ptr<Hierarchy const> share_hierarchy() const { return hierarchy_; }
  LargeArray<Real>& level(int l) { return values_[l]; }
  LargeArray<Real> const& level(int l) const { return values_[l]; }

 private:
  std::shared_ptr<Hierarchy const> hierarchy_;
  std::vector<LargeArray<Real>> values_;
};

}  // namespace amrpic
