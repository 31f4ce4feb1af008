#include "matrixfree/composite_plan.hpp"

#include <algorithm>

namespace amrpic {

namespace {

Box moved(Box const& box, Index3 const& shift, int sign) {
  return box.shift({sign * shift[0], sign * shift[1], sign * shift[2]});
}

/// The layer of cells just beyond a face of a box.
Box beyond(Box const& box, int axis, int side) {
  Box out = box;
  out.lower[axis] = out.upper[axis] = side == 0 ? box.lower[axis] - 1 : box.upper[axis] + 1;
  return out;
}

/// Flags on a rectangle of cells in a plane.
class Mask {
 public:
  Mask(Box const& plane, int axis, char value)
      : lower_(plane.lower), axes_(tangential_axes(axis)), nu_(plane.extent(axes_[0])), nv_(plane.extent(axes_[1])) {
    flags_.assign(std::size_t(nu_) * std::size_t(nv_), value);
  }
  void set(Box const& part, char value) {
    auto const [u, v] = axes_;
    for (int b = part.lower[v]; b <= part.upper[v]; ++b)
      std::fill_n(&at(part.lower[u] - lower_[u], b - lower_[v]), part.extent(u), value);
  }
  char& at(int u, int v) { return flags_[std::size_t(u) + std::size_t(nu_) * std::size_t(v)]; }
  char at(int u, int v) const { return flags_[std::size_t(u) + std::size_t(nu_) * std::size_t(v)]; }
  int nu() const { return nu_; }
  int nv() const { return nv_; }

  /// Call f(u, v, nu, nv) for rectangles that make up the cells with a flag.
  template <class F>
  void for_each_rectangle(F&& f) {
    for (int v = 0; v < nv_; ++v)
      for (int u = 0; u < nu_; ++u) {
        if (!at(u, v)) continue;
        int n = 1, m = 1;
        while (u + n < nu_ && at(u + n, v)) ++n;
        while (v + m < nv_ && std::all_of(&at(u, v + m), &at(u, v + m) + n, [](char c) { return c != 0; })) ++m;
        for (int b = v; b < v + m; ++b) std::fill_n(&at(u, b), n, 0);
        f(u, v, n, m);
      }
  }

 private:
  Index3 lower_;
  std::array<int, 2> axes_;
  int nu_, nv_;
  std::vector<char> flags_;
};

/// Makes the lists of one level of this rank.
class LevelPlanner {
 public:
  LevelPlanner(Hierarchy const& hierarchy, int l, Imports& cells, LevelPlan& out)
      : l_(l),
        level_(hierarchy.level(l)),
        coarser_(l > 0 ? &hierarchy.level(l - 1) : nullptr),
        finer_(hierarchy.has_finer(l) ? &hierarchy.level(l + 1) : nullptr),
        cells_(cells),
        out_(out) {}

  /// Faces, interfaces and covered parts; the finer level comes later, when its interfaces are known.
  void plan_faces() {
    find_walls();
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      box_ = level_.box(b);
      plan_ = &out_.boxes[std::size_t(b - level_.first_local_box())];
      near_ = overlaps(level_, box_.grow(1));
      if (coarser_) {
        Box const behind = box_.coarsen(refinement_ratio).grow(2);
        coarse_near_ = overlaps(*coarser_, behind);
        refined_near_ = overlaps(level_, behind.refine(refinement_ratio));
      }
      for (int axis = 0; axis < 3; ++axis)
        for (int side = 0; side < 2; ++side) plan_face(axis, side);
    }
  }

  /// Covered parts, fluxes and means from the finer level, whose faces are planned.
  void plan_refinement(LevelPlan& fine) {
    std::vector<std::pair<int, Family>> families;
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      box_ = level_.box(b);
      plan_ = &out_.boxes[std::size_t(b - level_.first_local_box())];
      auto const near = overlaps(*finer_, box_.grow(1).refine(refinement_ratio));
      std::vector<Box> covered;
      plan_->covered.first = std::int32_t(out_.covered.size());
      GlobalIndex cells = 0;
      for (auto const& o : near) {
        Box const part = o.part.coarsen(refinement_ratio).intersect(box_);
        if (part.empty()) continue;
        covered.push_back(part);
        cells += part.cells();
        out_.covered.push_back(counted_from_first(part));
        plan_means(b, o.box, part, families);
      }
      plan_->covered.last = std::int32_t(out_.covered.size());
      plan_->is_fully_covered = cells == box_.cells();
      plan_->refined.first = std::int32_t(out_.refined.size());
      // By axis and side first: a cell with several such faces rounds alike however the boxes are cut.
      for (int axis = 0; axis < 3; ++axis)
        for (int side = 0; side < 2; ++side)
          for (auto const& o : near) plan_refined_side(fine, o, axis, side, covered);
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
  Box counted_from_first(Box const& part) const { return moved(part, box_.lower, -1); }

  /// Wall data come by axis, side and box, each face's by its lower axis first.
  void find_walls() {
    out_.boxes.resize(std::size_t(level_.last_local_box() - level_.first_local_box()));
    int place = 0;
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side)
        for (int b = level_.first_local_box(); b < level_.last_local_box() && !level_.periodic()[axis]; ++b) {
          Box const& box = level_.box(b);
          bool const at_wall = side == 0 ? box.lower[axis] == level_.domain().lower[axis]
                                         : box.upper[axis] == level_.domain().upper[axis];
          if (!at_wall) continue;
          out_.boxes[std::size_t(b - level_.first_local_box())].faces[std::size_t(2 * axis + side)].wall = place;
          place += int(box.cells() / box.extent(axis));
        }
  }

  void plan_face(int axis, int side) {
    FacePlan& face = plan_->faces[std::size_t(2 * axis + side)];
    if (face.wall >= 0) return;
    auto const [u, v] = tangential_axes(axis);
    Box const slab = beyond(box_, axis, side);
    GlobalIndex found = 0;
    face.neighbours.first = std::int32_t(out_.neighbours.size());
    for (auto const& o : near_) {
      Box const part = o.part.intersect(slab);
      if (part.empty()) continue;
      found += part.cells();
      out_.neighbours.push_back(rectangle(level_, l_, o, part, axis, slab.lower));
    }
    face.neighbours.last = std::int32_t(out_.neighbours.size());
    if (found == slab.cells()) return;

    Box const coarse_slab = slab.coarsen(refinement_ratio);
    Mask missing(coarse_slab, axis, 1);
    for (auto const& o : near_) {
      Box const part = o.part.intersect(slab);
      if (!part.empty()) missing.set(part.coarsen(refinement_ratio), 0);
    }
    int first[2] = {missing.nu(), missing.nv()}, last[2] = {-1, -1};
    for (int b = 0; b < missing.nv(); ++b)
      for (int a = 0; a < missing.nu(); ++a)
        if (missing.at(a, b)) {
          first[0] = std::min(first[0], a), last[0] = std::max(last[0], a);
          first[1] = std::min(first[1], b), last[1] = std::max(last[1], b);
        }
    face.interface = int(out_.interfaces.size());
    Interface interface {};
    interface.u = first[0], interface.v = first[1];
    interface.nu = last[0] - first[0] + 1, interface.nv = last[1] - first[1] + 1;
    Box region = coarse_slab;
    region.lower[u] += first[0], region.upper[u] = region.lower[u] + interface.nu - 1;
    region.lower[v] += first[1], region.upper[v] = region.lower[v] + interface.nv - 1;
    plan_interface(interface, missing, region, axis);
    out_.interfaces.push_back(interface);
  }

  void plan_interface(Interface& interface, Mask const& missing, Box const& region, int axis) {
    auto const [u, v] = tangential_axes(axis);
    auto widened = [&, u = u, v = v](int n) {
      Box out = region;
      out.lower[u] -= n, out.upper[u] += n, out.lower[v] -= n, out.upper[v] += n;
      return out;
    };
    Mask usable(widened(2), axis, 0);
    for (auto const& o : coarse_near_) {
      Box const part = o.part.intersect(widened(2));
      if (!part.empty()) usable.set(part, 1);
    }
    for (auto const& o : refined_near_) {
      Box const part = o.part.coarsen(refinement_ratio).intersect(widened(2));
      if (!part.empty()) usable.set(part, 0);
    }
    interface.fits = std::int32_t(out_.fits.size());
    interface.fluxes = out_.fluxes;
    for (int b = 0; b < interface.nv; ++b)
      for (int a = 0; a < interface.nu; ++a) {
        FitNumber const fit = missing.at(interface.u + a, interface.v + b) ? fit_at(usable, a + 2, b + 2) : no_fit;
        if (fit != no_fit) interface.margin = std::max(interface.margin, numbered_fit(fit).reach);
        out_.fits.push_back(fit);
      }
    out_.fluxes += interface.nu * interface.nv;
    interface.coarse.first = std::int32_t(out_.coarse.size());
    Box const read = widened(interface.margin);
    for (auto const& o : coarse_near_) {
      Box const part = o.part.intersect(read);
      if (!part.empty()) out_.coarse.push_back(rectangle(*coarser_, l_ - 1, o, part, axis, read.lower));
    }
    interface.coarse.last = std::int32_t(out_.coarse.size());
  }

  static FitNumber fit_at(Mask const& usable, int u, int v) {
    bool central = true;
    for (int b = -1; b <= 1; ++b)
      for (int a = -1; a <= 1; ++a) central = central && usable.at(u + a, v + b);
    if (central) return central_fit;
    unsigned bits = 0;
    for (int a = -2; a <= 2; ++a)
      for (int b = -2; b <= 2; ++b)
        if (usable.at(u + a, v + b)) bits |= plane_bit(a, b);
    return fit_number(bits);
  }

  /// The part of a plane that a box covers, placed from `origin`.
  Rectangle rectangle(Level const& level, int l, Overlap const& o, Box const& part, int axis, Index3 const& origin) {
    auto const [u, v] = tangential_axes(axis);
    Rectangle out{};
    out.u = part.lower[u] - origin[u], out.v = part.lower[v] - origin[v];
    out.nu = part.extent(u), out.nv = part.extent(v);
    Box const own = moved(part, o.shift, -1);
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
      Box const child = moved(part.refine(refinement_ratio), finer_->box(fine_box).lower, -1);
      families.push_back({fine_box, {parent, pitch_y, pitch_z, child.lower, parents}});
    } else {
      std::int32_t const from = out_.finer_means.ask(owner, {l_ + 1, fine_box, -1, part});
      out_.remote_means.push_back({owner, from, parent, pitch_y, pitch_z, parents});
    }
  }

  /// The uncovered cells of the box beyond a face of a finer one.
  void plan_refined_side(LevelPlan const& fine, Overlap const& o, int axis, int side, std::vector<Box> const& covered) {
    auto const [u, v] = tangential_axes(axis);
    Box const slab = beyond(finer_->box(o.box).shift(o.shift).coarsen(refinement_ratio), axis, side);
    Box const candidates = slab.intersect(box_);
    if (candidates.empty()) return;
    Mask uncovered(candidates, axis, 1);
    for (Box const& part : covered) {
      Box const common = part.intersect(candidates);
      if (!common.empty()) uncovered.set(common, 0);
    }
    uncovered.for_each_rectangle([&, u = u, v = v](int first_u, int first_v, int nu, int nv) {
      Box cells = candidates;
      cells.lower[u] += first_u, cells.upper[u] = cells.lower[u] + nu - 1;
      cells.lower[v] += first_v, cells.upper[v] = cells.lower[v] + nv - 1;
      Box const own = moved(cells, Index3{o.shift[0] / 2, o.shift[1] / 2, o.shift[2] / 2}, -1);  // beside the finer box
      int const face = 2 * axis + side, owner = finer_->owner(o.box);
      Rectangle fluxes{owner, 0, 1, nu, 0, 0, nu, nv};
      if (owner == level_.rank()) {
        auto const& box = fine.boxes[std::size_t(o.box - finer_->first_local_box())];
        Interface const& i = fine.interfaces[std::size_t(box.faces[std::size_t(face)].interface)];
        Box const parents = finer_->box(o.box).coarsen(refinement_ratio);
        fluxes.owner = Rectangle::here;
        fluxes.from =
            i.fluxes + (own.lower[u] - parents.lower[u] - i.u) + i.nu * (own.lower[v] - parents.lower[v] - i.v);
        fluxes.pv = i.nu;
      } else {
        fluxes.from = out_.finer_fluxes.ask(owner, {l_ + 1, o.box, face, own});
      }
      out_.refined.push_back({axis, 1 - side, counted_from_first(cells), fluxes});
    });
  }

  int l_;
  Level const& level_;
  Level const* coarser_;
  Level const* finer_;
  Imports& cells_;
  LevelPlan& out_;
  Box box_;                                                 ///< under way
  BoxPlan* plan_ = nullptr;                                 ///< of the box under way
  std::vector<Overlap> near_, coarse_near_, refined_near_;  ///< of the box under way
};

template <class T>
std::size_t bytes_of(std::vector<T> const& list) {
  return list.capacity() * sizeof(T);
}

}  // namespace

std::vector<Overlap> overlaps(Level const& level, Box const& region) {
  std::vector<Overlap> out;
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) { out.push_back({b, part, shift}); });
  return out;
}

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
