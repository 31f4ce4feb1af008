#include "mesh/field.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "mesh/integral.hpp"
#include "mesh/sample.hpp"
#include "mesh/transfer.hpp"

void bind_field(nb::module_& m) {
  nb::class_<Field>(m, "Field")
      .def(nb::init<std::shared_ptr<Hierarchy const>, bool>(), "hierarchy"_a, "zero"_a = true)
      .def(
          "level",
          [](nb::handle self, int level) {
            auto& values = nb::cast<Field&>(self).level(level);
            return nb::ndarray<nb::numpy, Real>(values.data(), {values.size()}, self);
          },
          "level"_a)
      .def(
          "average_down", [](Field& field) { Transfer(field.share_hierarchy()).average_down({&field}); },
          nb::call_guard<nb::gil_scoped_release>())
      .def(
          "own_integral", [](Field const& field) { return integral(field); }, nb::call_guard<nb::gil_scoped_release>())
      .def(
          "own_integral_with", [](Field const& field, Field const& other) { return integral(field, other); }, "other"_a,
          nb::call_guard<nb::gil_scoped_release>())
      .def(
          "own_integral_with_itself",
          [](Field const& field, Field const& other, std::vector<Real> const& weight) {
            return integral(field, other, weight);
          },
          "other"_a, "weight"_a, nb::call_guard<nb::gil_scoped_release>())
      .def(
          "sample",
          [](Field const& field, bind::RealRows points) {
            std::vector<Real3> at;
            for (std::size_t p = 0; p < points.shape(0); ++p) at.push_back({points(p, 0), points(p, 1), points(p, 2)});
            auto values = bind::released([&] { return sample(field, at); });
            return bind::to_array(std::move(values));
          },
          "points"_a);

  nb::class_<ElectricField>(m, "ElectricField")
      .def(
          "__init__",
          [](ElectricField* self, std::shared_ptr<Field const> x, std::shared_ptr<Field const> y,
             std::shared_ptr<Field const> z) {
            nb::gil_scoped_release release;
            new (self) ElectricField({std::move(x), std::move(y), std::move(z)});
          },
          "x"_a, "y"_a, "z"_a)
      .def(
          "write",
          [](ElectricField const& field, Field& x, Field& y, Field& z) {
            nb::gil_scoped_release release;
            field.write({&x, &y, &z});
          },
          "x"_a, "y"_a, "z"_a)
      .def(
          "compensate",
          [](ElectricField& field, std::shared_ptr<Field const> density, std::vector<Real3> factor) {
            field.compensate({std::move(density), std::move(factor)});
          },
          "density"_a, "factor"_a,
          "Let gather add factor[level][axis] times the density below less that above; the field on the mesh stays.")
      .def(
          "own_integral_of_square", [](ElectricField const& field) { return integral_of_square(field); },
          nb::call_guard<nb::gil_scoped_release>());
}
