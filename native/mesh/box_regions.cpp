#include "mesh/box_regions.hpp"

#include <algorithm>
#include <numeric>

namespace amrpic {

namespace {

/// Pointers to each component of a vector.
template <class T>
std::vector<T*> components_of(int components, T* first) {
  std::vector<T*> out;
  for (int c = 0; c < components; ++c) out.push_back(first + c);
  return out;
}

}  // namespace

BoxRegions::BoxRegions(Communicator const& comm, Level const& owners, Level const& readers,
                       std::function<Box(Box const&)> const& near, std::function<Box(int)> const& region) {
  CellReads reads(owners);
  reads.add(readers, near, [&](int b, auto&& read) { read(region(b)); });
  halo_ = Halo(comm, reads);
  for (int b = readers.first_local_box(); b < readers.last_local_box(); ++b)
    parts_.push_back({region(b), runs_of(owners, region(b))});
}

/// None passes from own cells to the halo. The halo is in the order of numbers, as own cells are.
std::vector<BoxRegions::Run> BoxRegions::runs_of(Level const& owners, Box const& region) const {
  std::vector<Run> out;
  owners.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
    for_each_row(owners, b, part, shift, [&](GlobalIndex first, LocalIndex count, Index3 const& cell) {
      LocalIndex const place = halo_.local(first), offset = LocalIndex(region.offset(cell));
      bool const follows = !out.empty() && out.back().place + out.back().count == place &&
                           out.back().offset + out.back().count == offset && place != halo_.owned();
      if (follows)
        out.back().count += count;
      else
        out.push_back({place, offset, count});
    });
  });
  return out;
}

std::vector<LocalIndex> BoxRegions::places(std::size_t part) const {
  std::vector<LocalIndex> out(std::size_t(parts_[part].region.cells()), no_place);
  for (Run const& run : parts_[part].runs)
    std::iota(out.begin() + run.offset, out.begin() + run.offset + run.count, run.place);
  return out;
}

void BoxRegions::read(std::size_t part, int components, Real const* own, Real const* halo, Real* dense) const {
  std::ptrdiff_t const width = components, owned = halo_.owned();
  for (Run const& run : parts_[part].runs) {
    Real const* const from = run.place < owned ? own + width * run.place : halo + width * (run.place - owned);
    std::copy_n(from, width * run.count, dense + width * run.offset);
  }
}

ArrayOnBox<Real> BoxRegions::values(std::size_t part, Real const* own, std::vector<Real> const& halo) const {
  ArrayOnBox<Real> out(region(part), 0);
  read(part, 1, own, halo.data(), out.values().data());
  return out;
}

void BoxRegions::add(std::size_t part, int components, Real const* dense, Real* own, Real* halo) const {
  std::ptrdiff_t const width = components, owned = halo_.owned();
  for (Run const& run : parts_[part].runs) {
    Real* const to = run.place < owned ? own + width * run.place : halo + width * (run.place - owned);
    Real const* const from = dense + width * run.offset;
    for (std::ptrdiff_t n = 0; n < width * run.count; ++n) to[n] += from[n];
  }
}

std::vector<Real> BoxRegions::halo(int components, Real const* own) const {
  std::vector<Real> out(halo_size() * std::size_t(components));
  halo_.update(components_of(components, own), components_of(components, out.data()), components);
  return out;
}

void BoxRegions::fold(int components, Real* own, Real const* halo) const {
  halo_.fold(components_of(components, own), components_of(components, halo), components);
}

}  // namespace amrpic
