#include "mesh/cluster.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "mesh/interpolate.hpp"
#include "mesh/refine.hpp"
#include "mesh/stencil_sums.hpp"

namespace {

using Array3 = nb::ndarray<Real const, nb::ndim<3>, nb::f_contig, nb::device::cpu>;
using Marks = nb::ndarray<std::uint8_t const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

}  // namespace

void bind_cluster(nb::module_& m) {
  m.def(
      "cluster",
      [](bind::IntRows blocks, Real efficiency) {
        std::vector<Index3> at;
        for (std::size_t b = 0; b < blocks.shape(0); ++b) at.push_back({blocks(b, 0), blocks(b, 1), blocks(b, 2)});
        return bind::from_boxes(cluster(std::move(at), efficiency));
      },
      "blocks"_a, "efficiency"_a);

  m.def(
      "refine",
      [](Hierarchy const& hierarchy, std::vector<Marks> const& tags, std::vector<bind::IntRows> const& fixed,
         int max_levels, int buffer, int nesting, Real efficiency) {
        std::vector<std::uint8_t const*> marks;
        for (auto const& level : tags) marks.push_back(level.data());
        std::vector<std::vector<Box>> boxes, levels;
        for (auto const& level : fixed) boxes.push_back(bind::to_boxes(level));
        {
          nb::gil_scoped_release release;
          levels = refine(hierarchy, marks, boxes, {max_levels, buffer, nesting, efficiency});
        }
        nb::list out;
        for (auto const& level : levels) out.append(bind::from_boxes(level));
        return out;
      },
      "hierarchy"_a, "tags"_a, "fixed"_a, "max_levels"_a, "buffer"_a, "nesting"_a, "efficiency"_a);

  nb::class_<BoxTable>(m, "BoxTable", "Disjoint boxes of a level, and a look-up by cells.")
      .def(
          "__init__",
          [](BoxTable* self, bind::IntRows boxes) {
            auto rows = bind::to_boxes(boxes);
            nb::gil_scoped_release release;
            new (self) BoxTable(std::move(rows));
          },
          "boxes"_a)
      .def(
          "meeting",
          [](BoxTable const& table, Index3 lower, Index3 upper) {
            return bind::to_array(table.meeting({lower, upper}));
          },
          "lower"_a, "upper"_a, "Ascending numbers of the boxes that have cells of a region.")
      .def(
          "meets",
          [](BoxTable const& table, bind::IntRows regions) {
            std::vector<std::uint8_t> out;
            for (Box const& region : bind::to_boxes(regions)) out.push_back(table.meets(region));
            return bind::to_array(std::move(out));
          },
          "regions"_a, "Whether a box has a cell of each region, a byte per region.")
      .def(
          "find",
          [](BoxTable const& table, bind::IntRows cells) {
            std::vector<int> out;
            for (std::size_t n = 0; n < cells.shape(0); ++n)
              out.push_back(table.find({cells(n, 0), cells(n, 1), cells(n, 2)}));
            return bind::to_array(std::move(out));
          },
          "cells"_a, "The box that holds each cell, -1 if none does.")
      .def_prop_ro("outer_faces", &outer_faces, "Number of cell faces on the surface of the union of the boxes.");

  m.def(
      "stencil_sums",
      [](Array3 value, bind::Starts place, bind::Starts kind, bind::Starts first, bind::IntRows offset,
         bind::RealRows weight) {
        std::array<std::ptrdiff_t, 3> const steps{1, std::ptrdiff_t(value.shape(0)),
                                                  std::ptrdiff_t(value.shape(0) * value.shape(1))};
        std::vector<std::int64_t> const places(place.data(), place.data() + place.size());
        std::vector<std::int64_t> const kinds(kind.data(), kind.data() + kind.size());
        SharedStencils const stencils{first.data(), offset.data(), weight.data(), weight.shape(1)};
        auto sums = bind::released([&] { return stencil_sums(value.data(), steps, places, kinds, stencils); });
        return bind::to_array(std::move(sums), {place.size(), weight.shape(1)});
      },
      "value"_a, "place"_a, "kind"_a, "first"_a, "offset"_a, "weight"_a,
      "Sums of weights times differences from the own value, (cells, rows), for cells at places of a dense array.");

  m.def("carry_over", &carry_over, nb::call_guard<nb::gil_scoped_release>(), "from_"_a, "to"_a);
}
