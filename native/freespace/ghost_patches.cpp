#include "freespace/ghost_patches.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <tuple>

namespace amrpic::freespace {

namespace {

/// Add U values V^T.
template <class Weights>
void add_interpolant(Weights const& u, Weights const& v, double const* values, double* to) {
  Lanes columns[patch_points];  // of U^T
  for (int n = 0; n < patch_points; ++n) {
    double column[patch_points];
    for (int i = 0; i < patch_points; ++i) column[i] = u[i][n];
    columns[n] = load<Lanes>(column);
  }
  Lanes rows[patch_points];
  for (int m = 0; m < patch_points; ++m) {
    rows[m] = Lanes{};
    for (int n = 0; n < patch_points; ++n) rows[m] += columns[n] * values[n + patch_points * m];
  }
  for (int j = 0; j < patch_points; ++j) {
    auto sum = load<Lanes>(to + patch_points * j);
    for (int m = 0; m < patch_points; ++m) sum += rows[m] * v[j][m];
    store(to + patch_points * j, sum);
  }
}

bool same_wall(GhostPatch const& a, GhostPatch const& b) {
  return a.face == b.face && a.layer == b.layer && a.level == b.level;
}

bool same_place(GhostPatch const& a, GhostPatch const& b) { return same_wall(a, b) && a.first == b.first; }

/// The patch twice as wide along the axes where it is short, so that patches of long cells become about square.
GhostPatch parent_of(GhostPatch const& child, Point const& shape) {
  auto const axes = plane_axes(child.face / 2);
  GhostPatch out = child;
  double const width[2] = {child.extent[0] * shape[axes[0]], child.extent[1] * shape[axes[1]]};
  for (int t = 0; t < 2; ++t) {
    if (width[t] > 1.5 * std::min(width[0], width[1])) continue;
    out.extent[t] *= 2;
    out.first[t] -= out.first[t] % out.extent[t];
  }
  return out;
}

/// Add the parents of the patches from `start` on, except for those that are alone on their wall.
void add_parents(std::vector<GhostPatch>& patches, std::size_t start, Point const& shape) {
  struct Link {
    GhostPatch parent;
    std::size_t child;
  };
  std::vector<Link> links;
  std::size_t const end = patches.size();
  for (std::size_t n = start; n < end; ++n) {
    bool const has_before = n > start && same_wall(patches[n - 1], patches[n]);
    bool const has_after = n + 1 < end && same_wall(patches[n + 1], patches[n]);
    if (has_before || has_after) links.push_back({parent_of(patches[n], shape), n});
  }
  std::stable_sort(links.begin(), links.end(), [](Link const& a, Link const& b) {
    auto const key = [](GhostPatch const& p) { return std::tie(p.face, p.layer, p.level, p.first[1], p.first[0]); };
    return key(a.parent) < key(b.parent);
  });
  for (auto const& [parent, child] : links) {
    if (patches.size() == end || !same_place(patches.back(), parent)) patches.push_back(parent);
    patches[child].parent = int(patches.size()) - 1;
  }
}

}  // namespace

bool GhostBlock::operator==(GhostBlock const& o) const {
  return face == o.face && layer == o.layer && level == o.level && place == o.place;
}

bool GhostBlock::operator<(GhostBlock const& o) const {
  return std::tie(face, layer, level, place[1], place[0]) < std::tie(o.face, o.layer, o.level, o.place[1], o.place[0]);
}

std::vector<GhostPatch> patches_around(Lattice const& lattice, std::vector<GhostBlock> const& blocks) {
  std::vector<GhostPatch> out;
  for (GhostBlock const& b : blocks)
    out.push_back({b.face,
                   b.layer,
                   b.level,
                   {b.place[0] * patch_points, b.place[1] * patch_points},
                   {patch_points, patch_points},
                   -1});
  for (std::size_t start = 0; start < out.size();) {
    std::size_t const end = out.size();
    add_parents(out, start, lattice.shape());
    start = end;
  }
  return out;
}

PatchBox::PatchBox(Cell const& cells, Point const& shape, GhostPatch const& patch) {
  int const normal = patch.face / 2;
  auto const axes = plane_axes(normal);
  double const ghost = std::ldexp((0.5 + patch.layer) * shape[normal], -patch.level);
  centre[normal] = patch.face % 2 == 0 ? -ghost : cells[normal] * shape[normal] + ghost;
  half[normal] = 0;
  for (int t = 0; t < 2; ++t) {
    double const spacing = std::ldexp(shape[axes[t]], -patch.level);
    centre[axes[t]] = (patch.first[t] + 0.5 * patch.extent[t]) * spacing;
    half[axes[t]] = 0.5 * (patch.extent[t] - 1) * spacing;
    if (patch.extent[t] > patch_points) width = std::max(width, half[axes[t]]);
  }
  radius = std::hypot(half[axes[0]], half[axes[1]]);
}

PatchBox PatchBox::seen_by(Image const& image, Point const& shape) const {
  PatchBox out = *this;
  for (int d = 0; d < 3; ++d) out.centre[d] = image.place(d, centre[d], shape[d]);
  return out;
}

PatchPoints::PatchPoints(Lattice const& lattice, GhostPatch const& patch, Image const& image)
    : normal(patch.face / 2), box(PatchBox(lattice.cells, lattice.shape(), patch).seen_by(image, lattice.shape())) {
  Point const shape = lattice.shape();
  auto const axes = plane_axes(normal);
  place = box.centre[normal];
  for (int t = 0; t < 2; ++t) {
    double const spacing = std::ldexp(shape[axes[t]], -patch.level);
    auto const cells = chebyshev_points(patch.extent[t]);
    for (int i = 0; i < patch_points; ++i)
      along[t][i] = image.place(axes[t], (patch.first[t] + cells[i] + 0.5) * spacing, shape[axes[t]]);
  }
}

void PatchInterpolation::add(GhostPatch const& parent, double const* values, GhostPatch const& child, double* to) {
  auto const along = [&](int t) -> Weights const& {
    return weights(parent.extent[t], child.extent[t], child.first[t] - parent.first[t]);
  };
  add_interpolant(along(0), along(1), values, to);
}

/// Lagrange's weights along an axis, for a child whose first ghost is `offset` behind that of its parent.
PatchInterpolation::Weights const& PatchInterpolation::weights(int parent_extent, int extent, int offset) {
  auto const [entry, is_new] = made_.try_emplace({parent_extent, extent, offset});
  if (is_new) {
    auto const nodes = chebyshev_points(parent_extent), points = chebyshev_points(extent);
    for (int i = 0; i < patch_points; ++i) entry->second[i] = lagrange_weights(nodes, offset + points[i]);
  }
  return entry->second;
}

}  // namespace amrpic::freespace
