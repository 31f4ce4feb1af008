#include "cycle/coarsening.hpp"

#include <algorithm>

#include "mesh/box_set.hpp"

namespace amrpic::cycle {

Coarsening::Coarsening(Communicator const& comm, SweptLevel& fine, SweptLevel& coarse, Index3 const& ratio,
                       Pair const& pair, CoarseGhosts const& ghosts)
    : comm_(comm),
      fine_(fine),
      coarse_(coarse),
      ratio_(ratio),
      refines_(pair.refines),
      has_gaps_(pair.has_gaps),
      // Such boxes make up the same larger blocks on both levels, unless they end at seams, which these have at places
      // of their own.
      in_place_(pair.parents_in_place && !fine.layout().has_seam() && !coarse.layout().has_seam()) {
  lay_out_coarse_patches(comm, ghosts, pair.most_direct, pair.known);
  if (coarse.level().ranks() == 1 && fine.level().ranks() > 1) plan_gathering();
  if (!refines_) return;
  interface_ = InterfaceCells(fine.level(), coarse.level(), pair.finer, fine.layout(), fine.faces(), coarse_patches_,
                              fine.stencil(), coarse.stencil().weight(), pair.gap_fits,
                              {pair.metal, pair.coarsest, coarse.equation()});
}

/// Lay out the parents of own blocks with their ghost cells, and plan how their values come.
void Coarsening::lay_out_coarse_patches(Communicator const& comm, CoarseGhosts const& ghosts, int most_direct,
                                        KnownReads* known) {
  Layout const& layout = fine_.layout();
  Level const& coarser = coarse_.level();
  std::vector<Copied> local, local_targets;
  std::size_t size = 0;
  sources_.reserve(layout.own_blocks());
  if (in_place_) targets_.reserve(layout.own_blocks());
  coarse_patches_.reserve(layout.own_blocks());
  int const reach = refines_ ? 2 : 1;   // the ghosts' fits reach one cell further
  int const beside = refines_ ? 1 : 0;  // cells that take fluxes
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    Box const &box = layout.blocks()[b].box, parents = box.coarsen(ratio_);
    CoarsePatch patch{parents.grow(reach), {}};
    patch.cells.origin = std::ptrdiff_t(size);
    patch.cells.pitch_y = patch.box.extent(0);
    patch.cells.pitch_z = patch.cells.pitch_y * patch.box.extent(1);
    size += std::size_t(patch.cells.pitch_z * patch.box.extent(2));
    ArrayOnBox<char> known(patch.box, 0);
    coarser.for_each_overlap(patch.box, [&](int n, Box const& part, Index3 const& shift) {
      if (coarser.owner(n) == coarser.rank()) {
        Placement copy = patch.cells;
        copy.origin = patch.place(part.lower);
        local.push_back({n, part.shift_back(shift), copy});
        Box const target = part.intersect(parents.grow(beside));
        if (!target.empty() && !in_place_) {
          copy.origin = patch.place(target.lower);
          local_targets.push_back({n, target.shift_back(shift), copy});
        }
      }
      known.fill(part, 1);
    });
    Placement cells = patch.cells;
    cells.origin = patch.place(parents.lower);
    Box const inside = coarser.cut_at_walls(parents);
    Parents source{cells, ratio_, {}, {}, {-1, -1, -1}, ghosts.weight, parents.lower, {}, ghosts.seam_width};
    for (int d = 0; d < 3; ++d) {
      source.odd[d] = box.lower[d] - ratio_[d] * parents.lower[d];
      source.extent[d] = inside.extent(d);
      bool const otherwise = ghosts.weight[d].last != 1 || ghosts.weight[d].before != 1;
      int const end = fine_.level().domain().upper[d] - box.lower[d];
      if (otherwise && end <= box.extent(d)) source.last[d] = end;
      if (ghosts.seam_width[d] != 1 && ratio_[d] == 2) source.seam[d] = coarser.domain().extent(d);
    }
    sources_.push_back(source);
    if (in_place_) {
      targets_.push_back(source);
      targets_.back().cells = coarse_.layout().blocks()[b].cells;
    }
    coarse_patches_.push_back(patch);
    add_ghosts(patch, known, ghosts);
  }
  values_.resize(size + 64);  // a vector that starts in the last row may reach past it
  Level const& level = fine_.level();
  auto const exchange = [&](std::vector<Copied> const& copied, int around, bool has_relays) {
    auto const near = [&](Box const& o) { return o.grow(around).refine(ratio_); };
    auto const regions = [&](int b, auto&& read) { read(level.box(b).coarsen(ratio_).grow(around)); };
    Routes routes{most_direct, {}};
    if (has_relays)
      routes.of = [&](int owner) {
        std::shared_ptr<RoutedReads const> found;
        auto& of_owner = known ? (*known)[owner] : found;
        if (!of_owner)
          of_owner =
              std::make_shared<RoutedReads const>(copies_asked_of(owner, level, coarser, near, regions), most_direct);
        return of_owner;
      };
    return RectangleExchange(
        comm, coarse_.layout(), copied, copies_across_ranks(level, coarser, near, regions),
        [this](Box const& box, VisitPart const& f) {
          for_each_part(coarse_patches_.begin(), coarse_patches_.end(), box, f);
        },
        Colours::all, routes);
  };
  // Where parents are in place each rank meets its neighbours alone, else all that share the children of one.
  parents_ = exchange(local, reach, !in_place_);
  if (!in_place_) targets_of_residuals_ = exchange(local_targets, beside, false);
}

/// A ghost cell of the coarser correction is a multiple of the cell before it; corners follow axis after axis.
void Coarsening::add_ghosts(CoarsePatch const& patch, ArrayOnBox<char>& known, CoarseGhosts const& ghosts) {
  Box const region = patch.box.grow(refines_ ? -1 : 0);
  std::vector<Index3> missing;
  amrpic::for_each_row(region, [&](Index3 const& cell) {
    char const *const first = &known(cell), *const end = first + region.extent(0);
    for (char const* at = first; (at = std::find(at, end, 0)) != end; ++at)
      missing.push_back({cell[0] + int(at - first), cell[1], cell[2]});
  });
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      std::vector<Index3> filled;
      for (Index3 const& ghost : missing) {
        Index3 before = ghost;
        before[axis] += side == 0 ? 1 : -1;
        if (known(ghost) || !region.contains(before) || !known(before)) continue;
        ghosts_.push_back({std::int32_t(patch.place(before)), std::int32_t(patch.place(ghost)),
                           float(ghosts.factor(coarse_.level().fold_at_walls(before), axis, side))});
        filled.push_back(ghost);
      }
      for (Index3 const& ghost : filled) known(ghost) = 1;
    }
}

/// What the ranks with cells of the finer level send each other, and nobody else, if all of the coarser one is theirs.
void Coarsening::plan_gathering() {
  Level const& level = fine_.level();
  int const me = level.rank();
  if (level.last_local_box() == level.first_local_box()) return;
  std::vector<std::vector<Box>> parents(std::size_t(level.ranks()));  // disjoint ones of each rank
  for (int b = 0; b < level.box_count(); ++b) {
    auto& known = parents[std::size_t(level.owner(b))];
    std::vector<Box> fresh{coarse_.level().cut_at_walls(level.box(b).coarsen(ratio_))};
    for (Box const& box : known) fresh = without(fresh, box);
    known.insert(known.end(), fresh.begin(), fresh.end());
  }
  std::vector<Parcel> asked, wanted;
  for (int r = 0; r < level.ranks(); ++r) {
    if (parents[std::size_t(r)].empty()) continue;
    if (r == me) first_own_part_ = parts_.size();
    for (Box const& box : parents[std::size_t(r)]) {
      parts_.push_back({box, gathered_.size()});
      gathered_.resize(gathered_.size() + std::size_t(box.cells()));
      if (r != me) wanted.push_back({r, box.cells()});
    }
    if (r == me) own_parts_ = parts_.size() - first_own_part_;
    for (Box const& box : parents[std::size_t(me)])
      if (r != me) asked.push_back({r, box.cells()});
  }
  gathering_ = Exchange<float>(comm_, asked, wanted);
}

/// Call f(place in a vector of the coarser level, place in the part, length) for the rows of a part of it.
template <class F>
void Coarsening::for_each_row(GatheredPart const& of, F&& f) const {
  coarse_.layout().for_each_own_part(of.parents, [&](Box const& part, Placement const& at) {
    for (int k = 0; k < part.extent(2); ++k)
      for (int j = 0; j < part.extent(1); ++j)
        f(at.place(0, j, k), std::size_t(of.parents.offset({part.lower[0], part.lower[1] + j, part.lower[2] + k})),
          part.extent(0));
  });
}

/// Add what others hold to a vector of the coarser level; cells with several terms in the order of ranks, so that all
/// find the same.
void Coarsening::gather_from_others(Vector& r) {
  for (std::size_t n = first_own_part_; n < first_own_part_ + own_parts_; ++n)
    for_each_row(parts_[n], [&](auto at, auto place, int length) {
      std::copy_n(&r[std::size_t(at)], length, &gathered_[parts_[n].first + place]);
    });
  gathering_.update(
      [&](std::size_t n, float* to) {
        GatheredPart const& part = parts_[first_own_part_ + n % own_parts_];
        std::copy_n(&gathered_[part.first], part.parents.cells(), to);
      },
      [&](std::size_t n, float const* from) {
        GatheredPart const& part = parts_[n < first_own_part_ ? n : n + own_parts_];
        std::copy_n(from, part.parents.cells(), &gathered_[part.first]);
      });
  std::fill(r.begin(), r.end(), 0.0f);
  for (GatheredPart const& part : parts_)
    for_each_row(part, [&](auto at, auto place, int length) {
      for (int i = 0; i < length; ++i) r[std::size_t(at + i)] += gathered_[part.first + place + std::size_t(i)];
    });
}

void Coarsening::prepare_residual() {
  if (has_gaps_) update_gaps();
  if (!fine_.has_odd_ring()) return;
  fine_.run();  // the copies behind it are not swept as their cells are
  fine_.exchange_corrections(false);
}

void Coarsening::restrict_residual() {
  Vector& target = clear_target();
  fine_.then({[&](std::size_t b, int k, RowChoice const&) {
                if (b < sources_.size())
                  fine_.sweep().restrict_to<true>(b, k, fine_.right_hand_side(), fine_.correction(), taking(b),
                                                  weight(), target);
              },
              both_colours, 0});
  fine_.run();
  interface_.subtract_flux(fine_.correction(), target);
  add_to_coarse_level();
}

/// Take what fits in gaps have of the finer correction into its right-hand side, from up-to-date copies.
void Coarsening::update_gaps() {
  fine_.run();
  fine_.exchange_corrections(false);
  fine_.run();
  interface_.subtract_in_gaps(fine_.correction(), fine_.right_hand_side());
}

void Coarsening::refresh_gaps() {
  update_gaps();
  fine_.exchange_corrections(true);
}

void Coarsening::restrict_right_hand_side() {
  Vector& target = clear_target();
  fine_.clear_right_hand_side_in_metal();
  fine_.then({[&](std::size_t b, int k, RowChoice const&) {
    if (b < sources_.size())
      fine_.sweep().restrict_to<false>(b, k, fine_.right_hand_side(), fine_.correction(), taking(b), weight(), target);
  }});
  fine_.run();
  add_to_coarse_level();
}

/// Where residuals of own blocks go.
Vector& Coarsening::clear_target() {
  if (in_place_) return coarse_.right_hand_side();
  std::fill(values_.begin(), values_.end(), 0.0f);
  return values_;
}

float Coarsening::weight() const {
  return float(coarse_.scale() / fine_.scale() / (ratio_[0] * ratio_[1] * ratio_[2]));
}

/// Add the target to the coarser right-hand side, on whichever ranks the parents are.
void Coarsening::add_to_coarse_level() {
  if (in_place_) return;
  Vector& r = coarse_.right_hand_side();
  if (!refines_) std::fill(r.begin(), r.end(), 0.0f);
  targets_of_residuals_.add(values_.data(), r.data());
  if (own_parts_ > 0) gather_from_others(r);
}

void Coarsening::prolong(Into into) {
  parents_.update(coarse_.correction().data(), values_.data());
  for (Copy const& c : ghosts_) values_[std::size_t(c.to)] = c.factor * values_[std::size_t(c.from)];
  interface_.subtract_coarse(values_, fine_.right_hand_side());
  auto const prolong = [this, into](std::size_t b, int k, RowChoice const& rows) {
    fine_.sweep().prolong(b, k, rows, sources_[b], values_, into == Into::place, fine_.right_hand_side(),
                          fine_.correction());
  };
  // What others copy comes first, so that it is under way while the rest is swept. Nothing is left to the sweeps before
  // a restriction that takes the same values for its own sums.
  Layout const& layout = fine_.layout();
  bool const all_now = (into == Into::place && !in_place_) || has_gaps_;
  fine_.corrections_are_new();
  if (fine_.is_thin() && !all_now) return fine_.then({prolong, 0, both_colours});
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    Box const& box = layout.blocks()[b].box;
    for (int k = box.lower[2]; k <= box.upper[2]; ++k)
      prolong(b, k, all_now ? RowChoice{} : layout.rows_by_copies(b, k, true));
  }
  if (has_gaps_) update_gaps();
  fine_.exchange_corrections(refines_);
  if (all_now) return;
  fine_.then({[&layout, prolong](std::size_t b, int k, RowChoice const&) {
    if (b < layout.own_blocks()) prolong(b, k, layout.rows_by_copies(b, k, false));
  }});
}

std::size_t Coarsening::bytes() const {
  return values_.size() * sizeof(float) + interface_.bytes() + ghosts_.size() * sizeof(Copy);
}

}  // namespace amrpic::cycle
