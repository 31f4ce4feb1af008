#include "freespace/images.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace amrpic::freespace {

namespace {

constexpr double pi = 3.14159265358979323846;

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

constexpr double faded = 18;  // by exp(-18)

/// How many copies of a period are seen from inside between sides whose walls let the potential of charge fade along
/// the axis; the lengths of periods.
int periods_seen(std::array<AxisImages, 3> const& axes, Point const& shape, int axis) {
  double square = 0;  // of the rate, of the mode that fades least
  for (int d = 0; d < 3; ++d)
    if (d != axis && axes[d].alternates()) square += std::pow(2 * pi / (axes[d].period * shape[d]), 2);
  return int(std::ceil(faded / (std::sqrt(square) * axes[axis].period * shape[axis])));
}

}  // namespace

bool AxisImages::alternates() const {
  return std::any_of(copies.begin(), copies.end(), [](Copy const& copy) { return copy.sign < 0; });
}

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
    : shape_(lattice.shape()), across_(across) {
  for (std::size_t d = 0; d < 3; ++d) {
    axes_[d] = images_of(walls[d][0], walls[d][1]);
    if (periodic[d]) axes_[d].period = lattice.cells[d];
    widest_ = std::max({widest_, lattice.cells[d] * shape_[d], axes_[d].period * shape_[d]});
  }
  if (across >= 0 && lattices() == 3) list_copies(std::size_t(across));
}

void Images::list_copies(std::size_t axis) {
  AxisImages& along = axes_[axis];
  int const seen = periods_seen(axes_, shape_, int(axis));
  std::vector<AxisImages::Copy> const within = std::move(along.copies);
  along.copies.clear();
  for (int n = 0; n <= 2 * seen; ++n)  // the charge itself first
    for (auto copy : within) {
      copy.shift += (n % 2 == 0 ? n / 2 : -(n + 1) / 2) * along.period;
      along.copies.push_back(copy);
    }
  along.period = 0;
}

bool Images::are_none() const {
  return std::all_of(axes_.begin(), axes_.end(),
                     [](AxisImages const& a) { return a.copies.size() == 1 && a.period == 0; });
}

std::vector<AxisImages::Copy> Images::copies_along(int d, Which which) const {
  auto out = axes_[std::size_t(d)].copies;
  auto const is_other = [&](AxisImages::Copy const& copy) { return copy.reflects != (which == Which::against); };
  if (which != Which::all && d == across_) out.erase(std::remove_if(out.begin(), out.end(), is_other), out.end());
  return out;
}

std::vector<std::vector<Image>> Images::copies(Which which) const {
  std::vector<std::vector<Image>> out;
  std::array<std::vector<AxisImages::Copy>, 3> const along{copies_along(0, which), copies_along(1, which),
                                                           copies_along(2, which)};
  std::array<std::size_t, 3> n{};
  auto const for_each = [&](bool of_lattices, auto&& f) {
    auto const count = [&](std::size_t d) { return (axes_[d].period > 0) == of_lattices ? along[d].size() : 1; };
    auto const all = [&](std::size_t d, auto const& next) {
      for (std::size_t i = 0; i < count(d); ++i) {
        if ((axes_[d].period > 0) == of_lattices) n[d] = i;
        next();
      }
    };
    all(2, [&] { all(1, [&] { all(0, f); }); });
  };
  for_each(false, [&] {
    std::vector<Image> together;
    for_each(true, [&] {
      Image image;
      for (std::size_t d = 0; d < 3; ++d) {
        auto const& copy = along[d][n[d]];
        image.reflects[d] = copy.reflects;
        image.shift[d] = copy.shift;
        image.sign *= copy.sign;
      }
      together.push_back(image);
    });
    if (!together.empty()) out.push_back(std::move(together));
  });
  return out;
}

double Images::copies_within(double distance) const {
  double out = 1;
  for (int d = 0; d < 3; ++d) {
    AxisImages const& axis = axes_[std::size_t(d)];
    if (axis.period > 0) out *= double(axis.copies.size()) * (1 + 2 * distance / (axis.period * shape_[d]));
  }
  return out;
}

double Images::longest_period() const {
  double out = 0;
  for (int d = 0; d < 3; ++d) out = std::max(out, axes_[std::size_t(d)].period * shape_[d]);
  return out;
}

int Images::doublings(int d, int fewest) const {
  double const period = axes_[std::size_t(d)].period * shape_[d];
  if (period == 0) return 0;
  return fewest + std::max(0, int(std::ceil(std::log2(widest_ / period))));
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

double Images::least_eigenvalue(int axis) const {
  double out = 0;
  for (int d = 0; d < 3; ++d) {
    AxisImages const& across = axes_[std::size_t(d)];
    if (d != axis && d != across_ && across.period > 0 && across.alternates())
      out += std::pow(2 * std::sin(pi / across.period) / shape_[d], 2);
  }
  return out;
}

bool Images::are_narrow() const {
  double const longest = longest_spacing(shape_);
  return least_eigenvalue(-1) * longest * longest > 4;
}

/// A mode of eigenvalue lambda falls by exp(-k) per cell along the axis, where the operator's symbol at i k is -lambda
/// h^2: s = 2 cosh k - 2 is lambda h^2 in second order, and s - s^2 / 12 is it in fourth. Finer cells make all modes
/// fall faster.
std::optional<int> Images::cells_seen(int axis, int operator_order) const {
  double const lambda = least_eigenvalue(axis);
  if (lambda == 0) return {};
  std::complex<double> s = lambda * shape_[axis] * shape_[axis];
  if (operator_order == 4) s = 6.0 - std::sqrt(36.0 - 12.0 * s);
  return 1 + int(std::ceil(faded / std::acosh(1.0 + 0.5 * s).real()));
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

/// The widest extent of a node across all lattices.
double width_across(TreeNode const& node, Images const& images) {
  double out = 0;
  for (int d = 0; d < 3; ++d)
    if (images.axis(d).period == 0) out = std::max(out, 2 * node.half[d]);
  return out;
}

/// The nodes that are not far longer than the periods, or not known in parts.
std::vector<int> parts_of(Octree const& tree, Images const& images) {
  std::vector<int> out, stack{0};
  while (!stack.empty()) {
    int const n = stack.back();
    stack.pop_back();
    TreeNode const& node = tree.nodes[std::size_t(n)];
    if (node.is_shared && width_across(node, images) > 2 * images.longest_period())
      for (int c = node.children; c-- > 0;) stack.push_back(node.first_child + c);
    else
      out.push_back(n);
  }
  return out;
}

/// Add the lattice of the copies of a node.
void add_lattice(Octree& tree, int number, std::vector<Image> const& copies, Images const& images, int doublings) {
  Point const shape = images.shape();
  Member const given{tree.nodes[std::size_t(number)], tree.moments[std::size_t(number)]};
  std::vector<Joined::Block> blocks;
  for (Image const& image : copies) blocks.push_back({number, image, image_of(given, image, shape)});
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
  for (int d = 0; d < 3; ++d) {
    length[d] = images.axis(d).period;
    left[d] = images.doublings(d, doublings);
  }
  for (;;) {
    int next = -1;
    for (int d = 0; d < 3; ++d)
      if (left[d] > 0 && (next < 0 || length[d] * shape[d] < length[next] * shape[next])) next = d;
    if (next < 0) break;
    block = joined.join(block, shifted(next, length[next]));
    length[next] *= 2;
    --left[next];
  }
  std::vector<Octree::Copy> tops{{block.node, block.image}};
  for (int d = 0; d < 3; ++d) {  // as far to either side
    if (length[d] == 0) continue;
    Image forth;
    forth.shift[std::size_t(d)] = length[d];
    for (std::size_t n = 0, count = tops.size(); n < count; ++n)
      tops.push_back({tops[n].node, tops[n].image.after(forth)});
  }
  tree.tops.insert(tree.tops.end(), tops.begin(), tops.end());
}

}  // namespace

void add_images(Octree& tree, Images const& images, Which which, Options const& options) {
  tree.tops.clear();
  if (tree.empty()) return;
  auto const copies = images.copies(which);
  if (images.lattices() > 0) tree.repeated = parts_of(tree, images);
  for (auto const& together : copies)
    if (images.lattices() == 0)
      tree.tops.push_back({0, together.front()});
    else
      for (int node : tree.repeated) add_lattice(tree, node, together, images, options.doublings);
}

Closing::Closing(Octree const& tree, Images const& images, Which which, Options const& options) {
  Point const shape = images.shape();
  if (options.operator_order == 2) h2_ = {shape[0] * shape[0], shape[1] * shape[1], shape[2] * shape[2]};
  int axes = 0;
  for (int d = 0; d < 3; ++d) {
    if (images.axis(d).period == 0) continue;
    along_[std::size_t(axes++)] = d;
    period_[d] = images.axis(d).period * shape[d];
    reach_[d] = std::ldexp(period_[d], images.doublings(d, options.doublings));
  }
  if (axes == 2) normal_ = 3 - along_[0] - along_[1];
  for (int n : tree.repeated)
    for (auto const& together : images.copies(which))
      for (Image const& image : together)
        add(image_of({tree.nodes[std::size_t(n)], tree.moments[std::size_t(n)]}, image, shape));
}

void Closing::add(Member const& member) {
  auto const& m = member.moments;
  Copy copy{member.node.centre, plain_moments(m).dipole, m[0].re, member.node.lattice.charge, {}};
  double const m20 = m[harmonic_index(2, 0)].re;
  auto const &m21 = m[harmonic_index(2, 1)], &m22 = m[harmonic_index(2, 2)];
  // Without trace: 3 z^2 - r^2 sums to 4 M20, x z + i y z to 2 M21, x^2 - y^2 to 8 Re M22, x y to 4 Im M22.
  copy.second = {{{4 * m22.re - 2 * m20 / 3, 4 * m22.im, 2 * m21.re},
                  {4 * m22.im, -4 * m22.re - 2 * m20 / 3, 2 * m21.im},
                  {2 * m21.re, 2 * m21.im, 4 * m20 / 3}}};
  for (int d = 0; d < 3; ++d) copy.second[std::size_t(d)][std::size_t(d)] -= copy.charge * period_[d] * period_[d] / 12;
  copies_.push_back(copy);
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
    sum -=
        copy.of_lattice * (h2_[std::size_t(u)] + h2_[std::size_t(v)]) / (16 * r * r);  // of the lattice, where a >> rho
  }
  return -sum / period_[w];
}

/// Of the fourth derivatives along all axes, each times h^2, of the integral of r over a rectangle of sides u and v
/// seen from a height z above a corner: -1/24 of it is what the lattice adds to the potential of uniform charge there.
double of_lattice(double u, double v, double z, Point const& h2) {
  double const r = std::sqrt(u * u + v * v + z * z), wu = u * u + z * z, wv = v * v + z * z;
  auto const along = [&](double a, double w) { return u * v / (r * w) * (-3 + a * a / (r * r) + 2 * a * a / w); };
  auto const up = [&](double w) { return u * v / (r * w) * (1 - z * z / (r * r) - 2 * z * z / w); };
  // Of the Laplacian of r, 2 / r, along z, less what the others are along it.
  double const across = 2 * u * v / r * (1 / wu + 1 / wv) + up(wu) + up(wv);
  return h2[0] * along(u, wu) + h2[1] * along(v, wv) + h2[2] * across;
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
      sum -= copy.of_lattice / 24 * of_lattice(u, v, z, {h2_[p], h2_[q], h2_[n]});
    }
  return -sum / (period_[p] * period_[q]);
}

}  // namespace amrpic::freespace
