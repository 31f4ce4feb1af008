#include "freespace/leaves.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>

#include "base/communicator.hpp"

namespace amrpic::freespace {

namespace {

bool by_key(LeafMoments const& a, LeafMoments const& b) { return a.leaf.key < b.leaf.key; }

void move_to(LeafMoments& part, Point const& centre, Point const& shape) {
  Point const old = part.leaf.centre(shape);
  if (old == centre) return;
  part.moments = translate_moments(part.moments, old[0] - centre[0], old[1] - centre[1], old[2] - centre[2]);
}

/// One leaf from the parts that two ranks hold.
LeafMoments joined(LeafMoments a, LeafMoments b, Point const& shape) {
  LeafMoments out = a;
  for (int d = 0; d < 3; ++d) {
    int const end = std::max(a.leaf.first[d] + a.leaf.extent[d], b.leaf.first[d] + b.leaf.extent[d]);
    out.leaf.first[d] = std::min(a.leaf.first[d], b.leaf.first[d]);
    out.leaf.extent[d] = end - out.leaf.first[d];
  }
  out.leaf.magnitude += b.leaf.magnitude;
  Point const centre = out.leaf.centre(shape);
  move_to(a, centre, shape);
  move_to(b, centre, shape);
  for (int n = 0; n < harmonic_count; ++n)
    out.moments[n] = {a.moments[n].re + b.moments[n].re, a.moments[n].im + b.moments[n].im};
  return out;
}

/// Drop the weakest leaves, by whole octaves of magnitude: a choice between leaves that differ only by rounding would
/// depend on the number of ranks.
void drop_weak(std::vector<LeafMoments>& leaves, double dropped) {
  std::map<int, double> octaves;
  double total = 0;
  for (auto const& [leaf, moments] : leaves) {
    octaves[std::ilogb(leaf.magnitude)] += leaf.magnitude;
    total += leaf.magnitude;
  }
  double sum = 0;
  auto octave = octaves.begin();
  while (octave != octaves.end() && (sum += octave->second) < dropped * total) ++octave;
  if (octave == octaves.begin() || octave == octaves.end()) return;
  auto const is_weak = [&](LeafMoments const& part) { return std::ilogb(part.leaf.magnitude) < octave->first; };
  leaves.erase(std::remove_if(leaves.begin(), leaves.end(), is_weak), leaves.end());
}

/// Number of a leaf in a sorted list, or -1.
int find(std::vector<LeafMoments> const& leaves, LeafMoments const& leaf) {
  auto const place = std::lower_bound(leaves.begin(), leaves.end(), leaf, by_key);
  return place != leaves.end() && place->leaf.key == leaf.leaf.key ? int(place - leaves.begin()) : -1;
}

}  // namespace

std::vector<LeafMoments> agree_on_leaves(Communicator const& comm, ChargeBlocks const& blocks, Point const& shape,
                                         double dropped) {
  auto const all = comm.gather(blocks.leaves());
  std::vector<std::size_t> order(all.values.size());
  for (std::size_t n = 0; n < order.size(); ++n) order[n] = n;
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return by_key(all.values[a], all.values[b]); });
  std::vector<LeafMoments> out;
  out.reserve(order.size());
  for (std::size_t n : order) {
    LeafMoments const& part = all.values[n];
    if (!out.empty() && out.back().leaf.key == part.leaf.key)
      out.back() = joined(out.back(), part, shape);
    else
      out.push_back(part);
  }
  drop_weak(out, dropped);
  return out;
}

LeafCharges::LeafCharges(Communicator const& comm, ChargeBlocks const& blocks, std::vector<LeafMoments> const& leaves,
                         std::vector<char> const& wanted, std::array<int, 3> const& across)
    : place_(leaves.size(), -1) {
  int count = 0;
  for (std::size_t n = 0; n < leaves.size(); ++n)
    if (wanted[n]) place_[n] = count++;
  if (count == 0) return;

  // Only the rows of the bounding boxes travel.
  std::vector<int> mine;
  std::vector<double> charges;
  for (std::size_t own = 0; own < blocks.leaves().size(); ++own) {
    if (!blocks.has_charges(own)) continue;
    int const n = find(leaves, blocks.leaves()[own]);
    if (n < 0 || !wanted[n]) continue;
    mine.push_back(n);
    Leaf const& leaf = leaves[n].leaf;
    BlockCharges const& block = blocks.charges(own);
    for (int k = leaf.first[2]; k < leaf.first[2] + leaf.extent[2]; ++k)
      for (int j = leaf.first[1]; j < leaf.first[1] + leaf.extent[1]; ++j) {
        double const* row = block.data() + leaf.first[0] + block_edge * (j + block_edge * k);
        charges.insert(charges.end(), row, row + leaf.extent[0]);
      }
  }
  auto const given = comm.gather(mine).values;
  auto const all = comm.gather(charges).values;

  std::array<int, 3> step;
  for (int t = 0, width = 1; t < 3; ++t, width *= block_edge) step[across[t]] = width;
  blocks_.assign(std::size_t(count), BlockCharges{});
  double const* from = all.data();
  for (int n : given) {
    double* const to = blocks_[std::size_t(place_[n])].data();
    Leaf const& leaf = leaves[n].leaf;
    for (int k = 0; k < leaf.extent[2]; ++k)
      for (int j = 0; j < leaf.extent[1]; ++j)
        for (int i = 0; i < leaf.extent[0]; ++i) to[step[0] * i + step[1] * j + step[2] * k] += *from++;
  }
  for (BlockCharges const& block : blocks_)
    if (std::all_of(block.begin(), block.end(), [](double q) { return q == 0; }))
      throw std::logic_error("LeafCharges: no rank kept the charges of a leaf near a wall");
}

}  // namespace amrpic::freespace
