#include "composite/composite_truncation.hpp"

#include <algorithm>

#include "mesh/box_regions.hpp"
#include "stencil/intergrid.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic {

namespace {

/// Whether the last cell of a level along an axis, the base's, has no partner to share a parent with. The parent that
/// it has alone holds no mean, and nothing is known of its neighbours, as of cells at walls.
bool leaves_a_cell(Level const& level, Index3 const& ratio, int axis) {
  return level.domain().extent(axis) % ratio[axis] != 0;
}

/// The parents of groups of `ratio` cells of a level, box by box. They do not go on beyond a periodic face before which
/// a cell is alone.
Level parents_of(Level const& level, Index3 const& ratio) {
  std::array<bool, 3> periodic = level.periodic();
  Real3 spacing = level.spacing();
  for (int d = 0; d < 3; ++d) {
    periodic[d] = periodic[d] && !leaves_a_cell(level, ratio, d);
    spacing[d] *= ratio[d];
  }
  std::vector<Box> boxes = level.boxes();
  for (Box& box : boxes) box = box.coarsen(ratio);
  std::vector<int> first_box;
  for (int r = 0; r <= level.ranks(); ++r) first_box.push_back(level.first_box(r));
  return Level(level.domain().coarsen(ratio), periodic, spacing, std::move(boxes), std::move(first_box), level.rank());
}

/// Regions of the cells of `owners` that reach so far beyond the boxes of parents.
BoxRegions around(Communicator const& comm, Level const& owners, Level const& parents, Index3 const& reach) {
  return BoxRegions(
      comm, owners, parents, [&](Box const& o) { return o.grow(reach); },
      [&](int b) { return parents.box(b).grow(reach); });
}

/// Add to a row of n parents `weight` times the sum of each one's children in a row.
void add_parents(int n, int ratio, Real weight, Real const* __restrict fine, Real* __restrict parents) {
  if (ratio == 1)
    for (int i = 0; i < n; ++i) parents[i] += weight * fine[i];
  else
    for (int i = 0; i < n; ++i) parents[i] += weight * (fine[2 * i] + fine[2 * i + 1]);
}

/// The means over groups of `ratio` cells of this rank's boxes, one box after the other, x fastest.
std::vector<Real> means(Level const& level, Index3 const& ratio, Level const& parents, Real const* fine) {
  std::vector<Real> out(std::size_t(parents.local_cells()), 0.0);
  Real const weight = mean_weight(ratio);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    Box const& to = parents.box(b);
    for_each_row(level.box(b), [&](Index3 const& first) {
      Index3 const parent{to.lower[0], floor_divide(first[1], ratio[1]), floor_divide(first[2], ratio[2])};
      int const count = level.box(b).extent(0);
      add_parents(count / ratio[0], ratio[0], weight, fine, out.data() + parents.local_offset(b) + to.offset(parent));
      fine += count;
    });
  }
  return out;
}

/// Parents in which the coarser Laplacian is an estimate: all children are uncovered, and they are not at a wall, nor
/// beside metal.
ArrayOnBox<char> usable_parents(Level const& level, Level const* finer, Index3 const& ratio, Level const& parents,
                                MetalCells const& metal, Box const& region) {
  ArrayOnBox<char> out(region, 0);
  parents.for_each_overlap(region, [&](int, Box const& part, Index3 const&) { out.fill(part, 1); });
  if (finer)
    for (auto const& o : overlaps(*finer, region.refine(ratio).refine(refinement_ratio)))
      out.fill(o.part.coarsen(refinement_ratio).coarsen(ratio), 0);
  for (int d = 0; d < 3; ++d) {
    if (parents.periodic()[d]) continue;
    Box below = region, above = region;  // with what lies beyond
    below.upper[d] = parents.domain().lower[d];
    above.lower[d] = parents.domain().upper[d] - (leaves_a_cell(level, ratio, d) ? 1 : 0);
    out.fill(below, 0);
    out.fill(above, 0);
  }
  amrpic::for_each_row(region.grow(1), [&](Index3 const& first) {
    metal.for_each_cut(first, region.extent(0) + 2, [&](CutCell const& cut) {
      out.fill(Box{cut.cell, cut.cell}.grow(1), 0);
    });
    metal.for_each_solid(first, region.extent(0) + 2, [&](SolidCell const& solid) {
      out.fill({solid.cell, solid.cell}, 0);
    });
  });
  return out;
}

/// Trilinear prolongation along a row of n cells: `parent[0]` belongs to the first cell's, which is a lower child.
void prolong_row(int n, int ratio, Real const* __restrict parent, Real* __restrict out) {
  if (ratio == 1) {
    std::copy_n(parent, n, out);
    return;
  }
  for (int i = 0; i < n / 2; ++i) {
    out[2 * i] = prolonged(parent[i], parent[i - 1]);
    out[2 * i + 1] = prolonged(parent[i], parent[i + 1]);
  }
  if (n % 2 != 0) out[n - 1] = prolonged(parent[n / 2], parent[n / 2 - 1]);
}

/// Parent along an axis, its neighbour on the side of the cell, and the neighbour's weight.
struct Pair {
  int parent, neighbour;
  Real far;
};
Pair parents_along(int cell, int ratio) {
  if (ratio == 1) return {cell, cell, 0};
  int const parent = floor_divide(cell, 2);
  return {parent, cell == 2 * parent ? parent - 1 : parent + 1, prolongation::far};
}

/// The truncation error in a row of n cells, from the potentials in a region around them and the means of rho.
void estimate_row(int n, Equation const& coarse, Real const* __restrict potential, Box const& region,
                  Real const* __restrict charge, Background const& background, char const* __restrict usable,
                  Real* __restrict error) {
  Equation const equation = coarse;
  Background const taken_away = background;
  std::ptrdiff_t const y = region.extent(0), z = y * region.extent(1);
  for (int i = 0; i < n; ++i) {
    Real const* const phi = potential + i;
    Real const found = laplacian(equation, phi[0], phi[-1], phi[1], phi[-y], phi[y], phi[-z], phi[z]);
    Real const f = taken_away.right_hand_side(charge[i]);
    error[i] = usable[i] ? truncation_error(found, f) : 0;
  }
}

/// What is known in the parents, in the uncovered cells of a box.
void prolong_truncation(CompositeMesh const& mesh, int l, int b, Index3 const& ratio, ArrayOnBox<Real> const& error,
                        Real scale, Block<float> const& out, Magnitude& largest) {
  Box const& own = mesh.box(l, b);
  int const width = error.box().extent(0), first = error.box().lower[0];
  int const before = floor_divide(own.lower[0], ratio[0]) - first;  // parents in front of the first cell's
  std::vector<Real> row(std::size_t(width), 0.0), plane(std::size_t(own.extent(0)) * std::size_t(own.extent(1)));
  for (int k = 0; k < own.extent(2); ++k) {
    Pair const z = parents_along(own.lower[2] + k, ratio[2]);
    for (int j = 0; j < own.extent(1); ++j) {
      Pair const y = parents_along(own.lower[1] + j, ratio[1]);
      Real const *nn = &error({first, y.parent, z.parent}), *fn = &error({first, y.neighbour, z.parent}),
                 *nf = &error({first, y.parent, z.neighbour}), *ff = &error({first, y.neighbour, z.neighbour});
      Real* __restrict const mixed = row.data();
      for (int i = 0; i < width; ++i)
        mixed[i] = prolonged(z.far, prolonged(y.far, nn[i], fn[i]), prolonged(y.far, nf[i], ff[i]));
      prolong_row(own.extent(0), ratio[0], row.data() + before, plane.data() + std::ptrdiff_t(j) * own.extent(0));
    }
    mesh.clear_covered(l, b, k, plane.data());
    largest.add(plane.data(), std::ptrdiff_t(own.extent(0)) * own.extent(1), mesh.volume(l));
    mesh.write_plane(l, b, k, plane.data(), scale, out);
  }
}

}  // namespace

Real composite_truncation(CompositeMesh& mesh, Source const& source, Field const& phi, Index3 const& base_ratio,
                          std::vector<Real> const& scale, Blocks<float> const& truncation) {
  Magnitude largest(Norm::max);
  for (int l = 0; l < mesh.levels(); ++l) {
    Index3 const ratio = l > 0 ? refinement_ratio : base_ratio;
    if (ratio == Index3{1, 1, 1}) {
      for (int b = 0; b < mesh.boxes(l); ++b) mesh.clear(l, b, truncation[std::size_t(l)][std::size_t(b)]);
      continue;
    }
    Level const& level = mesh.level(l);
    Level const parents = parents_of(level, ratio);
    Level const& coarser = l > 0 ? mesh.level(l - 1) : parents;
    BoxRegions const rho = around(mesh.comm(), parents, parents, {ratio[0] - 1, ratio[1] - 1, ratio[2] - 1});
    BoxRegions const phi_near = around(mesh.comm(), coarser, parents, ratio);
    auto const charges = means(level, ratio, parents, source.rho.level(l).data());
    auto const potentials = l > 0 ? std::vector<Real>() : means(level, ratio, parents, phi.level(0).data());
    Real const* const coarse_phi = l > 0 ? phi.level(l - 1).data() : potentials.data();
    auto const charge_halo = rho.halo(1, charges.data()), phi_halo = phi_near.halo(1, coarse_phi);
    Equation const coarse = equation_on(parents.spacing(), mesh.shift());
    MetalCells const metal = mesh.metal() ? mesh.metal()->own_cells(parents) : MetalCells{};
    for (int b = 0; b < mesh.boxes(l); ++b) {
      Box const& region = rho.region(std::size_t(b));  // of the box and of the cells around it that prolongation reads
      auto const charge = rho.values(std::size_t(b), charges.data(), charge_halo);
      auto const potential = phi_near.values(std::size_t(b), coarse_phi, phi_halo);
      auto const usable = usable_parents(level, mesh.hierarchy().has_finer(l) ? &mesh.level(l + 1) : nullptr, ratio,
                                         parents, metal, region);
      ArrayOnBox<Real> error(region, 0.0);
      for_each_row(region, [&](Index3 const& first) {
        estimate_row(region.extent(0), coarse, &potential(first), potential.box(), &charge(first), source.background,
                     &usable(first), &error(first));
      });
      prolong_truncation(mesh, l, b, ratio, error, scale[std::size_t(l)], truncation[std::size_t(l)][std::size_t(b)],
                         largest);
    }
  }
  return largest.over(mesh.comm());
}

}  // namespace amrpic
