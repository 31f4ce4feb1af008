#include <algorithm>
#include <optional>

#include "operators/forms.hpp"
#include "operators/halos.hpp"
#include "operators/intergrid_rows.hpp"
#include "operators/multigrid_levels.hpp"
#include "operators/open_walls.hpp"
#include "operators/operators.hpp"
#include "operators/regular_rows.hpp"

namespace amrpic {

namespace {

/// Writes the rows of prolongation whose parents all exist.
class RegularProlongation {
 public:
  RegularProlongation(Index3 const& ratio, Prolongation kind) : ratio_(ratio) {
    for (int d = 0; d < 3; ++d) linear_[d] = kind == Prolongation::trilinear && ratio[d] == 2;
    for (int corner = 0; corner < 8; ++corner) {
      Real weight = 1;
      for (int d = 0; d < 3; ++d)
        weight *= linear_[d] ? ((corner >> d) & 1 ? prolongation::far : prolongation::near) : (corner >> d) & 1 ? 0 : 1;
      if (weight != 0) weights_.push_back(weight), corners_.push_back(corner);
    }
  }
  std::size_t terms() const { return weights_.size(); }

  /// `places` of the coarser level's cells hold all that the rows read.
  void operator()(ArrayOnBox<LocalIndex> const& places, Index3 const& first, LocalIndex rows, LocalIndex* column,
                  Real* value) const {
    Index3 parent, step;
    for (int d = 0; d < 3; ++d) {
      parent[d] = floor_divide(first[d], ratio_[d]);
      step[d] = linear_[d] ? 2 * (first[d] - 2 * parent[d]) - 1 : 0;
    }
    repeat(weights_.data(), terms(), rows, value);
    LocalIndex const odd = first[0] - ratio_[0] * parent[0];
    for (std::size_t t = 0; t < terms(); ++t) {
      Index3 cell = parent;
      for (int d : {1, 2})
        if ((corners_[t] >> d) & 1) cell[d] += step[d];
      LocalIndex const* source = &places(cell);
      LocalIndex* out = column + t;
      if (ratio_[0] == 1)
        for (LocalIndex n = 0; n < rows; ++n, out += terms()) *out = source[n];
      else if (corners_[t] & 1)  // the neighbour on the cell's side
        for (LocalIndex n = 0, i = odd; n < rows; ++n, ++i, out += terms()) *out = source[i / 2 + 2 * (i & 1) - 1];
      else
        for (LocalIndex n = 0, i = odd; n < rows; ++n, ++i, out += terms()) *out = source[i / 2];
    }
  }

 private:
  Index3 ratio_;
  std::array<bool, 3> linear_;
  std::vector<int> corners_;  ///< bit d: the neighbour along axis d instead of the parent
  std::vector<Real> weights_;
};

/// Writes rows of means over children; `places` of the finer level's cells hold them.
void write_means(Index3 const& ratio, ArrayOnBox<LocalIndex> const& places, Index3 const& first, LocalIndex rows,
                 LocalIndex* column, Real* value) {
  int const terms = ratio[0] * ratio[1] * ratio[2];
  std::fill_n(value, std::ptrdiff_t(rows) * terms, mean_weight(ratio));
  for (int k = 0, t = 0; k < ratio[2]; ++k)
    for (int j = 0; j < ratio[1]; ++j, t += ratio[0]) {
      LocalIndex const* child = &places({first[0] * ratio[0], first[1] * ratio[1] + j, first[2] * ratio[2] + k});
      LocalIndex* out = column + t;
      for (LocalIndex n = 0; n < rows; ++n, out += terms, child += ratio[0]) std::copy_n(child, ratio[0], out);
    }
}

/// Builders of one level's operators: `count` runs the formulas for single rows and measures the others, `fill` writes
/// these.
class LevelAssembly {
 public:
  LevelAssembly(MultigridLevels const& multigrid, std::size_t l, Prolongation kind)
      : multigrid_(multigrid),
        l_(l),
        kind_(kind),
        level_(*multigrid.levels[l]),
        faces_(multigrid.faces[l]),
        equation_(multigrid.equation(l)),
        near_(level_, multigrid.walls[l]),
        open_walls_(multigrid),
        seam_width_(seam_widths(level_.periodic(), multigrid.upper[l])),
        prolong_(multigrid.ratio[l], kind),
        no_fine_(rows()),
        uncovered_(std::size_t(rows()), 1) {
    if (!faces_) faces_ = std::make_shared<LevelFaces const>(faces_of_boxes(level_, nullptr));
    if (l > 0) {
      coarser_ = multigrid.levels[l - 1].get();
      coarse_boundary_.emplace(rows());
      prolongation_.emplace(rows());
    }
    if (l + 1 < multigrid.levels.size()) {
      finer_ = multigrid.levels[l + 1].get();
      composite_.emplace(rows());
      fine_boundary_.emplace(rows());
      restriction_.emplace(rows());
    }
  }

  void count() {
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      count_laplacians(b);
      if (coarser_) count_prolongation(b);
    }
  }

  void fill(Halo const& own, Halo const* coarse, Halo const* fine) {
    no_fine_.start_filling(own);
    if (coarser_) {
      coarse_boundary_->start_filling(*coarse);
      prolongation_->start_filling(*coarse);
    }
    if (finer_) {
      composite_->start_filling(own);
      fine_boundary_->start_filling(*fine);
      restriction_->start_filling(*fine);
    }
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      fill_laplacians(b, own);
      if (coarser_) fill_prolongation(b, *coarse);
      if (finer_) fill_restriction(b, *fine);
    }
  }

  void move_into(LevelOperators& out) {
    out.level = multigrid_.levels[l_];
    out.walls = multigrid_.walls[l_];
    for (int d = 0; d < 3; ++d) out.last_width[d] = multigrid_.upper[l_][d].width;
    out.no_fine = no_fine_.take();
    if (coarser_) {
      out.coarse_boundary = coarse_boundary_->take();
      out.prolongation = prolongation_->take();
    }
    if (finer_) {
      out.own_composite = composite_->take();
      out.fine_boundary = fine_boundary_->take();
      out.restriction = restriction_->take();
    }
    out.uncovered = std::move(uncovered_);
    out.has_gaps = !gaps_.empty();
  }

 private:
  LocalIndex rows() const { return level_.local_cells(); }
  /// A multigrid level is covered whole by the next one.
  bool is_fully_covered() const { return finer_ && !multigrid_.refines(l_ + 1); }

  void count_laplacians(int b) {
    StencilCells const n = stencil_cells_of((*faces_)[std::size_t(b - level_.first_local_box())], level_,
                                            multigrid_.beside(l_), seam_width_);
    auto const kinds = row_kinds(n, Execution::without_finer);
    auto const composite =
        is_fully_covered() ? RowKinds(level_.box(b), RowKind::covered) : row_kinds(n, Execution::composite);
    for_each_run(kinds, level_.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      if (kind == RowKind::regular) return no_fine_.put_run(run, RegularRows::laplacian_terms);
      for_each_in_run(first, run,
                      [&](Index3 const& cell, LocalIndex row) { count_special(n, cell, row, composite(cell)); });
    });
    if (finer_) count_composite(b, n, composite);
  }

  Form const& laplacian(StencilCells const& n, Index3 const& cell, Execution execution) {
    CellShape const shape = cell_shape(n, cell, execution, gaps_);
    return laplacians_(shape, [&] {
      return laplacian_form(equation_, near_.own(),
                            [&](int axis, int side) { return near_.across(shape[axis][side], axis, side); });
    });
  }

  /// A row that a missing neighbour makes special, and with it that of the composite where it is the same.
  void count_special(StencilCells const& n, Index3 const& cell, LocalIndex row, RowKind composite) {
    terms_.set(laplacian(n, cell, Execution::without_finer), n, cell);
    if (finer_ && composite == RowKind::special) composite_->put(row, terms_.own_row);
    if (composite == RowKind::covered) add_open_walls(n, cell);
    no_fine_.put(row, terms_.own_row);
    if (coarser_) coarse_boundary_->put(row, terms_.coarse_row);
  }

  /// The composite's rows, except the special ones, and restriction.
  void count_composite(int b, StencilCells const& n, RowKinds const& kinds) {
    for_each_run(kinds, level_.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      if (kind == RowKind::regular) composite_->put_run(run, RegularRows::laplacian_terms);
      if (kind == RowKind::covered) {
        count_restriction(first, run);
        std::fill_n(uncovered_.begin() + run.row, run.count, 0);
      }
      if (kind != RowKind::beside) return;
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
        terms_.set(laplacian(n, cell, Execution::composite), n, cell);
        composite_->put(row, terms_.own_row);
        fine_boundary_->put(row, terms_.fine_row);
      });
    });
  }

  /// Means over children; single rows where some are missing or weigh otherwise, at the upper ends of the finer level.
  void count_restriction(Index3 const& first, RowRun const& run) {
    Index3 const ratio = multigrid_.ratio[l_ + 1];
    auto const weight = last_children_of(multigrid_, l_ + 1);
    auto special = [&](int d, int parent) {
      int const last = finer_->domain().upper[d];
      bool const otherwise = weight[d].last != 1 || weight[d].before != 1 || last % ratio[d] != ratio[d] - 1;
      return otherwise && parent == last / ratio[d];
    };
    auto put = [&](Index3 const& cell, LocalIndex row) {
      row_.clear();
      restrict_mean(cell, ratio, *finer_, weight, [&](GlobalIndex c, Real w) { row_.append(c, w); });
      restriction_->put(row, row_);
    };
    RowRun regular = run;
    if (special(1, first[1]) || special(2, first[2]))
      regular.count = 0;
    else if (special(0, first[0] + run.count - 1))
      --regular.count;
    if (regular.count > 0) restriction_->put_run(regular, std::size_t(ratio[0] * ratio[1] * ratio[2]));
    for (LocalIndex n = regular.count; n < run.count; ++n) put({first[0] + int(n), first[1], first[2]}, run.row + n);
  }

  void fill_laplacians(int b, Halo const& halo) {
    Box const& box = level_.box(b);
    auto const places = halo.places(level_, box.grow(1));
    RegularRows const regular(level_.spacing(), equation_.shift, places);
    auto write = [&](auto const&... where) { regular.laplacian(where...); };
    no_fine_.fill_runs(box, level_.local_offset(b), write);
    if (finer_) composite_->fill_runs(box, level_.local_offset(b), write);
  }

  /// Covered cells hold corrections of finer ones alone.
  void add_open_walls(StencilCells const& n, Index3 const& cell) {
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side)
        if (n.faces(cell)(axis, side) == Beyond::wall && multigrid_.boundary[axis][side] == Boundary::open)
          terms_.own_row.add(n.own(cell), equation_.weight[axis] * open_walls_.first(l_, cell, axis, side));
  }

  /// Prolongation reads ghost cells of the parents in cells at walls, along axes that it interpolates; where half a
  /// pair was dropped, in two.
  RowKinds prolongation_kinds(Box const& box) const {
    Box inside = box;
    for (int d = 0; d < 3; ++d) {
      if (multigrid_.ratio[l_][d] == 1) continue;
      if (coarser_->periodic()[d]) {
        if (multigrid_.upper[l_ - 1][d].width == 1) continue;
        // children of the last cell and of its neighbours
        inside.lower[d] = std::max(inside.lower[d], level_.domain().lower[d] + 2);
        inside.upper[d] = std::min(inside.upper[d], level_.domain().upper[d] - 4);
        continue;
      }
      bool const odd = level_.domain().extent(d) % 2 != 0;
      if (kind_ == Prolongation::constant && !odd) continue;
      inside.lower[d] = std::max(inside.lower[d], level_.domain().lower[d] + 1);
      inside.upper[d] = std::min(inside.upper[d], level_.domain().upper[d] - (odd ? 2 : 1));
    }
    RowKinds kinds(box, RowKind::special);
    for_each_cell(inside, [&](Index3 const& cell) { kinds(cell) = RowKind::regular; });
    return kinds;
  }

  void count_prolongation(int b) {
    Box const& box = level_.box(b);
    Index3 const ratio = multigrid_.ratio[l_];
    Real3 const coarse_seam = seam_widths(coarser_->periodic(), multigrid_.upper[l_ - 1]);
    std::optional<ArrayOnBox<GlobalIndex>> coarse;
    for_each_run(prolongation_kinds(box), level_.local_offset(b),
                 [&](RowKind kind, Index3 const& first, RowRun const& run) {
                   if (kind == RowKind::regular) return prolongation_->put_run(run, prolong_.terms());
                   if (!coarse) coarse = cell_numbers(*coarser_, parents_read(box, ratio, kind_));
                   for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
                     row_.clear();
                     prolong(
                         cell, ratio, kind_, *coarser_, *coarse, coarse_seam,
                         [&](Index3 const& parent, int axis, int side) {
                           return prolonged_end(multigrid_, open_walls_, l_ - 1, parent, axis, side);
                         },
                         [&](GlobalIndex c, Real w) { row_.append(c, w); });
                     prolongation_->put(row, row_);
                   });
                 });
  }

  void fill_prolongation(int b, Halo const& halo) {
    Box const& box = level_.box(b);
    auto const places = halo.places(*coarser_, parents_read(box, multigrid_.ratio[l_], kind_));
    prolongation_->fill_runs(box, level_.local_offset(b), [&](auto const&... where) { prolong_(places, where...); });
  }

  void fill_restriction(int b, Halo const& halo) {
    Index3 const ratio = multigrid_.ratio[l_ + 1];
    Box const &box = level_.box(b), children = box.refine(ratio);
    if (!finer_->intersects(children)) return;
    auto const places = halo.places(*finer_, children);
    restriction_->fill_runs(box, level_.local_offset(b),
                            [&](auto const&... where) { write_means(ratio, places, where...); });
  }

  MultigridLevels const& multigrid_;
  std::size_t l_;
  Prolongation kind_;
  Level const& level_;
  std::shared_ptr<LevelFaces const> faces_;
  Equation equation_;
  FormsNear near_;
  GapFits gaps_;
  ByShape<Form> laplacians_;
  Level const* coarser_ = nullptr;
  Level const* finer_ = nullptr;
  Terms terms_;
  Row row_;
  OpenWalls open_walls_;
  Real3 seam_width_;
  RegularProlongation prolong_;
  CrsBuilder no_fine_;
  std::optional<CrsBuilder> composite_, fine_boundary_, restriction_, coarse_boundary_, prolongation_;
  std::vector<char> uncovered_;
};

/// Whether both have the same level in a place, or none.
bool same_level(MultigridLevels const& multigrid, MultigridLevels const& former, std::size_t l) {
  std::size_t const count = multigrid.levels.size(), before = former.levels.size();
  return (l >= count && l >= before) || (l < count && l < before && multigrid.levels[l]->same_as(*former.levels[l]));
}

/// The operators in `former` of levels that it has with the same neighbouring levels; null for the others. The
/// halo may be numbered differently.
MultigridOperators reused(MultigridLevels const& multigrid, Prolongation prolongation, Assembled const& former) {
  std::size_t const count = multigrid.levels.size(), before = former.multigrid.levels.size();
  MultigridOperators out(count);
  if (prolongation != former.prolongation || multigrid.base != former.multigrid.base ||
      multigrid.boundary != former.multigrid.boundary || multigrid.shift != former.multigrid.shift)
    return out;
  auto same = [&](std::size_t l) { return same_level(multigrid, former.multigrid, l); };
  bool const only_neighbours_count = !refines_open_wall(multigrid) && !refines_open_wall(former.multigrid);
  for (std::size_t l = 0; l < std::min(count, before); ++l) {
    bool lasts = (l == 0 || same(l - 1)) && same(l) && same(l + 1);
    for (std::size_t finer = l + 2; finer < std::max(count, before) && !only_neighbours_count; ++finer)
      lasts = lasts && same(finer);
    if (lasts) out[l] = former.operators[l];
  }
  return out;
}

/// Free operators whose columns have another halo now, on any rank, or whose fits in gaps may be others. Collective.
void drop_outdated(Communicator const& comm, MultigridLevels const& multigrid, Assembled const& former,
                   std::vector<Halo> const& halos, MultigridOperators& operators) {
  std::size_t const count = halos.size();
  std::vector<int> other(2 * count);  // halos, then fits
  for (std::size_t l = 0; l < count; ++l) {
    bool const is_new = l >= former.operators.size();
    other[l] = is_new || !former.operators[l]->halo.has_cells_of(halos[l]);
    other[count + l] = !is_new && former.operators[l]->has_gaps && !same_level(multigrid, former.multigrid, l + 2);
  }
  comm.largest_each(other);
  for (std::size_t l = 0; l < count; ++l)
    if (other[l] || (l > 0 && other[l - 1]) || (l + 1 < count && other[l + 1]) || other[count + l])
      operators[l].reset();
}

}  // namespace

MultigridLevels refinement_levels(Hierarchy const& hierarchy, Real shift) {
  MultigridLevels multigrid;
  multigrid.shift = shift;
  multigrid.boundary = hierarchy.domain().boundary;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    multigrid.levels.push_back(hierarchy.share_level(l));
    multigrid.faces.push_back(hierarchy.share_faces(l));
    multigrid.ratio.push_back(refinement_ratio);
    multigrid.parents_in_place.push_back(0);
    multigrid.upper.emplace_back();
    Real3 const h = hierarchy.level(l).spacing();
    WallGhosts& walls = multigrid.walls.emplace_back();
    for (int d = 0; d < 3; ++d)
      for (int side = 0; side < 2; ++side) walls[d][side] = wall_ghost(multigrid.boundary[d][side], h[d]);
  }
  return multigrid;
}

Assembled assemble(Communicator const& comm, MultigridLevels const& multigrid, Prolongation prolongation,
                   Assembled former) {
  std::size_t const count = multigrid.levels.size();
  Assembled result{multigrid, prolongation, reused(multigrid, prolongation, former), 0};
  MultigridOperators& out = result.operators;
  std::vector<Halo> halos;
  for (std::size_t l = 0; l < count; ++l) halos.emplace_back(comm, operator_reads(multigrid, l, prolongation));
  drop_outdated(comm, multigrid, former, halos, out);
  former = {};

  std::vector<std::unique_ptr<LevelAssembly>> assemblies(count);
  for (std::size_t l = 0; l < count; ++l) {
    if (out[l]) continue;
    ++result.made;
    assemblies[l] = std::make_unique<LevelAssembly>(multigrid, l, prolongation);
    assemblies[l]->count();
    out[l] = std::make_shared<LevelOperators>();
    out[l]->halo = halos[l];
    out[l]->stencil_halo = Halo(comm, halos[l], relaxation_reads(multigrid, l));
  }
  for (std::size_t l = 0; l < count; ++l) {
    if (!assemblies[l]) continue;
    assemblies[l]->fill(out[l]->halo, l > 0 ? &out[l - 1]->halo : nullptr, l + 1 < count ? &out[l + 1]->halo : nullptr);
    assemblies[l]->move_into(*out[l]);
    assemblies[l].reset();
  }
  return result;
}

std::size_t LevelOperators::bytes() const {
  std::size_t sum = no_fine.bytes() + (own_composite ? own_composite->bytes() : 0) + coarse_boundary.bytes() +
                    fine_boundary.bytes() + restriction.bytes() + prolongation.bytes() + uncovered.size();
  for (auto const& axis : gradient) sum += axis.own.bytes() + axis.coarse.bytes() + axis.fine.bytes();
  return sum;
}

}  // namespace amrpic
