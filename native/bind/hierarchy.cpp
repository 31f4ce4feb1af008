#include "mesh/hierarchy.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include "base/error.hpp"
#include "bind/bind.hpp"
#include "bind/communicator.hpp"
#include "bind/convert.hpp"
#include "mesh/array_on_box.hpp"
#include "mesh/cells_around.hpp"
#include "mesh/leaves_around.hpp"

void bind_hierarchy(nb::module_& m) {
  nb::exception<HierarchyError>(m, "HierarchyError");
  nb::exception<SolverError>(m, "SolverError");

  m.def(
      "wrapped",
      [](bind::RealRows points, Real3 lower, Real3 upper, std::array<bool, 3> periodic) {
        std::vector<Real> out(points.data(), points.data() + points.size());
        for (std::size_t n = 0; n < out.size(); ++n)
          if (std::size_t const d = n % 3; periodic[d] && std::isfinite(out[n]))
            out[n] = wrapped(out[n], lower[d], upper[d]);
        return bind::to_array(std::move(out), {points.shape(0), 3});
      },
      "points"_a, "lower"_a, "upper"_a, "periodic"_a,
      "Points (n, 3), those beyond periodic faces where their images are in the domain.");

  nb::class_<Hierarchy>(m, "Hierarchy")
      .def(
          "__init__",
          [](Hierarchy* self, bind::Ranks comm, Real3 lower, Real3 upper, Index3 cells, std::array<int, 6> boundary,
             std::vector<bind::IntRows> levels, int max_grid_size, int blocking_factor, bind::IntRows base,
             Hierarchy const* earlier) {
            Domain domain{lower, upper, cells, {}};
            for (int face = 0; face < 6; ++face) domain.boundary[face / 2][face % 2] = Boundary(boundary[face]);
            std::vector<std::vector<Box>> boxes;
            for (auto const& level : levels) boxes.push_back(bind::to_boxes(level));
            nb::gil_scoped_release release;
            new (self) Hierarchy(bind::communicator(comm), domain, boxes, max_grid_size, blocking_factor,
                                 bind::to_boxes(base), earlier);
          },
          "comm"_a, "lower"_a, "upper"_a, "cells"_a, "boundary"_a, "levels"_a, "max_grid_size"_a, "blocking_factor"_a,
          "base"_a, "earlier"_a.none())
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
          "metadata_bytes", [](Hierarchy const& h, int level) { return h.level(level).share_table()->bytes(); },
          "level"_a, "What the boxes of a level take on each rank, which levels with the same boxes share.")
      .def(
          "same_boxes",
          [](Hierarchy const& h, Hierarchy const& other, int level) {
            Level const &a = h.level(level), &b = other.level(level);
            return a.share_table() == b.share_table() || a.boxes() == b.boxes();
          },
          "other"_a, "level"_a)
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
          "level"_a, "box"_a)
      .def(
          "cells_around",
          [](Hierarchy const& h, bind::RealRows points, bind::Reals radius) {
            CellsAround found;
            {
              nb::gil_scoped_release release;
              std::vector<Real3> places(points.shape(0));
              for (std::size_t p = 0; p < places.size(); ++p) places[p] = {points(p, 0), points(p, 1), points(p, 2)};
              found = cells_around(h, places, {radius.data(), radius.data() + radius.size()});
            }
            return nb::make_tuple(bind::to_array(std::move(found.start)), bind::to_array(std::move(found.cell)));
          },
          "points"_a, "radius"_a, "Starts and numbers of the uncovered cells within a radius of each point.")
      .def(
          "leaves_around",
          [](Hierarchy const& h, Real reach) {
            auto found = bind::released([&] { return leaves_around(h, reach); });
            return nb::make_tuple(bind::to_array(std::move(found.leaf)), bind::to_array(std::move(found.radius)),
                                  bind::to_array(std::move(found.start)), bind::to_array(std::move(found.cell)),
                                  bind::to_array(std::move(found.kind)),
                                  bind::to_array(std::move(found.representative)));
          },
          "reach"_a, "Uncovered cells, their radii, starts and numbers of those near each, kinds, one of each kind.");
}
