#include "freespace/octree.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>

namespace amrpic::freespace {

namespace {

/// A node that has no parent yet, and the block it lies in at the present depth.
struct Root {
  Cell place;
  int number;  ///< among all nodes made
};

bool by_place(Root const& a, Root const& b) {
  return std::tie(a.place[2], a.place[1], a.place[0]) < std::tie(b.place[2], b.place[1], b.place[0]);
}

struct Member {
  TreeNode node;
  Harmonics<double> moments;
};

Member leaf_member(LeafMoments const& part, int number, Point const& shape) {
  auto const& [leaf, moments] = part;
  double const scale = std::ldexp(1.0, -leaf.key.level);
  TreeNode node{};
  node.centre = leaf.centre(shape);
  for (int d = 0; d < 3; ++d) node.half[d] = 0.5 * (leaf.extent[d] - 1) * shape[d] * scale;
  node.radius = std::hypot(node.half[0], node.half[1], node.half[2]);
  node.coarsest = scale;
  node.magnitude = leaf.magnitude;
  auto const &first = moments[harmonic_index(1, 0)], &second = moments[harmonic_index(1, 1)];
  node.lattice.charge = moments[0].re * scale * scale;
  node.lattice.dipole = {2 * second.re * scale * scale, 2 * second.im * scale * scale, first.re * scale * scale};
  node.level = leaf.key.level;
  node.first = leaf.corner();
  node.extent = leaf.extent;
  node.leaf = number;
  return {node, moments};
}

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
  return out;
}

class Builder {
 public:
  std::vector<Root> roots;

  void add(Cell const& place, Member const& member) {
    roots.push_back({place, int(made_.size())});
    made_.push_back(member);
  }

  /// Make the blocks twice as wide along some axes.
  void widen(std::array<bool, 3> const& doubled) {
    for (Root& root : roots)
      for (int d = 0; d < 3; ++d) root.place[d] >>= doubled[d] ? 1 : 0;
  }

  /// Give a common parent to those of one place. A single node stays a root.
  void join() {
    std::stable_sort(roots.begin(), roots.end(), by_place);
    std::vector<Root> const children = std::move(roots);
    roots.clear();
    for (auto first = children.begin(); first != children.end();) {
      auto last = first + 1;
      while (last != children.end() && last->place == first->place) ++last;
      if (last - first == 1)
        roots.push_back(*first);
      else
        add(first->place, parent_of(&*first, &*first + (last - first)));
      first = last;
    }
  }

  Octree finish() {
    for (Root const& root : roots) keep(made_[std::size_t(root.number)]);
    return std::move(tree_);
  }

 private:
  Member parent_of(Root const* first, Root const* last) {
    children_.clear();
    for (; first != last; ++first) children_.push_back(made_[std::size_t(first->number)]);
    Member const *from = children_.data(), *to = from + children_.size();
    Member out{enclose(from, to), {}};
    out.node.first_child = int(tree_.nodes.size());
    out.moments = join_moments(out.node, from, to);
    for (Member const& child : children_) keep(child);
    return out;
  }

  void keep(Member const& member) {
    tree_.nodes.push_back(member.node);
    tree_.moments.push_back(member.moments);
    tree_.expansions.push_back(to_expansion(member.moments));
  }

  std::vector<Member> made_, children_;
  Octree tree_;
};

using Axes = std::array<bool, 3>;

/// Which axes to double next, so that blocks stay about as long as wide also where cells are not cubes.
Axes axes_to_double(Point const& width) {
  double const shortest = std::min({width[0], width[1], width[2]});
  return {width[0] < 1.5 * shortest, width[1] < 1.5 * shortest, width[2] < 1.5 * shortest};
}

/// The axes to double, one time after the other, until blocks of cells become as wide as they are long.
std::vector<Axes> steps_to_widest(Point const& shape) {
  double const longest = std::max({shape[0], shape[1], shape[2]});
  std::vector<Axes> out;
  for (Point width = shape;;) {
    Axes doubled = axes_to_double(width);
    for (int d = 0; d < 3; ++d) doubled[d] = doubled[d] && 2 * width[d] <= longest;
    if (doubled == Axes{}) return out;
    for (int d = 0; d < 3; ++d) width[d] *= doubled[d] ? 2 : 1;
    out.push_back(doubled);
  }
}

}  // namespace

Cell widest_blocks(Point const& shape) {
  Cell out{block_edge, block_edge, block_edge};
  for (Axes const& doubled : steps_to_widest(shape))
    for (int d = 0; d < 3; ++d) out[d] *= doubled[d] ? 2 : 1;
  return out;
}

Octree build_octree(std::vector<LeafMoments> const& leaves, Point const& shape) {
  Builder builder;
  int const finest = leaves.empty() ? 0 : leaves.back().leaf.key.level;
  auto last = int(leaves.size());
  auto const steps = steps_to_widest(shape);
  for (int level = finest; level >= 0; --level) {
    std::vector<Root> finer;
    finer.swap(builder.roots);
    int first = last;
    while (first > 0 && leaves[first - 1].leaf.key.level == level) --first;
    for (int n = first; n < last; ++n) builder.add(leaves[n].leaf.key.place, leaf_member(leaves[n], n, shape));
    last = first;
    for (Axes const& doubled : steps) {
      builder.widen(doubled);
      builder.join();
    }
    finer.insert(finer.end(), builder.roots.begin(), builder.roots.end());
    builder.roots = std::move(finer);
    builder.join();
    if (level > 0) builder.widen({true, true, true});
  }
  Cell const widest = widest_blocks(shape);
  Point width;
  for (int d = 0; d < 3; ++d) width[d] = shape[d] * widest[d];
  while (builder.roots.size() > 1) {
    Axes const doubled = axes_to_double(width);
    for (int d = 0; d < 3; ++d) width[d] *= doubled[d] ? 2 : 1;
    builder.widen(doubled);
    builder.join();
  }
  return builder.finish();
}

}  // namespace amrpic::freespace
