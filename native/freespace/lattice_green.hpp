// Lattice Green's functions of the Laplacians: the potential that a discrete operator itself gives a unit charge in one
// cell of an infinite lattice.
//
// With -sum_d A_d / h_d^2 G = delta, and e_n(t) the heat kernel of one axis, that of exp(t A_d),
//   G(i, j, k) = integral_0^infinity e_i(t / h_x^2) e_j(t / h_y^2) e_k(t / h_z^2) dt.
// In second order A_d is the second difference, and e_n(t) = exp(-2t) I_n(2t).
// Here G is divided by the cell volume, so that q G is the potential of a charge q; far away it is q / (4 pi r).
#pragma once

#include <array>
#include <vector>

#include "freespace/lane_sums.hpp"

namespace amrpic::freespace {

struct TimeNode {
  double time, weight;
};

/// For integrals over all times of products of three heat kernels: intervals that double in length from `shortest`
/// squared over four, and after `late` a tail that is smooth in 1 / sqrt(t). Ascending but for the tail.
std::vector<TimeNode> time_nodes(double shortest, double late);

/// exp(-x) I_n(x) for n = 0 .. last; x > 0.
std::vector<double> scaled_bessel(double x, int last);

/// The heat kernel of the operator of fourth order along one axis, for n = 0 .. last; t > 0.
std::vector<double> fourth_order_heat(double t, int last);

/// The heat kernel of the operator of that order along one axis, for n = 0 .. last.
std::vector<double> line_heat(double t, int last, int operator_order);

/// The same on a ring of cells, for n = 0 .. cells - 1; without its mean, 1 / cells, where that cancels between images.
std::vector<double> ring_heat(double t, int cells, int operator_order, bool has_mean);

/// G / volume at every `stride`-th point, 0 <= i, j, k <= reach, i fastest, of the operator of that order, 2 or 4.
/// Accurate to rounding; lengths of about one are expected.
std::vector<double> lattice_green_octant(std::array<double, 3> const& spacing, std::array<int, 3> const& reach,
                                         std::array<int, 3> const& stride = {1, 1, 1}, int operator_order = 2);

/// Charges as input of the first lattice correction: their sum and first moments, each charge times the square of its
/// level's spacing over that of the base.
struct LatticeMoments {
  double charge;
  std::array<double, 3> dipole;
};

/// 4 pi times what the lattice adds, at first order in h^2, to the potential of charges at (x, y, z) from their centre;
/// `inverse_r`: 1 / distance, `h2`: squared base spacings.
///
/// From 1 / symbol = 1 / k^2 + sum_d h_d^2 k_d^4 / (12 k^4) + ..., and 1 / k^4 being the transform of -r / (8 pi), a
/// unit charge gives
///   f = -p / (8 r^7), p = sum_d h_d^2 s_d^2 (4 x_d^2 - s_d^2), s_d^2 = r^2 - x_d^2;
/// a dipole D gives -D . grad f.
template <class T>
T lattice_correction(LatticeMoments const& moments, T const& x, T const& y, T const& z, T const& inverse_r,
                     std::array<double, 3> const& h2) {
  T const x2 = x * x, y2 = y * y, z2 = z * z;
  T const ax = h2[0] * (y2 + z2), ay = h2[1] * (x2 + z2), az = h2[2] * (x2 + y2);  // h^2 s^2
  T const bx = 2.0 * h2[0] * x2 - ax, by = 2.0 * h2[1] * y2 - ay, bz = 2.0 * h2[2] * z2 - az;
  T const p = (y2 + z2) * (2.0 * bx + ax) + (x2 + z2) * (2.0 * by + ay) + (x2 + y2) * (2.0 * bz + az);
  T const b = bx + by + bz;  // the slope of p along d is 4 x_d (2 a_d + b - b_d)
  auto const& d = moments.dipole;
  T const slope =
      4.0 * (d[0] * x * (2.0 * ax + b - bx) + d[1] * y * (2.0 * ay + b - by) + d[2] * z * (2.0 * az + b - bz));
  T const along = d[0] * x + d[1] * y + d[2] * z;
  T const u = inverse_r * inverse_r;
  return 0.125 * (u * u * u * inverse_r) * (slope - p * (moments.charge + 7.0 * along * u));
}

/// 4 pi times what the means of potentials over cells of one size add to those over cells of another, of charges at
/// (x, y, z) from their centre. `moments`: each charge times a factor c, which stands for c sum_d h_d^2 d^2/dx_d^2 of
/// its potential; that is zero in cubes.
template <class T>
T means_correction(LatticeMoments const& moments, T const& x, T const& y, T const& z, T const& inverse_r,
                   std::array<double, 3> const& h2) {
  auto const& d = moments.dipole;
  double const sum = h2[0] + h2[1] + h2[2];
  T const u = inverse_r * inverse_r;
  T const along = 3.0 * u * (h2[0] * x * x + h2[1] * y * y + h2[2] * z * z);  // a charge gives (along - sum) / r^3
  T const dipole = d[0] * x + d[1] * y + d[2] * z;
  T const slope = 6.0 * (h2[0] * d[0] * x + h2[1] * d[1] * y + h2[2] * d[2] * z);
  return u * inverse_r * (moments.charge * (along - sum) + u * (dipole * (5.0 * along - 3.0 * sum) - slope));
}

}  // namespace amrpic::freespace
