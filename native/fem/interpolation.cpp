#include "fem/interpolation.hpp"

#include <algorithm>
#include <utility>

#include "fem/basis.hpp"

namespace amrpic::fem {

Interpolation::Interpolation(std::shared_ptr<Lattice const> fine, std::shared_ptr<Lattice const> corners)
    : fine_(std::move(fine)), corners_(std::move(corners)) {
  for (Real x : lobatto_nodes(fine_->degree())) share_.push_back((1 + x) / 2);
  share_.pop_back();
}

template <class F>
void Interpolation::for_each_weight(std::size_t part, F&& f) const {
  int const degree = fine_->degree();
  Level const& nodes = fine_->nodes();
  int const b = nodes.first_local_box() + int(part);
  Box const& corners = corners_->parts()[part].nodes;
  LocalIndex node = nodes.local_offset(b);
  for_each_cell(nodes.box(b), [&](Index3 const& at) {
    std::array<std::array<Real, 2>, 3> weight;
    Index3 lowest;
    for (std::size_t d = 0; d < 3; ++d) {
      Real const upper = share_[std::size_t(at[d] % degree)];
      lowest[d] = at[d] / degree;
      weight[d] = {1 - upper, upper};
    }
    for (int corner = 0; corner < 8; ++corner) {
      Index3 const side{corner & 1, corner >> 1 & 1, corner >> 2};
      Real product = 1;
      for (std::size_t d = 0; d < 3; ++d) product *= weight[d][std::size_t(side[d])];
      if (product > 0)  // there may be no element beyond a node on the upper faces
        f(node, corners.offset({lowest[0] + side[0], lowest[1] + side[1], lowest[2] + side[2]}), product);
    }
    ++node;
  });
}

std::vector<Real> Interpolation::at_corners(int components, Real const* fine) const {
  std::vector<Real> out;
  Level const &corners = corners_->nodes(), &nodes = fine_->nodes();
  for (int b = corners.first_local_box(); b < corners.last_local_box(); ++b)
    for_each_cell(corners.box(b), [&](Index3 at) {
      for (int& i : at) i *= fine_->degree();
      Real const* const value = fine + (nodes.local_offset(b) + nodes.box(b).offset(at)) * components;
      out.insert(out.end(), value, value + components);
    });
  return out;
}

void Interpolation::add(int components, Real const* corners, Real* fine) const {
  std::vector<Real> const halo = corners_->regions().halo(components, corners);
  std::vector<Real> dense;
  for (std::size_t p = 0; p < corners_->parts().size(); ++p) {
    auto const& part = corners_->parts()[p];
    dense.resize(std::size_t(part.nodes.cells()) * std::size_t(components));
    corners_->regions().read(p, components, corners, halo.data(), dense.data());
    for_each_weight(p, [&](LocalIndex node, GlobalIndex corner, Real weight) {
      for (int c = 0; c < components; ++c)
        fine[std::ptrdiff_t(node) * components + c] += weight * dense[std::size_t(corner * components + c)];
    });
  }
}

void Interpolation::transposed(int components, Real const* fine, Real* corners) const {
  std::vector<Real> halo(corners_->regions().halo_size() * std::size_t(components), 0), dense;
  std::fill_n(corners, std::size_t(corners_->own_nodes()) * std::size_t(components), Real(0));
  for (std::size_t p = 0; p < corners_->parts().size(); ++p) {
    auto const& part = corners_->parts()[p];
    dense.assign(std::size_t(part.nodes.cells()) * std::size_t(components), 0);
    for_each_weight(p, [&](LocalIndex node, GlobalIndex corner, Real weight) {
      for (int c = 0; c < components; ++c)
        dense[std::size_t(corner * components + c)] += weight * fine[std::ptrdiff_t(node) * components + c];
    });
    corners_->regions().add(p, components, dense.data(), corners, halo.data());
  }
  corners_->regions().fold(components, corners, halo.data());
}

}  // namespace amrpic::fem
