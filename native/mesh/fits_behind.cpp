#include "mesh/fits_behind.hpp"

#include <algorithm>
#include <map>

#include "mesh/hierarchy.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

/// The fit at a cell of a plane with 1 for usable cells.
FitNumber fit_at(char const* cell, std::ptrdiff_t pitch) {
  int central = 1;
  for (char const* c : {cell - pitch, cell, cell + pitch}) central &= c[-1] & c[0] & c[1];
  if (central) return central_fit;
  unsigned usable = 0;
  for (int j = -plane_reach; j <= plane_reach; ++j)
    for (int i = -plane_reach; i <= plane_reach; ++i)
      if (cell[i + j * pitch]) usable |= plane_bit(i, j);
  int const placement = plane_placement(usable);
  return placement < 0 ? fit_in_gap : FitNumber(placement);
}

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
  ArrayOnBox<char> usable(near, 0);
  for (Overlap const& o : coarser) usable.fill(o.part, 1);
  for (Overlap const& o : refined) usable.fill(o.part.coarsen(refinement_ratio), 0);
  auto const [u, v] = tangential_axes(axis);
  std::ptrdiff_t const pitch = usable.box().extent(u);  // a plane: rows along u, one after the other
  FitNumber* fit = out.values().data();
  char const* middle = usable.values().data() + plane_reach + plane_reach * pitch;
  for (int j = 0; j < out.box().extent(v); ++j, middle += 2 * plane_reach)
    for (int i = 0; i < out.box().extent(u); ++i, ++middle, ++fit)
      if (*fit != no_fit) *fit = fit_at(middle, pitch);
  return out;
}

GapCells::GapCells(Level const& level, Box const& coarse, std::vector<Overlap> const& coarser,
                   std::vector<Overlap> const& refined, Level const* finer)
    : coarse_(coarse, 0), fine_(coarse.refine(refinement_ratio), 0) {
  for (Overlap const& o : coarser) coarse_.fill(o.part, 1);
  for (Overlap const& o : refined) {
    coarse_.fill(o.part.coarsen(refinement_ratio), 0);
    if (gap_fits_take_fine_cells(level)) fine_.fill(o.part, 1);
  }
  if (!finer) return;
  for (Overlap const& o : overlaps(*finer, fine_.box().refine(refinement_ratio)))
    fine_.fill(o.part.coarsen(refinement_ratio), 0);
}

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
