#pragma once

#include <memory>
#include <vector>

#include "fem/block_rows.hpp"
#include "solver/chebyshev.hpp"

namespace amrpic {

/// Numbers in (-1/2, 1/2) without order, for each of this rank's unknowns, that depend on nodes' places alone.
std::vector<Real> disordered(Level const& nodes, int components);

/// The solve on the coarsest level: every rank gathers the whole matrix and factors it, L D L' without pivoting.
///
/// Pivots that are not positive, as an indefinite matrix has, are taken by their size, so that the answer is that of a
/// positive matrix near by. Unknowns whose pivots vanish are left zero.
class DenseBottom {
 public:
  /// Collective.
  DenseBottom(Communicator const& comm, fem::NodeBlocks const& blocks);

  /// x near the solution of A x = b, for this rank's unknowns. Collective.
  void solve(std::vector<Real> const& b, std::vector<Real>& x);

 private:
  Communicator comm_;
  std::size_t size_, first_;
  std::vector<int> counts_, starts_;
  std::vector<Real> factor_, inverse_pivot_, whole_;  ///< rows of L below the diagonal
};

/// A symmetric V-cycle for rows of degree 1: half as many bricks along each axis on each level, Galerkin products, and
/// Chebyshev's iteration with the diagonal.
class NodeLevels {
 public:
  /// Collective.
  NodeLevels(Communicator const& comm, fem::NodeBlocks blocks);

  /// z near the solution of A z = r; both are zero where unknowns are fixed. Collective.
  void apply(std::vector<Real> const& r, std::vector<Real>& z) { cycle(0, r, z); }

 private:
  struct Level {
    int components;
    std::vector<Real> free;
    fem::BlockRows rows;
    std::unique_ptr<Chebyshev> smoother;
    std::unique_ptr<fem::Halving> to_coarser;
    std::vector<Real> coarse_r, coarse_z;
  };
  void cycle(std::size_t level, std::vector<Real> const& r, std::vector<Real>& z);

  std::vector<std::unique_ptr<Level>> levels_;
  std::unique_ptr<DenseBottom> bottom_;
};

}  // namespace amrpic
