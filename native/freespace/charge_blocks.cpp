#include "freespace/charge_blocks.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include "base/all_gather.hpp"
#include "base/error.hpp"

namespace amrpic::freespace {

bool BlockKey::operator<(BlockKey const& o) const {
  return std::tie(level, place[2], place[1], place[0]) < std::tie(o.level, o.place[2], o.place[1], o.place[0]);
}

namespace {

// Cells of the domain are not negative.
BlockKey block_of(int level, Cell const& cell) {
  return {level, {cell[0] / block_edge, cell[1] / block_edge, cell[2] / block_edge}};
}
int place_in_block(Cell const& cell) {
  return cell[0] % block_edge + block_edge * (cell[1] % block_edge + block_edge * (cell[2] % block_edge));
}

/// Call f(block key, first, last) for the blocks that cells lower .. upper touch; first, last: the common cells.
template <class F>
void for_each_block(int level, Cell const& lower, Cell const& upper, F&& f) {
  Cell const from = block_of(level, lower).place, to = block_of(level, upper).place;
  Cell place;
  for (place[2] = from[2]; place[2] <= to[2]; ++place[2])
    for (place[1] = from[1]; place[1] <= to[1]; ++place[1])
      for (place[0] = from[0]; place[0] <= to[0]; ++place[0]) {
        Cell first, last;
        for (int d = 0; d < 3; ++d) {
          first[d] = std::max(lower[d], place[d] * block_edge);
          last[d] = std::min(upper[d], place[d] * block_edge + block_edge - 1);
        }
        f(BlockKey{level, place}, first, last);
      }
}

bool any_value(ChargeBox const& box, Cell const& first, Cell const& last) {
  std::ptrdiff_t const nx = box.upper[0] - box.lower[0] + 1, ny = box.upper[1] - box.lower[1] + 1;
  for (int k = first[2]; k <= last[2]; ++k)
    for (int j = first[1]; j <= last[1]; ++j) {
      double const* row = box.values + (first[0] - box.lower[0] + nx * (j - box.lower[1] + ny * (k - box.lower[2])));
      for (int i = 0; i <= last[0] - first[0]; ++i)
        if (row[i] != 0) return true;
    }
  return false;
}

/// The bounding box and the sum of |q| of one rank's part of a leaf.
Leaf describe(BlockKey const& key, double const* charges) {
  Leaf out{key, {}, {}, {}, 0, 0};
  Cell first{block_edge, block_edge, block_edge}, last{-1, -1, -1};
  for (int k = 0; k < block_edge; ++k)
    for (int j = 0; j < block_edge; ++j) {
      double const* row = charges + block_edge * (j + block_edge * k);
      double sum = 0, greatest = 0;
      for (int i = 0; i < block_edge; ++i) {
        sum += std::abs(row[i]);
        greatest = std::max(greatest, std::abs(row[i]));
      }
      if (sum == 0) continue;
      out.magnitude += sum;
      int left = 0, right = block_edge - 1;
      while (row[left] == 0) ++left;
      while (row[right] == 0) --right;
      first = {std::min(first[0], left), std::min(first[1], j), std::min(first[2], k)};
      last = {std::max(last[0], right), std::max(last[1], j), std::max(last[2], k)};
      if (greatest > out.greatest) {
        out.greatest = greatest;
        out.peak = {left, j, k};
        while (std::abs(row[out.peak[0]]) < greatest) ++out.peak[0];
      }
    }
  out.first = first;
  out.extent = {last[0] - first[0] + 1, last[1] - first[1] + 1, last[2] - first[2] + 1};
  return out;
}

/// One leaf from the parts that two ranks hold.
void join(Leaf& leaf, Leaf const& other) {
  for (int d = 0; d < 3; ++d) {
    int const end = std::max(leaf.first[d] + leaf.extent[d], other.first[d] + other.extent[d]);
    leaf.first[d] = std::min(leaf.first[d], other.first[d]);
    leaf.extent[d] = end - leaf.first[d];
  }
  leaf.magnitude += other.magnitude;
  if (other.greatest > leaf.greatest) leaf.greatest = other.greatest, leaf.peak = other.peak;
}

/// Leaves without the weakest. Whole octaves of magnitude go at a time: a choice between leaves that are equal but for
/// rounding would depend on the number of ranks.
std::vector<Leaf> without_weak(std::vector<Leaf> const& leaves, double dropped) {
  std::map<int, double> octaves;
  double total = 0;
  for (Leaf const& leaf : leaves) {
    octaves[std::ilogb(leaf.magnitude)] += leaf.magnitude;
    total += leaf.magnitude;
  }
  double sum = 0;
  auto octave = octaves.begin();
  while (octave != octaves.end() && (sum += octave->second) < dropped * total) ++octave;
  std::vector<Leaf> out;
  for (Leaf const& leaf : leaves)
    if (std::ilogb(leaf.magnitude) >= octave->first) out.push_back(leaf);
  return out;
}

/// Call f(block number, leaf number) for the blocks of this rank that are leaves; both lists are sorted.
template <class F>
void for_each_own_leaf(ChargeBlocks const& blocks, std::vector<Leaf> const& leaves, F&& f) {
  std::size_t n = 0;
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    while (n < leaves.size() && leaves[n].key < blocks.key(b)) ++n;
    if (n < leaves.size() && leaves[n].key == blocks.key(b)) f(b, int(n));
  }
}

Harmonics<double> moments_about_centre(double const* charges, Leaf const& leaf, Point const& shape) {
  BlockPowers powers;
  for (int d = 0; d < 3; ++d) {
    double const width = std::ldexp(shape[d], -leaf.key.level), centre = leaf.first[d] + 0.5 * (leaf.extent[d] - 1);
    for (int i = 0; i < block_edge; ++i) {
      powers[d][0][i] = 1;
      for (int n = 1; n <= order; ++n) powers[d][n][i] = powers[d][n - 1][i] * ((i - centre) * width);
    }
  }
  return moments_of(block_monomials(charges, powers));
}

}  // namespace

void ChargeBlocks::reserve_blocks(std::vector<BlockKey> keys) {
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  keys_ = std::move(keys);
  charges_.assign(keys_.size() * block_cells, 0.0);
  last_ = 0;
}

double* ChargeBlocks::find(BlockKey const& key) {
  if (last_ >= keys_.size() || !(keys_[last_] == key))
    last_ = std::size_t(std::lower_bound(keys_.begin(), keys_.end(), key) - keys_.begin());
  return last_ < keys_.size() && keys_[last_] == key ? charges_.data() + last_ * block_cells : nullptr;
}

void ChargeBlocks::assign(Lattice const& lattice, std::vector<PointCharge> const& charges) {
  std::vector<BlockKey> keys;
  for (PointCharge const& charge : charges) {
    if (charge.charge == 0) continue;
    Cell const cell = lattice.cell_at(charge.position, charge.level);
    for (int d = 0; d < 3; ++d)
      if (cell[d] < 0 || cell[d] >= (lattice.cells[d] << charge.level))
        throw SolverError("open boundary: a charge lies outside the domain; remove lost particles before the solve");
    BlockKey const key = block_of(charge.level, cell);
    if (keys.empty() || !(keys.back() == key)) keys.push_back(key);
  }
  reserve_blocks(std::move(keys));
  for (PointCharge const& charge : charges)
    if (charge.charge != 0) {
      Cell const cell = lattice.cell_at(charge.position, charge.level);
      find(block_of(charge.level, cell))[place_in_block(cell)] += charge.charge;
    }
}

void ChargeBlocks::assign(std::vector<ChargeBox> const& boxes) {
  std::vector<BlockKey> keys;
  for (ChargeBox const& box : boxes)
    for_each_block(box.level, box.lower, box.upper, [&](BlockKey const& key, Cell const& first, Cell const& last) {
      if (any_value(box, first, last)) keys.push_back(key);
    });
  reserve_blocks(std::move(keys));
  for (ChargeBox const& box : boxes) add_box(box);
}

void ChargeBlocks::add_box(ChargeBox const& box) {
  std::ptrdiff_t const nx = box.upper[0] - box.lower[0] + 1, ny = box.upper[1] - box.lower[1] + 1;
  for_each_block(box.level, box.lower, box.upper, [&](BlockKey const& key, Cell const& first, Cell const& last) {
    double* const block = find(key);
    if (!block) return;
    for (int k = first[2]; k <= last[2]; ++k)
      for (int j = first[1]; j <= last[1]; ++j) {
        double const* from = box.values + (first[0] - box.lower[0] + nx * (j - box.lower[1] + ny * (k - box.lower[2])));
        double* to = block + place_in_block({first[0], j, k});
        for (int i = 0; i <= last[0] - first[0]; ++i) to[i] += box.factor * from[i];
      }
    for (ChargeBox::Part const& part : box.covered)
      for (int k = std::max(first[2], part.lower[2]); k <= std::min(last[2], part.upper[2]); ++k)
        for (int j = std::max(first[1], part.lower[1]); j <= std::min(last[1], part.upper[1]); ++j)
          for (int i = std::max(first[0], part.lower[0]); i <= std::min(last[0], part.upper[0]); ++i)
            block[place_in_block({i, j, k})] = 0;
  });
}

std::vector<Leaf> agree_on_leaves(MPI_Comm comm, ChargeBlocks const& blocks, double dropped) {
  std::vector<Leaf> mine;
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    Leaf const leaf = describe(blocks.key(b), blocks.charges(b));
    if (leaf.greatest != 0) mine.push_back(leaf);
  }
  std::vector<Leaf> all = all_gather(comm, mine).values;
  std::stable_sort(all.begin(), all.end(), [](Leaf const& a, Leaf const& b) { return a.key < b.key; });
  std::vector<Leaf> joined;
  for (Leaf const& leaf : all) {
    if (!joined.empty() && joined.back().key == leaf.key)
      join(joined.back(), leaf);
    else
      joined.push_back(leaf);
  }
  return joined.empty() ? joined : without_weak(joined, dropped);
}

std::vector<Harmonics<double>> gather_moments(MPI_Comm comm, ChargeBlocks const& blocks,
                                              std::vector<Leaf> const& leaves, Point const& shape) {
  struct Part {
    int leaf;
    Harmonics<double> moments;
  };
  std::vector<Part> mine;
  for_each_own_leaf(blocks, leaves, [&](std::size_t block, int leaf) {
    mine.push_back({leaf, moments_about_centre(blocks.charges(block), leaves[leaf], shape)});
  });
  std::vector<Harmonics<double>> out(leaves.size(), Harmonics<double>{});
  for (Part const& part : all_gather(comm, mine).values)
    for (int n = 0; n < harmonic_count; ++n) {
      out[part.leaf][n].re += part.moments[n].re;
      out[part.leaf][n].im += part.moments[n].im;
    }
  return out;
}

LeafCharges::LeafCharges(MPI_Comm comm, ChargeBlocks const& blocks, std::vector<Leaf> const& leaves,
                         std::vector<char> const& wanted)
    : place_(leaves.size(), -1) {
  int count = 0;
  for (std::size_t n = 0; n < leaves.size(); ++n)
    if (wanted[n]) place_[n] = count++;
  if (count == 0) return;

  // Only the rows of the bounding boxes travel.
  std::vector<int> mine;
  std::vector<double> charges;
  for_each_own_leaf(blocks, leaves, [&](std::size_t block, int n) {
    if (!wanted[n]) return;
    mine.push_back(n);
    Leaf const& leaf = leaves[n];
    for (int k = leaf.first[2]; k < leaf.first[2] + leaf.extent[2]; ++k)
      for (int j = leaf.first[1]; j < leaf.first[1] + leaf.extent[1]; ++j) {
        double const* row = blocks.charges(block) + leaf.first[0] + block_edge * (j + block_edge * k);
        charges.insert(charges.end(), row, row + leaf.extent[0]);
      }
  });
  auto const given = all_gather(comm, mine).values;
  auto const all = all_gather(comm, charges).values;

  blocks_.assign(std::size_t(count), Block{});
  double const* from = all.data();
  for (int n : given) {
    double* const to = blocks_[std::size_t(place_[n])].values.data();
    Leaf const& leaf = leaves[n];
    for (int k = 0; k < leaf.extent[2]; ++k)
      for (int j = 0; j < leaf.extent[1]; ++j)
        for (int i = 0; i < leaf.extent[0]; ++i) to[i + block_edge * (j + block_edge * k)] += *from++;
  }
  for (Block& block : blocks_)
    for (int row = 0; row < block_edge * block_edge; ++row) {
      double const* const values = block.values.data() + block_edge * row;
      if (std::any_of(values, values + block_edge, [](double q) { return q != 0; }))
        block.rows[block.row_count++] = static_cast<unsigned char>(row);
    }
}

}  // namespace amrpic::freespace
