#include "matrixfree/composite_truncation.hpp"

#include <algorithm>

#include "mesh/array_on_box.hpp"
#include "stencil/intergrid.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic {

namespace {

/// A part of a window, in the memory of a box of this rank or as another rank sent it.
struct Part {
  bool here;
  RemoteReads::Values values;
  Box place;  ///< in the window
};

/// Whether the last cell of a level along an axis, the base's, has no partner to share a parent with. The parent that
/// it has alone holds no mean, and nothing is known of its neighbours, as of cells at walls.
bool leaves_a_cell(Level const& level, Index3 const& ratio, int axis) {
  return level.domain().extent(axis) % ratio[axis] != 0;
}

/// Whether values that come from another image of the domain cross a periodic face where the last cell is alone:
/// parents do not go on there.
bool crosses_lone_cell(Level const& level, Index3 const& ratio, Index3 const& shift) {
  bool out = false;
  for (int d = 0; d < 3; ++d) out = out || (shift[d] != 0 && leaves_a_cell(level, ratio, d));
  return out;
}

/// The overlaps with a region of parents' children where parents go on.
std::vector<Overlap> overlaps_of_parents(Level const& level, Index3 const& ratio, Box const& region) {
  auto out = overlaps(level, region);
  out.erase(std::remove_if(out.begin(), out.end(),
                           [&](Overlap const& o) { return crosses_lone_cell(level, ratio, o.shift); }),
            out.end());
  return out;
}

/// Values that are read for a window around the parents of each box of a level: one for each `ratio` cells of a level,
/// up to `reach` beyond the parents, which are `parent_ratio` cells of the boxes' level.
struct Window {
  int purpose;  ///< of imports
  int level;
  Index3 ratio, parent_ratio;
  Index3 reach;

  Box around(Box const& box) const { return box.coarsen(parent_ratio).grow(reach); }
};

/// What passes between ranks for the windows of a level's boxes.
Reads reads_of(Hierarchy const& hierarchy, int boxes, Window const& window) {
  Level const &readers = hierarchy.level(boxes), &owners = hierarchy.level(window.level);
  Reads reads = reads_across_ranks(
      readers, owners,
      [&](Box const& o) { return o.coarsen(window.ratio).grow(window.reach).refine(window.parent_ratio); },
      [&](int b, auto&& read) { read(window.around(readers.box(b)).refine(window.ratio)); });
  for (auto* list : {&reads.wanted, &reads.asked})
    list->erase(std::remove_if(list->begin(), list->end(),
                               [&](Read const& r) { return crosses_lone_cell(owners, window.ratio, r.shift); }),
                list->end());
  return coarsened(std::move(reads), window.ratio);
}

/// Where the parents of this rank's boxes start, one box after the other; boxes + 1 values.
std::vector<std::int32_t> first_parents(Level const& level, Index3 const& ratio) {
  std::vector<std::int32_t> out{0};
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    out.push_back(out.back() + std::int32_t(level.box(b).coarsen(ratio).cells()));
  return out;
}

/// The parts of the window of box b that lie in boxes of the level. `first`: of `first_parents`.
std::vector<Part> find_parts(Hierarchy const& hierarchy, int boxes, int b, Window const& window,
                             std::vector<std::int32_t> const& first, RemoteReads const& imports) {
  Level const& level = hierarchy.level(window.level);
  std::vector<Part> out;
  Box const around = window.around(hierarchy.level(boxes).box(b));
  for (auto const& o : overlaps_of_parents(level, window.ratio, around.refine(window.ratio))) {
    Box const box = level.box(o.box).coarsen(window.ratio), place = o.part.coarsen(window.ratio);
    Index3 shift = o.shift;
    for (int d = 0; d < 3; ++d) shift[d] /= window.ratio[d];
    Box const own = place.shift_back(shift);
    bool const here = level.owner(o.box) == level.rank();
    if (here)
      out.push_back({here,
                     {first[std::size_t(o.box - level.first_local_box())] + std::int32_t(box.offset(own.lower)),
                      box.extent(0), box.extent(0) * box.extent(1)},
                     place});
    else
      out.push_back({here, imports.find(window.purpose, b, 0, o.box, shift, place), place});
  }
  return out;
}

/// The values of a window, zero where the level has no cells.
ArrayOnBox<Real> gather(Box const& box, std::vector<Part> const& parts, Real const* own, RemoteReads const& imports) {
  ArrayOnBox<Real> out(box, 0.0);
  for (Part const& p : parts) {
    Real const* from = (p.here ? own : imports.values()) + p.values.from;
    for (int k = 0; k < p.place.extent(2); ++k)
      for (int j = 0; j < p.place.extent(1); ++j)
        std::copy_n(from + std::ptrdiff_t(j) * p.values.pitch_y + std::ptrdiff_t(k) * p.values.pitch_z,
                    p.place.extent(0), &out({p.place.lower[0], p.place.lower[1] + j, p.place.lower[2] + k}));
  }
  return out;
}

/// Add to a row of n parents `weight` times the sum of each one's children in a row.
void add_parents(int n, int ratio, Real weight, Real const* __restrict fine, Real* __restrict parents) {
  if (ratio == 1)
    for (int i = 0; i < n; ++i) parents[i] += weight * fine[i];
  else
    for (int i = 0; i < n; ++i) parents[i] += weight * (fine[2 * i] + fine[2 * i + 1]);
}

/// The means over groups of `ratio` cells of this rank's boxes, one box after the other, x fastest.
std::vector<Real> means(Level const& level, Index3 const& ratio, std::vector<std::int32_t> const& first_parent,
                        Real const* fine) {
  std::vector<Real> out(std::size_t(first_parent.back()), 0.0);
  Real const weight = mean_weight(ratio);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    Box const &box = level.box(b), parents = box.coarsen(ratio);
    Real* const first = out.data() + first_parent[std::size_t(b - level.first_local_box())];
    int const n = parents.extent(0);
    for (int k = 0; k < box.extent(2); ++k)
      for (int j = 0; j < box.extent(1); ++j, fine += box.extent(0)) {
        Real* const to =
            first + std::ptrdiff_t(n) * (j / ratio[1] + std::ptrdiff_t(parents.extent(1)) * (k / ratio[2]));
        add_parents(box.extent(0) / ratio[0], ratio[0], weight, fine, to);
      }
  }
  return out;
}

/// Pack a part of such means.
Real* pack_means(Level const& level, Index3 const& ratio, std::vector<std::int32_t> const& first,
                 std::vector<Real> const& means, Read const& read, Real* out) {
  Box const parents = level.box(read.owner).coarsen(ratio), part = read.cells();
  Real const* const from = means.data() + first[std::size_t(read.owner - level.first_local_box())];
  for_each_row(part, [&](Index3 const& first_of_row) {
    out = std::copy_n(from + parents.offset(first_of_row), part.extent(0), out);
  });
  return out;
}

/// One box for which the truncation error is sought, and what it takes for that.
struct Task {
  int box;                ///< local
  Box parents;            ///< of the box and of the cells around it that prolongation reads
  std::vector<Part> rho;  ///< means over their children
  std::vector<Part> phi;  ///< in them and their neighbours: the coarser level's, or means where none is
};

/// Parents in which the coarser Laplacian is an estimate: all children are uncovered, and they are not at a wall.
ArrayOnBox<char> usable_parents(Level const& level, Level const* finer, Index3 const& ratio, Box const& parents) {
  ArrayOnBox<char> out(parents, 0);
  Box const children = parents.refine(ratio), domain = level.domain().coarsen(ratio);
  for (auto const& o : overlaps_of_parents(level, ratio, children)) out.fill(o.part.coarsen(ratio), 1);
  if (finer)
    for (auto const& o : overlaps(*finer, children.refine(refinement_ratio)))
      out.fill(o.part.coarsen(refinement_ratio).coarsen(ratio), 0);
  for (int d = 0; d < 3; ++d) {
    bool const is_left = leaves_a_cell(level, ratio, d);
    if (level.periodic()[d] && !is_left) continue;
    Box below = parents, above = parents;  // with what lies beyond
    below.upper[d] = domain.lower[d];
    above.lower[d] = domain.upper[d] - (is_left ? 1 : 0);
    out.fill(below, 0);
    out.fill(above, 0);
  }
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

/// The truncation error in a row of n cells, from the potentials in a window around them and the means of rho.
void estimate_row(int n, Equation const& coarse, Real const* __restrict potential, Box const& window,
                  Real const* __restrict charge, Background const& background, char const* __restrict usable,
                  Real* __restrict error) {
  Equation const equation = coarse;
  Background const taken_away = background;
  std::ptrdiff_t const y = window.extent(0), z = y * window.extent(1);
  for (int i = 0; i < n; ++i) {
    Real const* const phi = potential + i;
    Real const found = laplacian(equation, phi[0], phi[-1], phi[1], phi[-y], phi[y], phi[-z], phi[z]);
    Real const f = taken_away.right_hand_side(charge[i]);
    error[i] = usable[i] ? truncation_error(found, f) : 0;
  }
}

/// What is known in the parents, in the uncovered cells of a box.
template <class T>
void prolong_truncation(CompositeMesh const& mesh, int l, int b, Index3 const& ratio, ArrayOnBox<Real> const& error,
                        Real scale, Block<T> const& out, Magnitude& largest) {
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

template <class T>
Real composite_truncation(CompositeMesh& mesh, Source const& source, Field const& phi, Index3 const& base_ratio,
                          std::vector<Real> const& scale, Blocks<T> const& truncation) {
  Magnitude largest(Norm::max);
  for (int l = 0; l < mesh.levels(); ++l) {
    Index3 const ratio = l > 0 ? refinement_ratio : base_ratio;
    if (ratio == Index3{1, 1, 1}) {
      for (int b = 0; b < mesh.boxes(l); ++b) mesh.clear(l, b, truncation[std::size_t(l)][std::size_t(b)]);
      continue;
    }
    auto const first = first_parents(mesh.level(l), ratio);
    auto const first_coarse = l > 0 ? first_parents(mesh.level(l - 1), {1, 1, 1}) : first;
    enum Purpose { of_rho, of_phi };
    Index3 const beside{ratio[0] - 1, ratio[1] - 1, ratio[2] - 1};
    Index3 const further{ratio[0], ratio[1], ratio[2]};
    Window const rho{of_rho, l, ratio, ratio, beside};
    Window const potential_window =
        l > 0 ? Window{of_phi, l - 1, {1, 1, 1}, ratio, further} : Window{of_phi, 0, ratio, ratio, further};
    RemoteReads imports;
    for (Window const& window : {rho, potential_window})
      imports.add(window.purpose, reads_of(mesh.hierarchy(), l, window));
    imports.plan(mesh.comm());
    std::vector<Task> tasks;
    for (int b = 0; b < mesh.boxes(l); ++b) {
      int const number = mesh.level(l).first_local_box() + b;
      tasks.push_back({b, rho.around(mesh.box(l, b)), find_parts(mesh.hierarchy(), l, number, rho, first, imports),
                       find_parts(mesh.hierarchy(), l, number, potential_window, first_coarse, imports)});
    }
    auto const charges = means(mesh.level(l), ratio, first, source.rho.level(l).data());
    auto const potentials = l > 0 ? std::vector<Real>() : means(mesh.level(0), ratio, first, phi.level(0).data());
    Real const* const coarse_phi = l > 0 ? phi.level(l - 1).data() : potentials.data();
    imports.start([&](int purpose, Read const& read, Real* out) {
      if (purpose == of_rho)
        pack_means(mesh.level(l), ratio, first, charges, read, out);
      else if (l > 0)
        mesh.pack_cells(phi, l - 1, read, out);
      else
        pack_means(mesh.level(0), ratio, first, potentials, read, out);
    });
    imports.finish();
    imports.settle();
    for (Task const& task : tasks) {
      auto const charge = gather(task.parents, task.rho, charges.data(), imports);
      auto const potential = gather(task.parents.grow(1), task.phi, coarse_phi, imports);
      auto const usable = usable_parents(mesh.level(l), mesh.hierarchy().has_finer(l) ? &mesh.level(l + 1) : nullptr,
                                         ratio, task.parents);
      Real3 spacing;
      for (int d = 0; d < 3; ++d) spacing[d] = ratio[d] * mesh.level(l).spacing()[d];
      Equation const coarse = equation_on(spacing, mesh.shift());
      ArrayOnBox<Real> error(task.parents, 0.0);
      for_each_row(task.parents, [&](Index3 const& first) {
        estimate_row(task.parents.extent(0), coarse, &potential(first), potential.box(), &charge(first),
                     source.background, &usable(first), &error(first));
      });
      prolong_truncation(mesh, l, task.box, ratio, error, scale[std::size_t(l)],
                         truncation[std::size_t(l)][std::size_t(task.box)], largest);
    }
  }
  return largest.over(mesh.comm());
}
template Real composite_truncation(CompositeMesh& mesh, Source const&, Field const&, Index3 const&,
                                   std::vector<Real> const&, Blocks<float> const&);
template Real composite_truncation(CompositeMesh& mesh, Source const&, Field const&, Index3 const&,
                                   std::vector<Real> const&, Blocks<Real> const&);

}  // namespace amrpic
