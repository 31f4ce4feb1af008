#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <optional>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "external/external_fields.hpp"

using namespace amrpic::external;

namespace {

typedef std::array<std::ptrdiff_t, 3> Sizes;
using NodeValues = nb::ndarray<Real const, nb::shape<-1, -1, -1, values_per_node>, nb::c_contig, nb::device::cpu>;
using Rows = nb::ndarray<nb::numpy, Real>;

std::shared_ptr<MapValues const> kept(std::optional<NodeValues> const& values) {
  if (!values) return nullptr;
  return std::make_shared<MapValues const>(values->data(), values->data() + values->size());
}

FieldMap field_map(bool axisymmetric, Real3 lower, Real3 spacing, Sizes cells, Sizes before,
                   std::optional<NodeValues> const& E, std::optional<NodeValues> const& B, Real scale, Real omega,
                   Real phase) {
  NodeValues const& any = E ? *E : B.value();
  std::array<Nodes, 3> axes;
  for (std::size_t d = 0; d < 3; ++d) axes[d] = {lower[d], spacing[d], cells[d], before[d], any.stride(d)};
  return {axisymmetric, axes, kept(E), kept(B), scale, {omega, phase}};
}

/// What particles fly by: rows of x, y, z.
struct Flights {
  bind::RealRows const &position, &velocity;
  Real time, from, to;

  std::size_t count() const { return position.shape(0); }
  template <class V, class Pick>
  Flight<V> flight(Pick const& pick) const {
    Flight<V> out{{}, {}, time, from, to};
    for (std::size_t d = 0; d < 3; ++d) {
      out.x[d] = pick([&](std::size_t n) { return position(n, d); });
      out.v[d] = pick([&](std::size_t n) { return velocity(n, d); });
    }
    return out;
  }
};

/// Means of E and B per flight, one after the other.
std::pair<std::vector<Real>, std::vector<Real>> means(ExternalFields const& fields, Flights const& flights) {
  std::pair<std::vector<Real>, std::vector<Real>> out;
  for (std::size_t n = 0; n < flights.count(); ++n) {
    Vector3<Real> E{}, B{};
    add_mean_field(fields, flights.flight<Real>([&](auto const& at) { return at(n); }), E, B);
    out.first.insert(out.first.end(), E.begin(), E.end());
    out.second.insert(out.second.end(), B.begin(), B.end());
  }
  return out;
}

/// The same, eight at a time.
std::pair<std::vector<Real>, std::vector<Real>> means_by_eights(ExternalFields const& fields, Flights const& flights) {
  std::pair<std::vector<Real>, std::vector<Real>> out;
  for (std::size_t first = 0; first < flights.count(); first += lane_count) {
    std::size_t const count = std::min(flights.count() - first, std::size_t(lane_count));
    Vector3<Lanes> E{}, B{};
    add_mean_field(fields, flights.flight<Lanes>([&](auto const& at) {
      Real eight[lane_count];
      for (std::size_t i = 0; i < lane_count; ++i) eight[i] = at(first + std::min(i, count - 1));
      return load<Lanes>(eight);
    }),
                   E, B);
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t d = 0; d < 3; ++d) out.first.push_back(E[d][int(i)]), out.second.push_back(B[d][int(i)]);
  }
  return out;
}

/// Their edges: first, last, when those were as two columns of three, normal and ends.
std::array<Rows, 5> edges(ExternalFields const& fields, Flights const& flights) {
  std::array<std::vector<Real>, 4> out;
  std::vector<Real> ends;
  for (std::size_t n = 0; n < flights.count(); ++n) {
    Vector3<Real> E{}, B{};
    Edges<Real> found;
    found.begin();
    add_mean_field(fields, flights.flight<Real>([&](auto const& at) { return at(n); }), E, B, found);
    std::array<Vector3<Real>, 4> const all{found.first, found.last, {found.entered, found.left, 0}, found.normal};
    for (std::size_t k = 0; k < 4; ++k) out[k].insert(out[k].end(), all[k].begin(), all[k].end());
    ends.push_back(found.ends);
  }
  auto const rows = [&](std::size_t k) { return Rows(bind::to_array(std::move(out[k]), {flights.count(), 3})); };
  return {rows(0), rows(1), rows(2), rows(3), bind::to_array(std::move(ends))};
}

}  // namespace

void bind_external(nb::module_& m) {
  nb::class_<Enge>(m, "EngeFringe")
      .def(nb::init<Real, std::array<Real, 6>, Real>(), "gap"_a = 0.0, "coefficient"_a = std::array<Real, 6>{},
           "reach"_a = 0.0, "The profile of a magnet; gap = 0: hard edges.");
  nb::class_<Uniform>(m, "UniformField").def(nb::init<Real3, Real3>(), "E"_a, "B"_a);
  nb::class_<Focusing>(m, "FocusingField").def(nb::init<Real3>(), "gradient"_a);
  nb::class_<Quadrupole>(m, "QuadrupoleField")
      .def(nb::init<Real, Real, Enge const&>(), "gradient"_a, "half"_a, "fringe"_a);
  nb::class_<Dipole>(m, "DipoleField")
      .def(
          "__init__",
          [](Dipole* self, Real field, Real half, Enge const& fringe, std::array<Real, 2> angle, Real gradient,
             Real turn, std::array<Real, 2> lost) {
            new (self) Dipole{field,
                              half,
                              fringe,
                              {std::sin(angle[0]), std::sin(angle[1])},
                              {std::cos(angle[0]), std::cos(angle[1])},
                              gradient,
                              turn,
                              lost};
          },
          "field"_a, "half"_a, "fringe"_a, "angle"_a = std::array<Real, 2>{}, "gradient"_a = 0.0, "turn"_a = 0.0,
          "lost"_a = std::array<Real, 2>{});
  nb::class_<Multipole>(m, "MultipoleField")
      .def(nb::init<std::array<Real, Multipole::most>, std::array<Real, Multipole::most>>(), "normal"_a, "skew"_a,
           "Factors of (x + i y)^n in B_y + i B_x, T/m^n.");
  nb::class_<Solenoid>(m, "SolenoidField")
      .def(nb::init<Real, Real, Real>(), "field"_a, "half"_a, "radius"_a, "radius = 0: hard edges.");
  nb::class_<Gap>(m, "GapField")
      .def(
          "__init__",
          [](Gap* self, Real voltage, Real half, Real omega, Real phase) {
            new (self) Gap{voltage, half, {omega, phase}};
          },
          "voltage"_a, "half"_a, "omega"_a, "phase"_a);
  nb::class_<Pillbox>(m, "PillboxField")
      .def(
          "__init__",
          [](Pillbox* self, Real field, Real omega, Real phase) {
            new (self) Pillbox{field, {omega, phase}};
          },
          "field"_a, "omega"_a, "phase"_a);
  nb::class_<FieldMap>(m, "MapField")
      .def(
          "__init__",
          [](FieldMap* self, bool axisymmetric, Real3 lower, Real3 spacing, Sizes cells, Sizes before,
             std::optional<NodeValues> E, std::optional<NodeValues> B, Real scale, Real omega, Real phase) {
            new (self) FieldMap(field_map(axisymmetric, lower, spacing, cells, before, E, B, scale, omega, phase));
          },
          "axisymmetric"_a, "lower"_a, "spacing"_a, "cells"_a, "before"_a, "E"_a = nb::none(), "B"_a = nb::none(),
          "scale"_a = 1.0, "omega"_a = 0.0, "phase"_a = 0.0,
          "Values (x, y, z, component), the fourth 0; `before` nodes and one at the other end lie outside.");

  nb::class_<Element>(m, "ExternalElement")
      .def(
          "__init__",
          [](Element* self, Real3 origin, std::array<Real3, 3> axes, std::array<Real, 2> extent, Kind kind,
             std::array<Real, 2> slope, Real reach) {
            new (self) Element{{origin, axes}, {{extent[0], slope[0]}, {extent[1], slope[1]}}, std::move(kind), reach};
          },
          "origin"_a, "axes"_a, "extent"_a, "kind"_a, "slope"_a = std::array<Real, 2>{},
          "reach"_a = std::numeric_limits<Real>::infinity(),
          "The extent is along z; its lower and upper end are planes that rise with x by the slopes. Reach: from z, "
          "m.");

  nb::class_<ExternalFields>(m, "ExternalFields")
      .def(nb::init<std::vector<Element>>(), "elements"_a)
      .def(
          "seen_from",
          [](ExternalFields const& self, Real3 origin, std::array<Real3, 3> axes) {
            return self.seen_from({origin, axes});
          },
          "origin"_a, "axes"_a, "The same fields in coordinates with another origin (m) and other unit vectors.")
      .def_prop_ro("electric", &ExternalFields::electric)
      .def_prop_ro("magnetic", &ExternalFields::magnetic)
      .def(
          "edges",
          [](ExternalFields const& self, bind::RealRows position, bind::RealRows velocity, Real from, Real to) {
            return edges(self, {position, velocity, 0, from, to});
          },
          "position"_a, "velocity"_a, "start"_a, "stop"_a,
          "What `means` has in B from planes: where flights enter a field and where they leave it (T), when they do "
          "(s, two columns and one of zeros), "
          "the normals of these planes, and 1 for flights that pass the end of a field.")
      .def(
          "means",
          [](ExternalFields const& self, bind::RealRows position, bind::RealRows velocity, Real time, Real from,
             Real to, bool by_eights) {
            std::pair<std::vector<Real>, std::vector<Real>> out;
            std::size_t const n = position.shape(0);
            {
              nb::gil_scoped_release release;
              Flights const flights{position, velocity, time, from, to};
              out = by_eights ? means_by_eights(self, flights) : means(self, flights);
            }
            return std::pair<Rows, Rows>{bind::to_array(std::move(out.first), {n, 3}),
                                         bind::to_array(std::move(out.second), {n, 3})};
          },
          "position"_a, "velocity"_a, "time"_a, "start"_a, "stop"_a, "by_eights"_a = true,
          "Means of E (V/m) and B (T) along flights position + velocity τ, τ from `start` to `stop` (s).");
}
