// Lines against a closed surface of triangles.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/types.hpp"

namespace amrpic {

/// Where lines cross triangles, line by line.
struct LineCrossings {
  std::vector<std::int64_t> line;
  std::vector<Real> parameter;      ///< of the line
  std::vector<std::int64_t> depth;  ///< by how much the number of surfaces around the line rises there
  std::vector<std::int64_t> triangle;
  std::vector<std::int64_t> grazing;  ///< lines that pass an edge within rounding
};

/// Triangles in a hierarchy of boxes. Each counts `weight` times; seen from outside its corners go counter-clockwise.
class Triangles {
 public:
  using Corners = std::array<Real3, 3>;

  Triangles(std::vector<Corners> corners, std::vector<int> weight);

  /// Where lines start + parameter * direction, `count` of them (x, y, z each), cross the triangles. A line through an
  /// edge or a corner counts as one that is shifted by less than rounding, the same way for all triangles: over a
  /// closed surface the depths of a line sum up to zero. Numbers of a line depend on nothing else.
  LineCrossings crossings(Real const* start, Real const* direction, std::int64_t count) const;

 private:
  struct Node {
    Real3 lower, upper;
    int first;  ///< triangle of a leaf; else number of the second child, the first one follows
    int count;  ///< of triangles in a leaf; 0 elsewhere
  };
  int build(int first, int last);

  std::vector<Corners> corners_;
  std::vector<int> weight_;
  std::vector<int> order_;  ///< triangles, leaf by leaf
  std::vector<Node> nodes_;
  Real margin_ = 0;    ///< of boxes
  Real rounding_ = 0;  ///< of places
};

}  // namespace amrpic
