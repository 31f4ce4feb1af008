#include <algorithm>
#include <map>
#include <optional>
#include <tuple>

#include "matrices/halos.hpp"
#include "matrices/intergrid_rows.hpp"
#include "matrices/near_levels.hpp"
#include "matrices/operators.hpp"
#include "multigrid/metal_on_levels.hpp"
#include "multigrid/open_walls.hpp"

namespace amrpic {

namespace {

/// The form of prolongation to a cell whose parents all exist.
Form regular_prolongation(Index3 const& cell, Index3 const& ratio, Prolongation kind) {
  Trilinear at{{0, 0, 0}};
  for (int d = 0; d < 3; ++d)
    if (kind == Prolongation::trilinear && ratio[d] == 2) {
      at.near[d] = prolongation::near, at.far[d] = prolongation::far;
      at.step[d] = cell[d] % 2 == 0 ? -1 : 1;
    }
  Form out;
  at.for_each([&](Index3 const& source, Real weight) { out.append(from_anchor(source, {0, 0, 0}), weight); });
  return out;
}

/// The form of means over children that all exist.
Form regular_mean(Index3 const& ratio) {
  Form out;
  for_each_cell(Box{{0, 0, 0}, {0, 0, 0}}.refine(ratio), [&](Index3 const& child) {
    out.append(from_anchor(child, {0, 0, 0}), mean_weight(ratio));
  });
  return out;
}

/// Metal as a level and those beside it see it.
class MetalBesideLevel {
 public:
  MetalBesideLevel(Metal const& metal, MultigridLevels const& multigrid, std::size_t l) {
    Level const& level = *multigrid.levels[l];
    auto const [coarser, finer, finest] = multigrid.beside(l);
    std::vector<Box> own, around, behind, near, before;
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      Box const& box = level.box(b);
      own.push_back(box), around.push_back(box.grow(1));
      behind.push_back(box.coarsen(refinement_ratio).grow(1 + plane_reach));
      near.push_back(box.grow(1 + plane_reach));
      if (!finer) continue;
      for (FinerNeighbour const& n : BoxFaces(level, box, finer).beside) {
        Index3 outwards{0, 0, 0};
        outwards[n.axis] = 1;
        before.push_back(n.cells.part.refine(refinement_ratio).grow(outwards));
      }
    }
    of_corrections = metal_on(metal, multigrid, l, own);
    if (l < multigrid.base) return;
    std::vector<Level const*> const next(finer ? 1 : 0, finer);
    of_potential = metal_of_level(metal, level, coarser, next, own, false).cells;
    if (coarser) behind_.emplace(*coarser, level, metal.cells(*coarser, behind), metal.cells(level, around));
    if (!before.empty()) before_.emplace(level, *finer, metal.cells(level, near), metal.cells(*finer, before));
  }

  MetalCells of_corrections, of_potential;  ///< as the equations of either have them

  /// What metal makes of a face of a cell between levels; null if it is as others are.
  MetalFace const* face(Index3 const& cell, int axis, int side, FaceShape const& shape) {
    bool const is_behind = shape.beyond == Beyond::coarser;
    auto const& levels = is_behind ? behind_ : before_;
    if (!levels || (!is_behind && shape.beyond != Beyond::finer)) return nullptr;
    Index3 coarse = cell;
    if (is_behind) coarse[axis] += side == 0 ? -1 : 1, coarse = parent_of(coarse);
    CoarseFace const at{coarse, axis, is_behind ? side : 1 - side};
    auto const [known, is_new] = faces_.try_emplace({is_behind, axis, side, coarse[0], coarse[1], coarse[2]});
    if (is_new) known->second = levels->beside_metal(at, shape.fit);
    return known->second ? &*known->second : nullptr;
  }

 private:
  std::optional<LevelsInMetal> behind_, before_;
  std::map<std::tuple<bool, int, int, int, int, int>, std::optional<MetalFace>> faces_;
};

/// Names the form of each row of one level's operators, box by box; kernels then fill these.
class LevelAssembly {
 public:
  /// `coarse`, `fine`: null where there is no such level.
  LevelAssembly(MultigridLevels const& multigrid, std::size_t l, Prolongation kind, LevelCells const& own,
                LevelCells const* coarse, LevelCells const* fine, Metal const* metal)
      : multigrid_(multigrid),
        l_(l),
        kind_(kind),
        level_(own.level()),
        faces_(multigrid.faces[l]),
        equation_(multigrid.equation(l)),
        near_(level_, multigrid.walls[l]),
        open_walls_(multigrid),
        seam_width_(seam_widths(level_.periodic(), multigrid.upper[l])),
        levels_{&own, coarse, fine, multigrid.ratio[l], fine ? multigrid.ratio[l + 1] : Index3{1, 1, 1}, {}, {}, {}},
        coarser_(coarse ? &coarse->level() : nullptr),
        finer_(fine ? &fine->level() : nullptr),
        no_fine_(own.rows()),
        composite_(own.rows()),
        fine_boundary_(own.rows()),
        restriction_(own.rows()),
        coarse_boundary_(own.rows()),
        prolongation_(own.rows()),
        uncovered_(std::size_t(own.rows()), 1) {
    if (!faces_) faces_ = std::make_shared<LevelFaces const>(faces_of_boxes(level_, nullptr));
    if (metal) metal_.emplace(*metal, multigrid, l);
    regular_laplacian_ = own_forms_.number(regular_laplacian(equation_, near_));
    if (finer_) regular_mean_ = fine_forms_.number(regular_mean(levels_.ratio_above));
    if (coarser_)
      for_each_cell(Box{{0, 0, 0}, {1, 1, 1}}, [&](Index3 const& c) {
        Form const form = regular_prolongation(c, levels_.ratio_below, kind_);
        regular_prolongation_[std::size_t(c[0] + 2 * c[1] + 4 * c[2])] = coarse_forms_.number(form);
      });
  }

  /// Local.
  void name_rows() {
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      StencilCells const n = stencil_cells_of((*faces_)[std::size_t(b - level_.first_local_box())], level_,
                                              multigrid_.beside(l_), seam_width_);
      Box const parents = coarser_ ? parents_read(level_.box(b), levels_.ratio_below, kind_) : Box{};
      auto const children = levels_.add(level_.box(b), n, parents);
      name_laplacians(b, n, children);
      if (coarser_) name_prolongation(b);
      if (metal_) name_metal(b, n);
      levels_.add_own(n);
    }
  }

  /// Collective.
  void fill(LevelOperators& out) {
    out.walls = multigrid_.walls[l_];
    for (int d = 0; d < 3; ++d) out.last_width[d] = multigrid_.upper[l_][d].width;
    out.no_fine = levels_.to_own(own_forms_, no_fine_);
    if (coarser_) {
      out.coarse_boundary = levels_.to_coarser(coarse_forms_, coarse_boundary_);
      out.prolongation = levels_.to_coarser(coarse_forms_, prolongation_);
    }
    if (has_composite()) out.own_composite = levels_.to_own(own_forms_, composite_);
    if (finer_) {
      out.fine_boundary = levels_.to_finer(fine_forms_, fine_boundary_);
      out.restriction = levels_.to_finer(fine_forms_, restriction_);
    }
    out.uncovered = std::move(uncovered_);
    out.has_gaps = !gaps_.empty();
  }

 private:
  /// A form of a shape, and the numbers of its parts.
  struct Numbered {
    SplitForm form;
    LocalIndex own, coarse, fine;
  };

  /// A multigrid level is covered whole by the next one.
  bool is_fully_covered() const { return finer_ && !multigrid_.refines(l_ + 1); }

  bool has_composite() const { return finer_ || metal_; }

  void name_laplacians(int b, StencilCells const& n, ArrayOnBox<LocalIndex> const& children) {
    auto const kinds = row_kinds(n, Execution::without_finer);
    auto const composite =
        is_fully_covered() ? RowKinds(level_.box(b), RowKind::covered) : row_kinds(n, Execution::composite);
    for_each_run(kinds, level_.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      if (kind == RowKind::regular) return no_fine_.set(run, regular_laplacian_);
      for_each_in_run(first, run,
                      [&](Index3 const& cell, LocalIndex row) { name_special(n, cell, row, composite(cell)); });
    });
    if (has_composite()) name_composite(b, n, composite, children);
  }

  CellShape shape_of(StencilCells const& n, Index3 const& cell, Execution execution) {
    CellShape out = cell_shape(n, cell, execution, gaps_);
    for (int axis = 0; metal_ && axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) out[axis][side].metal = metal_->face(cell, axis, side, out[axis][side]);
    return out;
  }

  Numbered const& laplacian(StencilCells const& n, Index3 const& cell, Execution execution) {
    CellShape const shape = shape_of(n, cell, execution);
    return laplacians_(shape, [&] {
      SplitForm form(laplacian_form(equation_, near_.own(),
                                    [&](int axis, int side) { return near_.across(shape[axis][side], axis, side); }));
      LocalIndex const own = own_forms_.number(form.own), coarse = coarse_forms_.number(form.coarse),
                       fine = fine_forms_.number(form.fine);
      return Numbered{std::move(form), own, coarse, fine};
    });
  }

  /// A row that a missing neighbour makes special, and with it that of the composite where it is the same.
  void name_special(StencilCells const& n, Index3 const& cell, LocalIndex row, RowKind composite) {
    Numbered const& form = laplacian(n, cell, Execution::without_finer);
    if (has_composite() && composite == RowKind::special) composite_.set(row, form.own);
    no_fine_.set(row,
                 composite == RowKind::covered ? own_forms_.number(with_open_walls(form.form.own, n, cell)) : form.own);
    coarse_boundary_.set(row, form.coarse);
  }

  /// The composite's rows, except the special ones, and restriction.
  void name_composite(int b, StencilCells const& n, RowKinds const& kinds, ArrayOnBox<LocalIndex> const& children) {
    for_each_run(kinds, level_.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      if (kind == RowKind::regular) composite_.set(run, regular_laplacian_);
      if (kind == RowKind::covered) {
        name_restriction(first, run, children);
        std::fill_n(uncovered_.begin() + run.row, run.count, 0);
      }
      if (kind != RowKind::beside) return;
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
        Numbered const& form = laplacian(n, cell, Execution::composite);
        composite_.set(row, form.own);
        fine_boundary_.set(row, form.fine);
      });
    });
  }

  /// The equation of a cut cell. `open`: covered, so that corrections vanish some way behind open walls.
  SplitForm cut_form(StencilCells const& n, CutCell const& cut, Execution execution, bool open) {
    CellShape const shape = shape_of(n, cut.cell, execution);
    auto const is_at = [&](int axis, int side, Boundary kind) {
      return n.faces(cut.cell)(axis, side) == Beyond::wall && multigrid_.boundary[axis][side] == kind;
    };
    return SplitForm(cut_laplacian_form(
        equation_, near_.own(), cut,
        [&](int axis, int side) {
          return n.faces(cut.cell)(axis, side) == Beyond::wall && multigrid_.walls[l_][axis][side].second != 0;
        },
        [&](int axis, int side) {
          Form out = near_.across(shape[axis][side], axis, side);
          if (open && is_at(axis, side, Boundary::open))
            out += open_walls_.first(l_, cut.cell, axis, side) * near_.own();
          return out;
        }));
  }

  /// The rows of cells in and beside metal, in place of others.
  void name_metal(int b, StencilCells const& n) {
    auto const row_of = [&](Index3 const& cell) {
      return level_.local_offset(b) + LocalIndex(level_.box(b).offset(cell));
    };
    auto const set_boundaries = [&](LocalIndex row, SplitForm const& form) {
      coarse_boundary_.set(row, coarse_forms_.number(form.coarse));
      fine_boundary_.set(row, fine_forms_.number(form.fine));
    };
    LocalIndex const held = own_forms_.number(-equation_.diagonal() * near_.own());
    for_each_row(level_.box(b), [&](Index3 const& first) {
      int const count = level_.box(b).extent(0);
      metal_->of_corrections.for_each_cut(first, count, [&](CutCell const& cut) {
        LocalIndex const row = row_of(cut.cell);
        SplitForm const form = cut_form(n, cut, Execution::without_finer, !uncovered_[std::size_t(row)]);
        no_fine_.set(row, own_forms_.number(form.own));
      });
      metal_->of_potential.for_each_cut(first, count, [&](CutCell const& cut) {
        LocalIndex const row = row_of(cut.cell);
        if (!uncovered_[std::size_t(row)]) return;
        SplitForm const form = cut_form(n, cut, Execution::composite, false);
        composite_.set(row, own_forms_.number(form.own));
        set_boundaries(row, form);
      });
      metal_->of_corrections.for_each_solid(first, count, [&](SolidCell const& solid) {
        LocalIndex const row = row_of(solid.cell);
        no_fine_.set(row, held);
        composite_.set(row, no_form), prolongation_.set(row, no_form);
        set_boundaries(row, {});
      });
    });
  }

  /// Means over children; some are missing or weigh otherwise at the upper ends of the finer level.
  void name_restriction(Index3 const& first, RowRun const& run, ArrayOnBox<LocalIndex> const& children) {
    Index3 const ratio = levels_.ratio_above;
    auto const weight = last_children_of(multigrid_, l_ + 1);
    auto special = [&](int d, int parent) {
      int const last = finer_->domain().upper[d];
      bool const otherwise = weight[d].last != 1 || weight[d].before != 1 || last % ratio[d] != ratio[d] - 1;
      return otherwise && parent == last / ratio[d];
    };
    LocalIndex regular = run.count;
    if (special(1, first[1]) || special(2, first[2]))
      regular = 0;
    else if (special(0, first[0] + run.count - 1))
      --regular;
    restriction_.set(RowRun{run.row, regular}, regular_mean_);
    for (LocalIndex n = regular; n < run.count; ++n) {
      Index3 const cell{first[0] + int(n), first[1], first[2]};
      Index3 const anchor = Box{cell, cell}.refine(ratio).lower;
      Form form;
      restrict_mean(cell, ratio, *finer_, children, weight,
                    [&](Index3 const& child, Real w) { form.append(from_anchor(child, anchor), w); });
      restriction_.set(run.row + n, fine_forms_.number(form));
    }
  }

  /// Covered cells hold corrections of finer ones alone.
  Form with_open_walls(Form form, StencilCells const& n, Index3 const& cell) {
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side)
        if (n.faces(cell)(axis, side) == Beyond::wall && multigrid_.boundary[axis][side] == Boundary::open)
          form.add(near_.own().terms()[0].column, equation_.weight[axis] * open_walls_.first(l_, cell, axis, side));
    return form;
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

  void name_prolongation(int b) {
    Index3 const ratio = levels_.ratio_below;
    Real3 const coarse_seam = seam_widths(coarser_->periodic(), multigrid_.upper[l_ - 1]);
    auto special = [&](Index3 const& cell) {
      Index3 const parent = Box{cell, cell}.coarsen(ratio).lower;
      Form form;
      prolong(
          cell, ratio, kind_, *coarser_, coarse_seam,
          [&](Index3 const& at, int axis, int side) {
            return prolonged_end(multigrid_, open_walls_, l_ - 1, at, axis, side);
          },
          [&](Index3 const& source, Real w) { form.append(from_anchor(source, parent), w); });
      return coarse_forms_.number(form);
    };
    for_each_run(prolongation_kinds(level_.box(b)), level_.local_offset(b),
                 [&](RowKind kind, Index3 const& first, RowRun const& run) {
                   std::size_t const line = std::size_t(2 * (first[1] & 1) + 4 * (first[2] & 1));
                   for_each_in_run(first, run, [&](Index3 const& c, LocalIndex row) {
                     bool const regular = kind == RowKind::regular;
                     prolongation_.set(row, regular ? regular_prolongation_[line + std::size_t(c[0] & 1)] : special(c));
                   });
                 });
  }

  MultigridLevels const& multigrid_;
  std::size_t l_;
  Prolongation kind_;
  Level const& level_;
  std::shared_ptr<LevelFaces const> faces_;
  Equation equation_;
  FormsNear near_;
  GapFits gaps_;
  ByShape<Numbered> laplacians_;
  OpenWalls open_walls_;
  Real3 seam_width_;
  NearLevels levels_;
  Level const *coarser_, *finer_;
  FormTable own_forms_, coarse_forms_, fine_forms_;
  LocalIndex regular_laplacian_ = no_form, regular_mean_ = no_form;
  std::array<LocalIndex, 8> regular_prolongation_{};  ///< by the parities of the cell
  RowForms no_fine_, composite_, fine_boundary_, restriction_, coarse_boundary_, prolongation_;
  std::vector<char> uncovered_;
  std::optional<MetalBesideLevel> metal_;
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
  bool const only_neighbours_count = !OpenWalls(multigrid).are_refined() && !OpenWalls(former.multigrid).are_refined();
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
    other[l] = is_new || !former.operators[l]->cells->halo().has_cells_of(halos[l]);
    other[count + l] = !is_new && former.operators[l]->has_gaps && !same_level(multigrid, former.multigrid, l + 2);
  }
  comm.largest_each(other);
  for (std::size_t l = 0; l < count; ++l)
    if (other[l] || (l > 0 && other[l - 1]) || (l + 1 < count && other[l + 1]) || other[count + l])
      operators[l].reset();
}

}  // namespace

Assembled assemble(Communicator const& comm, MultigridLevels const& multigrid, Prolongation prolongation,
                   Assembled former, Metal const* metal) {
  std::size_t const count = multigrid.levels.size();
  Assembled result{multigrid, prolongation, reused(multigrid, prolongation, former), 0};
  MultigridOperators& out = result.operators;
  std::vector<Halo> halos;
  for (std::size_t l = 0; l < count; ++l) halos.emplace_back(comm, operator_reads(multigrid, l, prolongation));
  drop_outdated(comm, multigrid, former, halos, out);
  former = {};

  std::vector<bool> is_new(count);
  for (std::size_t l = 0; l < count; ++l) {
    if (out[l]) continue;
    ++result.made;
    is_new[l] = true;
    out[l] = std::make_shared<LevelOperators>();
    out[l]->level = multigrid.levels[l];
    out[l]->cells = std::make_shared<LevelCells const>(comm, multigrid.levels[l], std::move(halos[l]),
                                                       relaxation_reads(multigrid, l));
  }
  for (std::size_t l = 0; l < count; ++l) {
    if (!is_new[l]) continue;
    LevelAssembly assembly(multigrid, l, prolongation, *out[l]->cells, l > 0 ? out[l - 1]->cells.get() : nullptr,
                           l + 1 < count ? out[l + 1]->cells.get() : nullptr, metal);
    assembly.name_rows();
    assembly.fill(*out[l]);
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
