#include "fem/node_regions.hpp"

#include <algorithm>
#include <numeric>

namespace amrpic::fem {

namespace {

/// Pointers to each component of a vector.
template <class T>
std::vector<T*> components_of(int components, T* first) {
  std::vector<T*> out;
  for (int c = 0; c < components; ++c) out.push_back(first + c);
  return out;
}

}  // namespace

NodeRegions::NodeRegions(Communicator const& comm, Level const& owners, Level const& readers,
                         std::function<Box(Box const&)> const& near, std::function<Box(int)> const& region)
    : owned_(owners.local_cells()) {
  auto const cut = [&](int b) { return region(b).intersect(owners.domain()); };
  CellReads reads(owners);
  reads.add(readers, near, [&](int b, auto&& read) { read(cut(b)); });
  halo_ = Halo(comm, reads);
  for (int b = readers.first_local_box(); b < readers.last_local_box(); ++b)
    parts_.push_back({cut(b), runs_of(halo_.places(owners, cut(b)).values())});
}

/// None passes from own nodes to the halo.
std::vector<NodeRegions::Run> NodeRegions::runs_of(std::vector<LocalIndex> const& places) const {
  std::vector<Run> out;
  for (std::size_t n = 0; n < places.size(); ++n) {
    bool const follows = !out.empty() && out.back().place + out.back().count == places[n] && places[n] != owned_;
    if (follows)
      ++out.back().count;
    else
      out.push_back({places[n], LocalIndex(n), 1});
  }
  return out;
}

std::vector<LocalIndex> NodeRegions::places(std::size_t part) const {
  std::vector<LocalIndex> out(std::size_t(parts_[part].region.cells()));
  for (Run const& run : parts_[part].runs)
    std::iota(out.begin() + run.offset, out.begin() + run.offset + run.count, run.place);
  return out;
}

void NodeRegions::read(std::size_t part, int components, Real const* own, Real const* halo, Real* dense) const {
  std::ptrdiff_t const width = components;
  for (Run const& run : parts_[part].runs) {
    Real const* const from = run.place < owned_ ? own + width * run.place : halo + width * (run.place - owned_);
    std::copy_n(from, width * run.count, dense + width * run.offset);
  }
}

void NodeRegions::add(std::size_t part, int components, Real const* dense, Real* own, Real* halo) const {
  std::ptrdiff_t const width = components;
  for (Run const& run : parts_[part].runs) {
    Real* const to = run.place < owned_ ? own + width * run.place : halo + width * (run.place - owned_);
    Real const* const from = dense + width * run.offset;
    for (std::ptrdiff_t n = 0; n < width * run.count; ++n) to[n] += from[n];
  }
}

void NodeRegions::update(int components, Real const* own, Real* halo) const {
  halo_.update(components_of(components, own), components_of(components, halo), components);
}

void NodeRegions::fold(int components, Real* own, Real const* halo) const {
  halo_.fold(components_of(components, own), components_of(components, halo), components);
}

}  // namespace amrpic::fem
