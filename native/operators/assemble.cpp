#include <algorithm>
#include <optional>

#include "operators/open_walls.hpp"
#include "operators/operators.hpp"
#include "operators/row.hpp"
#include "stencil/gradient.hpp"

namespace amrpic {

namespace {

/// Terms of a row, apart by the level of the columns.
struct Terms {
  Row own_row, coarse_row, fine_row;
  void clear() { own_row.clear(), coarse_row.clear(), fine_row.clear(); }
  void own(GlobalIndex cell, Real value) { own_row.add(cell, value); }
  void coarse(GlobalIndex cell, Real value) { coarse_row.add(cell, value); }
  void fine(GlobalIndex cell, Real value) { fine_row.add(cell, value); }
};

void laplacian_row(Neighbourhood const& n, Index3 const& cell, Execution execution, Terms& terms) {
  terms.own(n.own(cell), 0);  // the diagonal comes first
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) outward_gradient(n, cell, axis, side, execution, 1 / n.spacing[axis], terms);
}

/// Rows of cells inside a box, away from its surface and from refined cells: their columns follow from the place of the
/// row, their weights are the same for all. The general formula gives the same rows, term by term.
class PlainRows {
 public:
  PlainRows(Box const& box, Real3 const& spacing)
      : inside_(box.grow(-1)), stride_{1, box.extent(0), box.extent(0) * box.extent(1)} {
    laplacian_[0] = 0;
    for (int d = 0; d < 3; ++d) {
      laplacian_[1 + 2 * d] = laplacian_[2 + 2 * d] = 1 / spacing[d] / spacing[d];
      laplacian_[0] -= 2 / spacing[d] / spacing[d];
      gradient_[d] = {0.5 / spacing[d], -0.5 / spacing[d]};
    }
  }
  bool has(Index3 const& cell) const { return inside_.contains(cell); }
  bool next_to_covered(Neighbourhood const& n, Index3 const& cell) const {
    for (int d = 0; d < 3; ++d)
      for (int step : {-1, 1}) {
        Index3 other = cell;
        other[d] += step;
        if (n.covered(other)) return true;
      }
    return false;
  }
  void put_laplacian(LocalIndex row, CrsBuilder& builder) const {
    builder.put_own<7>({row, row - 1, row + 1, row - stride_[1], row + stride_[1], row - stride_[2], row + stride_[2]},
                       laplacian_);
  }
  void put_gradient(LocalIndex row, int axis, CrsBuilder& builder) const {
    builder.put_own<2>({row - stride_[axis], row + stride_[axis]}, gradient_[axis]);
  }

 private:
  Box inside_;
  std::array<LocalIndex, 3> stride_;
  std::array<Real, 7> laplacian_;
  std::array<std::array<Real, 2>, 3> gradient_;
};

/// E along an axis: minus the mean of the two face derivatives, of which the lower one points outward against the axis.
void gradient_row(Neighbourhood const& n, Index3 const& cell, int axis, Execution execution, Terms& terms) {
  outward_gradient(n, cell, axis, 0, execution, 0.5, terms);
  outward_gradient(n, cell, axis, 1, execution, -0.5, terms);
}

std::vector<GlobalIndex> joined(std::vector<std::vector<GlobalIndex> const*> const& lists) {
  std::vector<GlobalIndex> out;
  for (auto const* list : lists) out.insert(out.end(), list->begin(), list->end());
  return out;
}

/// Builders of one level's operators; `pass` runs the formulas once over all rows and so counts or fills.
class LevelAssembly {
 public:
  LevelAssembly(LevelStack const& stack, std::size_t l, Prolongation kind)
      : stack_(stack),
        l_(l),
        kind_(kind),
        level_(*stack.levels[l]),
        open_walls_(stack),
        no_fine_(rows(), level_),
        uncovered_(std::size_t(rows()), 1) {
    if (l > 0) {
      coarser_ = stack.levels[l - 1].get();
      coarse_boundary_.emplace(rows(), *coarser_);
      prolongation_.emplace(rows(), *coarser_);
    }
    if (l + 1 < stack.levels.size()) {
      finer_ = stack.levels[l + 1].get();
      composite_.emplace(rows(), level_);
      fine_boundary_.emplace(rows(), *finer_);
      restriction_.emplace(rows(), *finer_);
    }
  }

  void pass() {
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      laplacians(b);
      if (finer_) restriction(b);
      if (coarser_) prolongation(b);
    }
  }

  void start_filling(Exchange const& own, Exchange const* coarse, Exchange const* fine) {
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
  }

  using Lists = std::vector<std::vector<GlobalIndex> const*>;
  Lists remote_stencil() const { return {&no_fine_.remote()}; }
  void add_remote_own(Lists& out) const {
    out.push_back(&no_fine_.remote());
    if (finer_) out.push_back(&composite_->remote());
  }
  void add_remote_coarse(Lists& out) const {
    if (coarser_) out.insert(out.end(), {&coarse_boundary_->remote(), &prolongation_->remote()});
  }
  void add_remote_fine(Lists& out) const {
    if (finer_) out.insert(out.end(), {&fine_boundary_->remote(), &restriction_->remote()});
  }

  void move_into(LevelOperators& out) {
    out.level = stack_.levels[l_];
    out.walls = stack_.walls[l_];
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
  }

 private:
  LocalIndex rows() const { return level_.local_cells(); }

  void laplacians(int b) {
    Box const box = level_.box(b);
    Neighbourhood const n = look_around(box, level_, stack_.refines(l_ + 1) ? finer_ : nullptr,
                                        stack_.refines(l_) ? coarser_ : nullptr, stack_.walls[l_]);
    // a multigrid level is covered whole by the next one
    bool const hidden = finer_ && !stack_.refines(l_ + 1);
    PlainRows const plain(box, level_.spacing());
    LocalIndex row = level_.local_offset(b);
    for_each_cell(box, [&](Index3 const& cell) {
      bool const inside = plain.has(cell);
      if (inside) {
        plain.put_laplacian(row, no_fine_);
        if (coarser_) coarse_boundary_->put_empty();
      } else {
        terms_.clear();
        laplacian_row(n, cell, Execution::without_finer, terms_);
        if (hidden || n.covered(cell)) add_open_walls(n, cell);
        no_fine_.put(terms_.own_row);
        if (coarser_) coarse_boundary_->put(terms_.coarse_row);
      }
      if (finer_) composite(n, plain, cell, row, hidden || n.covered(cell), inside);
      ++row;
    });
  }

  /// Covered cells hold corrections of finer ones alone.
  void add_open_walls(Neighbourhood const& n, Index3 const& cell) {
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        bool const at_wall = cell[axis] == (side == 0 ? n.domain.lower[axis] : n.domain.upper[axis]);
        if (at_wall && stack_.boundary[axis][side] == Boundary::open)
          terms_.own(n.own(cell), open_walls_.first(l_, cell, axis, side) / n.spacing[axis] / n.spacing[axis]);
      }
  }

  /// Ghost of a coarser level's correction behind a wall, over its first cell inside.
  Real correction_at_wall(Index3 const& parent, int axis, int side) const {
    Boundary const kind = stack_.boundary[axis][side];
    return kind == Boundary::open ? open_walls_.first(l_ - 1, parent, axis, side) : coarse_wall_ghost(kind).first;
  }

  void composite(Neighbourhood const& n, PlainRows const& plain, Index3 const& cell, LocalIndex row, bool covered,
                 bool inside) {
    uncovered_[std::size_t(row)] = !covered;
    if (covered) {
      composite_->put_empty();
      fine_boundary_->put_empty();
    } else if (inside && !plain.next_to_covered(n, cell)) {
      plain.put_laplacian(row, *composite_);
      fine_boundary_->put_empty();
    } else {
      terms_.clear();
      laplacian_row(n, cell, Execution::composite, terms_);
      composite_->put(terms_.own_row);
      fine_boundary_->put(terms_.fine_row);
    }
  }

  void restriction(int b) {
    Index3 const ratio = stack_.ratio[l_ + 1];
    Box const box = level_.box(b);
    auto const fine = cell_numbers(*finer_, box.refine(ratio));
    for_each_cell(box, [&](Index3 const& cell) {
      terms_.clear();
      if (fine({cell[0] * ratio[0], cell[1] * ratio[1], cell[2] * ratio[2]}) != no_cell)
        restrict_mean(cell, ratio, fine, [&](GlobalIndex c, Real w) { terms_.fine_row.append(c, w); });
      restriction_->put(terms_.fine_row);
    });
  }

  void prolongation(int b) {
    Index3 const ratio = stack_.ratio[l_];
    Box const box = level_.box(b);
    auto const coarse = cell_numbers(*coarser_, box.coarsen(ratio).grow(1));
    for_each_cell(box, [&](Index3 const& cell) {
      terms_.clear();
      prolong(
          cell, ratio, kind_, coarse, coarser_->domain(), level_.periodic(),
          [&](Index3 const& parent, int axis, int side) { return correction_at_wall(parent, axis, side); },
          [&](GlobalIndex c, Real w) { terms_.coarse_row.append(c, w); });
      prolongation_->put(terms_.coarse_row);
    });
  }

  LevelStack const& stack_;
  std::size_t l_;
  Prolongation kind_;
  Level const& level_;
  Level const* coarser_ = nullptr;
  Level const* finer_ = nullptr;
  Terms terms_;
  OpenWalls open_walls_;
  CrsBuilder no_fine_;
  std::optional<CrsBuilder> composite_, fine_boundary_, restriction_, coarse_boundary_, prolongation_;
  std::vector<char> uncovered_;
};

}  // namespace

LevelStack stack_of(Hierarchy const& hierarchy) {
  LevelStack stack;
  stack.boundary = hierarchy.domain().boundary;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    stack.levels.push_back(hierarchy.share_level(l));
    stack.ratio.push_back(refinement_ratio);
    Real3 const h = hierarchy.level(l).spacing();
    Domain const& domain = hierarchy.domain();
    stack.walls.push_back(wall_ghosts(domain, [&](Boundary kind, int axis) { return wall_ghost(kind, h[axis]); }));
  }
  return stack;
}

std::vector<LevelOperators> assemble(MPI_Comm comm, LevelStack const& stack, Prolongation prolongation) {
  std::size_t const count = stack.levels.size();
  std::vector<std::unique_ptr<LevelAssembly>> assemblies;
  for (std::size_t l = 0; l < count; ++l) {
    assemblies.push_back(std::make_unique<LevelAssembly>(stack, l, prolongation));
    assemblies.back()->pass();
  }
  std::vector<LevelOperators> out(count);
  for (std::size_t l = 0; l < count; ++l) {
    LevelAssembly::Lists readers;
    assemblies[l]->add_remote_own(readers);
    if (l > 0) assemblies[l - 1]->add_remote_fine(readers);
    if (l + 1 < count) assemblies[l + 1]->add_remote_coarse(readers);
    auto const ghosts = remote_cells(*stack.levels[l], joined(readers));
    out[l].halo = Exchange(comm, *stack.levels[l], ghosts);
    out[l].stencil_halo = Exchange(comm, *stack.levels[l], ghosts,
                                   remote_cells(*stack.levels[l], joined(assemblies[l]->remote_stencil())));
  }
  for (std::size_t l = 0; l < count; ++l)
    assemblies[l]->start_filling(out[l].halo, l > 0 ? &out[l - 1].halo : nullptr,
                                 l + 1 < count ? &out[l + 1].halo : nullptr);
  for (std::size_t l = 0; l < count; ++l) {
    assemblies[l]->pass();
    assemblies[l]->move_into(out[l]);
    assemblies[l].reset();
  }
  return out;
}

void assemble_gradient(LevelStack const& stack, std::vector<LevelOperators>& operators) {
  for (std::size_t l = stack.base; l < stack.levels.size(); ++l) {
    Level const& level = *stack.levels[l];
    Level const* coarser = stack.refines(l) ? stack.levels[l - 1].get() : nullptr;
    Level const* finer = stack.refines(l + 1) ? stack.levels[l + 1].get() : nullptr;
    LocalIndex const rows = level.local_cells();
    // Every cell that a face derivative reads is in the halo, since the Laplacian reads it too.
    std::array<CrsBuilder, 3> own{CrsBuilder(rows, level), CrsBuilder(rows, level), CrsBuilder(rows, level)};
    std::vector<CrsBuilder> coarse, fine;
    for (int d = 0; d < 3; ++d) {
      coarse.emplace_back(rows, coarser ? *coarser : level);
      fine.emplace_back(rows, finer ? *finer : level);
    }
    Terms terms;
    auto pass = [&] {
      for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
        Neighbourhood const n = look_around(level.box(b), level, finer, coarser, stack.walls[l]);
        PlainRows const plain(level.box(b), level.spacing());
        LocalIndex row = level.local_offset(b);
        for_each_cell(level.box(b), [&](Index3 const& cell) {
          bool const is_plain = plain.has(cell) && !n.covered(cell) && !plain.next_to_covered(n, cell);
          for (int d = 0; d < 3; ++d) {
            terms.clear();
            if (is_plain)
              plain.put_gradient(row, d, own[d]);
            else if (!n.covered(cell))
              gradient_row(n, cell, d, Execution::composite, terms);
            if (!is_plain) own[d].put(terms.own_row);
            coarse[d].put(terms.coarse_row);
            fine[d].put(terms.fine_row);
          }
          ++row;
        });
      }
    };
    pass();
    for (int d = 0; d < 3; ++d) {
      own[d].start_filling(operators[l].halo);
      coarse[d].start_filling(coarser ? operators[l - 1].halo : operators[l].halo);
      fine[d].start_filling(finer ? operators[l + 1].halo : operators[l].halo);
    }
    pass();
    for (int d = 0; d < 3; ++d) operators[l].gradient[d] = {own[d].take(), coarse[d].take(), fine[d].take()};
  }
}

std::array<Crs, 3> assemble_covered_gradient(LevelStack const& stack, std::size_t l, LevelOperators const& operators) {
  Level const& level = *stack.levels[l];
  LocalIndex const rows = level.local_cells();
  std::array<CrsBuilder, 3> axes{CrsBuilder(rows, level), CrsBuilder(rows, level), CrsBuilder(rows, level)};
  Terms terms;
  auto pass = [&] {
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      // Levels nest, so the neighbours of a covered cell are cells of its level or lie beyond a wall.
      Neighbourhood const n = look_around(level.box(b), level, nullptr, nullptr, stack.walls[l]);
      PlainRows const plain(level.box(b), level.spacing());
      LocalIndex row = level.local_offset(b);
      for_each_cell(level.box(b), [&](Index3 const& cell) {
        for (int d = 0; d < 3; ++d) {
          if (operators.uncovered[row]) {
            axes[d].put_empty();
          } else if (plain.has(cell)) {
            plain.put_gradient(row, d, axes[d]);
          } else {
            terms.clear();
            gradient_row(n, cell, d, Execution::without_finer, terms);
            axes[d].put(terms.own_row);
          }
        }
        ++row;
      });
    }
  };
  pass();
  for (CrsBuilder& axis : axes) axis.start_filling(operators.halo);
  pass();
  return {axes[0].take(), axes[1].take(), axes[2].take()};
}

std::size_t LevelOperators::bytes() const {
  std::size_t sum = no_fine.bytes() + (own_composite ? own_composite->bytes() : 0) + coarse_boundary.bytes() +
                    fine_boundary.bytes() + restriction.bytes() + prolongation.bytes() + uncovered.size();
  for (auto const& axis : gradient) sum += axis.own.bytes() + axis.coarse.bytes() + axis.fine.bytes();
  return sum;
}

}  // namespace amrpic
