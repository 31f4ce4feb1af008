#include "mesh/integral.hpp"

namespace amrpic {

namespace {

/// Sum of value(n) for n < count: eight sums side by side, which do not wait for each other.
template <class Value>
Real sum(LocalIndex count, Value const& value) {
  constexpr int width = 8;
  Real parts[width] = {};
  LocalIndex n = 0;
  for (; n + width <= count; n += width)
    for (int i = 0; i < width; ++i) parts[i] += value(n + i);
  for (; n < count; ++n) parts[n % width] += value(n);
  for (int half = width / 2; half > 0; half /= 2)
    for (int i = 0; i < half; ++i) parts[i] += parts[i + half];
  return parts[0];
}

/// Integral over this rank's cells of all levels: `plane(level, box, k)`, all counted from its first one,
/// gives a function of the places of cells in a plane.
template <class Plane>
Real integral_on_rank(Hierarchy const& hierarchy, Plane const& plane) {
  Real total = 0;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    LevelFaces const& boxes = hierarchy.faces(l);
    Real on_level = 0;
    for (std::size_t b = 0; b < boxes.size(); ++b) {
      Box const& box = boxes[b].box;
      LocalIndex const cells = box.extent(0) * box.extent(1);
      bool const refined = !boxes[b].covered.empty();
      auto const covered = refined ? boxes[b].covered_cells() : ArrayOnBox<char>(Box{}, 0);
      for (int k = 0; k < box.extent(2); ++k) {
        auto const value = plane(l, int(b), k);
        auto const uncovered = [&](LocalIndex n) {
          return covered.values()[std::size_t(k * cells + n)] ? 0 : value(n);
        };
        on_level += refined ? sum(cells, uncovered) : sum(cells, value);
      }
    }
    total += hierarchy.level(l).cell_volume() * on_level;
  }
  return total;
}

/// Plane k of a box of a field.
Real const* plane_of(Field const& field, int l, int b, int k) {
  Level const& level = field.hierarchy().level(l);
  Box const& box = level.box(level.first_local_box() + b);
  return field.level(l).data() + level.local_offset(level.first_local_box() + b) + k * box.extent(0) * box.extent(1);
}

}  // namespace

Real integral(Field const& field) {
  return integral_on_rank(field.hierarchy(), [&](int l, int b, int k) {
    return [values = plane_of(field, l, b, k)](LocalIndex n) { return values[n]; };
  });
}

Real integral(Field const& one, Field const& other) {
  return integral_on_rank(one.hierarchy(), [&](int l, int b, int k) {
    return [first = plane_of(one, l, b, k), second = plane_of(other, l, b, k)](LocalIndex n) {
      return first[n] * second[n];
    };
  });
}

Real integral(Field const& one, Field const& other, std::vector<Real> const& weight) {
  return integral_on_rank(one.hierarchy(), [&](int l, int b, int k) {
    return [first = plane_of(one, l, b, k), second = plane_of(other, l, b, k),
            w = weight[std::size_t(l)]](LocalIndex n) { return first[n] * (second[n] + w * first[n]); };
  });
}

Real integral_of_square(ElectricField const& field) {
  std::array<std::vector<Real>, 3> values;
  return integral_on_rank(field.hierarchy(), [&](int l, int b, int k) {
    Level const& level = field.hierarchy().level(l);
    Box const& box = level.box(level.first_local_box() + b);
    for (auto& component : values) component.resize(std::size_t(box.extent(0)) * std::size_t(box.extent(1)));
    std::array<Real*, 3> const e{values[0].data(), values[1].data(), values[2].data()};
    field.write_plane(l, b, k, e);
    return [e](LocalIndex n) { return e[0][n] * e[0][n] + e[1][n] * e[1][n] + e[2][n] * e[2][n]; };
  });
}

}  // namespace amrpic
