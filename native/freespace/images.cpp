#include "freespace/images.hpp"

#include <algorithm>
#include <cmath>

namespace amrpic::freespace {

namespace {

constexpr double pi = 3.14159265358979323846;
constexpr int fewest_doublings = 3;  ///< of a block as long as all else is wide

AxisImages images_of(std::optional<Mirror> const& lower, std::optional<Mirror> const& upper) {
  AxisImages out;
  if (lower) out.copies.push_back({true, lower->twice, lower->sign});
  if (upper && !lower) out.copies.push_back({true, upper->twice, upper->sign});
  if (!lower || !upper) return out;
  out.period = upper->twice - lower->twice;
  if (lower->sign == upper->sign) return out;
  for (int n = 0; n < 2; ++n)
    out.copies.push_back({out.copies[std::size_t(n)].reflects, out.copies[std::size_t(n)].shift + out.period,
                          -out.copies[std::size_t(n)].sign});
  out.period *= 2;
  return out;
}

}  // namespace

Image Image::after(Image const& first) const {
  Image out;
  for (std::size_t d = 0; d < 3; ++d) {
    out.reflects[d] = reflects[d] != first.reflects[d];
    out.shift[d] = (reflects[d] ? -first.shift[d] : first.shift[d]) + shift[d];
  }
  out.sign = sign * first.sign;
  return out;
}

Image Image::inverse() const {
  Image out = *this;
  for (std::size_t d = 0; d < 3; ++d)
    if (!reflects[d]) out.shift[d] = -shift[d];
  return out;
}

Images::Images(Lattice const& lattice, std::array<std::array<std::optional<Mirror>, 2>, 3> const& walls,
               std::array<bool, 3> const& periodic, int across)
    : shape_(lattice.shape()), cells_(lattice.cells), across_(across) {
  for (std::size_t d = 0; d < 3; ++d) {
    axes_[d] = images_of(walls[d][0], walls[d][1]);
    if (periodic[d]) axes_[d].period = cells_[d];
  }
}

bool Images::are_none() const {
  return std::all_of(axes_.begin(), axes_.end(),
                     [](AxisImages const& a) { return a.copies.size() == 1 && a.period == 0; });
}

std::vector<Image> Images::copies(Which which) const {
  std::vector<Image> out;
  for (auto const& z : axes_[2].copies)
    for (auto const& y : axes_[1].copies)
      for (auto const& x : axes_[0].copies) {
        std::array<AxisImages::Copy, 3> const of{x, y, z};
        if (which != Which::all && of[std::size_t(across_)].reflects != (which == Which::against)) continue;
        Image image;
        for (std::size_t d = 0; d < 3; ++d) {
          image.reflects[d] = of[d].reflects;
          image.shift[d] = of[d].shift;
          image.sign *= of[d].sign;
        }
        out.push_back(image);
      }
  return out;
}

int Images::doublings(int d) const {
  int const period = axes_[std::size_t(d)].period;
  if (period == 0) return 0;
  double widest = 0;  // of what lies across: open extents with their reflection, and other periods
  for (int e = 0; e < 3; ++e) {
    AxisImages const& other = axes_[std::size_t(e)];
    int const cells = other.period > 0 ? other.period : cells_[e] * int(other.copies.size());
    if (e != d) widest = std::max(widest, cells * shape_[e]);
  }
  return fewest_doublings + std::max(0, int(std::ceil(std::log2(widest / (period * shape_[d])))));
}

double Images::apart(int d, double place, double other) const {
  AxisImages const& axis = axes_[std::size_t(d)];
  double out = 0;
  bool is_first = true;
  for (auto const& copy : axis.copies) {
    double distance = (copy.reflects ? -place : place) + copy.shift * shape_[d] - other;
    if (axis.period > 0) distance = std::remainder(distance, axis.period * shape_[d]);
    out = is_first ? std::abs(distance) : std::min(out, std::abs(distance));
    is_first = false;
  }
  return out;
}

namespace {

/// The charge of a node, as an image of it has it.
Member image_of(Member const& member, Image const& image, Point const& shape) {
  Image const back = image.inverse();
  Member out = member;
  for (int d = 0; d < 3; ++d) {
    out.node.centre[d] = back.place(d, member.node.centre[d], shape[d]);
    out.node.lattice.dipole[d] *= back.reflects[std::size_t(d)] ? -image.sign : image.sign;
  }
  out.node.lattice.charge *= image.sign;
  out.moments = reflected(member.moments, back.reflects, image.sign);
  return out;
}

/// Joins nodes to wider ones, which it adds to a tree.
class Joined {
 public:
  struct Block {
    int node;
    Image image;    ///< of the node, at the places where it is evaluated
    Member member;  ///< where it stands
  };
  explicit Joined(Octree& tree) : tree_(tree) {}

  Block join(Block const& a, Block const& b) {
    Member const both[] = {a.member, b.member};
    Member made = parent_of(both, both + 2);
    made.node.level = made.node.leaf = -1;
    made.node.first_child = made.node.children = 0;
    made.node.first_copy = int(tree_.copies.size());
    made.node.copies = 2;
    for (Block const* block : {&a, &b}) tree_.copies.push_back({block->node, block->image});
    tree_.nodes.push_back(made.node);
    tree_.moments.push_back(made.moments);
    tree_.expansions.push_back(to_expansion(made.moments));
    return {int(tree_.nodes.size()) - 1, Image{}, std::move(made)};
  }

 private:
  Octree& tree_;
};

}  // namespace

void add_images(Octree& tree, Images const& images, Which which) {
  tree.tops.clear();
  if (tree.empty()) return;
  for (Image const& image : images.copies(which)) tree.tops.push_back({0, image});
  if (!images.has_lattice()) return;
  Point const shape = images.shape();
  Member const root{tree.nodes.front(), tree.moments.front()};
  std::vector<Joined::Block> blocks;
  for (auto const& [node, image] : tree.tops) blocks.push_back({node, image, image_of(root, image, shape)});
  Joined joined(tree);
  while (blocks.size() > 1) {
    std::vector<Joined::Block> pairs;
    for (std::size_t n = 0; n < blocks.size(); n += 2)
      pairs.push_back(n + 1 < blocks.size() ? joined.join(blocks[n], blocks[n + 1]) : blocks[n]);
    blocks = std::move(pairs);
  }
  Joined::Block block = blocks.front();
  auto const shifted = [&](int axis, int cells) {
    Joined::Block out = block;
    Image back;
    back.shift[std::size_t(axis)] = -cells;
    out.image = out.image.after(back);
    out.member.node.centre[std::size_t(axis)] += cells * shape[axis];
    return out;
  };
  Cell length{}, left{};
  for (int d = 0; d < 3; ++d) length[d] = images.axis(d).period, left[d] = images.doublings(d);
  for (;;) {
    int next = -1;
    for (int d = 0; d < 3; ++d)
      if (left[d] > 0 && (next < 0 || length[d] * shape[d] < length[next] * shape[next])) next = d;
    if (next < 0) break;
    block = joined.join(block, shifted(next, length[next]));
    length[next] *= 2;
    --left[next];
  }
  tree.tops = {{block.node, block.image}};
  for (int d = 0; d < 3; ++d) {  // as far to either side
    if (length[d] == 0) continue;
    auto const tops = tree.tops;
    for (auto [node, image] : tops) {
      Image forth;
      forth.shift[std::size_t(d)] = length[d];
      tree.tops.push_back({node, image.after(forth)});
    }
  }
}

Closing::Closing(Octree const& tree, Images const& images, Lattice const& lattice, Which which) {
  if (!images.has_lattice() || tree.empty()) return;
  Point const shape = lattice.shape();
  int axes = 0;
  for (int d = 0; d < 3; ++d) {
    if (images.axis(d).period == 0) continue;
    along_[std::size_t(axes++)] = d;
    period_[d] = images.axis(d).period * shape[d];
    reach_[d] = std::ldexp(period_[d], images.doublings(d));
  }
  if (axes == 2) normal_ = 3 - along_[0] - along_[1];
  Member const root{tree.nodes.front(), tree.moments.front()};
  for (Image const& image : images.copies(which)) {
    Member const member = image_of(root, image, shape);
    auto const& m = member.moments;
    Copy copy{member.node.centre, plain_moments(m).dipole, m[0].re, {}};
    double const m20 = m[harmonic_index(2, 0)].re;
    auto const &m21 = m[harmonic_index(2, 1)], &m22 = m[harmonic_index(2, 2)];
    // Without trace: 3 z^2 - r^2 sums to 4 M20, x z + i y z to 2 M21, x^2 - y^2 to 8 Re M22, x y to 4 Im M22.
    copy.second = {{{4 * m22.re - 2 * m20 / 3, 4 * m22.im, 2 * m21.re},
                    {4 * m22.im, -4 * m22.re - 2 * m20 / 3, 2 * m21.im},
                    {2 * m21.re, 2 * m21.im, 4 * m20 / 3}}};
    for (std::size_t d = 0; d < 3; ++d) copy.second[d][d] -= copy.charge * period_[d] * period_[d] / 12;
    copies_.push_back(copy);
  }
}

double Closing::at(Point const& place) const {
  double out = 0;
  for (Copy const& copy : copies_) {
    Point from_centre;
    for (int d = 0; d < 3; ++d) from_centre[d] = place[d] - copy.centre[d];
    out += normal_ < 0 ? around_axis(copy, from_centre) : beside_plane(copy, from_centre);
  }
  return out;
}

/// Of what continues a copy along one axis: -[F(a) + F(b) - 2 ln(period)] / period, with the distances a and b to both
/// ends, and F(a) = ln(a + sqrt(a^2 + rho^2)).
double Closing::around_axis(Copy const& copy, Point const& x) const {
  int const w = along_[0], u = w == 0 ? 1 : 0, v = w == 2 ? 1 : 2;
  double const rho2 = x[u] * x[u] + x[v] * x[v];
  double sum = -2 * copy.charge * std::log(period_[w]);
  for (int side : {-1, 1}) {
    double const end = 0.5 * period_[w], a = side < 0 ? x[w] + end + reach_[w] : reach_[w] - end - x[w];
    double const r = std::sqrt(a * a + rho2), near = 1 / (r * (a + r));
    double const bend = -(2 * r + a) * near * near / r;  // slope of `near` along u, over u
    double const da = side < 0 ? 1 : -1;                 // slope of a
    auto const& m = copy.second;
    double const slope = copy.dipole[w] * da / r + (copy.dipole[u] * x[u] + copy.dipole[v] * x[v]) * near;
    double const second = -m[w][w] * a / (r * r * r) - 2 * da * (m[w][u] * x[u] + m[w][v] * x[v]) / (r * r * r) +
                          (m[u][u] + m[v][v]) * near +
                          bend * (m[u][u] * x[u] * x[u] + 2 * m[u][v] * x[u] * x[v] + m[v][v] * x[v] * x[v]);
    sum += copy.charge * std::log(a + r) - slope + 0.5 * second;
  }
  return -sum / period_[w];
}

/// Of what continues a copy in a plane: [-2 pi |z| - sum of F over the four corners] / area, with the distances u and v
/// to both ends of each axis and F the integral of 1 / r over the rectangle, u asinh(v / sqrt(u^2 + z^2)) + v asinh(u /
/// sqrt(v^2 + z^2)) - z atan(u v / (z r)). The first term takes charge and dipole as they are: charge lies on one side
/// of every place that counts.
double Closing::beside_plane(Copy const& copy, Point const& x) const {
  int const p = along_[0], q = along_[1], n = normal_;
  double const z = std::abs(x[n]), up = x[n] < 0 ? -1 : 1;
  auto const& m = copy.second;
  double sum = 2 * pi * (copy.charge * z - copy.dipole[n] * up);
  for (int side_p : {-1, 1})
    for (int side_q : {-1, 1}) {
      auto const to_end = [&](int axis, int side) {
        double const end = 0.5 * period_[axis];
        return side < 0 ? x[axis] + end + reach_[axis] : reach_[axis] - end - x[axis];
      };
      double const u = to_end(p, side_p), v = to_end(q, side_q), du = -side_p, dv = -side_q;
      double const r = std::sqrt(u * u + v * v + z * z), angle = std::atan2(u * v, z * r);
      double const u2 = u * u + z * z, v2 = v * v + z * z;
      double const along_u = std::asinh(v / std::sqrt(u2)), along_v = std::asinh(u / std::sqrt(v2));
      double const value = u * along_u + v * along_v - z * angle;
      double const slope = copy.dipole[p] * du * along_u + copy.dipole[q] * dv * along_v - copy.dipole[n] * up * angle;
      double const uu = -u * v / (r * u2), vv = -u * v / (r * v2);
      double const second = m[p][p] * uu + m[q][q] * vv - m[n][n] * (uu + vv) + 2 * m[p][q] * du * dv / r -
                            2 * up * z * (m[p][n] * du * v / u2 + m[q][n] * dv * u / v2) / r;
      sum += copy.charge * value - slope + 0.5 * second;
    }
  return -sum / (period_[p] * period_[q]);
}

}  // namespace amrpic::freespace
