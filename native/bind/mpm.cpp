#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "mpm/damage.hpp"
#include "mpm/solid.hpp"

namespace {

using Numbers = nb::ndarray<int const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

std::vector<Real> values_of(bind::Reals const& array) { return {array.data(), array.data() + array.size()}; }

}  // namespace

void bind_mpm(nb::module_& m) {
  nb::class_<mpm::Solid>(m, "MpmSolid", "Points that carry a solid; amrpic.mpm.Solid has it.")
      .def(
          "__init__",
          [](mpm::Solid* self, std::shared_ptr<fem::Points> const& points, std::vector<mpm::Law> laws, Numbers law,
             bind::Reals deformation, bind::Reals damage) {
            new (self) mpm::Solid{points, std::move(laws), law.data(), deformation.data(), damage.data()};
          },
          "points"_a, "laws"_a, "law"_a.noconvert(), "deformation"_a.noconvert(), "damage"_a.noconvert(),
          nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(), nb::keep_alive<1, 6>())
      .def(
          "respond",
          [](mpm::Solid const& solid, bind::Reals u) {
            auto found = bind::released([&] { return mpm::respond(solid, u.data()); });
            return nb::make_tuple(bind::to_array(std::move(found.force)), found.energy, found.smallest_j);
          },
          "u"_a, "Internal forces, energy, and the smallest det F.")
      .def(
          "tangent",
          [](mpm::Solid const& solid, bind::Reals u, int form, Real stiffening) {
            nb::gil_scoped_release release;
            return mpm::tangent(solid, u.data(), mpm::Form(form), stiffening);
          },
          "u"_a, "form"_a, "stiffening"_a)
      .def(
          "deformation",
          [](mpm::Solid const& solid, bind::Reals u) { return bind::to_array(mpm::deformation(solid, u.data())); },
          "u"_a, "F of each point, 9 numbers.")
      .def(
          "energies",
          [](mpm::Solid const& solid, bind::Reals u) {
            auto found = mpm::energies(solid, u.data());
            return nb::make_tuple(bind::to_array(std::move(found.stored)), bind::to_array(std::move(found.driving)));
          },
          "u"_a, "Energy and driving energy of each point.")
      .def(
          "stresses",
          [](mpm::Solid const& solid, bind::Reals deformation) {
            return bind::to_array(mpm::stresses(solid, deformation.data()));
          },
          "deformation"_a, "Kirchhoff's stress of each point, 9 numbers.");
  m.def(
      "mpm_determinants",
      [](bind::Reals deformation) {
        return bind::to_array(mpm::determinants(deformation.data(), deformation.size() / 9));
      },
      "deformation"_a, "Of each point's 9 numbers.");
  m.def(
      "mpm_damage",
      [](std::shared_ptr<fem::Points> const& points, bind::Reals volume, bind::Reals driving, bind::Reals surface,
         bind::Reals length) {
        return mpm::damage_operator(
            {points, values_of(volume), values_of(driving), values_of(surface), values_of(length)});
      },
      "points"_a, "volume"_a, "driving"_a, "surface"_a, "length"_a, "The operator that damage is found with.");
}
