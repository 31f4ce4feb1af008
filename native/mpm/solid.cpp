#include "mpm/solid.hpp"

#include <algorithm>
#include <functional>
#include <limits>
#include <type_traits>
#include <variant>

#include "mpm/point_kernels.hpp"

namespace amrpic::mpm {

namespace {

using material::Tensor;

Tensor tensor_at(Real const* entries) {
  Tensor out;
  material::for_each_entry([&](std::size_t i, std::size_t j) { out[i][j] = entries[3 * i + j]; });
  return out;
}

/// call(law, damage) where the law asks for the damage, else call(law).
template <class Call>
auto ask(Law const& law, Real damage, Call&& call) {
  return std::visit(
      [&](auto const& own) {
        if constexpr (std::is_same_v<std::decay_t<decltype(own)>, material::DamagedNeoHookean>)
          return call(own, damage);
        else
          return call(own);
      },
      law);
}
Real energy_of(Law const& law, Tensor const& f, Real damage) {
  return ask(law, damage, [&](auto const& own, auto... d) { return own.energy(f, d...); });
}
Tensor stress_of(Law const& law, Tensor const& f, Real damage) {
  return ask(law, damage, [&](auto const& own, auto... d) { return own.stress(f, d...); });
}
/// c : e
Tensor moduli_times(Law const& law, Tensor const& f, Real damage, Tensor const& e) {
  return ask(law, damage, [&](auto const& own, auto... d) { return own.moduli(f, d...)(e); });
}

/// What becomes of slopes of a displacement in space: f(place, slopes), point after point. If it `tests`, it leaves the
/// slopes' conjugates in their place: what the gradients of nodes' functions are multiplied with.
template <bool tests>
struct PointByPoint {
  fem::Points const& points;
  Real3 scale;
  std::function<void(Place const&, Tensor&)> const& f;

  void operator()(std::int64_t block, AtPoint<3>& at) const {
    Matrix<> out{};
    for_each_place(points, block, [&](Place const& place) {
      Tensor own;
      for_each_entry(
          [&](std::size_t i, std::size_t j) { own[i][j] = at.slope[i][j][std::size_t(place.lane)] * scale[j]; });
      f(place, own);
      for_each_entry([&](std::size_t i, std::size_t j) { out[i][j][std::size_t(place.lane)] = own[i][j] * scale[j]; });
    });
    if constexpr (tests)
      for (std::size_t i = 0; i < 3; ++i) at.slope[i] = out[i];
  }
};

/// Call f(place, slopes) for this rank's points under a displacement, and return the sums over points of what it leaves
/// there times the gradients of nodes' functions, if it `tests`. Collective.
template <bool tests, class F>
std::vector<Real> sum_point_by_point(fem::Points const& points, Real const* u, F&& f) {
  std::function<void(Place const&, Tensor&)> const call = std::ref(f);
  std::vector<Real> out(tests ? std::size_t(points.lattice().own_nodes()) * 3 : 0);
  PointByPoint<tests> const d{points, fem::slope_scale(points.lattice()), call};
  fem::with_degree(points.lattice().degree(), [&](auto nodes) {
    fem::AtPoints<nodes(), 3, fem::AnyOfSlopes<3, tests>> const kernel{points, {fem::PointFunction<3>::of(d)}};
    fem::sum_over_elements<nodes(), 3>(points, u, tests ? out.data() : nullptr, kernel);
  });
  return out;
}

/// One point under a displacement.
struct Moved {
  Tensor before, relative, whole;  ///< F~, 1 + grad u, F
  Real volume;                     ///< initial
  Law const& law;
  Real damage;
};

Moved moved(Solid const& solid, Place const& at, Tensor const& slopes) {
  Tensor const before = tensor_at(solid.deformation + 9 * at.point);
  Tensor const relative = material::sum(material::unit_tensor(), 1, slopes);
  Real const weight = solid.points->weights()[at.block * native_lane_count + at.lane];
  return {before,
          relative,
          material::product(relative, before),
          weight / material::determinant(before),
          solid.laws[std::size_t(solid.law[at.point])],
          solid.damage[at.point]};
}

Real det(Tensor const& f) { return material::determinant(f); }

// ---- the state of tangents ----

/// S (1 + grad u)^-1, row after row.
void write_inverse(Moved const& at, Real3 const& scale, Real* out) {
  Tensor const inverse = material::inverse(at.relative);
  material::for_each_entry([&](std::size_t i, std::size_t j) { out[3 * i + j] = scale[i] * inverse[i][j]; });
}

void write_symmetric(Tensor const& a, Real* out) {
  material::for_each_entry([&](std::size_t i, std::size_t j) { out[symmetric[i][j]] = a[i][j]; });
}

/// Moduli of a law that has few.
material::IsotropicModuli isotropic(Law const& law, Tensor const& f, Real damage) {
  if (auto const* damaged = std::get_if<material::DamagedNeoHookean>(&law)) return damaged->moduli(f, damage);
  return std::get<material::NeoHookean>(law).moduli(f);
}

template <bool damage>
void write_state(CurrentIsotropic<damage> const*, Moved const& at, Real3 const& scale, Real* out) {
  write_inverse(at, scale, out);
  write_symmetric(material::scaled(at.volume, stress_of(at.law, at.whole, at.damage)), out + 9);
  auto const moduli = isotropic(at.law, at.whole, at.damage);
  out[15] = at.volume * moduli.a, out[16] = at.volume * moduli.b / 2;
  // d dev = (d/g) (g dev), and g dev is the deviator of the stress.
  if (damage) out[17] = std::holds_alternative<material::DamagedNeoHookean>(at.law) ? Real(2) / Real(3) : Real(0);
}

void write_state(CurrentGeneral const*, Moved const& at, Real3 const& scale, Real* out) {
  write_inverse(at, scale, out);
  write_symmetric(material::scaled(at.volume, stress_of(at.law, at.whole, at.damage)), out + 9);
  Real* modulus = out + 15;
  constexpr std::size_t of[6][2] = {{0, 0}, {1, 1}, {2, 2}, {1, 2}, {2, 0}, {0, 1}};
  for (std::size_t i = 0; i < 6; ++i) {
    Tensor strain{};
    strain[of[i][0]][of[i][1]] += Real(0.5), strain[of[i][1]][of[i][0]] += Real(0.5);
    Tensor const stress = moduli_times(at.law, at.whole, at.damage, strain);
    for (std::size_t j = i; j < 6; ++j) *modulus++ = at.volume * stress[of[j][0]][of[j][1]];
  }
}

void write_state(InitialNeoHookean const*, Moved const& at, Real3 const& scale, Real* out) {
  auto const& law = std::get<material::NeoHookean>(at.law);
  write_inverse(at, scale, out);
  Tensor b = material::product(at.before, material::transposed(at.before));
  material::for_each_entry([&](std::size_t i, std::size_t j) { b[i][j] *= at.volume * law.mu * scale[i] * scale[j]; });
  write_symmetric(b, out + 9);
  out[15] = at.volume * law.moduli(at.whole).b / 2, out[16] = at.volume * law.lambda;
}

/// Add a part of c (h - h'), the stiffness against rotation by which h . stress is positive for all h. It is that of
/// 2 c h - c (h + h').
template <class D>
void stiffen(D const*, Real part, Real* state) {
  constexpr bool general = std::is_same_v<D, CurrentGeneral>;
  Real* const stress = state + 9;
  Tensor whole;
  material::for_each_entry([&](std::size_t i, std::size_t j) { whole[i][j] = stress[symmetric[i][j]]; });
  Real const c = part * std::max(Real(0), -material::smallest_eigenvalue(whole)) / 2;
  for (int d = 0; d < 3; ++d) stress[d] += 2 * c;
  if constexpr (general)
    for (int i = 0, n = 15; i < 6; n += 6 - i, ++i) state[n] -= i < 3 ? 2 * c : c;
  else
    state[16] -= c;
}

template <class D>
std::unique_ptr<fem::Operator> tangent_as(Solid const& solid, Real const* u, Real stiffening) {
  Real3 const scale = fem::slope_scale(solid.points->lattice());
  Blocks state(*solid.points, D::width);
  sum_point_by_point<false>(*solid.points, u, [&](Place const& at, Tensor const& slopes) {
    Real own[D::width];
    write_state(static_cast<D const*>(nullptr), moved(solid, at, slopes), scale, own);
    if (stiffening > 0) stiffen(static_cast<D const*>(nullptr), stiffening, own);
    state.write(own, at.block, at.lane);
  });
  return std::make_unique<fem::OperatorOf<D, 3>>(solid.points, D(std::move(state)));
}

template <class Kind>
bool any_of(Solid const& solid) {
  return std::any_of(solid.laws.begin(), solid.laws.end(),
                     [](Law const& law) { return std::holds_alternative<Kind>(law); });
}

}  // namespace

Response respond(Solid const& solid, Real const* u) {
  Response out{{}, 0, std::numeric_limits<Real>::max()};
  out.force = sum_point_by_point<true>(*solid.points, u, [&](Place const& place, Tensor& slopes) {
    Moved const at = moved(solid, place, slopes);
    Real const j = det(at.whole);
    out.smallest_j = std::min(out.smallest_j, j);
    slopes = {};
    if (!(j > 0)) return;
    out.energy += at.volume * energy_of(at.law, at.whole, at.damage);
    Tensor const stress = material::scaled(at.volume, stress_of(at.law, at.whole, at.damage));
    slopes = material::product(stress, material::transposed(material::inverse(at.relative)));
  });
  Communicator const& comm = solid.points->lattice().comm();
  out.energy = comm.sum(out.energy);
  out.smallest_j = comm.smallest(out.smallest_j);
  return out;
}

std::vector<Real> deformation(Solid const& solid, Real const* u) {
  std::vector<Real> out(9 * solid.count());
  sum_point_by_point<false>(*solid.points, u, [&](Place const& at, Tensor const& slopes) {
    Tensor const whole = moved(solid, at, slopes).whole;
    for (std::size_t i = 0; i < 3; ++i) std::copy(whole[i].begin(), whole[i].end(), &out[9 * at.point + 3 * i]);
  });
  return out;
}

Energies energies(Solid const& solid, Real const* u) {
  Energies out{std::vector<Real>(solid.count()), std::vector<Real>(solid.count())};
  sum_point_by_point<false>(*solid.points, u, [&](Place const& place, Tensor const& slopes) {
    Moved const at = moved(solid, place, slopes);
    out.stored[place.point] = energy_of(at.law, at.whole, at.damage);
    auto const* damaged = std::get_if<material::DamagedNeoHookean>(&at.law);
    out.driving[place.point] = damaged ? damaged->driving_energy(at.whole) : 0;
  });
  return out;
}

std::vector<Real> stresses(Solid const& solid, Real const* deformation) {
  std::vector<Real> out(9 * solid.count());
  for (std::size_t p = 0; p < solid.count(); ++p) {
    Tensor const stress =
        stress_of(solid.laws[std::size_t(solid.law[p])], tensor_at(deformation + 9 * p), solid.damage[p]);
    for (std::size_t i = 0; i < 3; ++i) std::copy(stress[i].begin(), stress[i].end(), &out[9 * p + 3 * i]);
  }
  return out;
}

std::unique_ptr<fem::Operator> tangent(Solid const& solid, Real const* u, Form form, Real stiffening) {
  if (form == Form::initial && stiffening == 0) return tangent_as<InitialNeoHookean>(solid, u, 0);
  if (any_of<material::Ogden>(solid)) return tangent_as<CurrentGeneral>(solid, u, stiffening);
  if (any_of<material::DamagedNeoHookean>(solid)) return tangent_as<CurrentIsotropic<true>>(solid, u, stiffening);
  return tangent_as<CurrentIsotropic<false>>(solid, u, stiffening);
}

std::vector<Real> determinants(Real const* deformation, std::size_t points) {
  std::vector<Real> out(points);
  for (std::size_t p = 0; p < points; ++p) out[p] = det(tensor_at(deformation + 9 * p));
  return out;
}

}  // namespace amrpic::mpm
