#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include <complex>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "freespace/density.hpp"
#include "freespace/free_space.hpp"
#include "freespace/lattice_green.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace amrpic;
using namespace amrpic::freespace;

namespace {

using Ints = nb::ndarray<int const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Values = nb::ndarray<double const, nb::ndim<3>, nb::f_contig, nb::device::cpu>;
using Moments = nb::ndarray<std::complex<double> const, nb::shape<harmonic_count>, nb::c_contig, nb::device::cpu>;

Point point(bind::RealRows const& rows, std::size_t n) { return {rows(n, 0), rows(n, 1), rows(n, 2)}; }

nb::ndarray<nb::numpy, std::complex<double>> from_moments(Harmonics<double> const& moments) {
  std::vector<std::complex<double>> out;
  for (auto const& m : moments) out.emplace_back(m.re, m.im);
  return bind::to_array(std::move(out));
}

}  // namespace

void bind_freespace(nb::module_& m) {
  m.def(
      "lattice_green",
      [](Point spacing, Cell reach) {
        std::vector<double> values;
        {
          nb::gil_scoped_release release;
          values = lattice_green_octant(spacing, reach);
        }
        return bind::to_array(std::move(values),
                              {std::size_t(reach[2] + 1), std::size_t(reach[1] + 1), std::size_t(reach[0] + 1)});
      },
      "spacing"_a, "reach"_a, "Potential (k, j, i) of a unit charge at the origin of the lattice, offsets 0 .. reach.");

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

  nb::class_<FreeSpace>(m, "FreeSpace")
      .def(
          "__init__",
          [](FreeSpace* self, int comm, Point lower, Point spacing, Cell cells, double acceptance, double lattice_limit,
             double separation) {
            Options options;
            options.acceptance = acceptance;
            options.lattice_limit = lattice_limit;
            options.separation = separation;
            new (self) FreeSpace(Communicator(MPI_Comm_f2c(comm)), Lattice{lower, spacing, cells}, options);
          },
          "comm"_a, "lower"_a, "spacing"_a, "cells"_a, "acceptance"_a = Options{}.acceptance,
          "lattice_limit"_a = Options{}.lattice_limit, "separation"_a = Options{}.separation)
      .def(
          "set_charges",
          [](FreeSpace& self, bind::RealRows positions, bind::Reals charges, Ints levels) {
            nb::gil_scoped_release release;
            std::vector<PointCharge> local(charges.size());
            for (std::size_t n = 0; n < local.size(); ++n) local[n] = {point(positions, n), charges(n), levels(n)};
            self.set_charges(local);
          },
          "positions"_a, "charges"_a, "levels"_a)
      .def(
          "set_box",
          [](FreeSpace& self, int level, Cell lower, Values charges) {
            nb::gil_scoped_release release;
            Cell upper;
            for (int d = 0; d < 3; ++d) upper[d] = lower[d] + int(charges.shape(d)) - 1;
            self.set_charges(std::vector<ChargeBox>{{level, lower, upper, charges.data(), 1.0}});
          },
          "level"_a, "lower"_a, "charges"_a, "This rank's charges as one box of cells, x fastest.")
      .def(
          "set_density",
          [](FreeSpace& self, Field const& density) {
            self.set_charges(charges_of(density, density.hierarchy(), 1.0));
          },
          "density"_a, nb::call_guard<nb::gil_scoped_release>(),
          "The charges of a density, over all levels; what it holds in covered cells does not count.")
      .def(
          "wall_planes",
          [](FreeSpace const& self, std::array<bool, 6> open) {
            std::array<std::vector<double>, 6> planes;
            {
              nb::gil_scoped_release release;
              planes = self.wall_planes(open);
            }
            nb::list out;
            for (int face = 0; face < 6; ++face) {
              if (!open[face]) {
                out.append(nb::none());
                continue;
              }
              Cell const& cells = self.lattice().cells;
              auto const axes = tangential_axes(face / 2);
              out.append(
                  bind::to_array(std::move(planes[face]), {std::size_t(cells[axes[1]]), std::size_t(cells[axes[0]])}));
            }
            return out;
          },
          "open"_a, "Per face an array (upper axis, lower axis), or None for walls that are not open.")
      .def(
          "potential",
          [](FreeSpace const& self, bind::RealRows positions, Ints levels) {
            std::vector<double> values;
            {
              nb::gil_scoped_release release;
              std::vector<PointTarget> local(levels.size());
              for (std::size_t n = 0; n < local.size(); ++n) local[n] = {point(positions, n), levels(n)};
              values = self.potential(local);
            }
            return bind::to_array(std::move(values));
          },
          "positions"_a, "levels"_a);
}
