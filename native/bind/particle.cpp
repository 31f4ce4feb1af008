#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <optional>

#include "bind/bind.hpp"
#include "bind/communicator.hpp"
#include "bind/convert.hpp"
#include "kokkos/particles.hpp"
#include "particle/apertures.hpp"
#include "particle/arrange.hpp"
#include "particle/array_pool.hpp"
#include "particle/beam_amplitudes.hpp"
#include "particle/beam_moments.hpp"
#include "particle/callers_columns.hpp"
#include "particle/count_per_brick.hpp"
#include "particle/deposit.hpp"
#include "particle/gather.hpp"
#include "particle/migrate.hpp"
#include "particle/moments.hpp"
#include "particle/push.hpp"
#include "particle/random.hpp"

namespace {

/// (n, 3), each column contiguous.
using Columns = nb::ndarray<Real, nb::shape<-1, 3>, nb::device::cpu>;
using ConstColumns = nb::ndarray<Real const, nb::shape<-1, 3>, nb::device::cpu>;
template <class T>
using Row = nb::ndarray<T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

template <class Array>
std::array<Real*, 3> columns(Array const& array) {
  Real* first = const_cast<Real*>(array.data());
  return {first, first + array.stride(1), first + 2 * array.stride(1)};
}

template <class Array>
std::array<Real*, 3> columns(std::optional<Array> const& array) {
  return array ? columns(*array) : std::array<Real*, 3>{};
}

/// One value each, or one for all, which are 0 numbers apart.
using OnePerParticle = nb::ndarray<Real const, nb::ndim<1>, nb::device::cpu>;

/// Particles as Python holds them. The kernels that take a view of them do not write where they should not.
template <class Vectors, class Momenta, class Ids>
ParticleView view(Vectors const& position, Momenta const& momentum, OnePerParticle const& weight, Ids const& id) {
  return {std::int64_t(position.shape(0)),  columns(position),     columns(momentum),
          const_cast<Real*>(weight.data()), weight.stride(0) == 0, const_cast<std::int64_t*>(id.data())};
}

Clouds clouds_of(Shape shape, bool matched, bool by_kokkos) {
  return {shape, matched, by_kokkos ? &kokkos::tile_kernels() : nullptr};
}

/// Particles as Python gives them to what keeps them for a while.
struct GivenParticles {
  ConstColumns position;
  std::optional<ConstColumns> momentum;
  OnePerParticle weight;
  Row<std::int64_t const> id;

  ParticleView all() const { return view(position, momentum, weight, id); }
};

/// A migration with the arrays that it reads until it has started.
struct BoundMigration : Migration {
  BoundMigration(ParticleMesh& mesh, Servers servers, GivenParticles given, ParticleList const& gone, bool has_weights)
      : Migration(mesh, std::move(servers), given.all(), gone, has_weights), arrays(std::move(given)) {}

  std::optional<GivenParticles> arrays;
};

/// A deposition with the arrays that it reads.
struct BoundDeposition : Deposition {
  BoundDeposition(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, GivenParticles given,
                  Row<std::int64_t const> slot_starts, Real charge, Field& density)
      : Deposition(mesh, remote, clouds, given.all(), slot_starts.data(), charge, density),
        particles(std::move(given)),
        starts(std::move(slot_starts)) {}

  GivenParticles particles;
  Row<std::int64_t const> starts;
};

Flights flights(ConstColumns const& start, ConstColumns const& end, Real3 const& start_offset,
                Real3 const& end_offset) {
  return {std::int64_t(start.shape(0)), columns(start), columns(end), start_offset, end_offset};
}

/// Flights, what they meet, and after which share of their way.
nb::tuple to_arrays(std::vector<Encounter> const& encounters) {
  std::vector<std::int64_t> flight, what;
  std::vector<Real> share;
  for (Encounter const& e : encounters) {
    flight.push_back(e.flight);
    what.push_back(e.what);
    share.push_back(e.share);
  }
  return nb::make_tuple(bind::to_array(std::move(flight)), bind::to_array(std::move(what)),
                        bind::to_array(std::move(share)));
}

}  // namespace

void bind_particle(nb::module_& m) {
  m.def(
      "recycled",
      [](std::size_t bytes) {
        void* const block = take_block(bytes);
        nb::capsule owner(block, [](void* p) noexcept { give_block(p); });
        return nb::ndarray<nb::numpy, std::uint8_t, nb::ndim<1>>(block, {bytes}, owner);
      },
      "bytes"_a, "Memory whose former owner is gone, if there is such; with whatever it holds.");
  m.def("idle_bytes", &idle_bytes, "Memory that waits for `recycled` to be called again.");

  nb::class_<ReservedMemory>(m, "ReservedMemory", "So many more bytes wait for `recycled` as long as this lives.")
      .def(nb::init<std::size_t>(), "bytes"_a);

  nb::class_<ParticleMesh>(m, "ParticleMesh")
      .def(nb::init<std::shared_ptr<Hierarchy const>>(), "hierarchy"_a, nb::call_guard<nb::gil_scoped_release>());

  nb::class_<RemoteBricks>(m, "RemoteBricks")
      .def(
          "__init__",
          [](RemoteBricks* self, std::shared_ptr<Hierarchy const> hierarchy) {
            new (self) RemoteBricks(std::move(hierarchy), {}, {});
          },
          "hierarchy"_a, "None.")
      .def_prop_ro(
          "bricks",
          [](RemoteBricks const& self) {
            std::vector<int> out;
            for (Home const& brick : self.bricks()) out.insert(out.end(), {brick.level, brick.box, brick.brick});
            return bind::to_array(std::move(out), {self.bricks().size(), 3});
          },
          nb::rv_policy::automatic, "Level, box, and number in the box, of each; int (n, 3).")
      .def_prop_ro(
          "cells",
          [](RemoteBricks const& self) {
            std::vector<Box> out;
            for (Home const& brick : self.bricks()) out.push_back(cells_of(self.hierarchy(), brick));
            return bind::from_boxes(out);
          },
          nb::rv_policy::automatic, "Those of each, in the indices of its level; int (n, 6).")
      .def("__len__", [](RemoteBricks const& self) { return self.bricks().size(); });

  m.def(
      "brick_regions",
      [](std::shared_ptr<Hierarchy const> hierarchy, bind::IntRows bricks, bool matched) {
        BrickCurve const curve(hierarchy->domain());
        std::vector<std::int64_t> places, parts;
        for (std::size_t n = 0; n < bricks.shape(0); ++n) {
          BrickRegions const of = regions_of(*hierarchy, {bricks(n, 0), bricks(n, 1), bricks(n, 2)}, matched);
          places.push_back(curve.place(of.home.level, of.cells.lower));
          for (Region const& region : of.regions)
            for (Overlap const& part : region.parts)
              parts.insert(parts.end(), {std::int64_t(n), region.level, part.box, part.part.cells()});
        }
        std::size_t const rows = parts.size() / 4;
        return nb::make_tuple(bind::to_array(std::move(places)), bind::to_array(std::move(parts), {rows, 4}));
      },
      "hierarchy"_a, "bricks"_a, "matched"_a,
      "What passes because of bricks, given by rows of level, box and number in it, where others serve them than own "
      "the "
      "cells: the place of each on the curve, and rows of brick, level, box and number of cells, of which the box's "
      "owner "
      "and the server exchange a component each way. From the boxes alone, whoever owns them.");

  m.attr("END_OF_CURVE") = nb::int_(BrickCurve::end);
  m.attr("PLACES_PER_BRICK") = nb::int_(BrickCurve::per_brick);
  m.attr("MOST_PARTICLES") = nb::int_(Migration::most);  // of a rank

  nb::class_<BoundMigration>(m, "Migration")
      .def(
          "__init__",
          [](BoundMigration* self, ParticleMesh& mesh, Row<std::int64_t const> servers, ConstColumns position,
             std::optional<ConstColumns> momentum, OnePerParticle weight, Row<std::int64_t const> id,
             Row<std::int64_t const> gone, bool has_weights) {
            nb::gil_scoped_release release;
            ParticleList const without{gone.data(), gone.data() + gone.shape(0)};
            std::vector<std::int64_t> first(servers.data(), servers.data() + servers.shape(0));
            Hierarchy const& hierarchy = mesh.hierarchy();
            new (self) BoundMigration(mesh, Servers(hierarchy.domain(), std::move(first), hierarchy.comm().rank()),
                                      {position, momentum, weight, id}, without, has_weights);
          },
          "mesh"_a, "servers"_a, "position"_a, "momentum"_a.none(), "weight"_a, "id"_a, "gone"_a, "has_weights"_a,
          nb::keep_alive<1, 2>())
      .def_prop_ro(
          "lost", [](BoundMigration const& self) { return bind::to_array(self.lost()); }, nb::rv_policy::automatic)
      .def_prop_ro("arriving", &Migration::arriving)
      .def_prop_ro("from_others", &Migration::from_others)
      .def_prop_ro("bricks", &Migration::bricks)
      .def(
          "start",
          [](BoundMigration& self, Columns position, std::optional<Columns> momentum, OnePerParticle weight,
             Row<std::int64_t> id) {
            auto finite = bind::released([&] { return self.start(view(position, momentum, weight, id)); });
            self.arrays.reset();
            return finite;
          },
          "position"_a, "momentum"_a.none(), "weight"_a, "id"_a)
      .def(
          "receive",
          [](BoundMigration& self, Columns position, std::optional<Columns> momentum, OnePerParticle weight,
             Row<std::int64_t> id) {
            nb::gil_scoped_release release;
            self.receive(view(position, momentum, weight, id));
          },
          "position"_a, "momentum"_a.none(), "weight"_a, "id"_a)
      .def(
          "carry",
          [](BoundMigration const& self, nb::ndarray<Real const, nb::ndim<2>, nb::c_contig, nb::device::cpu> from,
             nb::ndarray<Real, nb::ndim<2>, nb::c_contig, nb::device::cpu> to) {
            nb::gil_scoped_release release;
            std::vector<Real const*> old;
            std::vector<Real*> fresh;
            for (std::size_t c = 0; c < from.shape(0); ++c) {
              old.push_back(from.data() + c * from.shape(1));
              fresh.push_back(to.data() + c * to.shape(1));
            }
            self.carry(old, fresh);
          },
          "columns"_a, "out"_a, "After `receive`: further columns, (columns, n), of the same particles. Collective.")
      .def_prop_ro(
          "starts", [](BoundMigration const& self) { return bind::to_array(self.starts()); }, nb::rv_policy::automatic)
      .def(
          "remote",
          [](BoundMigration const& self, std::shared_ptr<Hierarchy const> hierarchy) {
            return std::make_unique<RemoteBricks>(std::move(hierarchy), self.remote(), self.first_servers());
          },
          "hierarchy"_a);

  nb::class_<Arrangement>(m, "Arrangement")
      .def(
          "__init__",
          [](Arrangement* self, ParticleMesh& mesh, Row<std::int64_t const> servers, ConstColumns position,
             Row<std::int64_t const> id) {
            nb::gil_scoped_release release;
            std::vector<std::int64_t> first(servers.data(), servers.data() + servers.shape(0));
            Hierarchy const& hierarchy = mesh.hierarchy();
            ParticleView const particles{std::int64_t(position.shape(0)),     columns(position), {}, nullptr, true,
                                         const_cast<std::int64_t*>(id.data())};
            Servers const all(hierarchy.domain(), std::move(first), hierarchy.comm().rank());
            new (self) Arrangement(arrange(mesh, all, particles));
          },
          "mesh"_a, "servers"_a, "position"_a, "id"_a)
      .def_prop_ro(
          "places", [](Arrangement const& self) { return bind::to_array(self.places); }, nb::rv_policy::automatic)
      .def_prop_ro(
          "starts", [](Arrangement const& self) { return bind::to_array(self.starts); }, nb::rv_policy::automatic)
      .def(
          "remote",
          [](Arrangement const& self, std::shared_ptr<Hierarchy const> hierarchy) {
            return std::make_unique<RemoteBricks>(std::move(hierarchy), self.remote, self.first_servers);
          },
          "hierarchy"_a);

  nb::enum_<Aperture::Hole>(m, "Hole")
      .value("ellipse", Aperture::Hole::ellipse)
      .value("rectangle", Aperture::Hole::rectangle);
  nb::class_<Whereabouts>(m, "Whereabouts")
      .def(nb::init<Real3, std::array<Real3, 3>, Real>(), "origin"_a, "axes"_a, "reach"_a,
           "Origin (m) and unit vectors; flights that start farther from z miss.")
      .def_prop_ro("is_turned", [](Whereabouts const& of) { return !of.is_laboratory(); });
  nb::class_<Aperture>(m, "Aperture")
      .def(
          "__init__",
          [](Aperture* self, Aperture::Hole hole, std::array<Real, 2> centre, std::array<Real, 2> half_width,
             std::array<Real, 2> z, Whereabouts const& where) {
            new (self) Aperture{hole, centre, half_width, {z[0], z[1]}, where};
          },
          "hole"_a, "centre"_a, "half_width"_a, "z"_a, "where"_a = Whereabouts{})
      .def_ro("where", &Aperture::where)
      .def_ro("hole", &Aperture::hole)
      .def_ro("centre", &Aperture::centre)
      .def_ro("half_width", &Aperture::half_width)
      .def_prop_ro("z", [](Aperture const& of) {
        return std::array<Real, 2>{of.z.lower, of.z.upper};
      });
  nb::class_<Screen>(m, "Screen")
      .def(nb::init<Real, Whereabouts const&>(), "z"_a, "where"_a = Whereabouts{})
      .def_ro("z", &Screen::z)
      .def_prop_ro("is_turned", [](Screen const& of) { return !of.where.is_laboratory(); });
  m.def(
      "first_encounters",
      [](std::vector<Aperture> const& apertures, ConstColumns start, ConstColumns end, Real3 start_offset,
         Real3 end_offset) {
        return to_arrays(first_encounters(apertures, flights(start, end, start_offset, end_offset)));
      },
      "apertures"_a, "start"_a, "end"_a, "start_offset"_a, "end_offset"_a);
  m.def(
      "crossings",
      [](std::vector<Screen> const& screens, ConstColumns start, ConstColumns end, Real3 start_offset,
         Real3 end_offset) { return to_arrays(crossings(screens, flights(start, end, start_offset, end_offset))); },
      "screens"_a, "start"_a, "end"_a, "start_offset"_a, "end_offset"_a);

  m.def(
      "count_per_brick",
      [](std::shared_ptr<Hierarchy const> hierarchy, ConstColumns position) {
        std::vector<std::int64_t> places, counts;
        {
          nb::gil_scoped_release release;
          Locator locator(std::move(hierarchy));
          for (BrickCount const& brick : count_per_brick(locator, columns(position), std::int64_t(position.shape(0))))
            places.push_back(brick.place), counts.push_back(brick.count);
        }
        return nb::make_tuple(bind::to_array(std::move(places)), bind::to_array(std::move(counts)));
      },
      "hierarchy"_a, "position"_a, "Places on the curve, ascending, and numbers of particles.");

  nb::enum_<Shape>(m, "Shape")
      .value("nearest_grid_point", Shape::nearest_grid_point)
      .value("cloud_in_cell", Shape::cloud_in_cell)
      .value("triangular", Shape::triangular);

  nb::class_<BoundDeposition>(m, "Deposition")
      .def(
          "__init__",
          [](BoundDeposition* self, ParticleMesh& mesh, RemoteBricks const& remote, Shape shape, bool matched,
             bool kokkos, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
             Row<std::int64_t const> id, Row<std::int64_t const> starts, Real charge, Field& density) {
            nb::gil_scoped_release release;
            new (self) BoundDeposition(mesh, remote, clouds_of(shape, matched, kokkos),
                                       {position, momentum, weight, id}, starts, charge, density);
          },
          "mesh"_a, "remote"_a, "shape"_a, "matched"_a, "kokkos"_a, "position"_a, "momentum"_a, "weight"_a, "id"_a,
          "starts"_a, "charge"_a, "density"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 13>())
      .def(
          "begin",
          [](BoundDeposition& self, BoundMigration& migration) {
            nb::gil_scoped_release release;
            self.begin(migration.under_way(), [&] { migration.poll(); });
          },
          "migration"_a, "Those that are in their places while others are under way.")
      .def("finish", &BoundDeposition::finish, nb::call_guard<nb::gil_scoped_release>(), "Collective.")
      .def_prop_ro("left", &BoundDeposition::left, "How many particles of this rank `finish` is to deposit.");

  m.def(
      "gather",
      [](ParticleMesh& mesh, RemoteBricks const& remote, Shape shape, bool matched, bool kokkos,
         ElectricField const& field, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, Row<std::int64_t const> starts, Columns out) {
        nb::gil_scoped_release release;
        gather(mesh, remote, clouds_of(shape, matched, kokkos), field, view(position, momentum, weight, id),
               starts.data(), columns(out));
      },
      "mesh"_a, "remote"_a, "shape"_a, "matched"_a, "kokkos"_a, "field"_a, "position"_a, "momentum"_a, "weight"_a,
      "id"_a, "starts"_a, "out"_a);

  m.def(
      "take_column",
      [](nb::ndarray<Real const, nb::ndim<1>, nb::device::cpu> from, std::optional<Row<std::int64_t const>> places,
         Real shift, Real scale, std::optional<Row<Real>> out) {
        std::size_t const count = places ? places->shape(0) : from.shape(0);
        if (out && out->shape(0) != count) throw std::invalid_argument("as many places as values are asked for");
        auto of = bind::released([&] {
          return take_column({from.data(), from.stride(0)}, places ? places->data() : nullptr, std::int64_t(count),
                             shift, scale, out ? out->data() : nullptr);
        });
        return nb::make_tuple(of.sum, of.magnitude, of.least, of.greatest);
      },
      "column"_a, "places"_a.none(), "shift"_a, "scale"_a, "out"_a.none(),
      "Values at places, or all, less `shift` times `scale` into `out`; Σ v, Σ |v|, the least and the greatest v.");
  m.def(
      "put_into_places",
      [](ConstColumns values, Row<std::int64_t const> places, Real3 factors, Columns out) {
        nb::gil_scoped_release release;
        put_into_places(columns(values), {places.data(), std::int64_t(places.shape(0)), factors}, columns(out));
      },
      "values"_a, "places"_a, "factors"_a, "out"_a, "Each vector times three factors to places[n].");

  m.def(
      "gather_into_places",
      [](ParticleMesh& mesh, RemoteBricks const& remote, Shape shape, bool matched, bool kokkos,
         ElectricField const& field, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, Row<std::int64_t const> starts, Row<std::int64_t const> places, Real3 factors,
         Columns out) {
        nb::gil_scoped_release release;
        gather_into_places(mesh, remote, clouds_of(shape, matched, kokkos), field, view(position, momentum, weight, id),
                           starts.data(), {places.data(), std::int64_t(places.shape(0)), factors}, columns(out));
      },
      "mesh"_a, "remote"_a, "shape"_a, "matched"_a, "kokkos"_a, "field"_a, "position"_a, "momentum"_a, "weight"_a,
      "id"_a, "starts"_a, "places"_a, "factors"_a, "out"_a, "What `gather` finds, times three factors, to places[n].");

  nb::enum_<Pusher>(m, "Pusher").value("boris", Pusher::boris).value("higuera_cary", Pusher::higuera_cary);

  m.def(
      "push",
      [](ParticleMesh& mesh, RemoteBricks const& remote, Shape shape, bool matched, bool kokkos,
         ElectricField const& field, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, Row<std::int64_t const> starts, OnePerParticle charge, OnePerParticle inverse_mass,
         Real before, Real after, Real flight, Pusher pusher, Real3 beta, std::optional<ConstColumns> electric,
         std::optional<ConstColumns> magnetic, Columns momentum_out, Columns position_out,
         std::optional<Columns> between, ExternalFields const* external, Real time, Real3 shift) {
        nb::gil_scoped_release release;
        Motion const motion{charge.data(),
                            inverse_mass.data(),
                            charge.stride(0) == 0,
                            before,
                            after,
                            flight,
                            pusher,
                            beta,
                            {columns(electric), columns(magnetic)},
                            external,
                            time,
                            shift};
        push(mesh, remote, clouds_of(shape, matched, kokkos), field, view(position, momentum, weight, id),
             starts.data(), motion, {columns(momentum_out), columns(position_out), columns(between)});
      },
      "mesh"_a, "remote"_a, "shape"_a, "matched"_a, "kokkos"_a, "field"_a, "position"_a, "momentum"_a, "weight"_a,
      "id"_a, "starts"_a, "charge"_a, "inverse_mass"_a, "before"_a, "after"_a, "flight"_a, "pusher"_a, "beta"_a,
      "electric"_a.none(), "magnetic"_a.none(), "momentum_out"_a, "position_out"_a, "between"_a.none(),
      "external"_a.none(), "time"_a, "shift"_a);
  m.def(
      "push_one",
      [](Real3 position, Real3 momentum, Real charge, Real mass, Real before, Real after, Real flight, Pusher pusher,
         ExternalFields const& external, Real time) {
        Motion motion{};
        motion.before = before, motion.after = after, motion.flight = flight, motion.pusher = pusher;
        motion.external = &external, motion.time = time;
        OneParticle const out = push_one({position, momentum, charge, 1 / mass}, motion);
        return std::pair<Real3, Real3>{out.position, out.momentum};
      },
      "position"_a, "momentum"_a, "charge"_a, "mass"_a, "before"_a, "after"_a, "flight"_a, "pusher"_a, "external"_a,
      "time"_a, "Place (m) and momentum (kg m/s) of one particle in the fields of elements alone.");

  nb::class_<BeamSums<Real>>(m, "BeamSums")
      .def_ro("weight", &BeamSums<Real>::weight)
      .def_ro("kinetic_energy", &BeamSums<Real>::kinetic_energy)
      .def_ro("momentum", &BeamSums<Real>::momentum)
      .def_ro("mean_x", &BeamSums<Real>::mean_x)
      .def_ro("xx", &BeamSums<Real>::xx)
      .def_ro("uu", &BeamSums<Real>::uu)
      .def_ro("xu", &BeamSums<Real>::xu);
  m.def(
      "beam_sums",
      [](bind::Ranks comm, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, OnePerParticle mass, ConstColumns later, Real share, Real3 centre, Real3 period) {
        nb::gil_scoped_release release;
        BeamView const beam{view(position, momentum, weight, id), mass.data(), mass.stride(0) == 0, columns(later),
                            share};
        return beam_sums(bind::communicator(comm), beam, {centre, period});
      },
      "comm"_a, "position"_a, "momentum"_a, "weight"_a, "id"_a, "mass"_a, "later"_a, "share"_a, "centre"_a, "period"_a);

  nb::class_<BeamParts>(m, "BeamParts")
      .def(
          "__init__",
          [](BeamParts* self, std::vector<std::int64_t> starts, std::vector<int> groups, std::vector<Real> lower,
             std::vector<Real> per_length, int slices, std::vector<Real3> const& centres,
             std::vector<Real3> const& periods) {
            std::vector<NearestImages> images;
            for (std::size_t group = 0; group < centres.size(); ++group)
              images.push_back({centres[group], periods.at(group)});
            new (self) BeamParts{std::move(starts), std::move(groups), std::move(lower), std::move(per_length), slices,
                                 std::move(images)};
          },
          "starts"_a, "groups"_a, "lower"_a, "per_length"_a, "slices"_a = 1, "centres"_a = std::vector<Real3>{},
          "periods"_a = std::vector<Real3>{},
          "Images nearest to the centres (groups, 3) stand for particles where periods (groups, 3) are not 0; m.");
  m.def(
      "circular_sums",
      [](bind::Ranks comm, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, OnePerParticle mass, ConstColumns later, Real share, BeamParts const& parts,
         Real3 lower, Real3 period) {
        nb::gil_scoped_release release;
        BeamView const beam{view(position, momentum, weight, id), mass.data(), mass.stride(0) == 0, columns(later),
                            share};
        return circular_sums(bind::communicator(comm), beam, parts, lower, period);
      },
      "comm"_a, "position"_a, "momentum"_a, "weight"_a, "id"_a, "mass"_a, "later"_a, "share"_a, "parts"_a, "lower"_a,
      "period"_a);
  nb::class_<BeamMoments>(m, "BeamMoments")
      .def_ro("count", &BeamMoments::count)
      .def_ro("weight", &BeamMoments::weight)
      .def_ro("mean", &BeamMoments::centre)
      .def_ro("second", &BeamMoments::second)
      .def_ro("planes", &BeamMoments::planes)
      .def_ro("lowest", &BeamMoments::lowest)
      .def_ro("highest", &BeamMoments::highest);
  m.def(
      "beam_moments",
      [](bind::Ranks comm, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, OnePerParticle mass, ConstColumns later, Real share, BeamParts const& parts) {
        nb::gil_scoped_release release;
        BeamView const beam{view(position, momentum, weight, id), mass.data(), mass.stride(0) == 0, columns(later),
                            share};
        return beam_moments(bind::communicator(comm), beam, parts);
      },
      "comm"_a, "position"_a, "momentum"_a, "weight"_a, "id"_a, "mass"_a, "later"_a, "share"_a, "parts"_a);
  m.def("joined_moments", &joined_moments, "parts"_a);
  m.def(
      "amplitude_quantiles",
      [](bind::Ranks comm, ConstColumns position, ConstColumns momentum, OnePerParticle weight,
         Row<std::int64_t const> id, OnePerParticle mass, ConstColumns later, Real share,
         std::vector<BeamParts> const& layers, std::vector<std::array<Real, 6>> const& centres,
         std::vector<std::array<Real3, 3>> const& forms, std::vector<std::array<Real, amplitude_kinds>> const& typical,
         std::vector<Real> const& fractions) {
        nb::gil_scoped_release release;
        BeamView const beam{view(position, momentum, weight, id), mass.data(), mass.stride(0) == 0, columns(later),
                            share};
        std::vector<AmplitudeFrame> frames;
        for (std::size_t part = 0; part < centres.size(); ++part)
          frames.push_back({centres[part], forms[part], typical[part]});
        return amplitude_quantiles(bind::communicator(comm), beam, layers, frames, fractions);
      },
      "comm"_a, "position"_a, "momentum"_a, "weight"_a, "id"_a, "mass"_a, "later"_a, "share"_a, "layers"_a, "centres"_a,
      "forms"_a, "typical"_a, "fractions"_a);

  m.def(
      "uniforms",
      [](std::uint64_t seed, std::uint64_t stream, std::uint64_t step, Row<std::int64_t const> id,
         nb::ndarray<Real, nb::shape<4, -1>, nb::c_contig, nb::device::cpu> out) {
        nb::gil_scoped_release release;
        fill_uniforms(seed, stream, step, id.data(), id.shape(0), out.data());
      },
      "seed"_a, "stream"_a, "step"_a, "id"_a, "out"_a,
      "Fill out (4, n) with numbers in (0, 1) that depend on the arguments alone.");
}
