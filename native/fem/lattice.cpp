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

/// `places` as runs; none passes from own nodes to the halo.
std::vector<Lattice::Run> runs_of(std::vector<LocalIndex> const& places, LocalIndex owned) {
  std::vector<Lattice::Run> out;
  for (std::size_t n = 0; n < places.size(); ++n) {
    bool const follows = !out.empty() && out.back().place + out.back().count == places[n] && places[n] != owned;
    if (follows)
      ++out.back().count;
    else
      out.push_back({places[n], LocalIndex(n), 1});
  }
  return out;
}

/// Pointers to each component of a vector.
template <class T>
std::vector<T*> components_of(int components, T* first) {
  std::vector<T*> out;
  for (int c = 0; c < components; ++c) out.push_back(first + c);
  return out;
}

}  // namespace

Lattice::Lattice(std::shared_ptr<Hierarchy const> hierarchy, int degree)
    : hierarchy_(std::move(hierarchy)), degree_(degree), nodes_(nodes_of(elements(), degree)) {
  CellReads reads(*nodes_);
  reads.add(
      *nodes_, [](Box const& owner) { return owner.grow(1); },
      [&](int b, auto&& read) { read(nodes_of_elements(elements().box(b), degree_)); });
  halo_ = Halo(comm(), reads);
  for (int b = elements().first_local_box(); b < elements().last_local_box(); ++b) {
    Box const nodes = nodes_of_elements(elements().box(b), degree_);
    parts_.push_back({elements().box(b), nodes, runs_of(halo_.places(*nodes_, nodes).values(), own_nodes()),
                      elements().local_offset(b)});
  }
}

void Lattice::read(Part const& part, int components, Real const* own, Real const* halo, Real* dense) const {
  for (Run const& run : part.runs) {
    Real const* const from =
        run.place < own_nodes() ? own + components * run.place : halo + components * (run.place - own_nodes());
    std::copy_n(from, components * run.count, dense + components * run.offset);
  }
}

void Lattice::add(Part const& part, int components, Real const* dense, Real* own, Real* halo) const {
  for (Run const& run : part.runs) {
    Real* const to =
        run.place < own_nodes() ? own + components * run.place : halo + components * (run.place - own_nodes());
    Real const* const from = dense + components * run.offset;
    for (LocalIndex n = 0; n < components * run.count; ++n) to[n] += from[n];
  }
}

void Lattice::update(int components, Real const* own, Real* halo) const {
  halo_.update(components_of(components, own), components_of(components, halo), components);
}

void Lattice::fold(int components, Real* own, Real const* halo) const {
  halo_.fold(components_of(components, own), components_of(components, halo), components);
}

}  // namespace amrpic::fem
