#include "mesh/metal_faces.hpp"

#include <algorithm>
#include <map>
#include <utility>

#include "mesh/hierarchy.hpp"

namespace amrpic {

namespace {

constexpr Real far_away = 1e9;           ///< arm where no surface is: the parabola through such an end is a line
constexpr Real shortest = wall_arm / 2;  ///< arm from which alone a slope is taken
// Along the normal of a face between levels, from a cell to the centres of those behind it, of the other level.
constexpr Real to_coarse = 1.5, to_fine = to_coarse / 2;

/// The electrode whose surface, taken for a plane through the ends of a cell's arms, passes between its centre and a
/// place that is `away` along each of three sides; -1 if none does. Arms that are not cut are taken for endless.
int between(CutCell const* cell, std::array<std::size_t, 3> const& sides, Real away) {
  if (!cell) return -1;
  Real sum = 0, nearest = 2;
  int out = -1;
  for (std::size_t side : sides) {
    std::size_t const opposite = side ^ 1;
    if (cell->is_cut(side)) {
      sum += away / cell->arm[side];
      if (cell->arm[side] < nearest) nearest = cell->arm[side], out = cell->electrode[side];
    } else if (cell->is_cut(opposite)) {
      sum -= away / cell->arm[opposite];
    }
  }
  return sum >= 1 ? out : -1;
}

Index3 moved(Index3 cell, int axis, int by) {
  cell[axis] += by;
  return cell;
}

struct Before {
  bool operator()(Index3 const& a, Index3 const& b) const { return comes_before(a, b); }
};

/// Cut cells with arms that are changed.
class ChangedArms {
 public:
  explicit ChangedArms(MetalCells const& metal) : metal_(metal) {}

  CutCell& operator()(Index3 const& cell) {
    CutCell const* const known = metal_.cut_at(cell);
    return changed_.try_emplace(cell, known ? *known : CutCell::uncut(cell)).first->second;
  }
  /// Let cells whose axes would all be dropped have an equation: these arms end `away(cell, side)` from it.
  template <class Away>
  void keep_an_axis(Away&& away) {
    for (auto& [cell, cut] : changed_) {
      auto const is_far = [&of = cut](std::size_t side) { return of.is_cut(side) && of.arm[side] == far_away; };
      if (!(is_far(0) || is_far(1)) || !(is_far(2) || is_far(3)) || !(is_far(4) || is_far(5))) continue;
      for (std::size_t side = 0; side < 6; ++side)
        if (is_far(side)) cut.arm[side] = away(cell, side);
    }
  }
  MetalCells cells() && {
    if (changed_.empty()) return metal_;
    std::vector<CutCell> out;
    auto at = changed_.begin();
    for (CutCell const& cut : metal_.cut()) {
      for (; at != changed_.end() && comes_before(at->first, cut.cell); ++at) out.push_back(at->second);
      if (at != changed_.end() && at->first == cut.cell)
        out.push_back(at++->second);
      else
        out.push_back(cut);
    }
    for (; at != changed_.end(); ++at) out.push_back(at->second);
    return metal_.with(std::move(out));
  }

 private:
  MetalCells const& metal_;
  std::map<Index3, CutCell, Before> changed_;
};

/// Call f(coarse face) for those beyond the sides of a box of a level.
template <class F>
void for_each_coarse_face(BoxFaces const& faces, F&& f) {
  for (int n = 0; n < 6; ++n) {
    Face const& side = faces.sides[std::size_t(n)];
    if (!side.has_coarser) continue;
    ArrayOnBox<char> is_coarse(side.layer.coarsen(refinement_ratio), 1);
    for (Overlap const& o : side.neighbours) is_coarse.fill(o.part.coarsen(refinement_ratio), 0);
    for_each_cell(is_coarse.box(), [&](Index3 const& cell) {
      if (is_coarse(cell)) f(CoarseFace{cell, n / 2, n % 2});
    });
  }
}

void change_fine(Metal const& metal, Level const& level, Level const& coarser, std::vector<Box> const& boxes,
                 MetalCells const& cells, ChangedArms& changed) {
  std::vector<BoxFaces> ends;
  std::vector<Box> behind;
  for (Box const& box : boxes) {
    BoxFaces faces(level, box);
    if (!faces.ends_level()) continue;
    behind.push_back(box.coarsen(refinement_ratio).grow(1));
    ends.push_back(std::move(faces));
  }
  if (ends.empty()) return;
  LevelsInMetal const levels(coarser, level, metal.cells(coarser, behind), cells);
  for (BoxFaces const& faces : ends)
    for_each_coarse_face(faces, [&](CoarseFace const& face) {
      if (!levels.is_near(face)) return;
      for (int b = 0; b < 2; ++b)
        for (int a = 0; a < 2; ++a) {
          auto const end = levels.end(face, a, b);
          if (!end || end->arm == 0) continue;
          CutCell& cut = changed(level.wrapped(face.fine(a, b)));
          cut.arm[face.outward()] = end->arm, cut.electrode[face.outward()] = end->electrode;
        }
    });
}

void change_coarse(Metal const& metal, Level const& level, Level const& finer, std::vector<Box> const& boxes,
                   MetalCells const& cells, ChangedArms& changed, std::vector<SharedFace>& shared) {
  std::vector<FinerNeighbour> beside;
  std::vector<Box> before;
  for (Box const& box : boxes)
    for (FinerNeighbour const& n : BoxFaces(level, box, &finer).beside) {
      beside.push_back(n);
      Index3 around{0, 0, 0};
      around[n.axis] = 1;
      before.push_back(n.cells.part.refine(refinement_ratio).grow(around));
    }
  if (beside.empty()) return;
  LevelsInMetal const levels(level, finer, cells, metal.cells(finer, before));
  for (FinerNeighbour const& n : beside)
    for_each_cell(n.cells.part, [&](Index3 const& cell) {
      CoarseFace const face{cell, n.axis, 1 - n.side};
      Index3 const own = level.wrapped(cell);
      if (!levels.is_near(face) || cells.solid_at(own)) return;
      int links = 0, electrode = -1;
      for (int b = 0; b < 2; ++b)
        for (int a = 0; a < 2; ++a)
          if (auto const end = levels.end(face, a, b))
            electrode = end->electrode;
          else
            ++links;
      std::size_t const side = face.inward();
      CutCell const* const known = cells.cut_at(own);
      bool const is_cut = known && known->is_cut(side);
      if (links > 0 && is_cut) changed(own).electrode[side] = -1;
      if (links > 0 && links < 4) shared.push_back({own, side, (4 - links) / 4.0, electrode});
      if (links == 0 && !is_cut) changed(own).arm[side] = far_away, changed(own).electrode[side] = electrode;
    });
}

}  // namespace

LevelsInMetal::LevelsInMetal(Level const& coarser, Level const& finer, MetalCells coarse, MetalCells fine)
    : coarser_(coarser),
      finer_(finer),
      coarse_(std::move(coarse)),
      fine_(std::move(fine)),
      near_coarse_(coarse_.hull()),
      near_fine_(fine_.hull()) {}

bool LevelsInMetal::is_near(CoarseFace const& face) const {
  if (near_coarse_.contains(coarser_.wrapped(face.coarse))) return true;
  int const outwards = face.side == 0 ? -1 : 1;
  for (int b = 0; b < 2; ++b)
    for (int a = 0; a < 2; ++a)
      if (Index3 const fine = face.fine(a, b); near_fine_.contains(finer_.wrapped(fine)) ||
                                               near_fine_.contains(finer_.wrapped(moved(fine, face.axis, outwards))))
        return true;
  return false;
}

std::optional<LevelsInMetal::End> LevelsInMetal::end(CoarseFace const& face, int a, int b) const {
  auto const [u, v] = tangential_axes(face.axis);
  std::size_t const outward = face.outward();
  Index3 const fine = face.fine(a, b), behind = moved(fine, face.axis, face.side == 0 ? -1 : 1);
  if (SolidCells const* const solid = fine_.solid_at(finer_.wrapped(fine))) return End{0, solid->electrode};
  CutCell const* const own = fine_.cut_at(finer_.wrapped(fine));
  if (own && own->is_cut(outward)) return End{own->arm[outward], own->electrode[outward]};
  CutCell const* const ghost = fine_.cut_at(finer_.wrapped(behind));
  CutCell const* const coarse = coarse_.cut_at(coarser_.wrapped(face.coarse));
  SolidCells const* const solid = coarse_.solid_at(coarser_.wrapped(face.coarse));
  // the coarse centre is half a cell from the one behind along each axis; of the coarse arms, a quarter
  std::array<std::size_t, 3> const there{std::size_t(2 * u + 1 - a), std::size_t(2 * v + 1 - b), outward};
  int on = solid ? solid->electrode : between(ghost, there, 0.5);
  if (on < 0) on = between(coarse, {there[0] ^ 1, there[1] ^ 1, there[2] ^ 1}, quarter(true));
  if (on < 0) return {};
  if (ghost && ghost->is_cut(outward)) return End{1 + ghost->arm[outward], ghost->electrode[outward]};
  return End{far_away, on};
}

bool LevelsInMetal::is_usable(Index3 const& coarse) const {
  for (int d = 0; d < 3; ++d)
    if (coarser_.is_behind_wall(coarse, d)) return false;
  Index3 const cell = coarser_.wrapped(coarse);
  return coarser_.find(cell) >= 0 && finer_.find(first_child_of(cell)) < 0;
}

/// Whether no metal is in a block of coarse cells, see `plane_corners`, nor between these.
bool LevelsInMetal::is_clean(Index3 const& middle, int axis, int placement) const {
  auto const [u, v] = tangential_axes(axis);
  auto const [first_u, first_v] = plane_corners[std::size_t(placement)];
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) {
      Index3 const cell = coarser_.wrapped(moved(moved(middle, u, first_u + i), v, first_v + j));
      if (coarse_.solid_at(cell)) return false;
      CutCell const* const cut = coarse_.cut_at(cell);
      if (!cut) continue;
      if (i < 2 && cut->is_cut(std::size_t(2 * u + 1))) return false;
      if (j < 2 && cut->is_cut(std::size_t(2 * v + 1))) return false;
    }
  return true;
}

std::optional<MetalFace> LevelsInMetal::beside_metal(CoarseFace const& face, FitNumber fit) const {
  bool const is_close = is_near(face);
  bool is_other = false;
  MetalFace out{face, {}, {}, 0, {}, {}};
  for (int b = 0; is_close && b < 2; ++b)
    for (int a = 0; a < 2; ++a) {
      CutCell const* const own = fine_.cut_at(finer_.wrapped(face.fine(a, b)));
      bool const is_linked = !end(face, a, b);
      out.linked[std::size_t(b)][std::size_t(a)] = is_linked;
      out.links += is_linked;
      out.linear[std::size_t(b)][std::size_t(a)] = own && own->is_cut(face.inward());
      is_other = is_other || own || !is_linked;
    }
  if (!is_close) out.linked = {{{1, 1}, {1, 1}}}, out.links = 4;
  Index3 const own = coarser_.wrapped(face.coarse);
  is_other = is_other || coarse_.cut_at(own) || coarse_.solid_at(own);
  bool is_fit_clean = !coarse_.empty() && !near_coarse_.grow(plane_reach).contains(own);
  for (bool const periodic : coarser_.periodic()) is_fit_clean = is_fit_clean && !periodic;  // images lie elsewhere
  is_fit_clean = is_fit_clean || coarse_.empty();
  if (!is_fit_clean && fit == fit_in_gap) {
    Box const around{{-1, -1, -1}, {1, 1, 1}};
    is_fit_clean = true;
    for_each_cell(around, [&](Index3 const& by) {
      Index3 const cell = coarser_.wrapped({own[0] + by[0], own[1] + by[1], own[2] + by[2]});
      is_fit_clean = is_fit_clean && !coarse_.cut_at(cell) && !coarse_.solid_at(cell);
    });
  } else if (!is_fit_clean) {
    is_fit_clean = is_clean(face.coarse, face.axis, fit);
  }
  if (!is_other && is_fit_clean) return {};
  if (out.links == 0) return out;
  auto const [u, v] = tangential_axes(face.axis);
  for (std::size_t p = 0; p < plane_corners.size(); ++p) {
    bool is_complete = true;
    for (int n = 0; is_complete && n < 9; ++n)
      is_complete =
          is_usable(moved(moved(face.coarse, u, plane_corners[p].first + n / 3), v, plane_corners[p].second + n % 3));
    if (!is_complete || !is_clean(face.coarse, face.axis, int(p))) continue;
    add_block(int(p), out);
    return out;
  }
  add_slopes(out);
  return out;
}

void LevelsInMetal::add_block(int placement, MetalFace& to) const {
  for (std::size_t b = 0; b < 2; ++b)
    for (std::size_t a = 0; a < 2; ++a) {
      PlaneFit const fit = plane_fit(placement, quarter(a != 0), quarter(b != 0));
      to.cells.resize(fit.terms.size());
      for (std::size_t t = 0; t < fit.terms.size(); ++t) {
        to.cells[t].i = fit.terms[t].i, to.cells[t].j = fit.terms[t].j;
        to.cells[t].weight[b][a] = fit.terms[t].weight;
      }
    }
}

/// phi* from the value of the coarse cell and its slopes in the plane, each from what ends its two arms there, cells or
/// surfaces: the longest piece of a line. It is exact for linear potentials.
void LevelsInMetal::add_slopes(MetalFace& to) const {
  CutCell const* const cut = coarse_.cut_at(coarser_.wrapped(to.at.coarse));
  MetalFace::CellTerm middle{0, 0, {{{1, 1}, {1, 1}}}};
  auto const [u, v] = tangential_axes(to.at.axis);
  for (int d : {u, v}) {
    std::array<Real, 2> arm{0, 0};  // none
    std::array<bool, 2> is_surface{};
    for (std::size_t s = 0; s < 2; ++s) {
      std::size_t const side = std::size_t(2 * d) + s;
      is_surface[s] = cut && cut->is_cut(side);
      if (is_surface[s])
        arm[s] = cut->arm[side];
      else if (is_usable(moved(to.at.coarse, d, s == 0 ? -1 : 1)))
        arm[s] = 1;
    }
    bool const both = arm[0] > 0 && arm[1] > 0;
    for (std::size_t s = 0; s < 2; ++s) {
      if (arm[s] == 0) continue;
      Real const factor = (s == 0 ? -1 : 1) / (both ? arm[0] + arm[1] : std::max(arm[s], shortest));
      FourStars<Real> weight;
      for (std::size_t b = 0; b < 2; ++b)
        for (std::size_t a = 0; a < 2; ++a) {
          weight[b][a] = factor * quarter((d == u ? a : b) != 0);
          if (!both) middle.weight[b][a] -= weight[b][a];
        }
      if (is_surface[s])
        to.surfaces.push_back({cut->electrode[std::size_t(2 * d) + s], weight});
      else
        to.cells.push_back({d == u ? (s == 0 ? -1 : 1) : 0, d == u ? 0 : (s == 0 ? -1 : 1), weight});
    }
  }
  to.cells.push_back(middle);
}

MetalOfLevel metal_of_level(Metal const& metal, Level const& level, Level const* coarser,
                            std::vector<Level const*> const& finer, std::vector<Box> const& boxes, bool holds) {
  std::vector<Box> around;
  for (Box const& box : boxes) around.push_back(box.grow(Metal::reach));
  MetalCells const cells = metal.cells(level, around, holds ? finer : std::vector<Level const*>{});
  ChangedArms changed(cells);
  MetalOfLevel out;
  std::vector<Box> inside;
  for (Box const& box : boxes) inside.push_back(level.cut_at_walls(box));
  if (coarser) change_fine(metal, level, *coarser, inside, cells, changed);
  if (!finer.empty()) change_coarse(metal, level, *finer.front(), inside, cells, changed, out.shared);
  changed.keep_an_axis([&](Index3 const& cell, std::size_t side) {
    Index3 const behind = level.wrapped(moved(cell, int(side) / 2, side % 2 == 0 ? -1 : 1));
    return !finer.empty() && finer.front()->find(first_child_of(behind)) >= 0 ? to_fine : to_coarse;
  });
  out.cells = std::move(changed).cells();
  return out;
}

}  // namespace amrpic
