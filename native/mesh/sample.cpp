#include "mesh/sample.hpp"

#include <cmath>
#include <limits>

namespace amrpic {

namespace {

/// Cell of a level at a point, before wrapping.
Index3 cell_at(Domain const& domain, Level const& level, Real3 const& point) {
  Index3 cell;
  for (int d = 0; d < 3; ++d) {
    Real const at = std::floor((point[d] - domain.lower[d]) / level.spacing()[d]);
    cell[d] = int(std::min(std::max(at, Real(-1)), Real(level.domain().extent(d))));
    if (point[d] == domain.upper[d]) --cell[d];
  }
  return cell;
}

/// Bring a point into the domain along periodic axes; false if it lies outside along another one.
bool enter(Domain const& domain, Real3& point) {
  for (int d = 0; d < 3; ++d) {
    if (!std::isfinite(point[d])) return false;
    if (domain.periodic(d))
      point[d] = wrapped(point[d], domain.lower[d], domain.upper[d]);
    else if (!(point[d] >= domain.lower[d] && point[d] <= domain.upper[d]))
      return false;
  }
  return true;
}

/// This rank's part of the trilinear value at a point, from level `l`, on which the cell `home` holds the point. A
/// neighbour that the level lacks takes its value from the next coarser one: the nearest cell's would be of first
/// order.
Real local_part(Field const& field, int l, Index3 const& home, Real3 const& point) {
  Level const& level = field.hierarchy().level(l);
  Domain const& domain = field.hierarchy().domain();
  Index3 step;  // towards the neighbour on the point's side of the centre
  Real3 far;    // that neighbour's weight
  for (int d = 0; d < 3; ++d) {
    Real const s = (point[d] - domain.lower[d]) / level.spacing()[d] - (home[d] + 0.5);
    step[d] = s < 0 ? -1 : 1;
    far[d] = std::abs(s);
  }
  Real sum = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Index3 cell = home;
    Real weight = 1;
    for (int d = 0; d < 3; ++d) {
      bool const other = (corner >> d) & 1;
      if (other) cell[d] += step[d];
      weight *= other ? far[d] : 1 - far[d];
    }
    Index3 const found = level.wrapped(level.fold_at_walls(cell));
    int const b = level.find(found);
    if (b < 0) {
      Real3 centre;
      for (int d = 0; d < 3; ++d) centre[d] = domain.lower[d] + (cell[d] + 0.5) * level.spacing()[d];
      sum += weight * local_part(field, l - 1, cell_at(domain, field.hierarchy().level(l - 1), centre), centre);
    } else if (level.owner(b) == level.rank()) {
      sum += weight * field.level(l)[level.local_offset(b) + level.box(b).offset(found)];
    }
  }
  return sum;
}

}  // namespace

std::vector<Real> sample(Field const& field, std::vector<Real3> const& points) {
  Hierarchy const& hierarchy = field.hierarchy();
  std::vector<Real> values(points.size(), std::numeric_limits<Real>::quiet_NaN());
  for (std::size_t p = 0; p < points.size(); ++p) {
    Real3 point = points[p];
    if (!enter(hierarchy.domain(), point)) continue;
    for (int l = hierarchy.level_count() - 1; l >= 0; --l) {
      Level const& level = hierarchy.level(l);
      Index3 const home = cell_at(hierarchy.domain(), level, point);
      if (level.find(level.wrapped(level.fold_at_walls(home))) < 0) continue;
      values[p] = local_part(field, l, home, point);
      break;
    }
  }
  hierarchy.comm().sum_each(values);
  return values;
}

}  // namespace amrpic
