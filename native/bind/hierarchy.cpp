#include "mesh/hierarchy.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include "base/error.hpp"
#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "mesh/array_on_box.hpp"

namespace nb = nanobind;
using namespace amrpic;
using namespace nb::literals;

namespace {

/// The Fortran handle of a communicator, or a virtual rank and the number of ranks.
using Ranks = std::variant<int, std::array<int, 2>>;

Communicator communicator(Ranks const& ranks) {
  if (auto const* handle = std::get_if<int>(&ranks)) return Communicator(MPI_Comm_f2c(*handle));
  auto const& [rank, count] = std::get<1>(ranks);
  return Communicator(rank, count);
}

}  // namespace

void bind_hierarchy(nb::module_& m) {
  nb::exception<HierarchyError>(m, "HierarchyError");
  nb::exception<SolverError>(m, "SolverError");

  nb::class_<Hierarchy>(m, "Hierarchy")
      .def(
          "__init__",
          [](Hierarchy* self, Ranks comm, Real3 lower, Real3 upper, Index3 cells, std::array<int, 6> boundary,
             std::vector<bind::IntRows> levels, int max_grid_size, int blocking_factor,
             std::vector<bind::Reals> weights) {
            Domain domain{lower, upper, cells, {}};
            for (int face = 0; face < 6; ++face) domain.boundary[face / 2][face % 2] = Boundary(boundary[face]);
            std::vector<std::vector<Box>> boxes;
            for (auto const& level : levels) boxes.push_back(bind::to_boxes(level));
            std::vector<std::vector<Real>> loads;
            for (auto const& w : weights) loads.emplace_back(w.data(), w.data() + w.size());
            nb::gil_scoped_release release;
            new (self) Hierarchy(communicator(comm), domain, boxes, max_grid_size, blocking_factor, loads);
          },
          "comm"_a, "lower"_a, "upper"_a, "cells"_a, "boundary"_a, "levels"_a, "max_grid_size"_a, "blocking_factor"_a,
          "weights"_a)
      .def(
          "seen_by", [](Hierarchy const& h, int rank) { return std::const_pointer_cast<Hierarchy>(h.seen_by(rank)); },
          "rank"_a, "The hierarchy of a virtual rank as another virtual rank has it.")
      .def_prop_ro("levels", &Hierarchy::level_count)
      .def(
          "boxes", [](Hierarchy const& h, int level) { return bind::from_boxes(h.level(level).boxes()); }, "level"_a)
      .def(
          "owners",
          [](Hierarchy const& h, int level) {
            std::vector<int> out;
            for (int b = 0; b < h.level(level).box_count(); ++b) out.push_back(h.level(level).owner(b));
            return bind::to_array(std::move(out));
          },
          "level"_a)
      .def(
          "local_boxes",
          [](Hierarchy const& h, int level) {
            return std::array<int, 2>{h.level(level).first_local_box(), h.level(level).last_local_box()};
          },
          "level"_a)
      .def(
          "cells", [](Hierarchy const& h, int level) { return h.level(level).cells(); }, "level"_a)
      .def(
          "covered",
          [](Hierarchy const& h, int level, int box) {
            Box const region = h.level(level).box(box);
            std::vector<std::int8_t> mask(std::size_t(region.cells()), 0);
            if (h.has_finer(level)) {
              auto const covered = covered_cells(h.level(level + 1), refinement_ratio, region);
              mask.assign(covered.values().begin(), covered.values().end());
            }
            std::size_t const shape[3] = {std::size_t(region.extent(0)), std::size_t(region.extent(1)),
                                          std::size_t(region.extent(2))};
            std::int64_t const strides[3] = {1, region.extent(0), std::int64_t(region.extent(0)) * region.extent(1)};
            auto* kept = new std::vector<std::int8_t>(std::move(mask));
            nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<std::int8_t>*>(p); });
            return nb::ndarray<nb::numpy, std::int8_t>(kept->data(), 3, shape, owner, strides);
          },
          "level"_a, "box"_a);
}
