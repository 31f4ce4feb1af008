#include "fem/at_points.hpp"
#include "fem/degrees.hpp"
#include "fem/operators.hpp"

namespace amrpic::fem {

namespace {

struct ReadValues {
  static constexpr bool reads = true, writes = false, values = true, slopes = false;
  Real* out;  ///< blocks

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    for (int c = 0; c < C; ++c) store(out + (block * C + c) * native_lane_count, at.value[c]);
  }
};

struct ReadSlopes {
  static constexpr bool reads = true, writes = false, values = false, slopes = true;
  Real* out;
  Real3 scale;

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    for (int c = 0; c < C; ++c)
      for (int d = 0; d < 3; ++d)
        store(out + ((block * C + c) * 3 + d) * native_lane_count, at.slope[c][std::size_t(d)] * scale[std::size_t(d)]);
  }
};

struct WriteValues {
  static constexpr bool reads = false, writes = true, values = true, slopes = false;
  Points const& points;
  Real const* in;

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    V const weight = of_block(points.weights(), block);
    for (int c = 0; c < C; ++c) at.value[c] = weight * load<V>(in + (block * C + c) * native_lane_count);
  }
};

/// Blocks of `width` values for each point, which a kernel of make(blocks) writes.
template <class Make>
std::vector<Real> at_points(Points const& points, int components, int width, Real const* u, Make&& make) {
  std::vector<Real> blocks(std::size_t(points.blocks() * width * native_lane_count));
  with_shape(points.lattice().degree(), components, [&](auto nodes, auto of_node) {
    auto const d = make(blocks.data());
    AtPoints<nodes(), of_node(), std::decay_t<decltype(d)>> const kernel{points, d};
    sum_over_elements<nodes(), of_node()>(points, u, nullptr, kernel);
  });
  return points.unblocked(blocks.data(), width);
}

}  // namespace

std::vector<Real> values_at(Points const& points, int components, Real const* u) {
  return at_points(points, components, components, u, [](Real* out) { return ReadValues{out}; });
}

std::vector<Real> slopes_at(Points const& points, int components, Real const* u) {
  Real3 scale = points.lattice().elements().spacing();
  for (Real& h : scale) h = 2 / h;
  return at_points(points, components, 3 * components, u, [&](Real* out) { return ReadSlopes{out, scale}; });
}

std::vector<Real> integrals(Points const& points, int components, Real const* values) {
  auto const blocks = points.blocked(values, components);
  std::vector<Real> out(std::size_t(points.lattice().own_nodes()) * std::size_t(components));
  with_shape(points.lattice().degree(), components, [&](auto nodes, auto of_node) {
    AtPoints<nodes(), of_node(), WriteValues> const kernel{points, {points, blocks.data()}};
    sum_over_elements<nodes(), of_node()>(points, nullptr, out.data(), kernel);
  });
  return out;
}

}  // namespace amrpic::fem
