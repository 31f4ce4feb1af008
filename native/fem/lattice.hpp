#pragma once

#include <memory>
#include <vector>

#include "mesh/box_regions.hpp"
#include "mesh/hierarchy.hpp"

namespace amrpic::fem {

/// The nodes of elements of one degree on the base cells of a hierarchy.
///
/// They are the cells of a level: box [l, u] of elements owns nodes [p l, p (u + 1) - 1], and at the domain's upper
/// faces those on them. So each node has one owner, who also has the element that it is the lowest node of; the
/// nodes on a box's upper faces are read from others through a halo. Vectors hold own nodes in the order of that level,
/// components of a node side by side.
class Lattice {
 public:
  Lattice(std::shared_ptr<Hierarchy const> hierarchy, int degree);

  Hierarchy const& hierarchy() const { return *hierarchy_; }
  std::shared_ptr<Hierarchy const> share_hierarchy() const { return hierarchy_; }
  Communicator const& comm() const { return hierarchy_->comm(); }
  Level const& elements() const { return hierarchy_->level(0); }
  Level const& nodes() const { return *nodes_; }
  std::shared_ptr<Level const> share_nodes() const { return nodes_; }
  /// The nodes of each part.
  BoxRegions const& regions() const { return regions_; }
  int degree() const { return degree_; }
  LocalIndex own_nodes() const { return nodes_->local_cells(); }

  /// One of this rank's boxes of elements.
  struct Part {
    Box elements;
    Box nodes;                 ///< of its elements, those on its upper faces too
    LocalIndex first_element;  ///< among this rank's
  };
  std::vector<Part> const& parts() const { return parts_; }

 private:
  std::shared_ptr<Hierarchy const> hierarchy_;
  int degree_;
  std::shared_ptr<Level const> nodes_;
  BoxRegions regions_;
  std::vector<Part> parts_;
};

}  // namespace amrpic::fem
