#include "kokkos/composite.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "composite/composite_kernels.hpp"
#include "mesh/gap_values.hpp"
#include "stencil/interface.hpp"
#include "stencil/intergrid.hpp"

namespace amrpic::kokkos {

// ---- what passes between ranks ----

RemoteBuffers::RemoteBuffers(RemoteReads const& reads) {
  std::size_t sent = 0;
  reads.for_each_asked([&](int, Read const& read) { sent += std::size_t(read.part.cells()); });
  sent_ = Array<Real>("sent", sent), received_ = Array<Real>("received", std::size_t(reads.size()));
  host_sent_ = Kokkos::create_mirror_view(sent_), host_received_ = Kokkos::create_mirror_view(received_);
}

void RemoteBuffers::pass(RemoteReads const& reads) const {
  copy_values(host_sent_, sent_);
  Real const* from = host_sent_.data();
  reads.start([&](int, Read const& read, Real* out) {
    std::copy_n(from, read.part.cells(), out);
    from += read.part.cells();
  });
  reads.finish();
  reads.settle();
  std::copy_n(reads.values(), reads.size(), host_received_.data());
  copy_values(received_, host_received_);
}

// ---- lists ----

namespace {

/// Runs from a rectangle to where it lies in a plane that begins at a place.
void add_runs(Rectangle const& r, std::int32_t plane, int pitch, std::vector<CopiedRun>& out) {
  for (int v = 0; v < r.nv; ++v) {
    std::int32_t const from = r.from + v * r.pv;
    out.push_back({r.here ? from : ~from, r.pu, plane + r.u + (r.v + v) * pitch, r.nu});
  }
}

/// Places of the cells around gaps, ~(place) of what other ranks sent.
GapValues<std::int32_t> places_around(LevelPlan const& plan, Box const& box, Range const& parts,
                                      std::vector<std::int32_t> const& own, std::vector<std::int32_t> const& received) {
  GapValues<std::int32_t> out;
  out.set_box(box);
  for (int p = parts.first; p < parts.last; ++p) {
    RegionPart const& part = plan.region_parts[std::size_t(p)];
    out.copy_in(part.part, (part.here ? own : received).data() + part.from, part.pitch_y, part.pitch_z);
  }
  return out;
}

std::vector<std::int32_t> numbers(std::size_t count, bool received) {
  std::vector<std::int32_t> out(count);
  for (std::size_t n = 0; n < count; ++n) out[n] = received ? ~std::int32_t(n) : std::int32_t(n);
  return out;
}

}  // namespace

Composite::Composite(CompositeMesh& mesh, std::vector<SweptLevel*> levels)
    : mesh_(mesh), swept_(std::move(levels)), levels_(std::size_t(mesh.levels())), cells_(mesh.plan().cells) {
  fits_ = NumberedFits::made();
  for (int l = 0; l < mesh_.levels(); ++l) {
    OnLevel& level = levels_[std::size_t(l)];
    std::vector<CompositeBox> boxes;
    for (int b = 0; b < mesh_.boxes(l); ++b) {
      Box const& box = mesh_.box(l, b);
      auto const at = swept_[std::size_t(l)]->plan().layout().box(mesh_.level(l).first_local_box() + b);
      boxes.push_back({mesh_.offset(l, b),
                       {box.extent(0), box.extent(1), box.extent(2)},
                       {},
                       std::int32_t(at.origin),
                       std::int32_t(at.pitch_y),
                       std::int32_t(at.pitch_z)});
    }
    plan_faces(l, level, boxes);
    plan_rows(l, level, boxes);
    plan_exchanges(l, level);
    level.boxes = listed(boxes);
  }
  // Each message's values in the order in which they are packed.
  std::vector<std::vector<CopiedRun>> sent(levels_.size());
  std::int32_t to = 0;
  mesh_.plan().cells.for_each_asked([&](int purpose, Read const& read) {
    int const l = CompositePlan::level_of(purpose);
    mesh_.for_each_row_read(l, read, [&](std::int32_t first, int count) {
      sent[std::size_t(l)].push_back({first, 1, to, count});
      to += count;
    });
  });
  for (std::size_t l = 0; l < levels_.size(); ++l) levels_[l].sent_cells = listed(sent[l]);
}

/// Ghosts of the boxes with uncovered cells.
void Composite::plan_faces(int l, OnLevel& level, std::vector<CompositeBox>& boxes) {
  LevelPlan const& plan = mesh_.plan(l);
  std::vector<CopiedRun> neighbours, coarse;
  std::vector<WallRun> walls;
  std::vector<SideBehind> sides;
  std::vector<CoarseFace> faces;
  std::vector<FaceBesideMetal> beside_metal;
  GapTerms::Lists gaps_coarse, gaps_fine, metal_terms;
  std::vector<std::int32_t> own, own_coarse, received;
  if (!plan.gaps.empty()) {
    own = numbers(std::size_t(mesh_.level(l).local_cells()), false);
    own_coarse = numbers(std::size_t(mesh_.level(l - 1).local_cells()), false);
    received = numbers(std::size_t(mesh_.plan().cells.size()), true);
  }
  std::int32_t ghosts = 0, planes = 0, gap_count = 0;
  for (int b = 0; b < mesh_.boxes(l); ++b) {
    if (mesh_.plan(l, b).is_fully_covered) continue;
    Box const& box = mesh_.box(l, b);
    Index3 const pitch = box.strides();
    for (int f = 0; f < 6; ++f) {
      int const axis = f / 2, side = f % 2;
      auto const [u, v] = tangential_axes(axis);
      FacePlan const& face = mesh_.plan(l, b).faces[std::size_t(f)];
      int const nu = box.extent(u), nv = box.extent(v);
      std::int32_t const first_ghost = ghosts, inward = side == 0 ? pitch[axis] : -pitch[axis];
      std::int32_t const first = mesh_.offset(l, b) + (side == 0 ? 0 : (box.extent(axis) - 1) * pitch[axis]);
      boxes[std::size_t(b)].ghosts[std::size_t(f)] = ghosts;
      ghosts += nu * nv;
      if (face.wall >= 0) {
        for (int y = 0; y < nv; ++y)
          walls.push_back({first + y * pitch[v], pitch[u], inward, first_ghost + y * nu, face.wall + y * nu, nu, f});
        continue;
      }
      for (int r = face.neighbours.first; r < face.neighbours.last; ++r)
        add_runs(plan.neighbours[std::size_t(r)], first_ghost, nu, neighbours);
      if (face.interface < 0) continue;

      Interface const& i = plan.interfaces[std::size_t(face.interface)];
      int const plane_v = i.nu + 2 * i.margin;
      std::int32_t const middle = planes + i.margin * (1 + plane_v);
      for (int r = i.coarse.first; r < i.coarse.last; ++r)
        add_runs(plan.coarse[std::size_t(r)], planes, plane_v, coarse);
      planes += plane_v * (i.nv + 2 * i.margin);
      GapValues<std::int32_t> coarse_values, values;
      if (i.gaps >= 0) {
        Gaps const& gaps = plan.gaps[std::size_t(i.gaps)];
        coarse_values = places_around(plan, gaps.coarse, gaps.coarse_parts, own_coarse, received);
        values = places_around(plan, gaps.coarse.refine(refinement_ratio), gaps.parts, own, received);
      }
      auto const face_at = [&, u = u, v = v](int m, int row, std::int32_t fit) {
        int const x = 2 * (i.u + m), y = 2 * (i.v + row);
        return CoarseFace{std::int32_t(sides.size()), first + x * pitch[u] + y * pitch[v], first_ghost + x + y * nu,
                          middle + m + row * plane_v, i.fluxes + m + row * i.nu,           fit};
      };
      for (int row = 0; row < i.nv; ++row)
        for (int m = 0; m < i.nu; ++m)
          if (FitNumber const fit = plan.fits[std::size_t(i.fits + m + row * i.nu)]; fit != no_fit && fit != fit_in_gap)
            faces.push_back(face_at(m, row, fit));
      Index3 behind = box.coarsen(refinement_ratio).layer(axis, side, 1).lower;
      plan.for_each_gap(i, [&, v = v, u = u](int m, int row, GapFit const& fit) {
        Index3 cell = behind;
        cell[u] += i.u + m, cell[v] += i.v + row;
        for (auto const& term : fit.terms)
          (term.fine ? gaps_fine : gaps_coarse)
              .terms.push_back(
                  {term.fine ? values(first_child_of(cell), term) : coarse_values(cell, term), term.weight});
        gaps_fine.end_gap(), gaps_coarse.end_gap();
        faces.push_back(face_at(m, row, ~gap_count++));
      });
      for (MetalFace const& metal : mesh_.metal_faces(l, face.interface)) {
        FaceBesideMetal const out{
            face_at(metal.at.coarse[u] - behind[u] - i.u, metal.at.coarse[v] - behind[v] - i.v, 0),
            GhostsBesideMetal(metal)};
        for (auto const& term : metal.cells)
          metal_terms.terms.push_back({out.face.plane + term.i + term.j * plane_v, term.weight});
        for (auto const& term : metal.surfaces) metal_terms.terms.push_back({~term.electrode, term.weight});
        metal_terms.end_gap();
        beside_metal.push_back(out);
      }
      sides.push_back({fine_side(box, axis, side), plane_v});
    }
  }
  level.neighbours = listed(neighbours), level.coarse = listed(coarse), level.walls = listed(walls);
  level.sides = listed(sides), level.faces = listed(faces);
  level.gaps_coarse = GapTerms(gaps_coarse), level.gaps_fine = GapTerms(gaps_fine);
  level.beside_metal = listed(beside_metal), level.metal_terms = GapTerms(metal_terms);
  bytes_ += level.metal_terms.bytes();
  level.ghosts = Array<Real>("ghosts", std::size_t(ghosts)), level.planes = Array<Real>("planes", std::size_t(planes));
  level.fluxes = Array<Real>("fluxes", std::size_t(plan.fluxes));
  bytes_ += (std::size_t(ghosts) + std::size_t(planes) + std::size_t(plan.fluxes)) * sizeof(Real);
}

CutCellPlace Composite::cut_cell(int l, int b, int k, CompositeMesh::CutHere const& here,
                                 CompositeBox const& box) const {
  Box const& own = mesh_.box(l, b);
  Index3 const pitch = own.strides();
  CutCellPlace out{box.first + k * pitch[2] + std::int32_t(here.place), 0, here.row, {}, {}, {}};
  for (std::size_t side = 0; side < 6; ++side) {
    int const axis = int(side) / 2;
    Index3 const& cell = here.at;
    std::int32_t const on_face = std::int32_t(place_on_face(own, axis, cell));  // where it lies at one
    out.datum[side] = here.cell.is_cut(side)        ? here.cell.electrode[side]
                      : here.row.surface(side) != 0 ? ~(mesh_.plan(l, b).faces[side].wall + on_face)
                                                    : 0;
    if (here.is_inside(side)) {
      out.in[side] = CutCellPlace::In::cells;
      out.beyond[side] = out.cell + (side % 2 == 0 ? -pitch[axis] : pitch[axis]);
    } else if (RefinedSide const* const r = mesh_.finer_beyond(l, cell, int(side))) {
      out.in[side] = r->fluxes.here ? CutCellPlace::In::fluxes : CutCellPlace::In::received_fluxes;
      out.beyond[side] = r->flux_at(counted_from_first(own, cell));
    } else {
      out.in[side] = CutCellPlace::In::ghosts;
      out.beyond[side] = box.ghosts[side] + on_face;
    }
  }
  return out;
}

/// Rows, and what is special in some.
void Composite::plan_rows(int l, OnLevel& level, std::vector<CompositeBox> const& boxes) {
  LevelPlan const& plan = mesh_.plan(l);
  std::vector<CompositeRow> rows;
  std::vector<std::int32_t> first_refined;
  std::vector<CellKind> kind;
  std::vector<RefinedFace> refined;
  std::vector<CutCellPlace> cuts;
  for (std::size_t b = 0; b < boxes.size(); ++b) {
    BoxPlan const& of_box = plan.boxes[b];
    Index3 const& extent = boxes[b].extent;
    bool const is_plain = of_box.covered.empty() && of_box.refined.empty() && !mesh_.has_metal(l, int(b));
    std::size_t const cells = std::size_t(extent[0]) * std::size_t(extent[1]) * std::size_t(extent[2]);
    std::vector<CellKind> kinds(is_plain || of_box.is_fully_covered ? 0 : cells, CellKind::plain);
    std::vector<std::vector<RefinedFace>> beside(kinds.size());
    auto const number = [&](Index3 const& c) { return std::size_t(c[0] + extent[0] * (c[1] + extent[1] * c[2])); };
    std::size_t const first_row = rows.size(), in_plane = std::size_t(extent[0]) * std::size_t(extent[1]);
    auto const for_each_in_metal = [&](auto const& cut, auto const& solid) {
      for (int k = 0; k < extent[2] && !kinds.empty(); ++k)
        mesh_.for_each_in_metal(
            l, int(b), k, Covered::visit,
            [&](CompositeMesh::CutHere const& here) {
              cut(k, std::size_t(here.place) + std::size_t(k) * in_plane, here);
            },
            [&](std::ptrdiff_t place, int n, int) { solid(std::size_t(place) + std::size_t(k) * in_plane, n); });
    };
    for_each_in_metal([&](int, std::size_t cell, auto const&) { kinds[cell] = CellKind::cut; },
                      [&](std::size_t cell, int n) { std::fill_n(&kinds[cell], n, CellKind::covered); });
    for (int c = of_box.covered.first; c < of_box.covered.last && !kinds.empty(); ++c)
      for_each_cell(plan.covered[std::size_t(c)], [&](Index3 const& cell) { kinds[number(cell)] = CellKind::covered; });
    for (int s = of_box.refined.first; s < of_box.refined.last && !kinds.empty(); ++s) {
      RefinedSide const& r = plan.refined[std::size_t(s)];
      for_each_cell(r.cells, [&](Index3 const& cell) {
        std::int32_t const flux = r.flux_at(cell);
        beside[number(cell)].push_back({r.fluxes.here ? flux : ~flux, r.axis, r.side});
      });
    }
    for (int k = 0; k < extent[2]; ++k)
      for (int j = 0; j < extent[1]; ++j) {
        CompositeRow row{std::int32_t(b), j, k, all_plain};
        if (of_box.is_fully_covered) {
          row.special = all_covered;
        } else if (!is_plain) {
          std::size_t const first = number({0, j, k}), last = first + std::size_t(extent[0]);
          auto const is_covered = [&](CellKind of) { return of == CellKind::covered; };
          bool const whole = std::all_of(&kinds[first], &kinds[last - 1] + 1, is_covered);
          bool any = false;
          for (std::size_t n = first; n < last; ++n) any = any || kinds[n] != CellKind::plain || !beside[n].empty();
          if (whole)
            row.special = all_covered;
          else if (any)
            row.special = std::int32_t(kind.size());
          for (std::size_t n = first; n < last && any && !whole; ++n) {
            first_refined.push_back(std::int32_t(refined.size()));
            kind.push_back(kinds[n]);
            if (kinds[n] == CellKind::plain) refined.insert(refined.end(), beside[n].begin(), beside[n].end());
          }
        }
        rows.push_back(row);
      }
    for_each_in_metal(
        [&](int k, std::size_t cell, CompositeMesh::CutHere const& here) {
          if (kinds[cell] == CellKind::covered) return;
          cuts.push_back(cut_cell(l, int(b), k, here, boxes[b]));
          std::size_t const row = cell / std::size_t(extent[0]);
          cuts.back().special = rows[first_row + row].special + std::int32_t(cell - row * std::size_t(extent[0]));
        },
        [](std::size_t, int) {});
  }
  first_refined.push_back(std::int32_t(refined.size()));
  level.rows = listed(rows), level.first_refined = listed(first_refined), level.kind = listed(kind);
  level.refined = listed(refined), level.cuts = listed(cuts);
  level.of_cut = Array<Real>("residuals of cut cells", cuts.empty() ? 0 : kind.size());
  bytes_ += level.of_cut.extent(0) * sizeof(Real);
}

/// Means of the level's cells for the coarser one, and what passes to and from the finer one.
void Composite::plan_exchanges(int l, OnLevel& level) {
  LevelPlan const& plan = mesh_.plan(l);
  level.finer_fluxes = RemoteBuffers(plan.finer_fluxes);
  std::vector<CopiedRun> received, fluxes;
  if (mesh_.hierarchy().has_finer(l)) {
    Families const& covered = mesh_.transfer().families(l);
    level.finer_means = RemoteBuffers(covered.means);
    for (RemoteFamily const& family : covered.remote)
      family.for_each_row([&](std::int32_t from, std::int32_t parent) {
        received.push_back({~from, 1, parent, family.parents[0]});
      });
  }
  level.received_means = listed(received);
  std::vector<ParentRun> families, sent;
  if (l > 0) {
    for (int b = 0; b < mesh_.boxes(l); ++b)
      for (Family const& family : mesh_.transfer().families(l - 1).of_box[std::size_t(b)]) {
        Index3 const pitch = mesh_.box(l, b).strides();
        std::int32_t const child =
            mesh_.offset(l, b) + family.child[0] + family.child[1] * pitch[1] + family.child[2] * pitch[2];
        for (int k = 0; k < family.parents[2]; ++k)
          for (int j = 0; j < family.parents[1]; ++j)
            families.push_back({family.parent + j * family.pitch_y + k * family.pitch_z,
                                child + 2 * (j * pitch[1] + k * pitch[2]), pitch[1], pitch[2], family.parents[0]});
      }
    std::int32_t to = 0;
    mesh_.transfer().families(l - 1).means.for_each_asked([&](int, Read const& read) {
      Box const &own = mesh_.level(l).box(read.owner), part = read.cells();
      amrpic::for_each_row(part, [&](Index3 const& parent) {
        std::int32_t const child =
            mesh_.level(l).local_offset(read.owner) + std::int32_t(own.offset(first_child_of(parent)));
        sent.push_back({to, child, own.strides()[1], own.strides()[2], part.extent(0)});
        to += part.extent(0);
      });
    });
    to = 0;
    mesh_.plan(l - 1).finer_fluxes.for_each_asked([&](int, Read const& read) {
      mesh_.for_each_flux_row_read(l, read, [&](std::int32_t first, int count) {
        fluxes.push_back({first, 1, to, count});
        to += count;
      });
    });
  }
  level.families = listed(families), level.sent_means = listed(sent), level.sent_fluxes = listed(fluxes);
}

// ---- potentials ----

void Composite::start(Source const& source, Field& phi, bool is_zero) {
  auto const mirror = [](auto const& values, Mirrored<Real>& out) {
    out.stand_for(const_cast<Real*>(values.data()), values.size());
  };
  for (int l = 0; l < mesh_.levels(); ++l) {
    OnLevel& level = levels_[std::size_t(l)];
    mirror(phi.level(l), level.phi), mirror(source.rho.level(l), level.rho);
    mirror(source.walls[std::size_t(l)].datum, level.datum);
    is_zero ? level.phi.zeros_to_device() : level.phi.to_device();
    level.rho.to_device(), level.datum.to_device();
  }
  potentials_ = on_device(source.potentials);
}

void Composite::walls_changed() {
  for (OnLevel const& level : levels_) level.datum.to_device();
}

void Composite::potential_to_host() const {
  for (OnLevel const& level : levels_) level.phi.to_host();
}

void Composite::potential_to_device() const {
  for (OnLevel const& level : levels_) level.phi.to_device();
}

namespace {

/// Copy runs of a level's values, or of what other ranks sent.
void copy(Array<CopiedRun> const& runs, Array<Real> const& own, Array<Real> const& received, Array<Real> const& to) {
  for_each_row(
      "copy rows", runs, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        CopiedRun const& run = runs(n);
        Real const* const from = run.from >= 0 ? own.data() + run.from : received.data() + ~run.from;
        Real* const out = to.data() + run.to;
        worker.for_each(run.count, [=](int i) { out[i] = from[i * run.stride]; });
      });
}

/// Set parents to the means of their children.
void average(Array<ParentRun> const& runs, Array<Real> const& children, Array<Real> const& parents) {
  for_each_row(
      "means of children", runs, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        ParentRun const& run = runs(n);
        Real const* const child = children.data() + run.child;
        Real* const parent = parents.data() + run.parent;
        worker.for_each(run.count,
                        [=](int i) { parent[i] = mean_of_children(child + 2 * i, run.pitch_y, run.pitch_z); });
      });
}

/// The numbers that a norm is made of, over the values of a row.
struct Sizes {
  Norm norm;
  Real factor;

  KOKKOS_INLINE_FUNCTION Real of(Real value) const {
    Real const size = factor * value < 0 ? -factor * value : factor * value;
    if (norm == Norm::max) return size <= std::numeric_limits<Real>::max() ? size : HUGE_VAL;  // not a number neither
    return norm == Norm::l1 ? size : size * size;
  }
  KOKKOS_INLINE_FUNCTION void join(Real& out, Real size) const {
    out = norm != Norm::max ? out + size : size > out ? size : out;
  }
  /// Of values that a thread of the host has found.
  Real of_all(Real const* values, int n) const {
    if (norm == Norm::max) {
      Largest<Real> largest;
      largest.add(values, n);
      return of(largest.value());
    }
    return Magnitude::sum_of(norm, values, n, factor);
  }
  /// Of what value(i, before, after) gives for the cells of a row of n, whose ends have values beyond them; those of a
  /// team's thread where there are teams.
  template <class T, class Value>
  KOKKOS_INLINE_FUNCTION Real over(Worker const& worker, int n, T const* here, T left, T right,
                                   Value const& value) const {
    Real out = 0;
    if constexpr (on_host) {
      Real values[cycle::chunk];
      for (int first = 0; first < n; first += cycle::chunk) {
        int const last = n < first + cycle::chunk ? n : first + cycle::chunk;
        along(first, last, n, here, left, right, [&](int i, T x, T y) { values[i - first] = value(i, x, y); });
        join(out, of_all(values, last - first));
      }
    } else {
      worker.for_each(
          n, [&](int i) { join(out, of(value(i, i > 0 ? here[i - 1] : left, i + 1 < n ? here[i + 1] : right))); });
    }
    return out;
  }
};

}  // namespace

/// Around the boxes of a level, and the differences before coarser cells. Copies have come.
void Composite::fill_ghosts(int l) {
  OnLevel const level = levels_[std::size_t(l)];
  auto const phi = level.phi.array(), received = cells_.received();
  copy(level.neighbours, phi, received, level.ghosts);

  std::array<WallGhost, 6> of_face;
  for (int f = 0; f < 6; ++f)
    of_face[std::size_t(f)] = wall_ghost(mesh_.hierarchy().domain().boundary[std::size_t(f / 2)][std::size_t(f % 2)],
                                         mesh_.level(l).spacing()[std::size_t(f / 2)]);
  for_each_row(
      "ghosts at walls", level.walls, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        WallRun const& run = level.walls(n);
        WallGhost const rule = of_face[std::size_t(run.face)];
        Real const *const cell = phi.data() + run.cell, *const given = level.datum.array().data() + run.datum;
        Real* const out = level.ghosts.data() + run.ghost;
        worker.for_each(run.count, [=](int i) {
          Real const* const first = cell + i * run.stride;
          out[i] = rule(first[0], first[run.inward], given[i]);
        });
      });

  if (l == 0) return;
  auto const coarser = levels_[std::size_t(l) - 1].phi.array();
  copy(level.coarse, coarser, received, level.planes);
  auto const fits = fits_;
  for_each(
      "ghosts at coarser cells", level.faces, KOKKOS_LAMBDA(std::int32_t n) {
        CoarseFace const& face = level.faces(n);
        SideBehind const& side = level.sides(face.side);
        FourStars<Real> stars{};
        if (face.fit >= 0) {
          stars = fits.stars(face.fit, level.planes.data() + face.plane, 1, side.plane_v);
        } else {
          auto const value = [&](Array<Real> const& own, std::int32_t at) { return at >= 0 ? own(at) : received(~at); };
          level.gaps_coarse.add(~face.fit, stars, [&](std::int32_t at) { return value(coarser, at); });
          level.gaps_fine.add(~face.fit, stars, [&](std::int32_t at) { return value(phi, at); });
        }
        level.fluxes(face.flux) = side.fine.set_ghosts(stars, &phi(face.cell), &level.ghosts(face.ghost));
      });
  fill_ghosts_beside_metal(l);
}

/// The same for the faces that metal makes others.
void Composite::fill_ghosts_beside_metal(int l) {
  OnLevel const level = levels_[std::size_t(l)];
  auto const phi = level.phi.array(), potentials = potentials_;
  for_each(
      "ghosts beside metal", level.beside_metal, KOKKOS_LAMBDA(std::int32_t n) {
        auto const& [face, ghosts] = level.beside_metal(n);
        FourStars<Real> stars{};
        level.metal_terms.add(n, stars, [&](std::int32_t at) { return at >= 0 ? level.planes(at) : potentials(~at); });
        level.fluxes(face.flux) =
            ghosts.set(level.sides(face.side).fine, stars, &phi(face.cell), &level.ghosts(face.ghost));
      });
}

/// Into `of_cut`. Ghosts and fluxes are there.
void Composite::residuals_of_cut_cells(int l, Background const& background) {
  OnLevel const level = levels_[std::size_t(l)];
  auto const phi = level.phi.array(), potentials = potentials_, received = level.finer_fluxes.received();
  auto const fluxes = l + 1 < mesh_.levels() ? levels_[std::size_t(l) + 1].fluxes : Array<Real>();
  for_each(
      "residuals of cut cells", level.cuts, KOKKOS_LAMBDA(std::int32_t n) {
        CutCellPlace const& cut = level.cuts(n);
        Real const here = phi(cut.cell);
        Real sum = -cut.row.diagonal * here, of_surfaces = 0;
        for (std::size_t side = 0; side < 6; ++side) {
          std::int32_t const at = cut.beyond[side], datum = cut.datum[side];
          if (cut.row.neighbour(side) != 0) {
            Real const beyond = cut.in[side] == CutCellPlace::In::cells    ? phi(at)
                                : cut.in[side] == CutCellPlace::In::ghosts ? level.ghosts(at)
                                : cut.in[side] == CutCellPlace::In::fluxes ? here + fine_face_weight * fluxes(at)
                                                                           : here + fine_face_weight * received(at);
            sum += cut.row.neighbour(side) * beyond;
          }
          if (cut.row.surface(side) != 0)
            of_surfaces += cut.row.surface(side) * (datum >= 0 ? potentials(datum) : level.datum.array()(~datum));
        }
        level.of_cut(cut.special) =
            cut.row.scale * background.right_hand_side(level.rho.array()(cut.cell)) - sum - of_surfaces;
      });
}

Real Composite::residual(Background const& background, Norm norm, std::vector<Real> const& scale) {
  for (OnLevel const& level : levels_) copy(level.sent_cells, level.phi.array(), level.phi.array(), cells_.sent());
  cells_.pass(mesh_.plan().cells);
  for (int l = mesh_.levels() - 1; l >= 0; --l) {
    fill_ghosts(l);
    if (l == 0) continue;
    OnLevel const& coarser = levels_[std::size_t(l) - 1];
    copy(levels_[std::size_t(l)].sent_fluxes, levels_[std::size_t(l)].fluxes, levels_[std::size_t(l)].fluxes,
         coarser.finer_fluxes.sent());
    coarser.finer_fluxes.pass(mesh_.plan(l - 1).finer_fluxes);
  }
  Magnitude magnitude(norm);
  for (int l = 0; l < mesh_.levels(); ++l) {
    residuals_of_cut_cells(l, background);
    auto const measured = [&](Norm by, Real factor) {
      return residual_of_level(l, background, by, factor, scale[std::size_t(l)]);
    };
    magnitude.add_by([&] { return measured(Norm::max, 1); }, [&](Real factor) { return measured(norm, factor); },
                     mesh_.volume(l));
  }
  return magnitude.over(mesh_.comm());
}

/// The residual of a level into the cycle's right-hand side, zero in covered cells; returns what a norm of `factor`
/// times it is made of.
Real Composite::residual_of_level(int l, Background const& background, Norm norm, Real factor, Real scale) {
  OnLevel const level = levels_[std::size_t(l)];
  kernels::Residual const formula{mesh_.equation(l), background, mesh_.is_nearly_free(l)};
  Sizes const sizes{norm, factor};
  auto const r = swept_[std::size_t(l)]->right_hand_side().array();
  bool const has_finer = l + 1 < mesh_.levels();
  auto const fluxes = has_finer ? levels_[std::size_t(l) + 1].fluxes : Array<Real>(),
             received = level.finer_fluxes.received();
  return reduced(
      "residual", level.rows, norm == Norm::max, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n)->double {
        CompositeRow const& row = level.rows(n);
        CompositeBox const& box = level.boxes(row.box);
        int const nx = box.extent[0], ny = box.extent[1], nz = box.extent[2], j = row.j, k = row.k;
        float* const out = r.data() + box.origin + j * box.pitch_y + k * box.pitch_z;
        if (row.special == all_covered) {
          worker.for_each(nx, [=](int i) { out[i] = 0; });
          return 0;
        }
        std::int32_t const at = box.first + nx * (j + ny * k);
        Real const *const c = level.phi.array().data() + at, *const charge = level.rho.array().data() + at;
        auto const ghost = [&](int face, std::int32_t place) {
          return level.ghosts.data() + box.ghosts[std::size_t(face)] + place;
        };
        Real const *const ym = j > 0 ? c - nx : ghost(2, k * nx), *const yp = j + 1 < ny ? c + nx : ghost(3, k * nx);
        Real const *const zm = k > 0 ? c - nx * ny : ghost(4, j * nx), *const zp =
                                                                           k + 1 < nz ? c + nx * ny : ghost(5, j * nx);
        Real const xm = *ghost(0, j + k * ny), xp = *ghost(1, j + k * ny);
        // With the fluxes of the finer level through the faces of refined cells, in place of the differences across.
        auto const beside_finer = [&](int i, Real before, Real after, Real value) {
          std::int32_t const cell = row.special + i;
          if (level.kind(cell) == CellKind::covered) return Real(0);
          if (level.kind(cell) == CellKind::cut) return level.of_cut(cell);
          for (std::int32_t f = level.first_refined(cell); f < level.first_refined(cell + 1); ++f) {
            RefinedFace const& face = level.refined(f);
            Real const flux = face.flux >= 0 ? fluxes(face.flux) : received(~face.flux);
            Real const beyond = face.axis == 0   ? (face.side == 0 ? before : after)
                                : face.axis == 1 ? (face.side == 0 ? ym[i] : yp[i])
                                                 : (face.side == 0 ? zm[i] : zp[i]);
            value -= formula.equation.weight[std::size_t(face.axis)] * (fine_face_weight * flux - (beyond - c[i]));
          }
          return value;
        };
        // Loops over whole vectors ask for nothing that is the same in all cells.
        auto const of_row = [&](auto differences, auto plain) {
          return sizes.over(worker, nx, c, xm, xp, [=](int i, Real before, Real after) {
            Real value = formula.find<differences()>(charge[i], c[i], before, after, ym[i], yp[i], zm[i], zp[i]);
            if constexpr (!plain()) value = beside_finer(i, before, after, value);
            out[i] = float(scale * value);
            return value;
          });
        };
        auto const by = [&](auto differences) {
          return row.special == all_plain ? of_row(differences, std::true_type())
                                          : of_row(differences, std::false_type());
        };
        return formula.in_differences ? by(std::true_type()) : by(std::false_type());
      });
}

Real Composite::add(Real scale) {
  Real largest = 0;
  for (int l = mesh_.levels() - 1; l >= 0; --l) {
    OnLevel const level = levels_[std::size_t(l)];
    auto const e = swept_[std::size_t(l)]->correction().array();
    Sizes const sizes{Norm::max, 1};
    largest = std::max(
        largest, reduced(
                     "add correction", level.rows, true, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n)->double {
                       CompositeRow const& row = level.rows(n);
                       CompositeBox const& box = level.boxes(row.box);
                       float const* const from = e.data() + box.origin + row.j * box.pitch_y + row.k * box.pitch_z;
                       Real* const to =
                           level.phi.array().data() + box.first + box.extent[0] * (row.j + box.extent[1] * row.k);
                       int const nx = box.extent[0];
                       auto const add = [=](int i, float, float) {
                         to[i] = fused(scale, Real(from[i]), to[i]);
                         return Real(from[i]);
                       };
                       if (row.special == all_plain) return sizes.over(worker, nx, from, 0.0f, 0.0f, add);
                       return sizes.over(worker, nx, from, 0.0f, 0.0f, [&](int i, float before, float after) {
                         bool const counts = row.special >= 0 && level.kind(row.special + i) != CellKind::covered;
                         return counts ? add(i, before, after) : Real(from[i]);
                       });
                     }));
  }
  for (int l = mesh_.levels() - 1; l > 0; --l) {
    OnLevel const &level = levels_[std::size_t(l)], &coarser = levels_[std::size_t(l) - 1];
    average(level.families, level.phi.array(), coarser.phi.array());
    average(level.sent_means, level.phi.array(), coarser.finer_means.sent());
    coarser.finer_means.pass(mesh_.transfer().families(l - 1).means);
    copy(coarser.received_means, coarser.phi.array(), coarser.finer_means.received(), coarser.phi.array());
  }
  return std::abs(scale) * largest;
}

}  // namespace amrpic::kokkos
