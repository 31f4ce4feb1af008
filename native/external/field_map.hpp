// Fields on a regular grid, in coordinates of their own: x, y, z, or r, z around the axis.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "external/cavities.hpp"

namespace amrpic::external {

/// Nodes along one axis, with more of them outside the first and the last place that count.
struct Nodes {
  Real lower, spacing;    ///< the first place that counts, m
  std::ptrdiff_t cells;   ///< from there to the last place
  std::ptrdiff_t before;  ///< nodes before the first place
  std::ptrdiff_t stride;  ///< values from one node to the next

  Real upper() const { return lower + Real(cells) * spacing; }
  bool contains(Real x) const { return x >= lower && x <= upper(); }
};

/// The four nodes around a place and their weights: the cubic convolution of R. G. Keys (IEEE Trans. ASSP 29, 1153
/// (1981)) with a = -1/2. It is exact for parabolas, its error of third order, its slope continuous.
struct Cubic {
  std::ptrdiff_t first;  ///< in values
  std::array<Real, 4> weight;

  Cubic(Nodes const& nodes, Real x) {
    Real const u = (x - nodes.lower) / nodes.spacing;
    std::ptrdiff_t const cell = std::min(std::max(std::ptrdiff_t(u), std::ptrdiff_t(0)), nodes.cells - 1);
    Real const s = u - Real(cell), t = 1 - s;
    first = (cell + nodes.before - 1) * nodes.stride;
    weight = {-s * t * t / 2, t * (2 + 2 * s - 3 * s * s) / 2, s * (2 + 2 * t - 3 * t * t) / 2, -t * s * s / 2};
  }
};

constexpr std::ptrdiff_t values_per_node = 4;
typedef std::vector<Real> MapValues;

/// The field of a map: zero outside its nodes.
struct FieldMap {
  bool axisymmetric;
  std::array<Nodes, 3> axes;              ///< x, y, z; or r, one of no importance, z
  std::shared_ptr<MapValues const> E, B;  ///< three components per node, and a zero; or null
  Real scale;
  Oscillation oscillation;

  static constexpr bool has_edges = false;
  static constexpr bool is_hard() { return false; }
  bool electric() const { return E != nullptr; }
  bool magnetic() const { return B != nullptr; }
};

/// The interpolated components of one kind. Lines of nodes along y are one node for maps of r and z.
inline Real3 interpolated(FieldMap const& map, MapValues const& values, Cubic const& x, Cubic const& y,
                          Cubic const& z) {
  HalfLanes out{};
  int const rows = map.axisymmetric ? 1 : 4;
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < rows; ++j) {
      Real const* const line = values.data() + x.first + i * map.axes[0].stride +
                               (map.axisymmetric ? 0 : y.first + j * map.axes[1].stride) + z.first;
      HalfLanes along_z{};
      for (int k = 0; k < 4; ++k) along_z += z.weight[std::size_t(k)] * load<HalfLanes>(line + k * map.axes[2].stride);
      out +=
          (map.axisymmetric ? x.weight[std::size_t(i)] : x.weight[std::size_t(i)] * y.weight[std::size_t(j)]) * along_z;
    }
  return {out[0], out[1], out[2]};
}

/// Of components along r, φ, z those along x, y, z.
inline Real3 turned(Real3 const& of, Real cosine, Real sine) {
  return {of[0] * cosine - of[1] * sine, of[0] * sine + of[1] * cosine, of[2]};
}

inline Fields<Real> field(FieldMap const& map, Vector3<Real> const& at, Real time) {
  Real const r = std::sqrt(at[0] * at[0] + at[1] * at[1]);
  Real3 const place = map.axisymmetric ? Real3{r, map.axes[1].lower, at[2]} : at;
  for (std::size_t d = 0; d < 3; ++d)
    if (!map.axes[d].contains(place[d])) return {};
  Cubic const x(map.axes[0], place[0]), y(map.axes[1], place[1]), z(map.axes[2], place[2]);
  Real const cosine = r > 0 ? at[0] / r : 1, sine = r > 0 ? at[1] / r : 0;
  auto const of = [&](std::shared_ptr<MapValues const> const& values, Real factor) {
    if (!values) return Real3{};
    Real3 const here = scaled(factor, interpolated(map, *values, x, y, z));
    return map.axisymmetric ? turned(here, cosine, sine) : here;
  };
  return {of(map.E, map.scale * map.oscillation.of_E(time)), of(map.B, map.scale * map.oscillation.of_B(time))};
}

/// Eight places one by one: what is read lies here and there.
template <class T>
Fields<Lanes> field(FieldMap const& map, Vector3<Lanes> const& at, T const& time) {
  Real values[6][lane_count];
  for (int i = 0; i < lane_count; ++i) {
    auto const one = field(map, Vector3<Real>{at[0][i], at[1][i], at[2][i]}, lane(time, i));
    for (std::size_t d = 0; d < 3; ++d) values[d][i] = one.E[d], values[3 + d][i] = one.B[d];
  }
  return {{load<Lanes>(values[0]), load<Lanes>(values[1]), load<Lanes>(values[2])},
          {load<Lanes>(values[3]), load<Lanes>(values[4]), load<Lanes>(values[5])}};
}

}  // namespace amrpic::external
