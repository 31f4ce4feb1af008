#include "mesh/leaves_around.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <numeric>

#include "base/error.hpp"
#include "mesh/array_on_box.hpp"
#include "mesh/cells_around.hpp"

namespace amrpic {

namespace {

constexpr Real equal = 1 + 1e-9;  ///< squares of radii that rounding alone tells apart

/// What a place of a level is, if it is no leaf of it; leaves are told by their numbers.
constexpr LocalIndex outside = -1, coarser = -2, finer = -3;

/// A leaf, seen from another one.
struct Seen {
  std::uint64_t offset;  ///< of centres, in half widths of the finest cells, 21 bits each for z, y, x
  LocalIndex number;
  bool operator<(Seen const& other) const { return offset < other.offset; }
};

/// Offsets of a kind's leaves, after the level.
using Kinds = std::map<std::vector<std::uint64_t>, LocalIndex>;

class Search {
 public:
  Search(Hierarchy const& hierarchy, Real reach)
      : hierarchy_(hierarchy), reach_(reach), first_(first_numbers(hierarchy)) {}

  LeavesAround take() {
    for (int l = 0; l < hierarchy_.level_count(); ++l) {
      enter(l);
      for (int b = 0; b < level_->box_count(); ++b) add_box(b);
    }
    return std::move(out_);
  }

 private:
  void enter(int l) {
    of_ = l, level_ = &hierarchy_.level(l);
    Real3 const h = level_->spacing();
    radius_ = reach_ * std::max({h[0], h[1], h[2]});
    // Each leaf within the radius, of any level, has a place of this level in it or at its lower corner in this window.
    for (int d = 0; d < 3; ++d) window_[d] = int(std::floor(radius_ * equal / h[d] + 0.5));
    int const farthest = *std::max_element(window_.begin(), window_.end()) + 1;
    if (in_half_widths({farthest, 0, 0})[0] >= 1 << 20)
      throw HierarchyError("a reach of " + std::to_string(reach_) + " on " + std::to_string(hierarchy_.level_count()) +
                           " levels is too many of the finest cells to tell surroundings apart; take a shorter one");
    template_.clear();
    for_each_cell(Box{{0, 0, 0}, {0, 0, 0}}.grow(window_), [&](Index3 const& offset) {
      if (is_within(in_half_widths(offset))) template_.push_back({offset, key(in_half_widths(offset))});
    });
  }

  /// Of places of this level, in half widths of the finest cells.
  Index3 in_half_widths(Index3 const& offset) const {
    int const width = 2 << (hierarchy_.level_count() - 1 - of_);
    return {width * offset[0], width * offset[1], width * offset[2]};
  }
  /// The centre of a cell of a level in these widths, from the domain's lower corner.
  Index3 centre(int l, Index3 const& cell) const {
    int const half = 1 << (hierarchy_.level_count() - 1 - l);
    return {(2 * cell[0] + 1) * half, (2 * cell[1] + 1) * half, (2 * cell[2] + 1) * half};
  }
  bool is_within(Index3 const& offset) const {
    Real3 const h = hierarchy_.level(hierarchy_.level_count() - 1).spacing();
    Real square = 0;
    for (int d = 0; d < 3; ++d) square += offset[d] * h[d] / 2 * (offset[d] * h[d] / 2);
    return square <= radius_ * radius_ * equal;
  }
  static std::uint64_t key(Index3 const& offset) {
    auto const bits = [](int n) { return std::uint64_t(n + (1 << 20)); };
    return bits(offset[2]) << 42 | bits(offset[1]) << 21 | bits(offset[0]);
  }

  void add_box(int b) {
    Box const box = level_->box(b);
    ArrayOnBox<LocalIndex> const places = places_around(box);
    ArrayOnBox<std::int8_t> const regular = among_leaves(places);
    std::vector<std::ptrdiff_t> steps;
    for (auto const& [offset, _] : template_)
      steps.push_back(offset[0] + offset[1] * places.box().stride(1) + offset[2] * places.box().stride(2));
    for_each_cell(box, [&](Index3 const& cell) {
      LocalIndex const* const here = &places(cell);
      if (*here < 0) return;
      if (regular(cell))
        add_regular(here, steps);
      else
        add_other(cell, places);
      out_.leaf.push_back(*here);
      out_.radius.push_back(radius_);
      out_.start.push_back(std::int64_t(out_.cell.size()));
    });
  }

  /// What the places in and around a box are.
  ArrayOnBox<LocalIndex> places_around(Box const& box) const {
    Box const region = box.grow(window_);
    ArrayOnBox<LocalIndex> out(region, outside);
    out.fill(level_->domain(), coarser);
    for (int b : level_->share_table()->meeting(region)) {
      Box const part = level_->box(b).intersect(region);
      for_each_row(*level_, b, part, {0, 0, 0}, [&](GlobalIndex first, LocalIndex count, Index3 const& cell) {
        std::iota(&out(cell), &out(cell) + count, LocalIndex(first_[std::size_t(of_)] + first));
      });
    }
    if (!hierarchy_.has_finer(of_)) return out;
    Level const& above = hierarchy_.level(of_ + 1);
    for (int b : above.share_table()->meeting(region.refine({2, 2, 2})))
      out.fill(above.box(b).coarsen({2, 2, 2}), finer);
    return out;
  }

  /// Whether all places in the window around each one are leaves; along x, then y, then z.
  ArrayOnBox<std::int8_t> among_leaves(ArrayOnBox<LocalIndex> const& places) const {
    ArrayOnBox<std::int8_t> all(places.box(), 1);
    for (std::size_t i = 0; i < all.values().size(); ++i) all.values()[i] = places.values()[i] >= 0;
    for (int d = 0; d < 3; ++d) {
      auto const before = all.values();
      std::ptrdiff_t const step = places.box().stride(d), last = std::ptrdiff_t(before.size()) - 1;
      for (int k = -window_[d]; k <= window_[d]; ++k)  // what wraps around is not asked for
        for (std::ptrdiff_t i = std::max<std::ptrdiff_t>(0, -k * step);
             i <= last - std::max<std::ptrdiff_t>(0, k * step); ++i)
          all.values()[std::size_t(i)] &= before[std::size_t(i + k * step)];
    }
    return all;
  }

  void add_regular(LocalIndex const* here, std::vector<std::ptrdiff_t> const& steps) {
    std::size_t const at = out_.cell.size();
    out_.cell.resize(at + steps.size());
    LocalIndex* const to = out_.cell.data() + at;
    for (std::size_t n = 0; n < steps.size(); ++n) to[n] = here[steps[n]];
    if (regular_kind_.size() <= std::size_t(of_)) regular_kind_.resize(std::size_t(of_) + 1, -1);
    LocalIndex& kind = regular_kind_[std::size_t(of_)];
    if (kind < 0) {
      seen_.clear();
      for (auto const& [_, offset] : template_) seen_.push_back({offset, 0});
      kind = kind_of_seen();
    }
    out_.kind.push_back(kind);
  }

  /// Of a cell near a wall or another level.
  void add_other(Index3 const& cell, ArrayOnBox<LocalIndex> const& places) {
    seen_.clear();
    centre_ = centre(of_, cell);
    for_each_cell(Box{cell, cell}.grow(window_), [&](Index3 const& place) {
      LocalIndex const what = places(place);
      if (what >= 0)
        see(of_, place, what);
      else if (what == finer)
        see_children(of_, place);
      else if (what == coarser)
        see_coarser(place);
    });
    std::sort(seen_.begin(), seen_.end());
    auto const same = [](Seen const& a, Seen const& b) { return a.offset == b.offset; };
    seen_.erase(std::unique(seen_.begin(), seen_.end(), same), seen_.end());  // a coarser one is met in several places
    for (Seen const& one : seen_) out_.cell.push_back(one.number);
    out_.kind.push_back(kind_of_seen());
  }
  void see(int l, Index3 const& cell, LocalIndex number) {
    Index3 offset = centre(l, cell);
    for (int d = 0; d < 3; ++d) offset[d] -= centre_[d];
    if (is_within(offset)) seen_.push_back({key(offset), number});
  }
  void see_children(int l, Index3 const& cell) {
    Index3 const first = first_child_of(cell);
    for_each_cell(Box{first, {first[0] + 1, first[1] + 1, first[2] + 1}}, [&](Index3 const& child) {
      if (hierarchy_.has_finer(l + 1) && box_of(l + 2, first_child_of(child)) >= 0) return see_children(l + 1, child);
      see(l + 1, child, number(l + 1, box_of(l + 1, child), child));
    });
  }
  void see_coarser(Index3 cell) {
    for (int l = of_ - 1; l >= 0; --l) {
      cell = parent_of(cell);
      int const box = box_of(l, cell);
      if (box >= 0) return see(l, cell, number(l, box, cell));
    }
  }
  /// The box of a level that holds a cell, or -1: most often that of the cell before it.
  int box_of(int l, Index3 const& cell) {
    Level const& level = hierarchy_.level(l);
    last_.resize(std::size_t(hierarchy_.level_count()), -1);
    int& last = last_[std::size_t(l)];
    if (last >= 0 && level.box(last).contains(cell)) return last;
    int const found = level.find(cell);
    if (found >= 0) last = found;
    return found;
  }
  LocalIndex number(int l, int box, Index3 const& cell) const {
    Level const& level = hierarchy_.level(l);
    return LocalIndex(first_[std::size_t(l)] + level.box_offset(box) + level.box(box).offset(cell));
  }

  /// The number of the kind whose leaves are those seen, which begins with this leaf if it is new.
  LocalIndex kind_of_seen() {
    key_.assign(1, std::uint64_t(of_));
    for (Seen const& one : seen_) key_.push_back(one.offset);
    auto const [found, is_new] = kinds_.try_emplace(key_, LocalIndex(kinds_.size()));
    if (is_new) out_.representative.push_back(LocalIndex(out_.leaf.size()));
    return found->second;
  }

  struct Place {
    Index3 offset;
    std::uint64_t key;
  };

  Hierarchy const& hierarchy_;
  Real reach_;
  std::vector<GlobalIndex> first_;  ///< number of the first cell of each level
  // of the level whose leaves are taken
  int of_ = 0;
  Level const* level_ = nullptr;
  Real radius_ = 0;
  Index3 window_{};
  std::vector<Place> template_;  ///< within the radius
  std::vector<LocalIndex> regular_kind_;
  // of one leaf
  Index3 centre_{};
  std::vector<Seen> seen_;
  std::vector<std::uint64_t> key_;

  std::vector<int> last_;  ///< box of each level
  Kinds kinds_;
  LeavesAround out_;
};

}  // namespace

LeavesAround leaves_around(Hierarchy const& hierarchy, Real reach) { return Search(hierarchy, reach).take(); }

}  // namespace amrpic
