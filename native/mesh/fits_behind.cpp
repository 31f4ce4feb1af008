#include "mesh/fits_behind.hpp"

#include <algorithm>
#include <map>

#include "mesh/hierarchy.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

/// The gaps of any boxes of a level, each found once.
class GapsOfBoxes {
 public:
  GapsOfBoxes(Level const& level, Level const& coarser, LevelFaces const* own = nullptr)
      : level_(level), coarser_(coarser), own_(own) {}

  std::array<Box, 6> const& operator()(int b) {
    auto const [at, is_new] = known_.try_emplace(b);
    if (is_new)
      at->second = own_ && level_.owner(b) == level_.rank()
                       ? gaps_behind((*own_)[std::size_t(b - level_.first_local_box())], level_, coarser_)
                       : gaps_behind(BoxFaces(level_, level_.box(b)), level_, coarser_);
    return at->second;
  }

 private:
  Level const &level_, &coarser_;
  LevelFaces const* own_;
  std::map<int, std::array<Box, 6>> known_;
};

/// Call f(number of the face, fits) for the faces of a box behind which coarser cells lie.
template <class F>
void for_each_fits_behind(BoxFaces const& faces, Level const& level, Level const& coarser, F&& f) {
  if (!faces.ends_level()) return;
  Box const near = faces.box.coarsen(refinement_ratio).grow(plane_reach + 1);
  auto const coarse = overlaps(coarser, near), refined = overlaps(level, near.refine(refinement_ratio));
  for (int n = 0; n < 6; ++n)
    if (faces.sides[std::size_t(n)].has_coarser) f(n, fits_behind(faces.sides[std::size_t(n)], n / 2, coarse, refined));
}

std::vector<ArrayOnBox<FitNumber>> fits_with_gaps(BoxFaces const& faces, Level const& level, Level const& coarser) {
  std::vector<ArrayOnBox<FitNumber>> out;
  for_each_fits_behind(faces, level, coarser, [&](int, ArrayOnBox<FitNumber> const& fits) {
    auto const& values = fits.values();
    if (std::find(values.begin(), values.end(), fit_in_gap) != values.end()) out.push_back(fits);
  });
  return out;
}

Box with_neighbours(Box const& gap) { return gap.empty() ? gap : gap.grow(1); }

}  // namespace

ArrayOnBox<FitNumber> fits_behind(Face const& face, int axis, std::vector<Overlap> const& coarser,
                                  std::vector<Overlap> const& refined) {
  ArrayOnBox<FitNumber> out(face.layer.coarsen(refinement_ratio), central_fit);
  for (Overlap const& o : face.neighbours) out.fill(o.part.coarsen(refinement_ratio), no_fit);
  Index3 around{plane_reach, plane_reach, plane_reach};
  around[axis] = 0;
  Box const near = out.box().grow(around);
  GlobalIndex coarse = 0;
  for (Overlap const& o : coarser) coarse += o.part.intersect(near).cells();
  bool const refined_near = std::any_of(refined.begin(), refined.end(), [&](Overlap const& o) {
    return !o.part.coarsen(refinement_ratio).intersect(near).empty();
  });
  if (coarse == near.cells() && !refined_near) return out;  // as nearly everywhere
  auto const usable = usable_cells(near, coarser, refined);
  for_each_cell(out.box(), [&](Index3 const& cell) {
    if (out(cell) != no_fit) out(cell) = fit_at(usable, cell, axis);
  });
  return out;
}

ArrayOnBox<char> usable_cells(Box const& region, std::vector<Overlap> const& cells,
                              std::vector<Overlap> const& refined) {
  ArrayOnBox<char> out(region, 0);
  for (Overlap const& o : cells) out.fill(o.part, 1);
  for (Overlap const& o : refined) out.fill(o.part.coarsen(refinement_ratio), 0);
  return out;
}

FitNumber fit_at(ArrayOnBox<char> const& usable, Index3 const& middle, int axis) {
  auto const [u, v] = tangential_axes(axis);
  char const* const at = &usable(middle);
  std::ptrdiff_t const step_u = usable.box().stride(u), step_v = usable.box().stride(v);
  int const placement = plane_placement([&](int i, int j) { return at[i * step_u + j * step_v] != 0; });
  return placement < 0 ? fit_in_gap : FitNumber(placement);
}

GapCells::GapCells(Level const& level, Box const& coarse, std::vector<Overlap> const& coarser,
                   std::vector<Overlap> const& refined, Level const* finer)
    : coarse_(usable_cells(coarse, coarser, refined)),
      fine_(usable_cells(coarse.refine(refinement_ratio),
                         gap_fits_take_fine_cells(level) ? refined : std::vector<Overlap>{},
                         finer ? overlaps(*finer, coarse.refine(refinement_ratio).refine(refinement_ratio))
                               : std::vector<Overlap>{})) {}

std::array<Box, 6> gaps_behind(BoxFaces const& faces, Level const& level, Level const& coarser) {
  std::array<Box, 6> out;
  for_each_fits_behind(faces, level, coarser, [&](int f, ArrayOnBox<FitNumber> const& fits) {
    out[std::size_t(f)] = hull_of_fits(fits, [](FitNumber fit) { return fit == fit_in_gap; });
  });
  return out;
}

Reads coarse_reads_in_gaps(Level const& level, LevelFaces const& own, Level const& coarser) {
  GapsOfBoxes gaps(level, coarser, &own);
  return reads_across_ranks(
      level, coarser, [](Box const& o) { return o.grow(2).refine(refinement_ratio); },
      [&](int b, auto&& read) {
        for (Box const& gap : gaps(b)) read(with_neighbours(gap));
      });
}

Reads fine_reads_in_gaps(Level const& level, LevelFaces const& own, Level const& coarser) {
  if (!gap_fits_take_fine_cells(level)) return {};
  GapsOfBoxes gaps(level, coarser, &own);
  return reads_across_ranks(
      level, level, [](Box const& o) { return o.coarsen(refinement_ratio).grow(2).refine(refinement_ratio); },
      [&](int b, auto&& read) {
        for (Box const& gap : gaps(b)) read(with_neighbours(gap).refine(refinement_ratio));
      });
}

Reads fine_reads_before_gaps(Level const& coarser, Level const& level) {
  if (!gap_fits_take_fine_cells(level)) return {};
  GapsOfBoxes gaps(level, coarser);
  return reads_across_ranks(
      coarser, level, [](Box const& o) { return o.coarsen(refinement_ratio).grow(2); },
      [&](int c, auto&& read) {
        for (Overlap const& o : overlaps(level, coarser.box(c).grow(1).refine(refinement_ratio)))
          for (Box gap : gaps(o.box)) {
            for (std::size_t d = 0; d < 3; ++d) gap.lower[d] += o.shift[d] / 2, gap.upper[d] += o.shift[d] / 2;
            read(with_neighbours(gap.intersect(coarser.box(c))).refine(refinement_ratio));
          }
      });
}

std::vector<Index3> cells_behind_gaps(Level const& coarser, Level const& level) {
  std::vector<Index3> out;
  if (!gap_fits_take_fine_cells(level)) return out;
  std::map<int, std::vector<ArrayOnBox<FitNumber>>> known;  // fits behind the faces of finer boxes
  for (int c = coarser.first_local_box(); c < coarser.last_local_box(); ++c) {
    ArrayOnBox<char> behind(coarser.box(c), 0);
    for (Overlap const& o : overlaps(level, coarser.box(c).grow(1).refine(refinement_ratio))) {
      auto const [at, is_new] = known.try_emplace(o.box);
      if (is_new) at->second = fits_with_gaps(BoxFaces(level, level.box(o.box)), level, coarser);
      for (auto const& fits : at->second)
        for_each_cell(fits.box(), [&](Index3 const& cell) {
          Index3 const image{cell[0] + o.shift[0] / 2, cell[1] + o.shift[1] / 2, cell[2] + o.shift[2] / 2};
          if (fits(cell) == fit_in_gap && behind.box().contains(image)) behind(image) = 1;
        });
    }
    for_each_cell(behind.box(), [&](Index3 const& cell) {
      if (behind(cell)) out.push_back(cell);
    });
  }
  return out;
}

}  // namespace amrpic
