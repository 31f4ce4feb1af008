// From vectors of nodes to elements and back, as many elements at a time as a vector of the processor has lanes.
#pragma once

#include <vector>

#include "base/native_lanes.hpp"
#include "fem/basis.hpp"
#include "fem/points.hpp"

namespace amrpic::fem {

using V = NativeLanes;

/// One of `width` values of a block of points.
inline V of_block(Real const* values, std::int64_t block, int width = 1, int number = 0) {
  return load<V>(values + (block * width + number) * native_lane_count);
}

/// Two blocks of an element in one vector, in single precision. The last one of an odd number is there twice.
struct BlockPair {
  std::int64_t first, second;
};
inline NativeFloats of_block(Real const* values, BlockPair const& pair, int width = 1, int number = 0) {
  return joined(__builtin_convertvector(of_block(values, pair.first, width, number), HalfFloats),
                __builtin_convertvector(of_block(values, pair.second, width, number), HalfFloats));
}

/// A vector of what is known of a block, or of a pair.
template <class Block>
using VectorOf = decltype(of_block(nullptr, std::declval<Block>()));

/// Elements that are worked on together, a lane each. Lanes without an element repeat the first one, and are not read.
struct ElementGroup {
  LocalIndex const* element;  ///< among this rank's
  LocalIndex const* corner;   ///< of their first nodes, among their part's
  int count;                  ///< 1 to native_lane_count

  LocalIndex corner_of(int lane) const { return corner[lane < count ? lane : 0]; }
};

/// Values of their nodes, x fastest, component after component.
template <int P, int C>
struct GroupValues {
  static constexpr int nodes = P * P * P;
  alignas(cache_line) V value[C][nodes];
};

/// Call f(n, place of node n behind its element's first one).
template <int P, class F>
inline void for_each_node(Box const& nodes, F&& f) {
  std::ptrdiff_t const y = nodes.stride(1), z = nodes.stride(2);
  for (int k = 0, n = 0; k < P; ++k)
    for (int j = 0; j < P; ++j)
      for (int i = 0; i < P; ++i, ++n) f(n, i + y * j + z * k);
}

/// Values of a group from those of its part.
template <int P, int C>
void gather(Box const& nodes, ElementGroup const& group, Real const* dense, GroupValues<P, C>& out) {
  std::ptrdiff_t corner[native_lane_count];
  for (int l = 0; l < native_lane_count; ++l) corner[l] = group.corner_of(l);
  for_each_node<P>(nodes, [&](int n, std::ptrdiff_t at) {
    for (int c = 0; c < C; ++c)
      for (int l = 0; l < native_lane_count; ++l) out.value[c][n][l] = dense[C * (corner[l] + at) + c];
  });
}

/// They are added to those of its part, element after element, as these share nodes.
template <int P, int C>
void scatter(Box const& nodes, ElementGroup const& group, GroupValues<P, C> const& values, Real* dense) {
  for (int l = 0; l < group.count; ++l) {
    Real* const first = dense + C * std::ptrdiff_t(group.corner[l]);
    for_each_node<P>(nodes, [&](int n, std::ptrdiff_t at) {
      for (int c = 0; c < C; ++c) first[C * at + c] += values.value[c][n][l];
    });
  }
}

/// First value of the n-th line along an axis.
template <int P>
constexpr int line_start(int axis, int n) {
  return axis == 0 ? n * P : axis == 1 ? n / P * P * P + n % P : n;
}
template <int P>
constexpr int line_stride(int axis) {
  return axis == 0 ? 1 : axis == 1 ? P : P * P;
}

/// A matrix applied along the lines of all three axes, in place.
template <int P>
inline void transform(Matrix<P> const& m, V* values) {
  for (int axis = 0; axis < 3; ++axis) {
    int const stride = line_stride<P>(axis);
    for (int n = 0; n < P * P; ++n) {
      V* const line = values + line_start<P>(axis, n);
      V in[P];
      for (int l = 0; l < P; ++l) in[l] = line[l * stride];
      for (int i = 0; i < P; ++i) {
        V sum = m[i][0] * in[0];
        for (int l = 1; l < P; ++l) sum += m[i][l] * in[l];
        line[i * stride] = sum;
      }
    }
  }
}

/// Sum over some elements of each part of what `kernel` makes of a vector; of components C per node, own nodes. Where
/// the kernel reads nothing `u` is null, where it writes nothing `v` is. Collective.
///
/// kernel(element numbers, how many, values) works on a group in place: it turns values of nodes into what the elements
/// add to nodes.
template <int P, int C, class Kernel>
void sum_over_elements(Lattice const& lattice, std::vector<Points::Filled> const& elements, Real const* u, Real* v,
                       Kernel const& kernel) {
  BoxRegions const& regions = lattice.regions();
  std::vector<Real> halo_u, halo_v(Kernel::writes ? regions.halo_size() * C : 0), dense_u, dense_v;
  if (Kernel::reads) halo_u = regions.halo(C, u);
  if (Kernel::writes) std::fill_n(v, std::size_t(lattice.own_nodes()) * C, Real(0));
  for (std::size_t p = 0; p < lattice.parts().size(); ++p) {
    auto const& part = lattice.parts()[p];
    auto const& filled = elements[p];
    if (filled.element.empty()) continue;
    std::size_t const size = std::size_t(part.nodes.cells()) * C;
    if (Kernel::reads) dense_u.resize(size), regions.read(p, C, u, halo_u.data(), dense_u.data());
    if (Kernel::writes) dense_v.assign(size, 0);
    for (std::size_t e = 0; e < filled.element.size(); e += native_lane_count) {
      int const count = int(std::min<std::size_t>(native_lane_count, filled.element.size() - e));
      ElementGroup const group{&filled.element[e], &filled.corner[e], count};
      GroupValues<P, C> values;
      if (Kernel::reads) gather(part.nodes, group, dense_u.data(), values);
      kernel(group.element, group.count, values);
      if (Kernel::writes) scatter(part.nodes, group, values, dense_v.data());
    }
    if (Kernel::writes) regions.add(p, C, dense_v.data(), v, halo_v.data());
  }
  if (Kernel::writes) regions.fold(C, v, halo_v.data());
}

/// Over all elements with points.
template <int P, int C, class Kernel>
void sum_over_elements(Points const& points, Real const* u, Real* v, Kernel const& kernel) {
  sum_over_elements<P, C>(points.lattice(), points.filled(), u, v, kernel);
}

/// A kernel, whichever it is, for what does so much else that a call costs nothing.
template <int P, int C>
struct GroupKernel {
  void const* kernel;
  void (*call)(void const*, LocalIndex const*, int, GroupValues<P, C>&);

  template <class Kernel>
  static GroupKernel of(Kernel const& kernel) {
    return {&kernel, [](void const* own, LocalIndex const* elements, int count, GroupValues<P, C>& values) {
              (*static_cast<Kernel const*>(own))(elements, count, values);
            }};
  }
  void operator()(LocalIndex const* elements, int count, GroupValues<P, C>& values) const {
    call(kernel, elements, count, values);
  }
};

/// The matrix that a kernel has for one element: rows and columns are nodes, x fastest, component after component.
template <int P, int C>
void fill_matrix(GroupKernel<P, C> const& kernel, LocalIndex element, std::vector<Real>& matrix);

}  // namespace amrpic::fem
