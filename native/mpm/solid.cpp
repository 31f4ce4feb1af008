#include "mpm/solid.hpp"

#include <algorithm>
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

/// One point under a displacement.
struct Moved {
  Tensor before, relative, whole;  ///< F~, 1 + grad u, F
  Real volume;                     ///< initial
  Law const& law;
  Real damage;
};

/// `slopes`: of u at points, (3, 3) each.
Moved moved(Solid const& solid, std::vector<Real> const& slopes, std::vector<Real> const& weights, std::size_t p) {
  Tensor const before = tensor_at(&solid.deformation[9 * p]);
  Tensor const relative = material::sum(material::unit_tensor(), 1, tensor_at(&slopes[9 * p]));
  return {before,
          relative,
          material::product(relative, before),
          weights[p] / material::determinant(before),
          solid.laws[std::size_t(solid.law[p])],
          solid.damage[p]};
}

std::vector<Real> weights_of(fem::Points const& points) {
  return points.unblocked({points.weights(), points.weights() + points.blocks() * native_lane_count}, 1);
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

template <class D, class Write>
std::unique_ptr<fem::Operator> made(std::shared_ptr<fem::Points const> points, Write&& write) {
  Blocks blocks(points->blocked_of(D::width, write), D::width);
  constexpr int components = D::values ? 1 : 3;
  D d(std::move(blocks));
  return std::make_unique<fem::OperatorOf<D, components>>(std::move(points), std::move(d));
}

template <class D>
std::unique_ptr<fem::Operator> tangent_as(Solid const& solid, Real const* u) {
  auto const slopes = fem::slopes_at(*solid.points, 3, u);
  auto const weights = weights_of(*solid.points);
  Real3 const scale = fem::slope_scale(solid.points->lattice());
  return made<D>(solid.points, [&](std::size_t p, Real* state) {
    write_state(static_cast<D const*>(nullptr), moved(solid, slopes, weights, p), scale, state);
  });
}

/// Forces from fluxes at points, (3, 3) each, in coordinates of elements and with weights.
struct Flux {
  static constexpr bool reads = false, writes = true, values = false, slopes = true;
  Blocks flux;

  void operator()(std::int64_t block, AtPoint<3>& at) const {
    for_each_entry([&](std::size_t i, std::size_t j) { at.slope[i][j] = flux(block, 3 * i + j); });
  }
};

std::vector<Real> forces_of(fem::Points const& points, std::vector<Real> flux) {
  Flux const d{Blocks(std::move(flux), 9)};
  std::vector<Real> out(std::size_t(points.lattice().own_nodes()) * 3);
  fem::with_degree(points.lattice().degree(), [&](auto nodes) {
    fem::AtPoints<nodes(), 3, Flux> const kernel{points, d};
    fem::sum_over_elements<nodes(), 3>(points, nullptr, out.data(), kernel);
  });
  return out;
}

template <class Kind>
bool any_of(Solid const& solid) {
  return std::any_of(solid.laws.begin(), solid.laws.end(),
                     [](Law const& law) { return std::holds_alternative<Kind>(law); });
}

}  // namespace

Response respond(Solid const& solid, Real const* u) {
  fem::Points const& points = *solid.points;
  auto const slopes = fem::slopes_at(points, 3, u);
  auto const weights = weights_of(points);
  Real3 const scale = fem::slope_scale(points.lattice());
  Response out{{}, 0, std::numeric_limits<Real>::max()};
  auto flux = points.blocked_of(9, [&](std::size_t p, Real* own) {
    Moved const at = moved(solid, slopes, weights, p);
    Real const j = det(at.whole);
    out.smallest_j = std::min(out.smallest_j, j);
    if (!(j > 0)) return;
    out.energy += at.volume * energy_of(at.law, at.whole, at.damage);
    Tensor const stress = material::scaled(at.volume, stress_of(at.law, at.whole, at.damage));
    Tensor const by = material::product(stress, material::transposed(material::inverse(at.relative)));
    material::for_each_entry([&](std::size_t i, std::size_t k) { own[3 * i + k] = by[i][k] * scale[k]; });
  });
  out.force = forces_of(points, std::move(flux));
  Communicator const& comm = points.lattice().comm();
  out.energy = comm.sum(out.energy);
  out.smallest_j = comm.smallest(out.smallest_j);
  return out;
}

std::unique_ptr<fem::Operator> tangent(Solid const& solid, Real const* u, Form form) {
  if (form == Form::initial) return tangent_as<InitialNeoHookean>(solid, u);
  if (any_of<material::Ogden>(solid)) return tangent_as<CurrentGeneral>(solid, u);
  if (any_of<material::DamagedNeoHookean>(solid)) return tangent_as<CurrentIsotropic<true>>(solid, u);
  return tangent_as<CurrentIsotropic<false>>(solid, u);
}

States states(Solid const& solid, Real const* deformation) {
  States out;
  for (std::size_t p = 0; p < solid.count(); ++p) {
    Law const& law = solid.laws[std::size_t(solid.law[p])];
    Tensor const f = tensor_at(deformation + 9 * p), stress = stress_of(law, f, solid.damage[p]);
    for (auto const& row : stress) out.stress.insert(out.stress.end(), row.begin(), row.end());
    out.energy.push_back(energy_of(law, f, solid.damage[p]));
    auto const* damaged = std::get_if<material::DamagedNeoHookean>(&law);
    out.driving.push_back(damaged ? damaged->driving_energy(f) : 0);
  }
  return out;
}

std::vector<Real> determinants(Real const* deformation, std::size_t points) {
  std::vector<Real> out(points);
  for (std::size_t p = 0; p < points; ++p) out[p] = det(tensor_at(deformation + 9 * p));
  return out;
}

std::unique_ptr<fem::Operator> damage_operator(DamageEquation const& e) {
  Real3 const scale = fem::slope_scale(e.points->lattice());
  return made<Damage>(e.points, [&](std::size_t p, Real* state) {
    bool const has_part = e.surface[p] > 0;
    state[0] = has_part ? e.volume[p] * (e.driving[p] + e.surface[p]) : 0;
    for (std::size_t d = 0; d < 3; ++d)
      state[1 + d] = e.volume[p] * e.surface[p] * e.length[p] * e.length[p] * scale[d] * scale[d];
  });
}

}  // namespace amrpic::mpm
