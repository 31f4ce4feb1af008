#include "mesh/cluster.hpp"

#include <nanobind/stl/vector.h>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "mesh/interpolate.hpp"
#include "mesh/refine.hpp"

namespace nb = nanobind;
using namespace amrpic;
using namespace nb::literals;

namespace {

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

  m.def(
      "outer_faces", [](bind::IntRows boxes) { return outer_faces(BoxTable(bind::to_boxes(boxes))); }, "boxes"_a,
      "The number of cell faces on the surface of the union of disjoint boxes.");

  m.def(
      "boxes_that_meet",
      [](bind::IntRows boxes, bind::IntRows others) {
        BoxTable const table(bind::to_boxes(others));
        std::vector<std::uint8_t> out;
        for (Box const& box : bind::to_boxes(boxes)) out.push_back(table.meets(box));
        return bind::to_array(std::move(out));
      },
      "boxes"_a, "others"_a, "Whether each box has a cell that one of the others has as well, a byte per box.");

  m.def("carry_over", &carry_over, nb::call_guard<nb::gil_scoped_release>(), "from_"_a, "to"_a);
}
