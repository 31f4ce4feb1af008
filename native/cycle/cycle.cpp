#include "cycle/cycle.hpp"

#include <algorithm>
#include <limits>

#include "multigrid/metal_on_levels.hpp"
#include "multigrid/semicoarse.hpp"

namespace amrpic::cycle {

namespace {

/// The ghost cells of corrections on level l.
GhostRules ghost_rules_of(CycleLevels const& multigrid, OpenWalls const& open_walls, std::size_t l) {
  if (auto const* semicoarse = multigrid.semicoarse(l))
    return {semicoarse->walls, nullptr, semicoarse->ghost,
            seam_widths(semicoarse->level->periodic(), semicoarse->upper)};
  GhostRules out;
  out.walls = multigrid.walls[l];
  out.seam_width = seam_widths(multigrid.levels[l]->periodic(), multigrid.upper[l]);
  out.inside = [](Index3 const&, int, int) { return WallGhost{interface_ghost::first, interface_ghost::second, 0}; };
  out.inside_beside_metal = WallGhost{linear_ghost::first, 0, 0};
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

/// How level c ends for prolongation to the level that it corrects, and the means that it takes of that one.
CoarseGhosts coarse_ghosts_of(CycleLevels const& multigrid, OpenWalls const& open_walls, std::size_t c) {
  if (auto const* semicoarse = multigrid.semicoarse(c))
    return {semicoarse->prolonged, semicoarse->children, seam_widths(semicoarse->level->periodic(), semicoarse->upper)};
  return {[&multigrid, &open_walls, c](Index3 const& cell, int axis, int side) {
            return prolonged_end(multigrid, open_walls, c, cell, axis, side);
          },
          last_children_of(multigrid, c + 1), seam_widths(multigrid.levels[c]->periodic(), multigrid.upper[c])};
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
             std::shared_ptr<GapFits> gap_fits, int most_direct, Known* known, Metal const* metal)
    : LevelActs(CycleLevels(std::move(multigrid), max_grid_size), {relaxation.pre_sweeps, relaxation.post_sweeps}),
      comm_(comm) {
  OpenWalls const open_walls(levels());
  auto has_gaps = levels_with_gaps(comm, levels());
  has_gaps.resize(levels().count());
  auto const is_refined = [&](std::size_t l) { return l > levels().base && l <= levels().finest(); };
  auto const metal_in = [&](std::size_t l) -> SweptLevel::MetalIn {
    if (!metal) return nullptr;
    return [this, metal, l](std::vector<Box> const& boxes) { return metal_on(*metal, levels(), l, boxes); };
  };
  auto const swept = [&](std::size_t l) {
    GhostRules const rules = ghost_rules_of(levels(), open_walls, l);
    Level const& level = *levels().level(l);
    bool const is_semicoarse = levels().semicoarse(l), is_semicoarsened = levels().coarser(l).size() > 1;
    Relaxation own = relaxation;
    own.factor = relaxation_on(level, levels().shift, levels().halves_at_most(l), relaxation.factor);
    if (is_semicoarse) {
      own.pre_sweeps = levels().pre_sweeps(l, sweeps());
      own.post_sweeps = levels().post_sweeps(l, sweeps());
    }
    // sweeps that do not start from zero, and a residual after them, read one cell further
    int const deep =
        own.halo(metal != nullptr) + (!is_semicoarse && (is_semicoarsened || !levels().refines(l)) ? 1 : 0);
    bool const thin = !is_semicoarse && !is_semicoarsened && !has_gaps[l] && has_thin_copies(level, rules);
    int const halo = thin ? 1 : std::max(deep, has_gaps[l] ? reach_in_gaps : 0);
    return std::make_unique<SweptLevel>(comm, levels().level(l), rules, levels().boundary, levels().shift, own, halo,
                                        metal_in(l));
  };
  auto const passage = [&](std::size_t l, std::size_t c) {
    auto const* semicoarse = levels().semicoarse(c);
    Coarsening::Pair pair;
    if (!semicoarse)
      pair = {levels().refines(l),
              levels().parents_in_place[l] != 0,
              has_gaps[l] != 0,
              levels().beside(l).finer,
              gap_fits,
              most_direct,
              known ? &(*known)[l] : nullptr,
              metal,
              is_refined(c) ? levels().level(c - 1).get() : nullptr};
    return std::make_unique<Coarsening>(comm, this->swept(l), this->swept(c),
                                        semicoarse ? semicoarse->ratio : levels().ratio[l], pair,
                                        coarse_ghosts_of(levels(), open_walls, c));
  };
  make(swept, passage);
  Level const &coarsest = *levels().levels.front(), &base = *levels().levels[levels().base];
  Box const& box = coarsest.domain();
  Equation const equation = scaled(levels().equation(0), this->swept(0).scale());
  GhostRules const rules = ghost_rules_of(levels(), open_walls, 0);
  Index3 const cells{box.extent(0), box.extent(1), box.extent(2)};
  WallGhosts const walls = walls_of_coarsest(levels(), rules);
  auto const in_metal = metal ? metal->cells(coarsest, {box}, levels_of_potential(levels(), 1)) : MetalCells{};
  if (!in_metal.empty())
    direct_ = std::make_unique<DenseRows>(cells, equation, walls, coarsest.periodic(), rules.seam_width, in_metal);
  else
    direct_ = std::make_unique<FastDiagonalisation>(cells, equation, walls, coarsest.periodic(), rules.seam_width,
                                                    is_mean_left_free(base, levels().boundary, levels().shift));
}

void Cycle::solve_coarsest() {
  Level const& level = *levels().levels.front();
  SweptLevel& swept = this->swept(0);
  Layout const& layout = swept.layout();
  values_.assign(std::size_t(level.cells()), 0.0);
  auto for_each_own_row = [&](auto&& f) {
    for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
      CellBlock const& block = layout.blocks()[b];
      for_each_row(block.box, [&](Index3 const& first) {
        f(std::size_t(block.place(first)), std::size_t(level.domain().offset(first)), block.box.extent(0));
      });
    }
  };
  Vector const& r = swept.right_hand_side();
  for_each_own_row([&](std::size_t place, std::size_t value, int n) { std::copy_n(&r[place], n, &values_[value]); });
  if (level.ranks() > 1) comm_.sum_each(values_);
  direct_->solve(values_);
  Vector& e = swept.correction();
  for_each_own_row([&](std::size_t place, std::size_t value, int n) {
    std::transform(&values_[value], &values_[value] + n, &e[place], [](Real v) { return float(v); });
  });
  swept.finish();
}

namespace {

/// Acts that note what they send, by levels.
class CountedActs : public CycleActs {
 public:
  CountedActs(CycleActs& acts, std::vector<LevelWork>& work) : acts_(acts), work_(work) {}
  void pre_smooth(std::size_t l, Guess guess) override { count(l, &CycleActs::pre_smooth, l, guess); }
  void find_residual(std::size_t l, std::size_t c) override { count(l, &CycleActs::find_residual, l, c); }
  void restrict_residual(std::size_t l, std::size_t c) override { count(l, &CycleActs::restrict_residual, l, c); }
  void prolong(std::size_t c, std::size_t l) override { count(l, &CycleActs::prolong, c, l); }
  void post_smooth(std::size_t l, std::size_t c) override { count(l, &CycleActs::post_smooth, l, c); }
  void solve_coarsest() override { count(0, &CycleActs::solve_coarsest); }
  void restrict_right_hand_side(std::size_t l) override { count(l, &CycleActs::restrict_right_hand_side, l); }

 private:
  template <class Act, class... Arguments>
  void count(std::size_t l, Act act, Arguments... arguments) {
    Traffic const before = traffic();
    (acts_.*act)(arguments...);
    work_[l].traffic.add_since(before, traffic());
  }

  CycleActs& acts_;
  std::vector<LevelWork>& work_;
};

}  // namespace

std::vector<LevelWork> Cycle::work() {
  std::vector<LevelWork> out(levels().count());
  std::vector<SweepWork> sweeps(out.size());
  for (std::size_t l = 0; l < out.size(); ++l) {
    SweptLevel& swept = this->swept(l);
    std::set<int> ranks = swept.neighbours();
    if (l > 0 && l <= levels().finest())
      ranks.insert(passage(l - 1).neighbours().begin(), passage(l - 1).neighbours().end());
    out[l] = {int(l) - int(levels().base), swept.level().local_cells(), 0, 0, 0, int(ranks.size()), {}};
    for (CellBlock const& block : swept.layout().blocks()) out[l].stored += block.box.cells();
    swept.rehearse(&sweeps[l]);
  }
  CountedActs acts(*this, out);
  run_cycle(levels(), acts);
  for (std::size_t l = 0; l < out.size(); ++l) {
    out[l].sweeps = sweeps[l].sweeps;
    out[l].relaxed = sweeps[l].relaxed;
    swept(l).rehearse(nullptr);
  }
  // What semicoarsened levels take is their refinement level's.
  for (std::size_t n = out.size(); n-- > levels().levels.size(); out.pop_back()) {
    LevelWork& finer = out[levels().finer(n)];
    finer.relaxed += out[n].relaxed;
    finer.traffic.add_since({}, out[n].traffic);
  }
  return out;
}

}  // namespace amrpic::cycle
