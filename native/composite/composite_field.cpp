#include "composite/composite_field.hpp"

#include <algorithm>

#include "base/fetch.hpp"
#include "base/lanes.hpp"
#include "mesh/means.hpp"

namespace amrpic {

namespace {

constexpr int children = 8;  ///< of a cell
constexpr std::ptrdiff_t width = ElectricField::components_per_cell;

}  // namespace

/// Set the field in plane k of a box, whose components there are `e`: in all cells, or in those at faces of the box.
void CompositeField::field_plane(int l, int b, int k, Where where, Field const& phi, std::array<Real*, 3> const& e) {
  Box const& own = mesh_.box(l, b);
  int const nx = own.extent(0), ny = own.extent(1), nz = own.extent(2);
  std::ptrdiff_t const plane = std::ptrdiff_t(nx) * ny;
  Real const* const cells = phi.level(l).data() + mesh_.offset(l, b);
  Real3 factor;
  for (int d = 0; d < 3; ++d) factor[d] = mesh_.factor_of_field(l, d);
  for (int j = 0; j < ny; ++j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    Real const* const c = cells + k * plane + at;
    fetch<Use::read>(c + plane + page<Real>, nx);
    auto difference = [&](int d, Real const* below, Real const* above, int first, int last) {
      Real* __restrict out = e[d] + at;
      for (int i = first; i < last; ++i) out[i] = field_between(factor[d], below[i], above[i]);
    };
    std::size_t const end = std::size_t(j) + std::size_t(k) * std::size_t(ny);
    auto set = [&](int first, int last) {
      difference(0, c - 1, c + 1, std::max(first, 1), std::min(last, nx - 1));
      if (first == 0) e[0][at] = field_between(factor[0], ghosts_.ghosts(0, 0)[end], c[1]);
      if (last == nx) e[0][at + nx - 1] = field_between(factor[0], c[nx - 2], ghosts_.ghosts(0, 1)[end]);
      difference(1, j > 0 ? c - nx : ghosts_.ghosts(1, 0) + std::ptrdiff_t(k) * nx,
                 j + 1 < ny ? c + nx : ghosts_.ghosts(1, 1) + std::ptrdiff_t(k) * nx, first, last);
      difference(2, k > 0 ? c - plane : ghosts_.ghosts(2, 0) + at, k + 1 < nz ? c + plane : ghosts_.ghosts(2, 1) + at,
                 first, last);
    };
    if (where == Where::everywhere || j == 0 || j + 1 == ny || k == 0 || k + 1 == nz) {
      set(0, nx);
    } else {
      set(0, 1);
      set(nx - 1, nx);
    }
  }
  ghosts_.for_each_refined(l, b, k, cells, [&](std::ptrdiff_t at, int axis, int side, Real excess) {
    e[axis][at - k * plane] += (side == 0 ? factor[axis] : -factor[axis]) * excess;
  });
}

/// Send other ranks the means of a level's cells, box by box, that belong to covered cells of theirs.
void CompositeField::send_means(int l, Real const* means) {
  mesh_.transfer().families(l - 1).means.start(
      [&](int, Read const& read, Real* out) {
        Box const parents = mesh_.level(l).box(read.owner).coarsen(refinement_ratio), part = read.cells();
        Real const* const first = means + width * (mesh_.level(l).local_offset(read.owner) / children);
        for_each_row(part, [&](Index3 const& of_row) {
          out = std::copy_n(first + width * parents.offset(of_row), width * part.extent(0), out);
        });
      },
      std::size_t(width));
}

/// Give the means of a level's cells to the covered cells of the coarser level, all cells of whose boxes are boundary
/// cells.
void CompositeField::take_means(int l, Real const* means, ElectricField& field) {
  Families const& families = mesh_.transfer().families(l - 1);
  auto const at_boundary = [&](LocalIndex place) {
    return field.at_boundary(l - 1) + width * field.boundary(l - 1).number(place);
  };
  auto const give = [&](Real const* from, Index3 const& pitch, auto const& to) {
    Real* const first = at_boundary(to.parent);
    for (int k = 0; k < to.parents[2]; ++k)
      for (int j = 0; j < to.parents[1]; ++j)
        std::copy_n(from + width * (j * std::ptrdiff_t(pitch[1]) + k * std::ptrdiff_t(pitch[2])), width * to.parents[0],
                    first + width * (j * std::ptrdiff_t(to.pitch_y) + k * std::ptrdiff_t(to.pitch_z)));
  };
  for (int b = 0; b < mesh_.boxes(l); ++b)
    for (Family const& family : families.of_box[std::size_t(b)]) {
      Index3 const pitch = mesh_.box(l, b).coarsen(refinement_ratio).strides();
      Real const* from = means + width * (mesh_.offset(l, b) / children);
      for (int d = 0; d < 3; ++d) from += width * (family.child[d] / 2) * pitch[d];
      give(from, pitch, family);
    }
  families.means.finish();
  for (RemoteFamily const& family : families.remote)
    give(families.means.values() + width * family.from, {1, family.parents[0], family.parents[0] * family.parents[1]},
         family);
}

/// Set the means of planes k and k + 1 of a box, which are under way, box by box.
void CompositeField::average_field(int l, int b, int k, Real* means) {
  Box const parents = mesh_.box(l, b).coarsen(refinement_ratio);
  std::ptrdiff_t const nx = parents.extent(0), plane = nx * parents.extent(1);
  Real* to = means + ElectricField::components_per_cell * (mesh_.offset(l, b) / children + k / 2 * plane);
  std::array<Real*, 3> const row{rows_.data(), rows_.data() + nx, rows_.data() + 2 * nx};
  for (int j = 0; j < parents.extent(1); ++j, to += ElectricField::components_per_cell * nx) {
    for (int d = 0; d < 3; ++d)
      average_children(int(nx), planes_.data() + 2 * d * 4 * plane + 4 * j * nx, 2 * nx, 4 * plane, row[d]);
    write_cells({row[0], row[1], row[2]}, int(nx), to);
  }
}

ElectricField CompositeField::electric_field(std::shared_ptr<Field const> potential, std::vector<Walls> const& walls,
                                             CoveredField covered) {
  Field const& phi = *potential;
  std::vector<Real3> factor(std::size_t(mesh_.levels()));
  for (std::size_t l = 0; l < factor.size(); ++l)
    for (int d = 0; d < 3; ++d) factor[l][d] = mesh_.factor_of_field(int(l), d);
  ElectricField out(std::move(potential), std::move(factor));

  bool const averages = covered == CoveredField::mean;
  std::vector<LargeArray<Real>> means(std::size_t(mesh_.levels()));  // of each level's cells
  for (int l = 1; averages && l < mesh_.levels(); ++l)
    means[std::size_t(l)].resize(ElectricField::components_per_cell *
                                 std::size_t(mesh_.level(l).local_cells() / children));

  auto planes_of = [&](int l, int b, int k) {  // set two by two, in memory that all boxes share
    std::array<Real*, 3> e;
    for (int d = 0; d < 3; ++d) e[d] = planes_.data() + (2 * d + k % 2) * mesh_.box(l, b).stride(2);
    return e;
  };
  auto set_box = [&](int l, int b) {
    bool const whole = out.boundary(l).is_whole(b), is_averaged = averages && l > 0 && !whole;
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      auto const e = planes_of(l, b, k);
      field_plane(l, b, k, whole || is_averaged ? Where::everywhere : Where::at_faces, phi, e);
      out.set_boundary(l, b, k, {e[0], e[1], e[2]});
      if (is_averaged && k % 2 == 1) average_field(l, b, k - 1, means[std::size_t(l)].data());
    }
  };
  auto finish_level = [&](int l) {  // covered cells first, then the means that take these in
    stream_end();
    if (averages && mesh_.hierarchy().has_finer(l)) take_means(l + 1, means[std::size_t(l) + 1].data(), out);
    for (int b = 0; b < mesh_.boxes(l) && averages && l > 0; ++b)
      for (int k = 0; out.boundary(l).is_whole(b) && k < mesh_.box(l, b).extent(2); ++k) {
        out.write_plane(l, b, k, planes_of(l, b, k));
        if (k % 2 == 1) average_field(l, b, k - 1, means[std::size_t(l)].data());
      }
    if (averages && l > 0) {
      stream_end();
      send_means(l, means[std::size_t(l)].data());  // under way while the next level is visited
    }
  };
  ghosts_.visit(phi, walls, {}, averages ? FullyCovered::skip : FullyCovered::visit, set_box, finish_level);
  mesh_.transfer().settle();
  return out;
}

namespace {

enum class Kind : char { absent, fluid, solid };

/// Which cells of a region a level has, and which of these lie in metal.
ArrayOnBox<Kind> kinds(Level const& level, MetalCells const& metal, Box const& region) {
  ArrayOnBox<Kind> out(region, Kind::absent);
  level.for_each_overlap(region, [&](int, Box const& part, Index3 const&) { out.fill(part, Kind::fluid); });
  for_each_cell(region, [&](Index3 const& cell) {
    metal.for_each_solid(level.wrapped(cell), 1, [&](SolidCell const&) { out(cell) = Kind::solid; });
  });
  return out;
}

/// How much the normal of the surface beside a cut cell lies along each axis: the squares of its components, from the
/// arms that a plane would cut so.
Real3 along_normal(CutCell const& cut) {
  Real3 out{0, 0, 0};
  for (std::size_t side = 0; side < 6; ++side)
    if (cut.is_cut(side)) out[int(side) / 2] = std::max(out[int(side) / 2], 1 / (cut.arm[side] * cut.arm[side]));
  return out;
}

}  // namespace

/// Give the cells in metal beside others what these make of a field that goes on linearly, each as much as the normal
/// lies along the axis between them; and those beside these likewise.
void CompositeField::continue_into_metal(int l, std::array<std::shared_ptr<Field>, 3> const& e) {
  Level const& level = mesh_.level(l);
  MetalCells const& metal = mesh_.metal(l);
  around_.resize(std::size_t(mesh_.levels()));
  auto& regions = around_[std::size_t(l)];
  auto const near = [](Box const& box) { return box.grow(Metal::reach); };
  if (!regions)
    regions = std::make_unique<BoxRegions>(mesh_.comm(), level, level, near, [&](int b) { return near(level.box(b)); });
  std::array<std::vector<Real>, 3> halo;
  for (std::size_t d = 0; d < 3; ++d) halo[d] = regions->halo(1, e[d]->level(l).data());
  std::array<std::vector<Real>, 3> old;
  for (std::size_t d = 0; d < 3; ++d) old[d].assign(e[d]->level(l).begin(), e[d]->level(l).end());
  for (int b = 0; b < mesh_.boxes(l); ++b) {
    Box const &own = mesh_.box(l, b), region = regions->region(std::size_t(b));
    bool has_solid = false;
    for_each_row(own, [&](Index3 const& first) {
      metal.for_each_solid(first, own.extent(0), [&](SolidCell const&) { has_solid = true; });
    });
    if (!has_solid) continue;
    ArrayOnBox<Kind> const kind = kinds(level, metal, region);
    std::array<ArrayOnBox<Real>, 3> const field{regions->values(std::size_t(b), old[0].data(), halo[0]),
                                                regions->values(std::size_t(b), old[1].data(), halo[1]),
                                                regions->values(std::size_t(b), old[2].data(), halo[2])};
    Box const inner = own.grow(1);
    ArrayOnBox<Real> weight(inner, 0.0);
    std::array<ArrayOnBox<Real>, 3> continued{ArrayOnBox<Real>(inner, 0.0), ArrayOnBox<Real>(inner, 0.0),
                                              ArrayOnBox<Real>(inner, 0.0)};
    auto const for_each_side = [](Index3 const& cell, auto&& f) {
      for (int side = 0; side < 6; ++side) {
        Index3 beside = cell, behind = cell;
        beside[side / 2] += side % 2 == 0 ? -1 : 1, behind[side / 2] += side % 2 == 0 ? -2 : 2;
        f(side / 2, beside, behind);
      }
    };
    for_each_cell(inner, [&](Index3 const& cell) {
      if (kind(cell) != Kind::solid) return;
      for_each_side(cell, [&](int axis, Index3 const& beside, Index3 const& behind) {
        if (kind(beside) != Kind::fluid) return;
        Real share = 0;
        metal.for_each_cut(level.wrapped(beside), 1, [&](CutCell const& cut) { share = along_normal(cut)[axis]; });
        weight(cell) += share;
        for (std::size_t d = 0; d < 3; ++d) {
          Real const next = field[d](beside);
          continued[d](cell) += share * (kind(behind) == Kind::fluid ? 2 * next - field[d](behind) : next);
        }
      });
      for (std::size_t d = 0; d < 3 && weight(cell) > 0; ++d) continued[d](cell) /= weight(cell);
    });
    for_each_cell(own, [&](Index3 const& cell) {
      if (kind(cell) != Kind::solid) return;
      std::size_t const place = std::size_t(mesh_.offset(l, b) + own.offset(cell));
      Real3 sum{0, 0, 0};
      int count = 0;
      for_each_side(cell, [&](int, Index3 const& beside, Index3 const& behind) {
        if (kind(beside) != Kind::solid || !(weight(beside) > 0)) return;
        for (std::size_t d = 0; d < 3; ++d) {
          Real const next = continued[d](beside);
          sum[int(d)] += kind(behind) == Kind::fluid ? 2 * next - field[d](behind) : next;
        }
        ++count;
      });
      for (std::size_t d = 0; d < 3; ++d)
        e[d]->level(l)[place] = weight(cell) > 0 ? continued[d](cell) : count > 0 ? sum[int(d)] / count : 0;
    });
  }
}

ElectricField CompositeField::beside_metal(Field const& phi, std::vector<Walls> const& walls,
                                           std::vector<Real> const& potentials, CoveredField covered,
                                           CompositeAverage& average) {
  std::array<std::shared_ptr<Field>, 3> e;
  for (auto& component : e) component = std::make_shared<Field>(phi.share_hierarchy(), false);
  ghosts_.visit(phi, walls, potentials, FullyCovered::visit, [&](int l, int b) {
    std::ptrdiff_t const plane = mesh_.box(l, b).stride(2);
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      std::array<Real*, 3> at;
      for (std::size_t d = 0; d < 3; ++d) at[d] = e[d]->level(l).data() + mesh_.offset(l, b) + k * plane;
      field_plane(l, b, k, Where::everywhere, phi, at);
      mesh_.for_each_in_metal(
          l, b, k, Covered::visit,
          [&](CompositeMesh::CutHere const& here) {
            CutRow const& row = here.row;
            Real const* const cell = phi.level(l).data() + mesh_.offset(l, b) + k * plane + here.place;
            for (std::size_t d = 0; d < 3; ++d) {
              if (row.surface(2 * d) == 0 && row.surface(2 * d + 1) == 0) continue;
              auto const line = ghosts_.line_through(l, b, here, int(d), cell, walls, potentials);
              at[d][here.place] = -2 * mesh_.factor_of_field(l, int(d)) * line.slope();
            }
          },
          [&](std::ptrdiff_t place, int n, int) {
            for (Real* component : at) std::fill_n(component + place, n, 0.0);
          });
    }
  });
  for (int l = 0; l < mesh_.levels(); ++l) continue_into_metal(l, e);
  std::array<std::shared_ptr<Field const>, 3> out;
  for (std::size_t d = 0; d < 3; ++d) {
    if (covered == CoveredField::mean) average.average_down(*e[d]);
    out[d] = e[d];
  }
  return ElectricField(out);
}

}  // namespace amrpic
