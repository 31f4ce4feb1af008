#include "cycle/layout.hpp"

#include <algorithm>
#include <limits>
#include <map>

#include "base/lanes.hpp"
#include "mesh/box_set.hpp"

namespace amrpic::cycle {

namespace {

constexpr std::ptrdiff_t line = 16;  // floats of a cache line

std::ptrdiff_t rounded_up(std::ptrdiff_t n, std::ptrdiff_t to) { return (n + to - 1) / to * to; }

/// Cells per vector of a row: the wide ones, unless they would carry too much padding. Vectors of 4 do half the work of
/// those of 8 at a time, so that it takes more padding for them.
int lanes_of(int cells) {
  constexpr int least = widest == 16 ? 8 : 4;
  bool const wide = least * rounded_up(cells, widest) <= (least + 1) * rounded_up(cells, narrowest);
  return wide ? widest : narrowest;
}

/// How many steps across faces of cells lead from one box to another.
int apart(Box const& a, Box const& b) {
  int out = 0;
  for (int d = 0; d < 3; ++d) out += std::max({0, a.lower[d] - b.upper[d], b.lower[d] - a.upper[d]});
  return out;
}

/// Call f(region) for the cells around a box of which there are copies: without those behind its edges where sweeps
/// read one cell far, since these are no cell's neighbours.
template <class F>
void for_each_region_around(Box const& box, int depth, F&& f) {
  if (depth > 1) return f(box.grow(depth));
  for (int face = 0; face < 6; ++face) f(box.layer(face / 2, face % 2, 1));
}

}  // namespace

Layout::Layout(Level const& level, int depth, std::array<bool, 3> const& seam)
    : domain_(level.domain()), first_box_(level.first_local_box()), has_seam_(seam[0] || seam[1] || seam[2]) {
  // Across an odd number of cells two of one colour meet: there images are copies with colours of their own.
  for (int d = 0; d < 3; ++d) wraps_[d] = d < 2 && level.periodic()[d] && domain_.extent(d) % 2 == 0;
  auto const periods = [&](int d) { return wraps_[d] ? depth / domain_.extent(d) + 1 : 0; };
  for (int y = -periods(1); y <= periods(1); ++y)
    for (int x = -periods(0); x <= periods(0); ++x)
      if (x != 0 || y != 0) images_.push_back({x * domain_.extent(0), y * domain_.extent(1), 0});
  images_.push_back({0, 0, 0});
  std::array<Seam, 3> seams;
  for (int d = 0; d < 3; ++d)
    if (seam[d]) seams[d] = {domain_.extent(d) - 1, domain_.extent(d)};
  std::vector<Box> own(level.boxes().begin() + level.first_local_box(), level.boxes().begin() + level.last_local_box());
  auto const large = joined(split(own, seams), seams);
  for (Box const& box : large) add(box);
  own_blocks_ = blocks_.size();
  for (CellBlock const& block : blocks_)
    rows_of_.emplace_back(std::size_t(block.box.extent(1)) * std::size_t(block.box.extent(2)), 0);

  // One copy of a box (or image) holds all that any own block needs of it. Images of own cells across x and y are read
  // in place where they can; those across z are copied, because a plane is swept when the one at the other end is not
  // yet.
  std::map<std::pair<int, Index3>, Box> wanted;
  for (Box const& block : large)
    for_each_region_around(block, depth, [&](Box const& region) {
      level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
        bool const mine = b >= level.first_local_box() && b < level.last_local_box();
        if (!mine || in_place(shift)) return;
        auto const [at, fresh] = wanted.emplace(std::make_pair(b, shift), part);
        if (!fresh) at->second = at->second.hull(part);
      });
    });
  std::vector<Box> copies;
  for (auto const& [key, part] : wanted) {
    Index3 const& shift = key.second;
    for (Box const& piece : split({part}, seams)) {
      copied_images_.push_back({key.first, piece.shift_back(shift), shift});
      mark_copied(copied_images_.back().cells);
      copies.push_back(piece);
    }
  }
  across_ranks_ = copies_across_ranks(
      level, level, [&](Box const& o) { return o.grow(depth); },
      [&](int b, auto&& read) { for_each_region_around(level.box(b), depth, read); }, seams);
  for (CopiedRectangle const& r : across_ranks_.asked) mark_copied(r.cells);
  for (CopiedRectangle const& r : across_ranks_.wanted) copies.push_back(r.cells.shift(r.shift));
  for (Box const& box : joined(copies, seams)) add(box);
  measure_halo(depth);
  std::ptrdiff_t longest = 0;
  for (CellBlock const& block : blocks_) longest = std::max(longest, block.cells.pitch_y);
  zero_row_ = std::ptrdiff_t(size_);
  size_ += std::size_t(longest) + 64;  // a vector that starts in the last row may reach past it

  for (Box const& box : own)  // nobody reads a box that a seam cuts
    for (std::size_t b = 0; b < own_blocks_; ++b)
      if (blocks_[b].box.contains(box)) {
        Placement cells = blocks_[b].cells;
        cells.origin = blocks_[b].place(box.lower);
        boxes_.push_back(cells);
        break;
      }

  if (blocks_.empty()) return;
  int last = blocks_[0].box.upper[2];
  first_plane_ = blocks_[0].box.lower[2];
  for (CellBlock const& block : blocks_) {
    first_plane_ = std::min(first_plane_, block.box.lower[2]);
    last = std::max(last, block.box.upper[2]);
  }
  plane_.resize(std::size_t(last - first_plane_ + 1));
  for (std::size_t b = 0; b < blocks_.size(); ++b)
    for (int k = blocks_[b].box.lower[2]; k <= blocks_[b].box.upper[2]; ++k)
      plane_[std::size_t(k - first_plane_)].push_back(int(b));
}

/// Find how far the rows of the halo lie from own cells.
void Layout::measure_halo(int halo) {
  first_halo_plane_ = std::numeric_limits<int>::max();
  for (std::size_t b = own_blocks_; b < blocks_.size(); ++b) {
    Box const& box = blocks_[b].box;
    first_halo_plane_ = std::min(first_halo_plane_, box.lower[2]);
    std::vector<Box> near;
    for (std::size_t own = 0; own < own_blocks_; ++own)
      if (!box.grow(halo).intersect(blocks_[own].box).empty()) near.push_back(blocks_[own].box);
    auto& steps = rows_of_.emplace_back();
    for_each_row(box, [&](Index3 const& first) {
      int nearest = std::numeric_limits<std::int8_t>::max();
      for (Box const& own : near) nearest = std::min(nearest, apart({first, {box.upper[0], first[1], first[2]}}, own));
      steps.push_back(std::int8_t(nearest));
    });
  }
}

void Layout::add(Box const& box) {
  CellBlock block;
  block.box = box;
  block.lanes = lanes_of(box.extent(0));
  block.cells.origin = std::ptrdiff_t(size_);
  block.cells.pitch_y = rounded_up(box.extent(0), block.lanes);
  // one line more than a power of two, else the planes' rows would share the same few sets of the cache
  std::ptrdiff_t const plane = rounded_up(block.cells.pitch_y * box.extent(1), line);
  block.cells.pitch_z = plane % 1024 == 0 ? plane + line : plane;
  size_ += std::size_t(block.cells.pitch_z * box.extent(2));
  blocks_.push_back(block);
}

/// Mark the rows of own blocks with some of these cells.
void Layout::mark_copied(Box const& cells) {
  for (std::size_t b = 0; b < own_blocks_; ++b) {
    Box const &box = blocks_[b].box, part = cells.intersect(box);
    if (part.empty()) continue;
    for (int k = part.lower[2]; k <= part.upper[2]; ++k)
      std::fill_n(&rows_of_[b][std::size_t(k - box.lower[2]) * std::size_t(box.extent(1)) +
                               std::size_t(part.lower[1] - box.lower[1])],
                  part.extent(1), std::int8_t(1));
  }
}

/// Whether own cells are read in place where they are images of such a shift.
bool Layout::in_place(Index3 const& shift) const {
  for (int d = 0; d < 3; ++d)
    if (shift[d] != 0 && !wraps_[d]) return false;
  return true;
}

std::vector<int> Layout::near(int lower_plane, int upper_plane) const {
  if (plane_.empty()) return {};
  int const first = std::max(lower_plane, first_plane_);
  int const last = std::min(upper_plane, first_plane_ + planes() - 1);
  if (first > last) return {};
  if (first == last) return on_plane(first);
  std::vector<int> out;
  for (std::size_t b = 0; b < blocks_.size(); ++b)
    if (blocks_[b].box.lower[2] <= last && blocks_[b].box.upper[2] >= first) out.push_back(int(b));
  return out;
}

std::ptrdiff_t Layout::find(Index3 const& cell) const {
  std::ptrdiff_t out = -1;  // the last one found is not an image
  for_each_overlap({cell, cell}, [&](CellBlock const& block, Box const& part, Index3 const& shift) {
    out = block.place({part.lower[0] - shift[0], part.lower[1] - shift[1], part.lower[2]});
  });
  return out;
}

}  // namespace amrpic::cycle
