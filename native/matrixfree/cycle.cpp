#include "matrixfree/cycle.hpp"

#include <algorithm>
#include <limits>

#include "base/no_denormals.hpp"
#include "operators/semicoarse.hpp"

namespace amrpic::matrixfree {

namespace {

/// The ghost cells of corrections on multigrid level l.
GhostRules ghost_rules_of(MultigridLevels const& multigrid, OpenWalls const& open_walls, std::size_t l) {
  GhostRules out;
  out.walls = multigrid.walls[l];
  out.seam_width = seam_widths(multigrid.levels[l]->periodic(), multigrid.upper[l]);
  out.inside = [](Index3 const&, int, int) { return WallGhost{interface_ghost::first, interface_ghost::second, 0}; };
  // Covered cells hold corrections of finer ones alone, and those vanish where the finest level's do.
  bool const fully_covered = l < multigrid.base;
  Level const* finer = l + 1 < multigrid.levels.size() ? multigrid.levels[l + 1].get() : nullptr;
  out.more = [&multigrid, &open_walls, l, fully_covered, finer](Index3 const& cell, int axis, int side) -> Real {
    if (multigrid.boundary[axis][side] != Boundary::open) return 0;
    Index3 const own = multigrid.levels[l]->wrapped(cell);
    bool const covered = fully_covered || (finer && finer->find({2 * own[0], 2 * own[1], 2 * own[2]}) >= 0);
    return covered ? open_walls.first(l, own, axis, side) : 0;
  };
  return out;
}

constexpr int reach_in_gaps = 4;  ///< how many cells away those lie that fits in gaps take

/// Which levels have gaps behind their faces whose fits take fine cells, on any rank. Collective.
std::vector<int> levels_with_gaps(Communicator const& comm, MultigridLevels const& multigrid) {
  std::vector<int> out(multigrid.levels.size());
  for (std::size_t l = multigrid.base + 1; l < out.size() && gap_fits_take_fine_cells(*multigrid.levels[l]); ++l)
    for (BoxFaces const& faces : *multigrid.faces[l])
      for (Box const& gap : gaps_behind(faces, *multigrid.levels[l], *multigrid.levels[l - 1]))
        out[l] = out[l] || !gap.empty();
  comm.largest_each(out);
  return out;
}

/// So many cells of a rank stay near the processor from one half of a sweep to the next, which then costs less than
/// deep copies; with more, all sweeps go over them in one pass.
constexpr GlobalIndex in_cache = 300'000;

/// Whether the copies of a level without a cycle of its own are one layer deep. The same on all ranks.
bool has_thin_copies(Level const& level, GhostRules const& rules) {
  bool even = true;  // with odd rings, cells of one colour meet
  for (int d = 0; d < 3; ++d)
    even = even && !rules.seams()[d] && !(level.periodic()[d] && level.domain().extent(d) % 2);
  return level.ranks() > 1 && even && level.cells() <= in_cache * level.ranks_in_use();
}

constexpr GlobalIndex whole_on_all_ranks = 10000;  ///< cells of a level; relaxing so few costs less than messages

/// Whether the coarsest level leaves the mean as it is: nothing holds it, or screening so weakly that it would be made
/// of what single precision rounds. What sweeps change of it adds next to nothing to the residual beside other errors,
/// or double precision has no digits for it.
bool leaves_mean(MultigridLevels const& multigrid) {
  Real const of_others = smallest_eigenvalue(*multigrid.levels[multigrid.base], multigrid.boundary, 0);
  bool const is_free = std::all_of(multigrid.boundary.begin(), multigrid.boundary.end(), is_closed);
  return is_free &&
         multigrid.shift < std::max(1e-9 * of_others, 1e-15 * multigrid.equation(multigrid.base).diagonal());
}

/// Walls of the coarsest level, with the open ones where corrections vanish behind the middle of each face.
WallGhosts walls_of_coarsest(MultigridLevels const& multigrid, GhostRules const& rules) {
  WallGhosts out = rules.walls;
  Box const& domain = multigrid.levels.front()->domain();
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side)
      if (multigrid.boundary[axis][side] == Boundary::open) {
        Index3 cell{domain.extent(0) / 2, domain.extent(1) / 2, domain.extent(2) / 2};
        cell[axis] = side == 0 ? domain.lower[axis] : domain.upper[axis];
        out[axis][side].first += rules.more(cell, axis, side);
      }
  return out;
}

}  // namespace

MultigridLevels Cycle::levels_of(Hierarchy const& hierarchy, Real shift, int order) {
  return coarsen_below(refinement_levels(hierarchy, shift, order), hierarchy.domain(),
                       {hierarchy.max_grid_size(), whole_on_all_ranks}, std::numeric_limits<int>::max());
}

Cycle::Cycle(Communicator const& comm, MultigridLevels multigrid, int max_grid_size, Relaxation const& relaxation,
             std::shared_ptr<GapFits> gap_fits, int most_direct, Known* known)
    : comm_(comm), multigrid_(std::move(multigrid)), relaxation_(relaxation) {
  Real const shift = multigrid_.shift;
  OpenWalls const open_walls(multigrid_);
  auto const has_gaps = levels_with_gaps(comm, multigrid_);
  for (std::size_t l = 0; l < multigrid_.levels.size(); ++l) {
    CycleLevel level;
    GhostRules const rules = ghost_rules_of(multigrid_, open_walls, l);
    Relaxation own = relaxation;
    own.factor = relaxation_on(*multigrid_.levels[l], shift, multigrid_.halves_at_most(l), relaxation.factor);
    std::vector<LevelCopy> copies;
    if (multigrid_.refines(l))
      copies = semicoarse_copies(multigrid_.levels[l], rules.walls, multigrid_.boundary, max_grid_size);
    // sweeps that do not start from zero, and a residual after them, read one cell further
    int const deep = own.halo() + (!copies.empty() || !multigrid_.refines(l) ? 1 : 0);
    bool const thin = copies.empty() && !has_gaps[l] && has_thin_copies(*multigrid_.levels[l], rules);
    int const halo = thin ? 1 : std::max(deep, has_gaps[l] ? reach_in_gaps : 0);
    level.swept =
        std::make_unique<SweptLevel>(comm, multigrid_.levels[l], rules, multigrid_.boundary, shift, own, halo);
    if (l > 0)
      level.coarsening = std::make_unique<Coarsening>(
          comm, *level.swept, *levels_.back().swept, multigrid_.ratio[l],
          Coarsening::Pair{multigrid_.refines(l), multigrid_.parents_in_place[l] != 0, has_gaps[l] != 0,
                           multigrid_.beside(l).finer, gap_fits, most_direct, known ? &(*known)[l] : nullptr},
          CoarseGhosts{[&](Index3 const& cell, int axis, int side) {
                         return prolonged_end(multigrid_, open_walls, l - 1, cell, axis, side);
                       },
                       last_children_of(multigrid_, l),
                       seam_widths(multigrid_.levels[l - 1]->periodic(), multigrid_.upper[l - 1])});
    level.local = make_local_cycle(comm, *level.swept, copies, multigrid_.boundary, shift, relaxation);
    levels_.push_back(std::move(level));
  }
  Level const& coarsest = *multigrid_.levels.front();
  Box const& box = coarsest.domain();
  Equation const equation = scaled(multigrid_.equation(0), levels_[0].swept->scale());
  GhostRules const rules = ghost_rules_of(multigrid_, open_walls, 0);
  direct_ = std::make_unique<FastDiagonalisation>(Index3{box.extent(0), box.extent(1), box.extent(2)}, equation,
                                                  walls_of_coarsest(multigrid_, rules), coarsest.periodic(),
                                                  rules.seam_width, leaves_mean(multigrid_));
}

CycleSteps Cycle::steps() {
  return {[this](std::size_t l) { levels_[l].coarsening->restrict_right_hand_side(); },
          [this](std::size_t l, Guess guess) { pre_smooth_and_restrict(levels_[l], guess); },
          [this](std::size_t l) { prolong_and_post_smooth(levels_[l]); }, [this] { solve_coarsest(); }};
}

void Cycle::run() {
  NoDenormals const guard;
  run_cycle(multigrid_, steps());
}

/// The stages with sweeps after them, of which all but the last have run where there are gaps: their fits are taken
/// into account between sweeps.
std::vector<PlaneStage> Cycle::relaxations(CycleLevel& level, std::vector<PlaneStage> stages, int sweeps,
                                           bool from_zero, int further) {
  auto const append = [&](int count) {
    for (auto& stage : level.swept->relaxations(count, from_zero, further)) stages.push_back(stage);
    from_zero = false;
  };
  for (; level.coarsening->has_gaps() && sweeps > 1; --sweeps) {
    append(1);
    level.swept->run(stages);
    stages.clear();
    level.coarsening->refresh_gaps();
  }
  append(sweeps);
  return stages;
}

/// Smooth, then leave the right-hand side of the coarser level.
void Cycle::pre_smooth_and_restrict(CycleLevel& level, Guess guess) {
  level.swept->exchange_right_hand_sides();
  std::vector<PlaneStage> stages;
  if (guess == Guess::coarser) stages = level.coarsening->prolongation(Coarsening::Into::place);
  int const sweeps = sweeps_beside(level, relaxation_.pre_sweeps);
  level.coarsening->start();
  level.coarsening->sweep_and_restrict(relaxations(level, stages, sweeps, guess == Guess::zero, 1));
}

/// Add the coarser level's correction, take its part of the ghosts into account, smooth. A cycle of the level's own
/// comes here, where it also finds what the coarser correction brought in along the coarse axis.
void Cycle::prolong_and_post_smooth(CycleLevel& level) {
  auto stages = level.coarsening->prolongation(Coarsening::Into::sum);
  int const sweeps = sweeps_beside(level, relaxation_.post_sweeps);
  int const further = level.local ? 1 : 0;  // a residual is taken there
  stages = relaxations(level, stages, sweeps, false, further);
  if (level.local) stages = level.local->improve(stages);
  if (level.last.act) stages.push_back(level.last);
  level.swept->run(stages);
}

/// Gathered on every rank where it is not yet there.
void Cycle::solve_coarsest() {
  Level const& level = *multigrid_.levels.front();
  Layout const& layout = levels_[0].swept->layout();
  values_.assign(std::size_t(level.cells()), 0.0);
  auto for_each_own_row = [&](auto&& f) {
    for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
      CellBlock const& block = layout.blocks()[b];
      for_each_row(block.box, [&](Index3 const& first) {
        f(std::size_t(block.place(first)), std::size_t(level.domain().offset(first)), block.box.extent(0));
      });
    }
  };
  Vector const& r = levels_[0].swept->right_hand_side();
  for_each_own_row([&](std::size_t place, std::size_t value, int n) { std::copy_n(&r[place], n, &values_[value]); });
  if (level.ranks() > 1) comm_.sum_each(values_);
  direct_->solve(values_);
  Vector& e = levels_[0].swept->correction();
  for_each_own_row([&](std::size_t place, std::size_t value, int n) {
    std::transform(&values_[value], &values_[value] + n, &e[place], [](Real v) { return float(v); });
  });
  if (levels_[0].last.act) levels_[0].swept->run({levels_[0].last});
}

std::vector<LevelWork> Cycle::work() {
  std::vector<LevelWork> out;
  std::vector<SweepWork> own(levels_.size()), of_copies(levels_.size());
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    SweptLevel& swept = *levels_[l].swept;
    LevelWork work{int(l) - int(multigrid_.base), swept.level().local_cells(), 0, 0, 0, 0, {}};
    for (CellBlock const& block : swept.layout().blocks()) work.stored += block.box.cells();
    std::set<int> ranks = swept.neighbours();
    if (l > 0) ranks.insert(levels_[l].coarsening->neighbours().begin(), levels_[l].coarsening->neighbours().end());
    work.neighbours = int(ranks.size());
    out.push_back(work);
    swept.rehearse(&own[l]);
    if (levels_[l].local) levels_[l].local->rehearse(&of_copies[l]);
  }
  auto const counted = [&](std::size_t l, auto const& step, auto... arguments) {
    Traffic const before = traffic();
    step(arguments...);
    out[l].traffic.add_since(before, traffic());
  };
  CycleSteps const step = steps();
  run_cycle(multigrid_, {[&](std::size_t l) { counted(l, step.restrict_right_hand_side, l); },
                         [&](std::size_t l, Guess guess) { counted(l, step.pre_smooth_and_restrict, l, guess); },
                         [&](std::size_t l) { counted(l, step.prolong_and_post_smooth, l); },
                         [&] { counted(0, step.solve_coarsest); }});
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    out[l].sweeps = own[l].sweeps;
    out[l].relaxed = own[l].relaxed + of_copies[l].relaxed;
    levels_[l].swept->rehearse(nullptr);
    if (levels_[l].local) levels_[l].local->rehearse(nullptr);
  }
  return out;
}

std::size_t Cycle::bytes() const {
  std::size_t sum = 0;
  for (auto const& l : levels_)
    sum += l.swept->bytes() + (l.coarsening ? l.coarsening->bytes() : 0) + (l.local ? l.local->bytes() : 0);
  return sum;
}

}  // namespace amrpic::matrixfree
