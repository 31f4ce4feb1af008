#include "fem/lattice.hpp"

#include <algorithm>
#include <utility>

namespace amrpic::fem {

namespace {

std::shared_ptr<Level const> nodes_of(Level const& elements, int degree) {
  Box domain = elements.domain();
  std::vector<Box> boxes = elements.boxes();
  auto const to_nodes = [&](Box& box) {
    for (int d = 0; d < 3; ++d) {
      bool const last = box.upper[d] == elements.domain().upper[d];
      box.lower[d] *= degree;
      box.upper[d] = (box.upper[d] + 1) * degree - (last ? 0 : 1);
    }
  };
  std::for_each(boxes.begin(), boxes.end(), to_nodes);
  to_nodes(domain);
  std::vector<int> first_box;
  for (int r = 0; r <= elements.ranks(); ++r) first_box.push_back(elements.first_box(r));
  Real3 spacing = elements.spacing();
  for (Real& h : spacing) h /= degree;
  return std::make_shared<Level const>(domain, std::array<bool, 3>{}, spacing, std::move(boxes), std::move(first_box),
                                       elements.rank());
}

Box nodes_of_elements(Box box, int degree) {
  for (int d = 0; d < 3; ++d) box.lower[d] *= degree, box.upper[d] = (box.upper[d] + 1) * degree;
  return box;
}

}  // namespace

Lattice::Lattice(std::shared_ptr<Hierarchy const> hierarchy, int degree)
    : hierarchy_(std::move(hierarchy)),
      degree_(degree),
      nodes_(nodes_of(elements(), degree)),
      regions_(
          comm(), *nodes_, *nodes_, [](Box const& owner) { return owner.grow(1); },
          [&](int b) { return nodes_of_elements(elements().box(b), degree_); }) {
  for (int b = elements().first_local_box(); b < elements().last_local_box(); ++b)
    parts_.push_back({elements().box(b), nodes_of_elements(elements().box(b), degree_), elements().local_offset(b)});
}

}  // namespace amrpic::fem
