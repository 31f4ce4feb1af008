#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include <complex>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "freespace/density.hpp"
#include "freespace/free_space.hpp"
#include "freespace/lattice_green.hpp"
#include "freespace/wall_counts.hpp"
#include "mesh/walls.hpp"

using namespace amrpic::freespace;

namespace {

using Moments = nb::ndarray<std::complex<double> const, nb::shape<harmonic_count>, nb::c_contig, nb::device::cpu>;

nb::ndarray<nb::numpy, std::complex<double>> from_moments(Harmonics<double> const& moments) {
  std::vector<std::complex<double>> out;
  for (auto const& m : moments) out.emplace_back(m.re, m.im);
  return bind::to_array(std::move(out));
}

Options options_beside(WallMesh const& mesh, int order) {
  return Options::of(order, !mesh.images.are_none(), mesh.images.lattices(), mesh.images.are_narrow());
}

/// The free space around a mesh, with the faces behind which its potential is wanted.
struct OpenWalls {
  struct AtLevel {
    std::vector<int> faces, cells;
    std::vector<std::size_t> places;
  };
  Options options;
  FreeSpace space;
  std::shared_ptr<WallPlan const> plan;
  std::vector<AtLevel> levels;

  OpenWalls(std::shared_ptr<Hierarchy const> const& mesh, Options const& options)
      : options(options),
        space(mesh->comm(), wall_mesh(*mesh).lattice, !wall_mesh(*mesh).images.are_none(), options),
        plan(space.plan(wall_mesh(*mesh, options.layers()))) {
    for (int l = 0; l < mesh->level_count(); ++l) {
      AtLevel& at = levels.emplace_back();
      for (auto const& face : find_walls(mesh->domain(), mesh->level(l)).faces) {
        if (face.kind != Boundary::open) continue;
        at.faces.push_back(2 * face.axis + face.side);
        at.cells.insert(at.cells.end(), face.cell.begin(), face.cell.end());
        for (int layer = 0; layer < options.layers(); ++layer)
          at.places.push_back(plan->place(at.faces.back(), layer, l, face.cell));
      }
    }
  }
  std::vector<double> values(Field const& density) {
    return space.walls(*plan, charges_of(density, density.hierarchy(), 1.0, options));
  }
};

/// The levels of a mesh as they would be on so many ranks; `first_boxes`: where the runs of each begin, or none.
WallMesh shared_out(Hierarchy const& mesh, std::vector<std::vector<int>> const& first_boxes) {
  WallMesh out = wall_mesh(mesh);
  for (std::size_t l = 0; l < first_boxes.size(); ++l) {
    Level const& level = out.level(int(l));
    out.levels[l] = std::make_shared<Level const>(level.domain(), level.periodic(), level.spacing(), level.boxes(),
                                                  first_boxes[l], 0);
  }
  return out;
}

nb::dict to_dict(WallCounts const& counts) {
  nb::dict out;
  out["patches"] = counts.patches;
  out["far"] = counts.far;
  out["near"] = counts.near;
  out["nodes_received"] = counts.nodes_received;
  out["leaves_received"] = counts.leaves_received;
  std::int64_t messages = 0, bytes = 0;
  auto const add = [&](char const* name, WallCounts::Sent const& sent) {
    out[name] = std::array<std::int64_t, 2>{sent.messages, sent.bytes};
    messages += sent.messages;
    bytes += sent.bytes;
  };
  add("parts", counts.parts);
  add("joins", counts.joins);
  add("families", counts.families);
  add("leaves", counts.leaves);
  add("down", counts.down);
  add("walls", counts.walls);
  out["messages"] = messages;
  out["bytes"] = bytes;
  out["received_messages"] = counts.received_messages;
  out["collectives"] = counts.collectives;
  return out;
}

}  // namespace

void bind_freespace(nb::module_& m) {
  m.def(
      "lattice_green",
      [](Point spacing, Cell reach, int order) {
        auto values = bind::released([&] { return lattice_green_octant(spacing, reach, {1, 1, 1}, order); });
        return bind::to_array(std::move(values),
                              {std::size_t(reach[2] + 1), std::size_t(reach[1] + 1), std::size_t(reach[0] + 1)});
      },
      "spacing"_a, "reach"_a, "order"_a = 2,
      "Potential (k, j, i) of a unit charge at the origin of the lattice, offsets 0 .. reach, by the operator of order "
      "2 "
      "or 4.");

  m.def(
      "multipole_moments",
      [](bind::RealRows positions, bind::Reals charges, Point centre) {
        Harmonics<double> out{};
        for (std::size_t n = 0; n < charges.size(); ++n) {
          auto const r =
              regular_harmonics(positions(n, 0) - centre[0], positions(n, 1) - centre[1], positions(n, 2) - centre[2]);
          for (int h = 0; h < harmonic_count; ++h) {
            out[h].re += charges(n) * r[h].re;
            out[h].im += charges(n) * r[h].im;
          }
        }
        return from_moments(out);
      },
      "positions"_a, "charges"_a, "centre"_a, "Moments (l, m >= 0), place l (l + 1) / 2 + m, of point charges.");

  m.def(
      "translate_moments",
      [](Moments moments, Point shift) {
        Harmonics<double> in;
        for (int h = 0; h < harmonic_count; ++h) in[h] = {moments(h).real(), moments(h).imag()};
        return from_moments(translate_moments(in, shift[0], shift[1], shift[2]));
      },
      "moments"_a, "shift"_a, "Moments about a centre that lies `shift` before the old one.");

  m.def("kernel_table_bytes", &kernel_table_bytes,
        "Bytes of the tables of near fields that are alive in this process.");

  nb::class_<OpenWalls>(m, "FreeSpace")
      .def(
          "__init__",
          [](OpenWalls* self, std::shared_ptr<Hierarchy const> const& mesh, std::optional<double> acceptance,
             std::optional<double> lattice_limit, std::optional<double> separation, int order,
             int fewest_sharing_ranks) {
            Options options = options_beside(wall_mesh(*mesh), order);
            options.acceptance = acceptance.value_or(options.acceptance);
            options.lattice_limit = lattice_limit.value_or(options.lattice_limit);
            options.separation = separation.value_or(options.separation);
            options.fewest_sharing_ranks = fewest_sharing_ranks;
            new (self) OpenWalls(mesh, options);
          },
          "hierarchy"_a, "acceptance"_a = nb::none(), "lattice_limit"_a = nb::none(), "separation"_a = nb::none(),
          "order"_a = Options{}.operator_order, "fewest_sharing_ranks"_a = Options{}.fewest_sharing_ranks,
          nb::call_guard<nb::gil_scoped_release>())
      .def(
          "walls",
          [](OpenWalls& self, Field const& density) {
            auto values = bind::released([&] { return self.values(density); });
            nb::list out;
            for (OpenWalls::AtLevel const& at : self.levels) {
              std::vector<double> of_level;
              for (std::size_t place : at.places) of_level.push_back(values[place]);
              std::size_t const n = at.faces.size(), layers = of_level.size() / std::max<std::size_t>(n, 1);
              out.append(nb::make_tuple(bind::to_array(std::vector<int>(at.faces)),
                                        bind::to_array(std::vector<int>(at.cells), {n, 3}),
                                        layers == 2 ? bind::to_array(std::move(of_level), {n, layers})
                                                    : bind::to_array(std::move(of_level))));
            }
            return out;
          },
          "density"_a,
          "Potential behind the open walls of this rank's cells, by a charge density / eps0. Per level: faces, 2 axis "
          "+ "
          "side; cells (n, 3); and values (n,), all of free space; in order 4 (n, 2), of both ghosts. Collective.");

  nb::class_<WallGeometry>(m, "OpenWallPlans")
      .def(
          "__init__",
          [](WallGeometry* self, std::shared_ptr<Hierarchy const> const& mesh,
             std::vector<std::vector<int>> const& first_boxes, int fewest_sharing_ranks) {
            Options options = options_beside(wall_mesh(*mesh), 2);
            options.fewest_sharing_ranks = fewest_sharing_ranks;
            new (self) WallGeometry(shared_out(*mesh, first_boxes), options);
          },
          "hierarchy"_a, "first_boxes"_a = std::vector<std::vector<int>>{},
          "fewest_sharing_ranks"_a = Options{}.fewest_sharing_ranks, nb::call_guard<nb::gil_scoped_release>(),
          "What all ranks know of the open walls of a mesh. `first_boxes`: per level, where the run of each rank "
          "begins, ranks + 1 values, for ranks that need not exist; else those of the mesh. So many ranks and more "
          "share the nodes right below the top of the tree of charge while they are few. Local.")
      .def(
          "counts",
          [](WallGeometry const& self, int rank, std::vector<std::array<Point, 2>> const& charged) {
            if (rank < 0 || rank >= self.mesh.ranks())
              throw std::invalid_argument("rank is " + std::to_string(rank) + "; it must be one of 0 to " +
                                          std::to_string(self.mesh.ranks() - 1));
            WallCounts found;
            {
              nb::gil_scoped_release release;
              std::vector<ChargedRegion> regions;
              for (auto const& [lower, upper] : charged) regions.push_back({lower, upper});
              std::shared_ptr<WallGeometry const> const shared(&self, [](WallGeometry const*) {});
              found = count(WallPlan(shared, rank), options_beside(self.mesh, 2), regions);
            }
            return to_dict(found);
          },
          "rank"_a, "charged"_a = std::vector<std::array<Point, 2>>{},
          "Counts of one solve on a rank, by the plan that a solve follows: patches evaluated, their interactions "
          "`far` "
          "and `near`, nodes and leaves received; messages and bytes sent, of each kind and of all; messages received; "
          "bytes of each collective. Where charge is, blocks are taken to be full: in the regions `charged`, (lower, "
          "upper) in cells of the base, or everywhere. Local.");
}
