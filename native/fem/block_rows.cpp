#include "fem/block_rows.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "base/native_lanes.hpp"

namespace amrpic::fem {

namespace {

/// The nodes that coincide with coarser ones have an even number, or are the last.
struct Parents {
  Index3 lowest;                              ///< of them
  std::array<std::array<Real, 2>, 3> weight;  ///< along each axis, of the lowest and of the next one
};

int halved(int node, int last) { return node == last ? (last + 1) / 2 : node / 2; }

Parents parents_of(Index3 const& at, Box const& domain) {
  Parents out;
  for (std::size_t d = 0; d < 3; ++d) {
    out.lowest[d] = halved(at[d], domain.upper[d]);
    bool const coincides = at[d] % 2 == 0 || at[d] == domain.upper[d];
    out.weight[d] = coincides ? std::array<Real, 2>{1, 0} : std::array<Real, 2>{Real(0.5), Real(0.5)};
  }
  return out;
}

/// Call f(parent, weight) for each.
template <class F>
void for_each_parent(Index3 const& at, Box const& domain, F&& f) {
  Parents const parents = parents_of(at, domain);
  for (int n = 0; n < 8; ++n) {
    Index3 const side{n & 1, n >> 1 & 1, n >> 2};
    Real weight = 1;
    Index3 parent;
    for (std::size_t d = 0; d < 3; ++d) {
      weight *= parents.weight[d][std::size_t(side[d])];
      parent[d] = parents.lowest[d] + side[d];
    }
    if (weight > 0) f(parent, weight);
  }
}

/// Coarser nodes that coincide with those of a box; there may be none.
Box coarse_box(Box const& box, Box const& domain) {
  Box out;
  for (std::size_t d = 0; d < 3; ++d)
    out.lower[d] = (box.lower[d] + 1) / 2, out.upper[d] = halved(box.upper[d], domain.upper[d]);
  return out;
}

std::shared_ptr<Level const> coarse_level(Level const& fine) {
  std::vector<Box> boxes;
  std::vector<int> first_box;
  for (int rank = 0; rank < fine.ranks(); ++rank) {
    first_box.push_back(int(boxes.size()));
    for (int b = fine.first_box(rank); b < fine.first_box(rank + 1); ++b)
      if (Box const box = coarse_box(fine.box(b), fine.domain()); !box.empty()) boxes.push_back(box);
  }
  first_box.push_back(int(boxes.size()));
  Real3 spacing = fine.spacing();
  for (Real& h : spacing) h *= 2;
  return std::make_shared<Level const>(coarse_box(fine.domain(), fine.domain()), std::array<bool, 3>{}, spacing,
                                       std::move(boxes), std::move(first_box), fine.rank());
}

/// The parents of a finer box's nodes.
Box parents_box(Box box, Box const& domain) {
  for (std::size_t d = 0; d < 3; ++d)
    box.lower[d] /= 2, box.upper[d] = std::min((box.upper[d] + 1) / 2, (domain.upper[d] + 1) / 2);
  return box;
}

BoxRegions around(Communicator const& comm, Level const& nodes) {
  return {comm, nodes, nodes, [](Box const& box) { return box.grow(1); },
          [&](int b) { return nodes.cut_at_walls(nodes.box(b).grow(1)); }};
}

/// Which of its 27 neighbours a node has at an offset.
int neighbour(Index3 const& by) { return by[0] + 1 + 3 * (by[1] + 1 + 3 * (by[2] + 1)); }
Index3 offset_of(int neighbour) { return {neighbour % 3 - 1, neighbour / 3 % 3 - 1, neighbour / 9 - 1}; }
Index3 difference(Index3 const& a, Index3 const& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

/// Zeros in rows and columns of fixed unknowns. Collective.
void mask(Communicator const& comm, NodeBlocks& blocks) {
  int const components = blocks.components;
  Level const& nodes = *blocks.nodes;
  BoxRegions const regions = around(comm, nodes);
  std::vector<Real> const halo = regions.halo(components, blocks.free.data());
  std::vector<Real> dense;
  Real* entry = blocks.value.data();
  std::size_t own = 0;
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - nodes.first_local_box());
    Box const& region = regions.region(part);
    dense.resize(std::size_t(region.cells()) * std::size_t(components));
    regions.read(part, components, blocks.free.data(), halo.data(), dense.data());
    for_each_cell(nodes.box(b), [&](Index3 const& at) {
      Real const* const rows = &blocks.free[own++ * std::size_t(components)];
      for (int n = 0; n < stencil; ++n) {
        Index3 const by = offset_of(n), other{at[0] + by[0], at[1] + by[1], at[2] + by[2]};
        Real const* const columns =
            region.contains(other) ? &dense[std::size_t(region.offset(other) * components)] : nullptr;
        for (int r = 0; r < components; ++r)
          for (int c = 0; c < components; ++c, ++entry)
            if (!columns || rows[r] == 0 || columns[c] == 0) *entry = 0;
      }
    });
  }
}

}  // namespace

NodeBlocks node_blocks(Operator const& a, std::vector<Real> free) {
  Lattice const& lattice = a.points().lattice();
  int const components = a.components();
  NodeBlocks out{lattice.share_nodes(), components, std::move(free), {}};
  BoxRegions const& regions = lattice.regions();
  std::size_t const width = out.width(), own = std::size_t(lattice.own_nodes()) * width;
  out.value.assign(own + regions.halo_size() * width, 0);
  std::vector<LocalIndex> places;
  std::size_t part = lattice.parts().size();
  a.for_each_element_matrix([&](std::size_t p, LocalIndex corner, std::vector<Real> const& matrix) {
    Box const& nodes = lattice.parts()[p].nodes;
    if (p != part) places = regions.places(p), part = p;
    for (int i = 0; i < 8; ++i) {
      Index3 const at{i & 1, i >> 1 & 1, i >> 2};
      auto const node = std::size_t(corner + at[0] + at[1] * nodes.stride(1) + at[2] * nodes.stride(2));
      Real* const blocks = &out.value[std::size_t(places[node]) * width];
      for (int j = 0; j < 8; ++j) {
        int const n = neighbour(difference({j & 1, j >> 1 & 1, j >> 2}, at));
        for (int r = 0; r < components; ++r)
          for (int c = 0; c < components; ++c)
            blocks[std::size_t((n * components + r) * components + c)] +=
                matrix[std::size_t((r * 8 + i) * 8 * components + c * 8 + j)];
      }
    }
  });
  regions.fold(int(width), out.value.data(), out.value.data() + own);
  out.value.resize(own);
  mask(lattice.comm(), out);
  return out;
}

// ---- to coarser bricks ----

Halving::Halving(Communicator const& comm, std::shared_ptr<Level const> fine)
    : comm_(comm),
      fine_(std::move(fine)),
      coarse_(coarse_level(*fine_)),
      parents_(
          comm, *coarse_, *fine_,
          [](Box const& box) {
            return box.refine({2, 2, 2}).grow(2);
          },
          [&](int b) { return parents_box(fine_->box(b), fine_->domain()); }) {}

template <class F>
void Halving::for_each_own(std::size_t part, F&& f) const {
  int const b = fine_->first_local_box() + int(part);
  std::size_t node = std::size_t(fine_->local_offset(b));
  for_each_cell(fine_->box(b), [&](Index3 const& at) { f(node++, at); });
}

std::vector<Real> Halving::at_coarse(int components, std::vector<Real> const& fine) const {
  std::vector<Real> out;
  for (int b = fine_->first_local_box(); b < fine_->last_local_box(); ++b)
    for_each_cell(coarse_box(fine_->box(b), fine_->domain()), [&](Index3 at) {
      for (std::size_t d = 0; d < 3; ++d) at[d] = std::min(2 * at[d], fine_->domain().upper[d]);
      auto const node = std::size_t(fine_->local_offset(b)) + std::size_t(fine_->box(b).offset(at));
      for (int c = 0; c < components; ++c) out.push_back(fine[node * std::size_t(components) + std::size_t(c)]);
    });
  return out;
}

NodeBlocks Halving::galerkin(NodeBlocks const& a) const {
  int const components = a.components;
  std::size_t const width = a.width(), block = std::size_t(components * components);
  NodeBlocks out{coarse_, components, at_coarse(components, a.free), {}};
  out.value.assign(std::size_t(coarse_->local_cells()) * width, 0);
  std::vector<Real> halo(parents_.halo_size() * width, 0), dense, columns;
  Box const& domain = fine_->domain();
  for (int b = fine_->first_local_box(); b < fine_->last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - fine_->first_local_box());
    Box const& region = parents_.region(part);
    dense.assign(std::size_t(region.cells()) * width, 0);
    for_each_own(part, [&](std::size_t node, Index3 const& at) {
      // The row times P: on the parents of the node's neighbours, which are near the node's lowest parent.
      Index3 const lowest = parents_of(at, domain).lowest;
      constexpr int reach = 4;  // from one below the lowest parent to two above
      columns.assign(reach * reach * reach * block, 0);
      for (int n = 0; n < stencil; ++n) {
        Index3 const by = offset_of(n), other{at[0] + by[0], at[1] + by[1], at[2] + by[2]};
        if (!domain.contains(other)) continue;
        Real const* const entries = &a.value[node * width + std::size_t(n) * block];
        for_each_parent(other, domain, [&](Index3 const& parent, Real weight) {
          Index3 const from = difference(parent, lowest);
          Real* const to = &columns[std::size_t(from[0] + 1 + reach * (from[1] + 1 + reach * (from[2] + 1))) * block];
          for (std::size_t e = 0; e < block; ++e) to[e] += weight * entries[e];
        });
      }
      for_each_parent(at, domain, [&](Index3 const& parent, Real weight) {
        Index3 const up = difference(parent, lowest);
        Real* to = &dense[std::size_t(region.offset(parent)) * width];
        for (int n = 0; n < stencil; ++n) {
          Index3 const by = offset_of(n);
          int const x = up[0] + by[0] + 1, y = up[1] + by[1] + 1, z = up[2] + by[2] + 1;
          Real const* const from = &columns[std::size_t(x + reach * (y + reach * z)) * block];
          for (std::size_t e = 0; e < block; ++e) *to++ += weight * from[e];
        }
      });
    });
    parents_.add(part, int(width), dense.data(), out.value.data(), halo.data());
  }
  parents_.fold(int(width), out.value.data(), halo.data());
  mask(comm_, out);
  return out;
}

void Halving::add(int components, Real const* coarse, Real* fine) const {
  std::vector<Real> const halo = parents_.halo(components, coarse);
  std::vector<Real> dense;
  for (int b = fine_->first_local_box(); b < fine_->last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - fine_->first_local_box());
    Box const& region = parents_.region(part);
    dense.resize(std::size_t(region.cells() * components));
    parents_.read(part, components, coarse, halo.data(), dense.data());
    for_each_own(part, [&](std::size_t node, Index3 const& at) {
      for_each_parent(at, fine_->domain(), [&](Index3 const& parent, Real weight) {
        for (int c = 0; c < components; ++c)
          fine[node * std::size_t(components) + std::size_t(c)] +=
              weight * dense[std::size_t(region.offset(parent) * components + c)];
      });
    });
  }
}

void Halving::transposed(int components, Real const* fine, Real* coarse) const {
  std::vector<Real> halo(parents_.halo_size() * std::size_t(components), 0), dense;
  std::fill_n(coarse, std::size_t(coarse_->local_cells()) * std::size_t(components), Real(0));
  for (int b = fine_->first_local_box(); b < fine_->last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - fine_->first_local_box());
    Box const& region = parents_.region(part);
    dense.assign(std::size_t(region.cells() * components), 0);
    for_each_own(part, [&](std::size_t node, Index3 const& at) {
      for_each_parent(at, fine_->domain(), [&](Index3 const& parent, Real weight) {
        for (int c = 0; c < components; ++c)
          dense[std::size_t(region.offset(parent) * components + c)] +=
              weight * fine[node * std::size_t(components) + std::size_t(c)];
      });
    });
    parents_.add(part, components, dense.data(), coarse, halo.data());
  }
  parents_.fold(components, coarse, halo.data());
}

// ---- products ----

BlockRows::BlockRows(Communicator const& comm, NodeBlocks blocks)
    : nodes_(blocks.nodes), components_(blocks.components), around_(around(comm, *nodes_)) {
  std::size_t const width = blocks.width(), c = std::size_t(components_);
  diagonal_.reserve(blocks.free.size());
  Real largest = std::numeric_limits<Real>::min();
  for (std::size_t node = 0; node < std::size_t(nodes_->local_cells()); ++node)
    for (std::size_t r = 0; r < c; ++r) {
      diagonal_.push_back(blocks.value[node * width + (stencil / 2 * c + r) * c + r]);
      largest = std::max(largest, diagonal_.back());
    }
  scale_ = std::exp2(std::ilogb(largest));
  std::size_t groups = 0;
  for (int b = nodes_->first_local_box(); b < nodes_->last_local_box(); ++b)
    for_each_plane(nodes_->box(b), [&](Box const&, Box const&, std::ptrdiff_t, std::size_t count) { groups += count; });
  by_group_.assign(groups * width * native_lane_count, 0);
  Real const* entry = blocks.value.data();
  groups = 0;
  for (int b = nodes_->first_local_box(); b < nodes_->last_local_box(); ++b)
    for_each_plane(nodes_->box(b), [&](Box const& plane, Box const& whole, std::ptrdiff_t first, std::size_t count) {
      for_each_cell(plane, [&](Index3 const& at) {
        std::size_t const n = std::size_t(whole.offset(at) - first), lane = n % native_lane_count;
        float* const out = &by_group_[(groups + n / native_lane_count) * width * native_lane_count + lane];
        for (std::size_t e = 0; e < width; ++e) out[e * native_lane_count] = float(*entry++ / scale_);
      });
      groups += count;
    });
}

template <class F>
void BlockRows::for_each_plane(Box const& box, F&& f) {
  Box const whole = box.grow(1);
  for (int k = box.lower[2]; k <= box.upper[2]; ++k) {
    Box const plane{{box.lower[0], box.lower[1], k}, {box.upper[0], box.upper[1], k}};
    auto const first = std::ptrdiff_t(whole.offset(plane.lower)), last = std::ptrdiff_t(whole.offset(plane.upper));
    f(plane, whole, first, std::size_t(last - first) / native_lane_count + 1);
  }
}

void BlockRows::apply(Real const* u, Real* v) const {
  if (components_ == 1)
    apply_as<1>(u, v);
  else
    apply_as<3>(u, v);
}

template <int C>
void BlockRows::apply_as(Real const* u, Real* v) const {
  std::vector<Real> const halo = around_.halo(C, u);
  std::vector<Real> dense, by_component, sums;
  float const* entry = by_group_.data();
  for (int b = nodes_->first_local_box(); b < nodes_->last_local_box(); ++b) {
    std::size_t const part = std::size_t(b - nodes_->first_local_box());
    Box const& region = around_.region(part);
    dense.resize(std::size_t(region.cells()) * C);
    around_.read(part, C, u, halo.data(), dense.data());
    Box const grown = nodes_->box(b).grow(1);  // beyond the walls zeros, and behind the end a group's
    std::size_t const count = std::size_t(grown.cells()) + native_lane_count;
    by_component.assign(C * count, 0);
    Real const* from = dense.data();
    for_each_cell(region, [&](Index3 const& at) {
      for (int c = 0; c < C; ++c) by_component[std::size_t(c) * count + std::size_t(grown.offset(at))] = *from++;
    });
    for_each_plane(nodes_->box(b), [&](Box const& plane, Box const& whole, std::ptrdiff_t first, std::size_t groups) {
      sums.resize(C * groups * native_lane_count);
      for (std::size_t g = 0; g < groups; ++g) {
        Real const* const x = &by_component[std::size_t(first) + g * native_lane_count];
        NativeLanes sum[C][C] = {};
        for (int n = 0; n < stencil; ++n) {
          Index3 const by = offset_of(n);
          std::ptrdiff_t const shift = by[0] + by[1] * whole.stride(1) + by[2] * whole.stride(2);
          NativeLanes there[C];
          for (int c = 0; c < C; ++c) there[c] = load<NativeLanes>(x + std::ptrdiff_t(std::size_t(c) * count) + shift);
          for (int r = 0; r < C; ++r)
            for (int c = 0; c < C; ++c, entry += native_lane_count)
              sum[r][c] += __builtin_convertvector(load<HalfFloats>(entry), NativeLanes) * there[c];
        }
        for (int r = 0; r < C; ++r) {
          NativeLanes row = sum[r][0];
          for (int c = 1; c < C; ++c) row += sum[r][c];
          store(&sums[(std::size_t(r) * groups + g) * native_lane_count], row * scale_);
        }
      }
      for_each_cell(plane, [&](Index3 const& at) {
        for (std::size_t r = 0; r < C; ++r)
          *v++ = sums[r * groups * native_lane_count + std::size_t(whole.offset(at) - first)];
      });
    });
  }
}

}  // namespace amrpic::fem
