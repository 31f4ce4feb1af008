#include "freespace/octree.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>

namespace amrpic::freespace {

namespace {

/// The cells of a node, if its children have charge of one level alone.
void set_cells(TreeNode& node, Member const* first, Member const* last) {
  TreeNode const& one = first->node;
  node.level = one.level;
  node.first = one.first;
  Cell end{};
  for (Member const* child = first; child != last; ++child) {
    if (child->node.level != one.level) node.level = -1;
    for (int d = 0; d < 3; ++d) {
      node.first[d] = std::min(node.first[d], child->node.first[d]);
      end[d] = std::max(end[d], child->node.first[d] + child->node.extent[d]);
    }
  }
  for (int d = 0; d < 3; ++d) node.extent[d] = end[d] - node.first[d];
}

/// The parent node of some children.
TreeNode enclose(Member const* first, Member const* last) {
  TreeNode out{};
  for (int d = 0; d < 3; ++d) {
    double lower = first->node.centre[d], upper = lower;
    for (Member const* child = first; child != last; ++child) {
      lower = std::min(lower, child->node.centre[d] - child->node.half[d]);
      upper = std::max(upper, child->node.centre[d] + child->node.half[d]);
    }
    out.centre[d] = 0.5 * (lower + upper);
    out.half[d] = 0.5 * (upper - lower);
  }
  out.radius = std::hypot(out.half[0], out.half[1], out.half[2]);
  for (Member const* child = first; child != last; ++child) {
    out.coarsest = std::max(out.coarsest, child->node.coarsest);
    out.magnitude += child->node.magnitude;
    out.lattice.charge += child->node.lattice.charge;
    for (int d = 0; d < 3; ++d)
      out.lattice.dipole[d] +=
          child->node.lattice.dipole[d] + child->node.lattice.charge * (child->node.centre[d] - out.centre[d]);
  }
  out.leaf = -1;
  out.children = int(last - first);
  set_cells(out, first, last);
  return out;
}

/// Sum of the moments of some children about the centre of their parent, eight children at a time.
Harmonics<double> join_moments(TreeNode const& parent, Member const* first, Member const* last) {
  Harmonics<double> out{};
  for (; first < last; first += lane_count) {
    int const count = int(std::min<std::ptrdiff_t>(lane_count, last - first));
    double shift[3][lane_count] = {}, re[harmonic_count][lane_count] = {}, im[harmonic_count][lane_count] = {};
    for (int t = 0; t < count; ++t) {
      for (int d = 0; d < 3; ++d) shift[d][t] = first[t].node.centre[d] - parent.centre[d];
      for (int n = 0; n < harmonic_count; ++n) re[n][t] = first[t].moments[n].re, im[n][t] = first[t].moments[n].im;
    }
    Harmonics<Lanes> moments;
    for (int n = 0; n < harmonic_count; ++n) moments[n] = {load<Lanes>(re[n]), load<Lanes>(im[n])};
    auto const moved = translate_moments(moments, load<Lanes>(shift[0]), load<Lanes>(shift[1]), load<Lanes>(shift[2]));
    for (int n = 0; n < harmonic_count; ++n) {
      out[n].re += sum_of(moved[n].re);
      out[n].im += sum_of(moved[n].im);
    }
  }
  for (int l = 0; l <= order; ++l) out[harmonic_index(l, 0)].im = 0;  // rounding alone
  return out;
}

}  // namespace

Member parent_of(Member const* first, Member const* last) {
  Member out{enclose(first, last), {}};
  out.moments = join_moments(out.node, first, last);
  return out;
}

LatticeMoments plain_moments(Harmonics<double> const& moments) {
  auto const &first = moments[harmonic_index(1, 0)], &second = moments[harmonic_index(1, 1)];
  return {moments[0].re, {2 * second.re, 2 * second.im, first.re}};
}

Member leaf_member(LeafMoments const& part, int number, Point const& shape) {
  auto const& [leaf, moments] = part;
  double const scale = std::ldexp(1.0, -leaf.key.level);
  TreeNode node{};
  node.centre = leaf.centre(shape);
  for (int d = 0; d < 3; ++d) node.half[d] = 0.5 * (leaf.extent[d] - 1) * shape[d] * scale;
  node.radius = std::hypot(node.half[0], node.half[1], node.half[2]);
  node.coarsest = scale;
  node.magnitude = leaf.magnitude;
  auto const plain = plain_moments(moments);
  node.lattice.charge = plain.charge * scale * scale;
  for (int d = 0; d < 3; ++d) node.lattice.dipole[d] = plain.dipole[d] * scale * scale;
  node.level = leaf.key.level;
  node.first = leaf.corner();
  node.extent = leaf.extent;
  node.leaf = number;
  return {node, moments};
}

NodeRecord::Content packed(Member const& member) {
  TreeNode const& node = member.node;
  NodeRecord::Content out{};
  out.centre = node.centre;
  out.half = node.half;
  out.magnitude = node.magnitude;
  out.lattice = node.lattice;
  out.first = node.first;
  out.extent = node.extent;
  out.level = node.level;
  out.depth = std::int16_t(-std::ilogb(node.coarsest));
  out.is_leaf = node.leaf >= 0;
  double* to = out.moments.data();
  for (int l = 0; l <= order; ++l)
    for (int m = 0; m <= l; ++m) {
      auto const& moment = member.moments[harmonic_index(l, m)];
      *to++ = moment.re;
      if (m > 0) *to++ = moment.im;
    }
  return out;
}

Member unpacked(NodeRecord::Content const& content, int leaf) {
  Member out{};
  TreeNode& node = out.node;
  node.centre = content.centre;
  node.half = content.half;
  node.radius = std::hypot(node.half[0], node.half[1], node.half[2]);
  node.coarsest = std::ldexp(1.0, -content.depth);
  node.magnitude = content.magnitude;
  node.lattice = content.lattice;
  node.level = content.level;
  node.first = content.first;
  node.extent = content.extent;
  node.leaf = content.is_leaf ? leaf : -1;
  double const* from = content.moments.data();
  for (int l = 0; l <= order; ++l)
    for (int m = 0; m <= l; ++m) {
      auto& moment = out.moments[harmonic_index(l, m)];
      moment.re = *from++;
      if (m > 0) moment.im = *from++;
    }
  return out;
}

OctreeBuilder::OctreeBuilder(BlockGrids const& grids, std::size_t own_leaves)
    : grids_(grids), found_(std::size_t(grids.count())), children_(found_.size()), next_leaf_(int(own_leaves)) {
  members_.reserve(own_leaves + own_leaves / 4);
}

int OctreeBuilder::keep(NodeRecord const& record) {
  auto const& [block, node] = record;
  if (!node.is_leaf) return keep(unpacked(node, -1));
  Cell place;
  for (int d = 0; d < 3; ++d) place[d] = node.first[d] / block_edge;
  Found const* const own = find({grids_.leaves(node.level), place});  // it may come back as all of a wider block
  return keep(unpacked(node, own ? member(*own).node.leaf : next_leaf_++));
}

void OctreeBuilder::join_sorted(int grid) {
  auto& children = children_[std::size_t(grid)];
  auto const is_own = [&](Child const& c) { return c.block.grid == grids_[grid].own; };
  std::sort(children.begin(), children.end(), [&](Child const& a, Child const& b) {
    if (!(a.parent == b.parent)) return by_place(a.parent, b.parent);
    if (a.block.grid != b.block.grid) return is_own(b);
    return by_place(a.block.place, b.block.place);
  });
  for (std::size_t first = 0, last; first < children.size(); first = last) {
    for (last = first + 1; last < children.size() && children[last].parent == children[first].parent;) ++last;
    int const member = last - first == 1 ? children[first].member
                                         : keep(parent_of(&children[first], &children[first] + (last - first)));
    found_[std::size_t(grid)].push_back({children[first].parent, member, int(first), int(last)});
  }
}

Member OctreeBuilder::parent_of(Child const* first, Child const* last) {
  together_.clear();
  for (; first != last; ++first) together_.push_back(members_[std::size_t(first->member)]);
  return freespace::parent_of(together_.data(), together_.data() + together_.size());
}

void OctreeBuilder::add_found(int grid, std::vector<NodeRecord> const& all) {
  std::vector<Found> const mine = std::move(found_[std::size_t(grid)]);
  auto& found = found_[std::size_t(grid)];
  found.clear();
  auto own = mine.begin();
  for (NodeRecord const& record : all)
    if (own != mine.end() && own->place == record.block.place)
      found.push_back(*own++);
    else
      found.push_back({record.block.place, keep(record)});
}

void OctreeBuilder::append_children(int grid, Found const& block, std::vector<NodeRecord>& to) const {
  auto const& children = children_[std::size_t(grid)];
  for (int c = block.first; c < block.last; ++c) {
    Child const& child = children[std::size_t(c)];
    to.push_back({child.block, packed(members_[std::size_t(child.member)])});
  }
}

/// A block, should this rank have found it.
OctreeBuilder::Found const* OctreeBuilder::find(Block const& block) const {
  auto const& found = found_[std::size_t(block.grid)];
  auto const place = std::lower_bound(found.begin(), found.end(), block.place,
                                      [](Found const& a, Cell const& b) { return by_place(a.place, b); });
  return place != found.end() && place->place == block.place ? &*place : nullptr;
}

Octree OctreeBuilder::finish(std::vector<NodeRecord> const& received, int top) {
  Octree out;
  int const last = grids_.count() - 1;
  if (found_[std::size_t(last)].empty()) return out;

  struct Family {
    Block parent;
    Child child;
  };
  std::vector<Family> others;  // in the order of each family
  for (NodeRecord const& record : received) {
    Block const parent = grids_.parent(record.block);
    others.push_back({parent, {parent.place, record.block, keep(record), -1}});
  }
  std::stable_sort(others.begin(), others.end(), [](Family const& a, Family const& b) { return a.parent < b.parent; });
  std::vector<Child> others_in_order;
  for (Family const& family : others) others_in_order.push_back(family.child);

  auto const children_of = [&](Child const& parent) -> std::pair<Child const*, Child const*> {
    Found const* const here =
        parent.found >= 0 ? &found_[std::size_t(parent.block.grid)][std::size_t(parent.found)] : find(parent.block);
    if (here && here->first < here->last) {
      Child const* const all = children_[std::size_t(parent.block.grid)].data();
      return {all + here->first, all + here->last};
    }
    auto const [from, to] = std::equal_range(others.begin(), others.end(), Family{parent.block, {}},
                                             [](Family const& a, Family const& b) { return a.parent < b.parent; });
    return {others_in_order.data() + (from - others.begin()), others_in_order.data() + (to - others.begin())};
  };
  auto const add = [&](Child const& child) {
    Member const& member = members_[std::size_t(child.member)];
    out.nodes.push_back(member.node);
    out.nodes.back().first_child = out.nodes.back().children = 0;
    out.moments.push_back(member.moments);
    out.expansions.push_back(to_expansion(member.moments));
  };
  std::vector<Child> nodes{{{}, {last, {0, 0, 0}}, found_[std::size_t(last)].front().member, 0}};
  add(nodes.front());
  out.tops = {{0, Image{}}};
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    if (out.nodes[n].leaf >= 0) continue;
    auto [from, to] = children_of(nodes[n]);
    int grid = nodes[n].block.grid;
    while (to - from == 1) {  // the same node
      grid = from->block.grid;
      std::tie(from, to) = children_of(*from);
    }
    out.nodes[n].is_shared = grid > top;
    out.nodes[n].first_child = int(nodes.size());
    out.nodes[n].children = int(to - from);
    for (; from != to; ++from) {
      add(*from);
      nodes.push_back(*from);
    }
  }
  return out;
}

}  // namespace amrpic::freespace
