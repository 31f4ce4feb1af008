#include "freespace/charge_blocks.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "freespace/lane_sums.hpp"

namespace amrpic::freespace {

bool BlockKey::operator<(BlockKey const& o) const {
  return std::tie(level, place[2], place[1], place[0]) < std::tie(o.level, o.place[2], o.place[1], o.place[0]);
}

Point Leaf::centre(Point const& shape) const {
  Point out;
  for (int d = 0; d < 3; ++d)
    out[d] = std::ldexp((key.place[d] * block_edge + first[d] + 0.5 * extent[d]) * shape[d], -key.level);
  return out;
}

namespace {

// Cells of the domain are not negative.
BlockKey block_of(int level, Cell const& cell) {
  return {level, {cell[0] / block_edge, cell[1] / block_edge, cell[2] / block_edge}};
}
int place_in_block(Cell const& cell) {
  return cell[0] % block_edge + block_edge * (cell[1] % block_edge + block_edge * (cell[2] % block_edge));
}

/// The cells that a box and a block have in common.
struct BlockPart {
  BlockKey key;
  ChargeBox const* box;
  Cell first, last;

  bool is_whole() const {
    bool out = true;
    for (int d = 0; d < 3; ++d) out = out && last[d] - first[d] + 1 == block_edge;
    return out;
  }
};

template <class F>
void for_each_part(ChargeBox const& box, F&& f) {
  Cell const from = block_of(box.level, box.lower).place, to = block_of(box.level, box.upper).place;
  Cell place;
  for (place[2] = from[2]; place[2] <= to[2]; ++place[2])
    for (place[1] = from[1]; place[1] <= to[1]; ++place[1])
      for (place[0] = from[0]; place[0] <= to[0]; ++place[0]) {
        BlockPart part{{box.level, place}, &box, {}, {}};
        for (int d = 0; d < 3; ++d) {
          part.first[d] = std::max(box.lower[d], place[d] * block_edge);
          part.last[d] = std::min(box.upper[d], place[d] * block_edge + block_edge - 1);
        }
        f(part);
      }
}

/// Call f(first, last) for the cells that a part has in common with a range, if there are any.
template <class F>
void with_common(BlockPart const& part, ChargeBox::CellRange const& range, F&& f) {
  Cell first, last;
  bool is_empty = false;
  for (int d = 0; d < 3; ++d) {
    first[d] = std::max(part.first[d], range.lower[d]);
    last[d] = std::min(part.last[d], range.upper[d]);
    is_empty = is_empty || first[d] > last[d];
  }
  if (!is_empty) f(first, last);
}

/// Call f(first, last) for the covered cells of a part.
template <class F>
void for_each_covered(BlockPart const& part, F&& f) {
  for (ChargeBox::CellRange const& covered : part.box->covered) with_common(part, covered, f);
}

int cells_in(Cell const& first, Cell const& last) {
  return (last[0] - first[0] + 1) * (last[1] - first[1] + 1) * (last[2] - first[2] + 1);
}

int seen_in(BlockPart part, Cell const& first, Cell const& last) {
  part.first = first, part.last = last;
  int out = cells_in(first, last);
  if (part.box->unseen)
    with_common(part, *part.box->unseen, [&](Cell const& a, Cell const& b) { out -= cells_in(a, b); });
  return out;
}

/// Whether any cell of a part counts. Covered parts do not overlap.
bool counts(BlockPart const& part) {
  int left = seen_in(part, part.first, part.last);
  for_each_covered(part, [&](Cell const& first, Cell const& last) { left -= seen_in(part, first, last); });
  return left > 0;
}

/// Call f(values, place in the block) for each row of a part.
template <class F>
void for_each_row(BlockPart const& part, F&& f) {
  ChargeBox const& box = *part.box;
  std::ptrdiff_t const nx = box.upper[0] - box.lower[0] + 1, ny = box.upper[1] - box.lower[1] + 1;
  for (int k = part.first[2]; k <= part.last[2]; ++k)
    for (int j = part.first[1]; j <= part.last[1]; ++j)
      f(box.values + (part.first[0] - box.lower[0] + nx * (j - box.lower[1] + ny * (k - box.lower[2]))),
        place_in_block({part.first[0], j, k}));
}

/// Short rows far apart are no pattern that the processor would find by itself.
void prefetch(BlockPart const& part) {
  for_each_row(part, [](double const* row, int) {
    __builtin_prefetch(row);
    __builtin_prefetch(row + block_edge - 1);
  });
}

/// Put the charges of a part into its block. Boxes do not overlap.
void fill(BlockPart const& part, BlockCharges& block) {
  double const factor = part.box->factor;
  int const length = part.last[0] - part.first[0] + 1;
  for_each_row(part, [&](double const* row, int place) {
    double* const to = block.data() + place;
    for (int i = 0; i < length; ++i) to[i] = factor * row[i];
  });
  for (auto const& [cells, weight] : part.box->weighted)
    with_common(part, cells, [&, weight = weight](Cell const& first, Cell const& last) {
      for (int k = first[2]; k <= last[2]; ++k)
        for (int j = first[1]; j <= last[1]; ++j)
          for (int i = first[0]; i <= last[0]; ++i) block[place_in_block({i, j, k})] *= weight;
    });
  for (ChargeBox::Added const& added : part.box->added)
    with_common(part, added.cells, [&](Cell const& first, Cell const& last) {
      Cell const& lower = added.cells.lower;
      std::ptrdiff_t const nx = added.cells.upper[0] - lower[0] + 1, ny = added.cells.upper[1] - lower[1] + 1;
      for (int k = first[2]; k <= last[2]; ++k)
        for (int j = first[1]; j <= last[1]; ++j) {
          double const* const row = added.values.data() + nx * (j - lower[1] + ny * (k - lower[2])) - lower[0];
          for (int i = first[0]; i <= last[0]; ++i) block[place_in_block({i, j, k})] += factor * row[i];
        }
    });
  auto const clear = [&](Cell const& first, Cell const& last) {
    for (int k = first[2]; k <= last[2]; ++k)
      for (int j = first[1]; j <= last[1]; ++j)
        for (int i = first[0]; i <= last[0]; ++i) block[place_in_block({i, j, k})] = 0;
  };
  for_each_covered(part, clear);
  if (part.box->unseen) with_common(part, *part.box->unseen, clear);
}

/// First number that is not zero, and how many there are up to the last one.
std::pair<int, int> range_of(std::array<double, block_edge> const& values) {
  int first = 0, last = block_edge - 1;
  while (first < last && values[first] == 0) ++first;
  while (last > first && values[last] == 0) --last;
  return {first, last - first + 1};
}

/// The bounding box and the sum of |q|.
Leaf describe(BlockKey const& key, BlockCharges const& charges) {
  Lanes columns{}, by_y[block_edge] = {}, by_z[block_edge] = {};
  for (int k = 0; k < block_edge; ++k)
    for (int j = 0; j < block_edge; ++j) {
      auto const row = absolute(load<Lanes>(charges.data() + block_edge * (j + block_edge * k)));
      columns += row;
      by_y[j] += row;
      by_z[k] += row;
    }
  std::array<std::array<double, block_edge>, 3> sums;
  for (int i = 0; i < block_edge; ++i)
    sums[0][i] = columns[i], sums[1][i] = sum_of(by_y[i]), sums[2][i] = sum_of(by_z[i]);
  Leaf out{key, {}, {}, sum_of(columns)};
  for (int d = 0; d < 3; ++d) std::tie(out.first[d], out.extent[d]) = range_of(sums[d]);
  return out;
}

Harmonics<double> moments_about_centre(BlockCharges const& charges, Leaf const& leaf, Point const& shape) {
  BlockPowers powers;
  for (int d = 0; d < 3; ++d) {
    double const width = std::ldexp(shape[d], -leaf.key.level), centre = leaf.first[d] + 0.5 * (leaf.extent[d] - 1);
    for (int i = 0; i < block_edge; ++i) {
      powers[d][0][i] = 1;
      for (int n = 1; n <= order; ++n) powers[d][n][i] = powers[d][n - 1][i] * ((i - centre) * width);
    }
  }
  return moments_of(block_monomials(charges.data(), powers));
}

}  // namespace

void copy_charges(ChargeBox const& box, Cell const& first, Cell const& last, double* to) {
  BlockPart const part{block_of(box.level, first), &box, first, last};
  BlockCharges block{};
  fill(part, block);
  for (int k = first[2]; k <= last[2]; ++k)
    for (int j = first[1]; j <= last[1]; ++j)
      to = std::copy_n(block.data() + place_in_block({first[0], j, k}), last[0] - first[0] + 1, to);
}

void copy_charges(ChargeBox const& box, double* to) {
  std::ptrdiff_t const nx = box.upper[0] - box.lower[0] + 1, ny = box.upper[1] - box.lower[1] + 1;
  for_each_part(box, [&](BlockPart const& part) {
    BlockCharges block{};
    fill(part, block);
    auto const [first, last] = std::tie(part.first, part.last);
    for (int k = first[2]; k <= last[2]; ++k)
      for (int j = first[1]; j <= last[1]; ++j)
        std::copy_n(block.data() + place_in_block({first[0], j, k}), last[0] - first[0] + 1,
                    to + (first[0] - box.lower[0] + nx * (j - box.lower[1] + ny * (k - box.lower[2]))));
  });
}

void ChargeBlocks::clear() {
  leaves_.clear();
  place_.clear();
  charges_.clear();
}

bool is_near_wall(Lattice const& lattice, Cell const& near, BlockKey const& key) {
  for (int d = 0; d < 3; ++d) {
    int const first = key.place[d] * block_edge, end = lattice.cells[d] << key.level;
    if (first < near[d] || first + block_edge > end - near[d]) return true;
  }
  return false;
}

void ChargeBlocks::add(BlockKey const& key, BlockCharges const& charges) {
  Leaf const leaf = describe(key, charges);
  if (leaf.magnitude == 0) return;
  leaves_.push_back({leaf, moments_about_centre(charges, leaf, shape_)});
  place_.push_back(-1);
  if (!is_near_wall(lattice_, kept_, key)) return;
  place_.back() = int(charges_.size());
  charges_.push_back(charges);
}

void ChargeBlocks::assign(std::vector<ChargeBox> const& boxes, std::vector<BlockKey> const& foreign) {
  auto const is_foreign = [&](BlockKey const& key) { return std::binary_search(foreign.begin(), foreign.end(), key); };
  std::vector<BlockPart> whole, shared;  // blocks of one box, and of several perhaps
  for (ChargeBox const& box : boxes)
    for_each_part(box, [&](BlockPart const& part) {
      if (!counts(part)) return;
      if (part.is_whole())
        whole.push_back(part);
      else if (!is_foreign(part.key))
        shared.push_back(part);
    });
  clear();
  BlockCharges block;
  constexpr std::size_t ahead = 2;
  for (std::size_t n = 0; n < whole.size(); ++n) {
    if (n + ahead < whole.size()) prefetch(whole[n + ahead]);
    fill(whole[n], block);
    add(whole[n].key, block);
  }
  std::stable_sort(shared.begin(), shared.end(), [](BlockPart const& a, BlockPart const& b) { return a.key < b.key; });
  for (auto first = shared.begin(); first != shared.end();) {
    BlockKey const key = first->key;
    block.fill(0);
    for (; first != shared.end() && first->key == key; ++first) fill(*first, block);
    add(key, block);
  }
}

}  // namespace amrpic::freespace
