#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "gmls/problem.hpp"

namespace {

using Numbers = nb::ndarray<LocalIndex const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Places = nb::ndarray<Real const, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Weights = nb::ndarray<Real, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using ExactWeights = nb::ndarray<Real, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Judgements = nb::ndarray<Real, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Paths = nb::ndarray<std::int8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

/// Of rows, terms, places, half widths or None, and coefficients.
gmls::Functionals to_functionals(nb::object const& given) {
  gmls::Functionals out;
  if (given.is_none()) return out;
  auto const parts = nb::cast<nb::tuple>(given);
  auto const terms = nb::cast<bind::IntRows>(parts[1]);
  auto const places = nb::cast<Places>(parts[2]);
  out.rows = nb::cast<int>(parts[0]);
  for (std::size_t t = 0; t < terms.shape(0); ++t)
    out.terms.push_back({terms(t, 0), terms(t, 1), terms(t, 2), {terms(t, 3), terms(t, 4), terms(t, 5)}});
  out.count = places.shape(0);
  out.places = int(places.shape(1));
  out.dimension = int(places.shape(2));
  out.place = places.data();
  if (!parts[3].is_none()) out.half = nb::cast<Places>(parts[3]).data();
  out.coefficient = nb::cast<bind::RealRows>(parts[4]).data();
  return out;
}

/// The problem, and the arrays that it reads.
struct BoundProblem {
  gmls::Problem problem;
  nb::object arrays;
};

}  // namespace

void bind_gmls(nb::module_& m) {
  m.def(
      "gmls_exponents",
      [](int dimension, int order) {
        std::vector<int> out;
        gmls::Monomials const monomials(dimension, order);
        for (auto const& e : monomials.exponents()) out.insert(out.end(), e.begin(), e.begin() + dimension);
        return bind::to_array(std::move(out), {std::size_t(monomials.count()), std::size_t(dimension)});
      },
      "dimension"_a, "order"_a, "Exponents of the monomials, (n, dimension), in the order of their coefficients.");

  nb::class_<BoundProblem>(m, "GmlsProblem", "Stencils of generalized moving least squares; amrpic.gmls makes it.")
      .def(
          "__init__",
          [](BoundProblem* self, int order, int components, bind::RealRows basis, int weight,
             std::array<Real, 2> parameters, std::array<Real, 3> aspect, bind::RealRows targets, bind::Reals reach,
             bind::Starts start, Numbers index, bind::RealRows sites, nb::object samples, nb::object wanted,
             nb::object exact) {
            int const dimension = int(targets.shape(1));
            gmls::Problem problem(dimension, order);
            problem.components = components;
            problem.basis.assign(basis.data(), basis.data() + basis.size());
            problem.weight = {gmls::WeightKind(weight), parameters[0], parameters[1]};
            problem.aspect = aspect;
            problem.count = targets.shape(0);
            problem.targets = targets.data();
            problem.reach = reach.data();
            problem.start = start.data();
            problem.index = index.data();
            problem.sites = sites.data();
            problem.samples = to_functionals(samples);
            problem.wanted = to_functionals(wanted);
            problem.exact = to_functionals(exact);
            new (self)
                BoundProblem{problem, nb::make_tuple(targets, reach, start, index, sites, samples, wanted, exact)};
          },
          "order"_a, "components"_a, "basis"_a, "weight"_a, "parameters"_a, "aspect"_a, "targets"_a, "reach"_a,
          "start"_a, "index"_a, "sites"_a, "samples"_a.none(), "wanted"_a, "exact"_a.none())
      .def(
          "solve",
          [](BoundProblem const& self, Real residual_bound, Real sum_bound, bool portable, Weights weights,
             ExactWeights exact_weights, Paths path, Judgements judgements) {
            gmls::Problem const& problem = self.problem;
            Real* const judged = judgements.data();
            gmls::Stencils const to{weights.data(), exact_weights.data(),   reinterpret_cast<gmls::Path*>(path.data()),
                                    judged,         judged + problem.count, judged + 2 * problem.count};
            nb::gil_scoped_release release;
            gmls::solve(problem, residual_bound, sum_bound, portable, to);
          },
          "residual_bound"_a, "sum_bound"_a, "portable"_a, "weights"_a, "exact_weights"_a, "path"_a, "judgements"_a,
          "Stencils of all targets, into arrays that are given.")
      .def(
          "equations",
          [](BoundProblem const& self, std::size_t target) {
            auto e = gmls::equations(self.problem, target);
            std::size_t const m = e.root_weight.size(), t = std::size_t(self.problem.wanted.rows);
            std::size_t const n = e.tau.size() / t;
            return nb::make_tuple(bind::to_array(std::move(e.rows), {m, n}), bind::to_array(std::move(e.root_weight)),
                                  bind::to_array(std::move(e.tau), {n, t}));
          },
          "target"_a,
          "Weighted rows of a target's samples (m, n), roots of their weights, and the targets (n, rows wanted): "
          "weights "
          "are root * z with rows.T @ z = targets.");
}
