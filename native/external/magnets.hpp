// Fields of magnets and of uniform and linear fields, in their own axes: z along the axis, the origin in the middle.
//
// Each kind has `is_hard`: whether its field ends at two planes, so that its mean is that of the part between them;
// `field` at a point; if it `has_edges`, `edge_field`: B that stands before δ(height - place) at the plane where it
// begins, and with the opposite sign at that where it ends; `electric` and `magnetic`: whether it has such a field.
#pragma once

#include "external/enge.hpp"
#include "external/flight.hpp"

namespace amrpic::external {

struct Uniform {
  Real3 E, B;  ///< V/m, T
  static constexpr bool has_edges = false;
  static constexpr bool is_hard() { return true; }
  bool electric() const { return E != Real3{}; }
  bool magnetic() const { return B != Real3{}; }
};

template <class V, class T>
Fields<V> field(Uniform const& of, Vector3<V> const&, T const&) {
  return {{V{} + of.E[0], V{} + of.E[1], V{} + of.E[2]}, {V{} + of.B[0], V{} + of.B[1], V{} + of.B[2]}};
}

/// E = -(gx x, gy y, gz z).
struct Focusing {
  Real3 gradient;  ///< V/m²
  static constexpr bool has_edges = false;
  static constexpr bool is_hard() { return true; }
  static constexpr bool electric() { return true; }
  static constexpr bool magnetic() { return false; }
};

template <class V, class T>
Fields<V> field(Focusing const& of, Vector3<V> const& x, T const&) {
  return {{0 - of.gradient[0] * x[0], 0 - of.gradient[1] * x[1], 0 - of.gradient[2] * x[2]}, {}};
}

/// B = ∇ψ, ψ = G x y (f - f'' (x² + y²) / 12) with the profile f: curl B = 0, and div B = -G f'''' x y (x² + y²) / 12.
/// A positive gradient focuses positive particles that move along +z in x. Hard edges: f = 1, without end terms.
struct Quadrupole {
  Real gradient;  ///< T/m
  Real half;      ///< length, m
  Enge fringe;
  static constexpr bool has_edges = false;
  bool is_hard() const { return fringe.hard(); }
  static constexpr bool electric() { return false; }
  static constexpr bool magnetic() { return true; }
};

template <class V, class T>
Fields<V> field(Quadrupole const& of, Vector3<V> const& at, T const&) {
  auto const& [x, y, z] = at;
  Real const G = of.gradient;
  if (of.is_hard()) return {{}, {G * y, G * x, V{}}};
  auto const f = profile<V>(of.fringe, of.half, z);
  V const xx = x * x, yy = y * y, second = f.second / 12;
  return {{},
          {G * y * (f.value - second * (3 * xx + yy)), G * x * (f.value - second * (xx + 3 * yy)),
           G * x * y * (f.first - f.third * (xx + yy) / 12)}};
}

/// B_y + i B_x = Σ (b_n + i a_n) (x + i y)^n / n!. Hard edges, without end terms.
struct Multipole {
  static constexpr std::size_t most = 6;
  std::array<Real, most> normal, skew;  ///< b_n / n!, a_n / n!, T/m^n
  static constexpr bool has_edges = false;
  static constexpr bool is_hard() { return true; }
  static constexpr bool electric() { return false; }
  static constexpr bool magnetic() { return true; }
};

template <class V, class T>
Fields<V> field(Multipole const& of, Vector3<V> const& at, T const&) {
  auto const& [x, y, z] = at;
  V By = V{} + of.normal.back(), Bx = V{} + of.skew.back();
  for (std::size_t n = Multipole::most - 1; n-- > 0;) {
    V const real = By * x - Bx * y;
    Bx = By * y + Bx * x + of.skew[n];
    By = real + of.normal[n];
  }
  return {{}, {Bx, By, V{}}};
}

/// B = ∇ψ, ψ = B0 (y f - y³ Δf / 6): curl B = 0, and div B = -B0 y³ ΔΔf / 6. Positive particles that move along +z turn
/// to -x. Hard edges: f is a step, ∇f its δ, which focuses vertically those that cross the edge at an angle. With
/// turned pole faces, f is the product of two profiles, each along the normal of its face; a positive angle makes the
/// magnet shorter at x > 0. With hard edges there may be a gradient G about an arc through the middles of both faces:
/// at a distance u outside of its radius, B_y = B0 + G (u - y²/(2r)) and B_r = G y, so that div B = 0.
struct Dipole {
  Real B0;    ///< T
  Real half;  ///< length, m
  Enge fringe;
  std::array<Real, 2> sine{}, cosine{1, 1};  ///< of the angles of the faces where z is lowest and highest
  Real gradient = 0, turn = 0;               ///< T/m; of the arc, towards -x, rad
  std::array<Real, 2> lost{};  ///< of hard faces: by how much less they rise with x for what they do across
  static constexpr bool has_edges = true;
  bool is_hard() const { return fringe.hard(); }
  static constexpr bool electric() { return false; }
  static constexpr bool magnetic() { return true; }
};

template <class V>
Fields<V> between_turned_faces(Dipole const& of, Vector3<V> const& at) {
  auto const& [x, y, z] = at;
  auto const &sine = of.sine, &cosine = of.cosine;
  auto const in = fall_off<V>(of.fringe, sine[0] * x - cosine[0] * (z + of.half)),
             out = fall_off<V>(of.fringe, sine[1] * x + cosine[1] * (z - of.half));
  // of the product: Δf, and ∇f and ∇Δf along the two normals (sine, 0, ∓cosine), of which twice the product is `cross`
  Real const cross = 2 * (sine[0] * sine[1] - cosine[0] * cosine[1]);
  V const laplacian = in.second * out.value + cross * in.first * out.first + in.value * out.second, six = y * y / 6;
  V const by_in = in.first * out.value -
                  six * (in.third * out.value + cross * in.second * out.first + in.first * out.second),
          by_out = in.value * out.first -
                   six * (in.second * out.first + cross * in.first * out.second + in.value * out.third);
  V const By = of.B0 * y;
  return {{},
          {By * (sine[0] * by_in + sine[1] * by_out), of.B0 * (in.value * out.value - 3 * six * laplacian),
           By * (cosine[1] * by_out - cosine[0] * by_in)}};
}

/// The gradient of a dipole, about its arc or, where that does not turn, its axis.
template <class V>
Vector3<V> gradient_field(Dipole const& of, Vector3<V> const& at) {
  auto const& [x, y, z] = at;
  Real const G = of.gradient;
  if (of.turn == 0) return {G * y, G * x, V{}};
  Real const radius = of.half / std::sin(of.turn / 2),
             side = radius > 0 ? 1 : -1;  // signed, as the distance r from the centre of the arc
  V const from_centre = x + radius * std::cos(of.turn / 2), r_square = from_centre * from_centre + z * z;
  V const r = square_root(r_square) * side, outside = (r_square - radius * radius) / (r + radius);
  return {G * y * from_centre / r, G * (outside - y * y / (2 * r)), G * y * z / r};
}

template <class V, class T>
Fields<V> field(Dipole const& of, Vector3<V> const& at, T const&) {
  if (of.is_hard()) {
    Vector3<V> B{V{}, V{} + of.B0, V{}};
    if (of.gradient != 0) B = sum(B, gradient_field(of, at));
    return {{}, B};
  }
  V const y = at[1], yy = y * y;
  if (of.sine != std::array<Real, 2>{}) return between_turned_faces(of, at);
  auto const f = profile<V>(of.fringe, of.half, at[2]);
  return {{}, {V{}, of.B0 * (f.value - f.second * yy / 2), of.B0 * y * (f.first - f.third * yy / 6)}};
}

template <class V>
Vector3<V> edge_field(Dipole const& of, Plane const& plane, Vector3<V> const& at) {
  V const along = of.B0 * at[1];
  return {(of.lost[plane.place > 0] - plane.slope) * along, V{}, along};
}

/// Hard edges: B_z = B0 between two planes, B_r = -(r/2) B_z'. With a radius R the thin winding of a coil: on the axis
/// B(z) = B0/2 (a / √(a² + R²) - b / √(b² + R²)) with a = z + half, b = z - half, and off it
/// B_z = B - r² B''/4, B_r = -r B'/2 + r³ B'''/16: div B = 0, and curl B = r³ B''''/16.
struct Solenoid {
  Real B0;      ///< T, in the middle of a long one
  Real half;    ///< length, m
  Real radius;  ///< of the coil, m; 0 for hard edges
  static constexpr bool has_edges = true;
  bool is_hard() const { return radius == 0; }
  static constexpr bool electric() { return false; }
  static constexpr bool magnetic() { return true; }
};

/// z / √(z² + R²) and its derivatives.
template <class V>
Derivatives<V> end_of_coil(Real R, V const& z) {
  V const q = 1 / (z * z + R * R), root = square_root(q), first = R * R * q * root, u = z * q;
  return {z * root, first, 0 - 3 * first * u, 3 * first * (5 * u * u - q)};
}

template <class V, class T>
Fields<V> field(Solenoid const& of, Vector3<V> const& at, T const&) {
  if (of.is_hard()) return {{}, {V{}, V{}, V{} + of.B0}};
  auto const& [x, y, z] = at;
  Real const half_B = of.B0 / 2;
  auto const a = end_of_coil<V>(of.radius, z + of.half), b = end_of_coil<V>(of.radius, z - of.half);
  V const rr = x * x + y * y;
  V const radial = half_B * ((a.third - b.third) * rr / 16 - (a.first - b.first) / 2);  // B_r / r
  return {{}, {radial * x, radial * y, half_B * (a.value - b.value - (a.second - b.second) * rr / 4)}};
}

template <class V>
Vector3<V> edge_field(Solenoid const& of, Plane const&, Vector3<V> const& at) {
  Real const half_B = of.B0 / 2;
  return {0 - half_B * at[0], 0 - half_B * at[1], V{}};
}

}  // namespace amrpic::external
