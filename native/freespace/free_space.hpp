// The potential of charges in free space by the 7-point operator: what an open wall needs.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "base/communicator.hpp"
#include "freespace/tree_potential.hpp"

namespace amrpic::freespace {

/// A place where the potential is wanted: the centre of a ghost cell of its level, behind one wall.
struct PointTarget {
  Point position;
  int level;
};

/// Potential phi of -Laplace phi = charge density on the infinite lattice: about q / (4 pi r), with 0 at infinity.
///
/// All functions are collective. Results depend on how the charges are distributed only by rounding.
class FreeSpace {
 public:
  FreeSpace(Communicator const& comm, Lattice const& lattice, Options const& options = {});
  Lattice const& lattice() const { return lattice_; }

  /// The charges of the uncovered cells of this rank. One exchange: which leaves there are, with their moments.
  void set_charges(std::vector<PointCharge> const& local);
  void set_charges(std::vector<ChargeBox> const& local);

  /// Potential at the ghost centres of the base level behind each open wall, face = 2 * axis + side, lower of the two
  /// axes fastest; empty for walls that are not open. The same on all ranks, which share the work.
  std::array<std::vector<double>, 6> wall_planes(std::array<bool, 6> const& open) const;

  /// Potential at this rank's targets. All ranks share the work.
  std::vector<double> potential(std::vector<PointTarget> const& local) const;

 private:
  void build_tree();
  std::vector<double> ghosts(std::vector<GhostBlock> const& blocks) const;
  double scale() const;  ///< of 4 pi times the potential, lengths in units of the smallest spacing

  Communicator comm_;
  Lattice lattice_;
  Options options_;
  ChargeTree charges_;
  std::unique_ptr<TreePotential const> evaluate_;
};

}  // namespace amrpic::freespace
