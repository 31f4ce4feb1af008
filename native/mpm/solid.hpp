#pragma once

#include <memory>
#include <variant>
#include <vector>

#include "fem/operators.hpp"
#include "material/neo_hookean.hpp"
#include "material/ogden.hpp"
#include "material/phase_field.hpp"

namespace amrpic::mpm {

/// Stress, energy and tangent of one material at F; `damage` matters to some.
using Law = std::variant<material::NeoHookean, material::Ogden, material::DamagedNeoHookean>;

/// Points that carry a solid on a mesh that has no displacement yet: the configuration of the mesh is the one in which
/// points have what they carry, and displacements u are from there on. F = (1 + grad u) F~.
struct Solid {
  std::shared_ptr<fem::Points const> points;
  std::vector<Law> laws;
  // Arrays of whoever made this, which must last as long as it.
  int const* law;           ///< of each point
  Real const* deformation;  ///< F~, 9 of each point, row after row
  Real const* damage;       ///< of each point

  std::size_t count() const { return std::size_t(points->count()); }
};

/// What a displacement does. Integrals are over initial volumes: a point's is its weight over det F~.
struct Response {
  std::vector<Real> force;  ///< of this rank's nodes: the internal forces, sums of w P : grad N
  Real energy;              ///< of all ranks
  Real smallest_j;          ///< of all ranks, det F; nothing else is of use unless it is positive
};

/// Collective.
Response respond(Solid const& solid, Real const* u);

enum class Form { initial, current };

/// How the internal forces change with u, which must leave all det F positive. In the initial form, which neo-Hookean
/// solids alone have, gradients are those of the mesh's configuration; in the current one those of the displaced one.
/// With `stiffening` it is the current form, stiffer against rotation where stress compresses, by this part of what
/// leaves no direction without stiffness. Collective.
std::unique_ptr<fem::Operator> tangent(Solid const& solid, Real const* u, Form form, Real stiffening = 0);

/// F of each point, 9 numbers, at a displacement. Collective.
std::vector<Real> deformation(Solid const& solid, Real const* u);

/// Of each point at a displacement, per initial volume: the energy, and that which drives damage, zero without.
/// Collective.
struct Energies {
  std::vector<Real> stored, driving;
};
Energies energies(Solid const& solid, Real const* u);

/// Kirchhoff's stress, 9 numbers, of each point at F. Local.
std::vector<Real> stresses(Solid const& solid, Real const* deformation);

/// det F of each point. Local.
std::vector<Real> determinants(Real const* deformation, std::size_t points);

}  // namespace amrpic::mpm
