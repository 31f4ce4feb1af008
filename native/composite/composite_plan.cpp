#include "composite/composite_plan.hpp"

#include <algorithm>

namespace amrpic {

namespace {

/// Makes the lists of one level of this rank.
class LevelPlanner {
 public:
  LevelPlanner(Hierarchy const& hierarchy, int l, RemoteReads const& cells, GapFits& gap_fits, int margin,
               LevelPlan& out)
      : l_(l),
        margin_(margin),
        level_(hierarchy.level(l)),
        faces_(hierarchy.faces(l)),
        coarser_(l > 0 ? &hierarchy.level(l - 1) : nullptr),
        finer_(hierarchy.has_finer(l) ? &hierarchy.level(l + 1) : nullptr),
        cells_(cells),
        gap_fits_(gap_fits),
        out_(out) {}

  /// Faces and interfaces; the finer level comes later, when its interfaces are known.
  void plan_faces() {
    out_.boxes.resize(faces_.size());
    for_each_wall(level_, [&](int b, int axis, int side, GlobalIndex first) {
      out_.boxes[std::size_t(b - level_.first_local_box())].faces[std::size_t(2 * axis + side)].wall = int(first);
    });
    for (std::size_t b = 0; b < faces_.size(); ++b) {
      number_ = level_.first_local_box() + int(b);
      box_ = faces_[b].box;
      plan_ = &out_.boxes[b];
      if (faces_[b].ends_level()) {
        Box const behind = box_.coarsen(refinement_ratio).grow(2);
        coarse_near_ = overlaps(*coarser_, behind);
        refined_near_ = overlaps(level_, behind.refine(refinement_ratio));
      }
      for (int f = 0; f < 6; ++f) plan_face(plan_->faces[std::size_t(f)], faces_[b].sides[std::size_t(f)], f);
    }
  }

  /// Covered parts, and fluxes from the finer level, whose faces are planned.
  void plan_refinement(LevelPlan const& fine) {
    for (std::size_t b = 0; b < faces_.size(); ++b) {
      number_ = level_.first_local_box() + int(b);
      box_ = faces_[b].box;
      plan_ = &out_.boxes[b];
      plan_->covered.first = std::int32_t(out_.covered.size());
      for (Overlap const& o : faces_[b].covered) out_.covered.push_back(counted(o.part));
      plan_->covered.last = std::int32_t(out_.covered.size());
      plan_->is_fully_covered = faces_[b].is_fully_covered();
      plan_->refined.first = std::int32_t(out_.refined.size());
      for (std::size_t n = 0; n < faces_[b].beside.size(); ++n) plan_refined_side(fine, int(n), faces_[b].beside[n]);
      plan_->refined.last = std::int32_t(out_.refined.size());
    }
  }

 private:
  Box counted(Box const& part) const { return part.shift_back(box_.lower); }

  void plan_face(FacePlan& plan, Face const& face, int f) {
    if (face.is_wall) return;
    plan.neighbours.first = std::int32_t(out_.neighbours.size());
    for (Overlap const& o : face.neighbours) out_.neighbours.push_back(rectangle(l_, o, f, face.layer.lower));
    plan.neighbours.last = std::int32_t(out_.neighbours.size());
    if (!face.has_coarser) return;
    plan.interface = int(out_.interfaces.size());
    out_.interfaces.push_back(interface_at(fits_behind(face, f / 2, coarse_near_, refined_near_), f));
  }

  /// The interface where coarser cells lie behind a face.
  Interface interface_at(ArrayOnBox<FitNumber> const& fits, int f) {
    int const axis = f / 2;
    auto const [u, v] = tangential_axes(axis);
    Box const region = hull_of_fits(fits, [](FitNumber fit) { return fit != no_fit; });
    Interface out{};
    out.margin = margin_;
    out.u = region.lower[u] - fits.box().lower[u], out.nu = region.extent(u);
    out.v = region.lower[v] - fits.box().lower[v], out.nv = region.extent(v);
    out.fits = std::int32_t(out_.fits.size());
    out.fluxes = out_.fluxes;
    for_each_cell(region, [&](Index3 const& cell) { out_.fits.push_back(fits(cell)); });
    for_each_run(&out_.fits[std::size_t(out.fits)], out.nu * out.nv, [&](int, int, FitNumber fit) {
      if (fit != fit_in_gap) out.margin = std::max(out.margin, numbered_fit(fit).reach);
    });
    out_.fluxes += out.nu * out.nv;
    out.coarse.first = std::int32_t(out_.coarse.size());
    Index3 margin{out.margin, out.margin, out.margin};
    margin[axis] = 0;
    Box const read = region.grow(margin);
    for (Overlap const& o : coarse_near_) {
      Box const part = o.part.intersect(read);
      if (!part.empty()) out_.coarse.push_back(rectangle(l_ - 1, {o.box, part, o.shift}, f, read.lower));
    }
    out.coarse.last = std::int32_t(out_.coarse.size());
    Box const gaps = hull_of_fits(fits, [](FitNumber fit) { return fit == fit_in_gap; });
    if (!gaps.empty()) {
      out.gaps = int(out_.gaps.size());
      out_.gaps.push_back(gaps_at(fits, gaps.grow(1), f));
    }
    return out;
  }

  /// The fits in gaps behind a face, `coarse` around them.
  Gaps gaps_at(ArrayOnBox<FitNumber> const& fits, Box const& coarse, int f) {
    Gaps out{coarse, {}, {}, std::int32_t(out_.fits_in_gaps.size())};
    out.coarse_parts = parts_of_region(l_ - 1, coarse_near_, coarse, f);
    if (gap_fits_take_fine_cells(level_))
      out.parts = parts_of_region(l_, refined_near_, coarse.refine(refinement_ratio), f);
    GapCells const cells(level_, coarse, coarse_near_, refined_near_, finer_);
    for_each_cell(fits.box(), [&](Index3 const& cell) {
      if (fits(cell) == fit_in_gap) out_.fits_in_gaps.push_back(&gap_fits_(cells.around(cell), f / 2));
    });
    return out;
  }

  /// The parts of a region that boxes of level l hold.
  Range parts_of_region(int l, std::vector<Overlap> const& near, Box const& region, int f) {
    Range out{std::int32_t(out_.region_parts.size()), 0};
    Level const& level = l == l_ ? level_ : *coarser_;
    for (Overlap const& o : near) {
      Overlap const met{o.box, o.part.intersect(region), o.shift};
      if (met.part.empty()) continue;
      int const purpose = l == l_ ? CompositePlan::around_gaps(l) : CompositePlan::behind_gaps(l);
      out_.region_parts.push_back(part_of(cells_, purpose, level, number_, f, met));
      plan_->remote = plan_->remote || !out_.region_parts.back().here;
    }
    out.last = std::int32_t(out_.region_parts.size());
    return out;
  }

  /// The part of the plane beyond face f that a box of level l covers, placed from `origin`.
  Rectangle rectangle(int l, Overlap const& o, int f, Index3 const& origin) {
    int const purpose = l == l_ ? CompositePlan::as_neighbours(l) : CompositePlan::behind_edges(l);
    RegionPart const part = part_of(cells_, purpose, l == l_ ? level_ : *coarser_, number_, f, o);
    plan_->remote = plan_->remote || !part.here;
    return part.across(f / 2, origin);
  }

  void plan_refined_side(LevelPlan const& fine, int number, FinerNeighbour const& n) {
    auto const [u, v] = tangential_axes(n.axis);
    Box const own = n.cells.in_box();
    int const face = 2 * n.axis + 1 - n.side;  // the finer box's
    bool const here = finer_->owner(n.cells.box) == level_.rank();
    Rectangle fluxes{here, 0, 1, 0, 0, 0, own.extent(u), own.extent(v)};
    plan_->remote = plan_->remote || !here;
    if (here) {
      auto const& box = fine.boxes[std::size_t(n.cells.box - finer_->first_local_box())];
      Interface const& i = fine.interfaces[std::size_t(box.faces[std::size_t(face)].interface)];
      Box const parents = finer_->box(n.cells.box).coarsen(refinement_ratio);
      fluxes.from = i.fluxes + (own.lower[u] - parents.lower[u] - i.u) + i.nu * (own.lower[v] - parents.lower[v] - i.v);
      fluxes.pv = i.nu;
    } else {
      fluxes = part_of(out_.finer_fluxes, 0, *finer_, number_, 6 * number + face, n.cells)
                   .across(n.axis, n.cells.part.lower);
    }
    out_.refined.push_back({n.axis, n.side, counted(n.cells.part), fluxes});
  }

  int l_, margin_;
  Level const& level_;
  LevelFaces const& faces_;
  Level const* coarser_;
  Level const* finer_;
  RemoteReads const& cells_;
  GapFits& gap_fits_;
  LevelPlan& out_;
  // of the box under way
  int number_ = 0;
  Box box_;
  BoxPlan* plan_ = nullptr;
  std::vector<Overlap> coarse_near_, refined_near_;  ///< coarser cells around it, and those that this level refines
};

template <class T>
std::size_t bytes_of(std::vector<T> const& list) {
  return list.capacity() * sizeof(T);
}

}  // namespace

void Rectangle::copy(Real const* own, Real const* remote, Real* to, std::ptrdiff_t pitch) const {
  Real const* row = (here ? own : remote) + from;
  to += u + pitch * v;
  for (int j = 0; j < nv; ++j, row += pv, to += pitch) {
    if (pu == 1)
      std::copy_n(row, nu, to);
    else
      for (int i = 0; i < nu; ++i) to[i] = row[std::ptrdiff_t(i) * pu];
  }
}

RegionPart part_of(RemoteReads const& cells, int purpose, Level const& level, int reader, int region,
                   Overlap const& o) {
  if (level.owner(o.box) != level.rank()) {
    RemoteReads::Values const values = cells.find(purpose, reader, region, o.box, o.shift, o.part);
    return {false, values.from, values.pitch_y, values.pitch_z, o.part};
  }
  Box const& box = level.box(o.box);
  Index3 const pitch = box.strides();
  return {true, level.local_offset(o.box) + std::int32_t(box.offset(o.in_box().lower)), pitch[1], pitch[2], o.part};
}

Rectangle RegionPart::across(int axis, Index3 const& origin) const {
  auto const [u, v] = tangential_axes(axis);
  Index3 const pitch{1, pitch_y, pitch_z};
  return {here,           from,          pitch[u], pitch[v], part.lower[u] - origin[u], part.lower[v] - origin[v],
          part.extent(u), part.extent(v)};
}

CompositePlan::CompositePlan(Hierarchy const& hierarchy, int margin) : levels(std::size_t(hierarchy.level_count())) {
  Communicator const& comm = hierarchy.comm();
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    cells.add(as_neighbours(l), reads_beyond_faces(level));
    if (l > 0) {
      Level const& coarser = hierarchy.level(l - 1);
      cells.add(behind_edges(l - 1), reads_behind_edges(level, hierarchy.faces(l), coarser));
      cells.add(behind_gaps(l - 1), coarse_reads_in_gaps(level, hierarchy.faces(l), coarser));
      cells.add(around_gaps(l), fine_reads_in_gaps(level, hierarchy.faces(l), coarser));
    }
    if (!hierarchy.has_finer(l)) continue;
    Level const& finer = hierarchy.level(l + 1);
    LevelPlan& plan = levels[std::size_t(l)];
    plan.finer_fluxes.add(0, reads_of_fine_fluxes(level, hierarchy.faces(l), finer));
    plan.finer_fluxes.plan(comm);
  }
  cells.plan(comm);
  for (int l = hierarchy.level_count() - 1; l >= 0; --l) {
    LevelPlanner planner(hierarchy, l, cells, *gap_fits, margin, levels[std::size_t(l)]);
    planner.plan_faces();
    if (hierarchy.has_finer(l)) planner.plan_refinement(levels[std::size_t(l) + 1]);
  }
}

std::size_t CompositePlan::bytes() const {
  std::size_t sum = cells.memory() + gap_fits->bytes();
  for (auto const& l : levels)
    sum += bytes_of(l.boxes) + bytes_of(l.neighbours) + bytes_of(l.interfaces) + bytes_of(l.coarse) + bytes_of(l.fits) +
           bytes_of(l.gaps) + bytes_of(l.region_parts) + bytes_of(l.fits_in_gaps) + bytes_of(l.covered) +
           bytes_of(l.refined) + l.finer_fluxes.memory();
  return sum;
}

}  // namespace amrpic
