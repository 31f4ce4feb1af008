#include "matrixfree/composite_plan.hpp"

#include <algorithm>

namespace amrpic {

namespace {

/// The smallest box that holds the cells with a fit, of which there are some.
Box cells_with_fit(ArrayOnBox<FitNumber> const& fits) {
  Box out = fits.box();
  auto has_fit = [&](Box const& part) {
    bool any = false;
    for_each_cell(part, [&](Index3 const& cell) { any = any || fits(cell) != no_fit; });
    return any;
  };
  for (int d = 0; d < 3; ++d) {
    while (!has_fit(out.layer(d, 0, 0))) ++out.lower[d];
    while (!has_fit(out.layer(d, 1, 0))) --out.upper[d];
  }
  return out;
}

/// Makes the lists of one level of this rank.
class LevelPlanner {
 public:
  LevelPlanner(Hierarchy const& hierarchy, int l, Imports& cells, LevelPlan& out)
      : l_(l),
        level_(hierarchy.level(l)),
        faces_(hierarchy.faces(l)),
        coarser_(l > 0 ? &hierarchy.level(l - 1) : nullptr),
        finer_(hierarchy.has_finer(l) ? &hierarchy.level(l + 1) : nullptr),
        cells_(cells),
        out_(out) {}

  /// Faces and interfaces; the finer level comes later, when its interfaces are known.
  void plan_faces() {
    number_walls();
    for (std::size_t b = 0; b < faces_.size(); ++b) {
      box_ = faces_[b].box;
      plan_ = &out_.boxes[b];
      if (faces_[b].ends_level()) {
        Box const behind = box_.coarsen(refinement_ratio).grow(2);
        coarse_near_ = overlaps(*coarser_, behind);
        refined_near_ = overlaps(level_, behind.refine(refinement_ratio));
      }
      for (std::size_t f = 0; f < 6; ++f) plan_face(plan_->faces[f], faces_[b].sides[f], int(f) / 2);
    }
  }

  /// Covered parts, fluxes and means from the finer level, whose faces are planned.
  void plan_refinement(LevelPlan& fine) {
    std::vector<std::pair<int, Family>> families;
    for (std::size_t b = 0; b < faces_.size(); ++b) {
      box_ = faces_[b].box;
      plan_ = &out_.boxes[b];
      plan_->covered.first = std::int32_t(out_.covered.size());
      for (Overlap const& o : faces_[b].covered) {
        out_.covered.push_back(counted_from_first(o.part));
        plan_means(level_.first_local_box() + int(b), o.box, o.part, families);
      }
      plan_->covered.last = std::int32_t(out_.covered.size());
      plan_->is_fully_covered = faces_[b].is_fully_covered();
      plan_->refined.first = std::int32_t(out_.refined.size());
      for (FinerNeighbour const& n : faces_[b].beside) plan_refined_side(fine, n);
      plan_->refined.last = std::int32_t(out_.refined.size());
    }
    std::stable_sort(families.begin(), families.end(), [](auto const& a, auto const& b) { return a.first < b.first; });
    for (auto const& [b, family] : families) {
      Range& range = fine.boxes[std::size_t(b - finer_->first_local_box())].families;
      if (range.empty()) range.first = range.last = std::int32_t(fine.families.size());
      fine.families.push_back(family);
      ++range.last;
    }
  }

 private:
  static Box counted_from(Index3 const& first, Box const& part) {
    return part.shift({-first[0], -first[1], -first[2]});
  }
  Box counted_from_first(Box const& part) const { return counted_from(box_.lower, part); }

  /// Wall data come by axis, side and box, each face's by its lower axis first.
  void number_walls() {
    out_.boxes.resize(faces_.size());
    int place = 0;
    for (std::size_t f = 0; f < 6; ++f)
      for (std::size_t b = 0; b < faces_.size(); ++b) {
        Face const& face = faces_[b].sides[f];
        if (!face.is_wall) continue;
        out_.boxes[b].faces[f].wall = place;
        place += int(face.layer.cells());
      }
  }

  void plan_face(FacePlan& plan, Face const& face, int axis) {
    if (face.is_wall) return;
    plan.neighbours.first = std::int32_t(out_.neighbours.size());
    for (Overlap const& o : face.neighbours)
      out_.neighbours.push_back(rectangle(level_, l_, o, axis, face.layer.lower));
    plan.neighbours.last = std::int32_t(out_.neighbours.size());
    if (!face.has_coarser) return;
    plan.interface = int(out_.interfaces.size());
    out_.interfaces.push_back(interface_at(fits_behind(face, axis, coarse_near_, refined_near_), axis));
  }

  /// The interface where coarser cells lie behind a face across an axis.
  Interface interface_at(ArrayOnBox<FitNumber> const& fits, int axis) {
    auto const [u, v] = tangential_axes(axis);
    Box const region = cells_with_fit(fits);
    Interface out{};
    out.u = region.lower[u] - fits.box().lower[u], out.nu = region.extent(u);
    out.v = region.lower[v] - fits.box().lower[v], out.nv = region.extent(v);
    out.fits = std::int32_t(out_.fits.size());
    out.fluxes = out_.fluxes;
    for_each_cell(region, [&](Index3 const& cell) { out_.fits.push_back(fits(cell)); });
    for_each_run(&out_.fits[std::size_t(out.fits)], out.nu * out.nv,
                 [&](int, int, FitNumber fit) { out.margin = std::max(out.margin, numbered_fit(fit).reach); });
    out_.fluxes += out.nu * out.nv;
    out.coarse.first = std::int32_t(out_.coarse.size());
    Index3 margin{out.margin, out.margin, out.margin};
    margin[axis] = 0;
    Box const read = region.grow(margin);
    for (Overlap const& o : coarse_near_) {
      Box const part = o.part.intersect(read);
      if (!part.empty()) out_.coarse.push_back(rectangle(*coarser_, l_ - 1, {o.box, part, o.shift}, axis, read.lower));
    }
    out.coarse.last = std::int32_t(out_.coarse.size());
    return out;
  }

  /// The part of a plane that a box covers, placed from `origin`.
  Rectangle rectangle(Level const& level, int l, Overlap const& o, int axis, Index3 const& origin) {
    auto const [u, v] = tangential_axes(axis);
    Rectangle out{};
    out.u = o.part.lower[u] - origin[u], out.v = o.part.lower[v] - origin[v];
    out.nu = o.part.extent(u), out.nv = o.part.extent(v);
    Box const own = o.in_box();
    Box const& box = level.box(o.box);
    int const owner = level.owner(o.box);
    if (owner == level.rank()) {
      Index3 const pitch{1, box.extent(0), box.extent(0) * box.extent(1)};
      out.owner = Rectangle::here;
      out.from = level.local_offset(o.box) + std::int32_t(box.offset(own.lower));
      out.pu = pitch[u], out.pv = pitch[v];
    } else {
      out.owner = owner;
      out.from = cells_.ask(owner, {l, o.box, -1, own});
      out.pu = 1, out.pv = out.nu;
      plan_->remote = true;
    }
    return out;
  }

  void plan_means(int b, int fine_box, Box const& part, std::vector<std::pair<int, Family>>& families) {
    std::int32_t const parent = level_.local_offset(b) + std::int32_t(box_.offset(part.lower));
    std::int32_t const pitch_y = box_.extent(0), pitch_z = box_.extent(0) * box_.extent(1);
    Index3 const parents{part.extent(0), part.extent(1), part.extent(2)};
    int const owner = finer_->owner(fine_box);
    if (owner == level_.rank()) {
      Box const child = counted_from(finer_->box(fine_box).lower, part.refine(refinement_ratio));
      families.push_back({fine_box, {parent, pitch_y, pitch_z, child.lower, parents}});
    } else {
      std::int32_t const from = out_.finer_means.ask(owner, {l_ + 1, fine_box, -1, part});
      out_.remote_means.push_back({owner, from, parent, pitch_y, pitch_z, parents});
    }
  }

  void plan_refined_side(LevelPlan const& fine, FinerNeighbour const& n) {
    auto const [u, v] = tangential_axes(n.axis);
    Box const own = n.cells.in_box();
    int const face = 2 * n.axis + 1 - n.side, owner = finer_->owner(n.cells.box);  // the finer box's face
    Rectangle fluxes{owner, 0, 1, own.extent(u), 0, 0, own.extent(u), own.extent(v)};
    if (owner == level_.rank()) {
      auto const& box = fine.boxes[std::size_t(n.cells.box - finer_->first_local_box())];
      Interface const& i = fine.interfaces[std::size_t(box.faces[std::size_t(face)].interface)];
      Box const parents = finer_->box(n.cells.box).coarsen(refinement_ratio);
      fluxes.owner = Rectangle::here;
      fluxes.from = i.fluxes + (own.lower[u] - parents.lower[u] - i.u) + i.nu * (own.lower[v] - parents.lower[v] - i.v);
      fluxes.pv = i.nu;
    } else {
      fluxes.from = out_.finer_fluxes.ask(owner, {l_ + 1, n.cells.box, face, own});
    }
    out_.refined.push_back({n.axis, n.side, counted_from_first(n.cells.part), fluxes});
  }

  int l_;
  Level const& level_;
  LevelFaces const& faces_;
  Level const* coarser_;
  Level const* finer_;
  Imports& cells_;
  LevelPlan& out_;
  // of the box under way
  Box box_;
  BoxPlan* plan_ = nullptr;
  std::vector<Overlap> coarse_near_, refined_near_;  ///< coarser cells around it, and those that this level refines
};

template <class T>
std::size_t bytes_of(std::vector<T> const& list) {
  return list.capacity() * sizeof(T);
}

}  // namespace

CompositePlan::CompositePlan(Hierarchy const& hierarchy) : levels(std::size_t(hierarchy.level_count())) {
  for (int l = hierarchy.level_count() - 1; l >= 0; --l) {
    LevelPlan& plan = levels[std::size_t(l)];
    LevelPlanner planner(hierarchy, l, cells, plan);
    planner.plan_faces();
    if (!hierarchy.has_finer(l)) continue;
    planner.plan_refinement(levels[std::size_t(l) + 1]);
    plan.finer_fluxes.connect(hierarchy.comm());
    plan.finer_means.connect(hierarchy.comm());
  }
  cells.connect(hierarchy.comm());
}

std::int64_t CompositePlan::messages() const {
  std::int64_t sum = cells.messages();
  for (auto const& l : levels) sum += l.finer_fluxes.messages() + l.finer_means.messages();
  return sum;
}

std::int64_t CompositePlan::message_bytes() const {
  std::int64_t sum = cells.bytes();
  for (auto const& l : levels) sum += l.finer_fluxes.bytes() + l.finer_means.bytes();
  return sum;
}

std::size_t CompositePlan::bytes() const {
  std::size_t sum = cells.memory();
  for (auto const& l : levels)
    sum += bytes_of(l.boxes) + bytes_of(l.neighbours) + bytes_of(l.interfaces) + bytes_of(l.coarse) + bytes_of(l.fits) +
           bytes_of(l.covered) + bytes_of(l.refined) + bytes_of(l.families) + bytes_of(l.remote_means) +
           l.finer_fluxes.memory() + l.finer_means.memory();
  return sum;
}

}  // namespace amrpic
