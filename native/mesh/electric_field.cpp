#include "mesh/electric_field.hpp"

#include <algorithm>
#include <cstdint>

#include "base/fetch.hpp"
#include "base/lanes.hpp"

namespace amrpic {

void write_cells(std::array<Real const*, 3> const& from, int count, Real* out) {
  bool const streams = reinterpret_cast<std::uintptr_t>(out) % sizeof(Lanes) == 0;
  int n = 0;
  for (; n + lane_count <= count; n += lane_count)
    for (Lanes const& part : packed(load<Lanes>(from[0] + n), load<Lanes>(from[1] + n), load<Lanes>(from[2] + n))) {
      streams ? stream(out, part) : store(out, part);
      out += lane_count;
    }
  for (; n < count; ++n)
    for (Real const* component : from) *out++ = component[n];
}

ElectricField::ElectricField(std::shared_ptr<Field const> potential, std::vector<Real3> factor)
    : hierarchy_(potential->share_hierarchy()), potential_(std::move(potential)) {
  lay_out_boundary();
  for (std::size_t l = 0; l < levels_.size(); ++l) levels_[l].factor = factor[l];
}

ElectricField::ElectricField(std::array<std::shared_ptr<Field const>, 3> components)
    : hierarchy_(components[0]->share_hierarchy()), components_(std::move(components)) {
  lay_out_boundary();
  for_each_plane([&](int l, int b, int k, std::ptrdiff_t place) {
    set_boundary(l, b, k,
                 {component(0).level(l).data() + place, component(1).level(l).data() + place,
                  component(2).level(l).data() + place});
  });
  stream_end();
}

void ElectricField::lay_out_boundary() {
  std::size_t all = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    BoundaryCells boundary(hierarchy_->faces(l));
    std::size_t const values = components_per_cell * std::size_t(boundary.cells());
    levels_.push_back({std::move(boundary), all, {0, 0, 0}});
    all += values;
  }
  boundary_values_.resize(all + 1);  // the last cell is read as a vector of four
}

/// Call f(level, box, plane, place of its first cell among the own ones of the level).
template <class F>
void ElectricField::for_each_plane(F&& f) const {
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    Level const& level = hierarchy_->level(l);
    for (int b = 0; b < level.last_local_box() - level.first_local_box(); ++b)
      for (int k = 0; k < box(l, b).extent(2); ++k)
        f(l, b, k, first_cell(l, b) + std::ptrdiff_t(k) * box(l, b).extent(0) * box(l, b).extent(1));
  }
}

void ElectricField::set_boundary(int level, int b, int k, std::array<Real const*, 3> const& plane) {
  std::ptrdiff_t const nx = box(level, b).extent(0);
  boundary(level).for_each_run(b, k, [&](BoundaryCells::CellRun const& run) {
    auto from = plane;
    for (Real const*& component : from) component += run.i + nx * run.j;
    Real* out = at_boundary(level) + components_per_cell * std::ptrdiff_t(run.number);
    if (run.axis == 0) return write_cells(from, run.count, out);
    fetch<Use::write>(out + page<Real>, components_per_cell * run.count);
    for (int n = 0; n < run.count; ++n)
      for (Real const* component : from) *out++ = component[n * nx];
  });
}

void ElectricField::write_plane(int level, int b, int k, std::array<Real*, 3> const& plane) const {
  std::ptrdiff_t const nx = box(level, b).extent(0), ny = box(level, b).extent(1), cells = nx * ny;
  std::ptrdiff_t const place = first_cell(level, b) + k * cells;
  if (!potential_) {
    for (int d = 0; d < 3; ++d) std::copy_n(component(d).level(level).data() + place, cells, plane[d]);
    return;
  }
  bool const has_inside = !boundary(level).is_whole(b) && k > 0 && k + 1 < box(level, b).extent(2);
  if (has_inside) {
    Real const* const phi = potential_->level(level).data() + place;
    std::ptrdiff_t const step[3] = {1, nx, cells};
    for (int d = 0; d < 3; ++d) {
      Real const *const below = phi - step[d], *const above = phi + step[d];
      Real const f = factor(level)[d];
      Real* __restrict const out = plane[d];
      for (std::ptrdiff_t n = nx; n < cells - nx; ++n) out[n] = field_between(f, below[n], above[n]);
    }
  }
  boundary(level).for_each_run(b, k, [&](BoundaryCells::CellRun const& run) {
    std::ptrdiff_t const first = run.i + nx * run.j, stride = run.axis == 0 ? 1 : nx;
    Real const* const from = at_boundary(level) + components_per_cell * std::ptrdiff_t(run.number);
    Real *const x = plane[0] + first, *const y = plane[1] + first, *const z = plane[2] + first;
    std::ptrdiff_t n = 0;
    for (; run.axis == 0 && n + lane_count <= run.count; n += lane_count) {
      Real const* const cells = from + components_per_cell * n;
      auto const e = unpacked({load<Lanes>(cells), load<Lanes>(cells + 8), load<Lanes>(cells + 16)});
      store(x + n, e[0]), store(y + n, e[1]), store(z + n, e[2]);
    }
    for (; n < run.count; ++n) {
      Real const* const cell = from + components_per_cell * n;
      x[n * stride] = cell[0], y[n * stride] = cell[1], z[n * stride] = cell[2];
    }
  });
}

void ElectricField::write_part(int level, int b, Box const& cells, Real* out) const {
  Box const& box = this->box(level, b);
  std::ptrdiff_t const step[3] = {box.stride(0), box.stride(1), box.stride(2)};
  auto const copy_boundary = [&](LocalIndex number, int count) {
    out = std::copy_n(at_boundary(level) + components_per_cell * std::ptrdiff_t(number), components_per_cell * count,
                      out);
  };
  for (int k = cells.lower[2]; k <= cells.upper[2]; ++k)
    for (int j = cells.lower[1]; j <= cells.upper[1]; ++j)
      for (int i = cells.lower[0], count = 1; i <= cells.upper[0]; i += count) {
        std::ptrdiff_t const place = first_cell(level, b) + box.offset({i, j, k});
        Index3 const from_lower{i - box.lower[0], j - box.lower[1], k - box.lower[2]};
        LocalIndex const number = potential_ ? boundary(level).number(b, from_lower) : -1;
        bool const in_row = j == box.lower[1] || j == box.upper[1] || k == box.lower[2] || k == box.upper[2];
        count = number >= 0 && (in_row || boundary(level).is_whole(b)) ? cells.upper[0] - i + 1 : 1;
        if (number >= 0) {
          copy_boundary(number, count);
        } else if (potential_) {
          Real const* phi = potential_->level(level).data() + place;
          count = std::min(cells.upper[0] + 1, box.upper[0]) - i;  // the last cell of a row is stored
          for (int n = 0; n < count; ++n, ++phi)
            for (int d = 0; d < 3; ++d) *out++ = field_between(factor(level)[d], phi[-step[d]], phi[step[d]]);
        } else {
          for (int d = 0; d < 3; ++d) *out++ = component(d).level(level)[std::size_t(place)];
        }
      }
}

void ElectricField::write(std::array<Field*, 3> const& components) const {
  for_each_plane([&](int l, int b, int k, std::ptrdiff_t place) {
    write_plane(l, b, k,
                {components[0]->level(l).data() + place, components[1]->level(l).data() + place,
                 components[2]->level(l).data() + place});
  });
}

}  // namespace amrpic
