#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "geometry/triangles.hpp"
#include "mesh/cells_in_metal.hpp"

namespace {

using Weights = nb::ndarray<int const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Owners = nb::ndarray<std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Axes = nb::ndarray<std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

}  // namespace

void bind_geometry(nb::module_& m) {
  nb::class_<Triangles>(m, "Triangles", "A closed surface of triangles, searched by a hierarchy of boxes.")
      .def(
          "__init__",
          [](Triangles* self, bind::RealRows corners, Weights weight) {
            std::vector<Triangles::Corners> triangles(corners.shape(0));
            for (std::size_t n = 0; n < triangles.size(); ++n)
              for (std::size_t c = 0; c < 9; ++c) triangles[n][c / 3][c % 3] = corners(n, c);
            std::vector<int> weights(weight.data(), weight.data() + weight.size());
            nb::gil_scoped_release release;
            new (self) Triangles(std::move(triangles), std::move(weights));
          },
          "corners"_a, "weight"_a)
      .def(
          "crossings",
          [](Triangles const& triangles, bind::RealRows start, bind::RealRows direction) {
            auto found = bind::released(
                [&] { return triangles.crossings(start.data(), direction.data(), std::int64_t(start.shape(0))); });
            return nb::make_tuple(bind::to_array(std::move(found.line)), bind::to_array(std::move(found.parameter)),
                                  bind::to_array(std::move(found.depth)), bind::to_array(std::move(found.triangle)),
                                  bind::to_array(std::move(found.grazing)));
          },
          "start"_a, "direction"_a,
          "Line, parameter, change of depth and triangle of each crossing, line by line, and the lines that pass edges "
          "within rounding; arguments are rows of x, y, z.");
  m.def(
      "mark_in_metal",
      [](bind::Starts first, bind::Starts count, bind::Starts stride, int electrode, int axis, Owners owner,
         Axes axes) {
        mark({first.data(), count.data(), stride.data(), first.size()}, electrode, std::uint8_t(1 << axis),
             owner.data(), axes.data());
      },
      "first"_a, "count"_a, "stride"_a, "electrode"_a, "axis"_a, "owner"_a, "axes"_a,
      "Give stretches of cells along an axis to an electrode, and add its bit to theirs.");
  m.def(
      "runs_in_metal",
      [](bind::IntRows boxes, Owners owner) {
        Runs found = runs_in(bind::to_boxes(boxes), owner.data());
        std::size_t const n = found.count.size();
        return nb::make_tuple(bind::to_array(std::move(found.first), {n, 3}), bind::to_array(std::move(found.count)),
                              bind::to_array(std::move(found.electrode)));
      },
      "boxes"_a, "owner"_a,
      "First cells, numbers and electrodes of the runs along x in boxes, by the owners of the cells of each and of a "
      "layer around it.");
}
