#include "mesh/box_set.hpp"

#include <algorithm>

namespace amrpic {

namespace {

/// Join boxes that follow each other along an axis.
void join(std::vector<Box>& boxes, int axis, Seam const& seam) {
  auto const [u, v] = tangential_axes(axis);
  auto key = [&, u = u, v = v](Box const& b) {
    return std::array<int, 5>{b.lower[v], b.upper[v], b.lower[u], b.upper[u], b.lower[axis]};
  };
  std::sort(boxes.begin(), boxes.end(), [&](Box const& a, Box const& b) { return key(a) < key(b); });
  std::vector<Box> out;
  for (Box const& box : boxes) {
    if (!out.empty()) {
      Box wanted = out.back();  // what the neighbour would be
      wanted.lower[axis] = wanted.upper[axis] + 1;
      wanted.upper[axis] = box.upper[axis];
      if (wanted == box && !seam.lies_before(box.lower[axis])) {
        out.back().upper[axis] = box.upper[axis];
        continue;
      }
    }
    out.push_back(box);
  }
  boxes = std::move(out);
}

}  // namespace

std::vector<Box> joined(std::vector<Box> boxes, std::array<Seam, 3> const& seams) {
  for (std::size_t before = 0; before != boxes.size();) {
    before = boxes.size();
    for (int axis = 0; axis < 3; ++axis) join(boxes, axis, seams[axis]);
  }
  std::sort(boxes.begin(), boxes.end(), [](Box const& a, Box const& b) {
    return std::array<int, 3>{a.lower[2], a.lower[1], a.lower[0]} <
           std::array<int, 3>{b.lower[2], b.lower[1], b.lower[0]};
  });
  return boxes;
}

std::vector<Box> split(std::vector<Box> boxes, std::array<Seam, 3> const& seams) {
  for (int axis = 0; axis < 3; ++axis) {
    if (seams[axis].period == 0) continue;
    std::vector<Box> out;
    for (Box box : boxes) {
      for (int i = box.lower[axis] + 1; i <= box.upper[axis]; ++i)
        if (seams[axis].lies_before(i)) {
          Box before = box;
          before.upper[axis] = i - 1;
          box.lower[axis] = i;
          out.push_back(before);
        }
      out.push_back(box);
    }
    boxes = std::move(out);
  }
  return boxes;
}

std::vector<Box> without(std::vector<Box> const& boxes, Box const& hole) {
  std::vector<Box> out;
  for (Box rest : boxes) {
    if (rest.intersect(hole).empty()) {
      out.push_back(rest);
      continue;
    }
    for (int d = 0; d < 3; ++d) {
      Box below = rest, above = rest;
      below.upper[d] = hole.lower[d] - 1;
      above.lower[d] = hole.upper[d] + 1;
      if (!below.empty()) out.push_back(below);
      if (!above.empty()) out.push_back(above);
      rest.lower[d] = std::max(rest.lower[d], hole.lower[d]);
      rest.upper[d] = std::min(rest.upper[d], hole.upper[d]);
    }
  }
  return out;
}

}  // namespace amrpic
