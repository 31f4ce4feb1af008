#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include "bind/bind.hpp"
#include "material/neo_hookean.hpp"
#include "material/ogden.hpp"
#include "material/phase_field.hpp"

using material::Tensor;

void bind_material(nb::module_& m) {
  nb::class_<material::NeoHookean>(m, "NeoHookean")
      .def(nb::init<Real, Real>(), "mu"_a, "lambda_"_a)
      .def("energy", &material::NeoHookean::energy, "f"_a, "Per initial volume.")
      .def("stress", &material::NeoHookean::stress, "f"_a, "Kirchhoff's.")
      .def("change_initially", &material::NeoHookean::change_initially, "f"_a, "change"_a)
      .def(
          "change",
          [](material::NeoHookean const& law, Tensor const& f, Tensor const& h) {
            return material::change_of_stress(law.stress(f), law.moduli(f), h);
          },
          "f"_a, "h"_a);

  nb::class_<material::Ogden>(m, "Ogden")
      .def(
          "__init__",
          [](material::Ogden* self, std::vector<std::pair<Real, Real>> const& terms, Real lambda) {
            new (self) material::Ogden{{}, lambda};
            for (auto const& [mu, alpha] : terms) self->terms.push_back({mu, alpha});
          },
          "terms"_a, "lambda_"_a)
      .def("energy", &material::Ogden::energy, "f"_a)
      .def("stress", &material::Ogden::stress, "f"_a)
      .def("change_initially", &material::Ogden::change_initially, "f"_a, "change"_a)
      .def(
          "change",
          [](material::Ogden const& law, Tensor const& f, Tensor const& h) {
            return material::change_of_stress(law.stress(f), law.moduli(f), h);
          },
          "f"_a, "h"_a);

  nb::class_<material::DamagedNeoHookean>(m, "DamagedNeoHookean")
      .def(nb::init<Real, Real, Real>(), "mu"_a, "lambda_"_a, "residual"_a)
      .def("energy", &material::DamagedNeoHookean::energy, "f"_a, "damage"_a)
      .def("driving_energy", &material::DamagedNeoHookean::driving_energy, "f"_a)
      .def("stress", &material::DamagedNeoHookean::stress, "f"_a, "damage"_a)
      .def("damage_of", &material::DamagedNeoHookean::damage_of, "driving"_a, "toughness"_a, "length"_a)
      .def(
          "change",
          [](material::DamagedNeoHookean const& law, Tensor const& f, Tensor const& h, Real damage) {
            return material::change_of_stress(law.stress(f, damage), law.moduli(f, damage), h);
          },
          "f"_a, "h"_a, "damage"_a);
}
