#pragma once

#include <memory>
#include <vector>

#include "fem/block_rows.hpp"
#include "solver/point_equations.hpp"

namespace amrpic {

/// A symmetric V-cycle for rows of degree 1 by MueLu's smoothed aggregates.
class NodeAggregates {
 public:
  /// `rigid`: what makes no stress are translations and rotations, else translations alone. Collective.
  NodeAggregates(Communicator const& comm, fem::NodeBlocks const& blocks, bool rigid);
  ~NodeAggregates();

  /// z near the solution of A z = r, which is zero where unknowns are fixed. Collective.
  void apply(std::vector<Real> const& r, std::vector<Real>& z);

 private:
  struct Library;
  std::unique_ptr<Library> library_;
};

}  // namespace amrpic
