#include "matrices/operators.hpp"

#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <stdexcept>

#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "solver/poisson.hpp"

namespace {

SparseMatrix const& find(LevelOperators const& o, std::string const& name, int axis) {
  if (name == "no_fine") return o.no_fine;
  if (name == "composite") return o.composite();
  if (name == "coarse_boundary") return o.coarse_boundary;
  if (name == "fine_boundary") return o.fine_boundary;
  if (name == "restriction") return o.restriction;
  if (name == "prolongation") return o.prolongation;
  if (name == "gradient_own") return o.gradient[axis].own;
  if (name == "gradient_coarse") return o.gradient[axis].coarse;
  if (name == "gradient_fine") return o.gradient[axis].fine;
  throw std::invalid_argument("there is no operator " + name);
}

/// This rank's rows of an operator, columns in global numbers: (row starts, columns, values).
nb::tuple rows_of(LevelOperators const& o, std::string const& name, LevelOperators const& columns, int axis) {
  HostRows rows = host_rows(*find(o, name, axis).matrix());
  auto const numbers = columns.cells->numbers();
  std::vector<std::int64_t> start(rows.row_start.begin(), rows.row_start.end()), column;
  column.reserve(rows.column.size());
  for (LocalIndex c : rows.column) column.push_back(numbers[std::size_t(c)]);
  return nb::make_tuple(bind::to_array(std::move(start)), bind::to_array(std::move(column)),
                        bind::to_array(std::move(rows.value)));
}

/// Operator times this rank's values.
nb::ndarray<nb::numpy, Real> multiply(LevelOperators const& o, std::string const& name, int axis, bind::Reals values) {
  std::vector<Real> in(values.data(), values.data() + values.size()), out(std::size_t(o.rows()));
  {
    nb::gil_scoped_release release;
    auto const& matrix = *find(o, name, axis).matrix();
    TpetraTypes::MultiVector x(matrix.getDomainMap(), 1), y(matrix.getRangeMap(), 1);
    copy_in(in, x);
    matrix.apply(x, y);
    copy_out(y, out);
  }
  return bind::to_array(std::move(out));
}

}  // namespace

void bind_operators(nb::module_& m) {
  using O = LevelOperators;
  nb::class_<O>(m, "LevelOperators")
      .def("rows_of", &rows_of, "name"_a, "columns"_a, "axis"_a = 0)
      .def("multiply", &multiply, "name"_a, "axis"_a, "values"_a)
      .def("uncovered",
           [](O const& o) { return bind::to_array(std::vector<std::int8_t>(o.uncovered.begin(), o.uncovered.end())); })
      .def_prop_ro("first_row", [](O const& o) { return o.level->first_local_cell(); })
      .def_prop_ro("rows", [](O const& o) { return o.level->cells(); })
      .def_prop_ro("local_rows", &O::rows)
      .def_prop_ro("bytes", &O::bytes);
  m.def(
      "operators_of",
      [](PoissonSolver& solver, int level) -> O const& { return solver.operators_with_gradient(level); }, "solver"_a,
      "level"_a, nb::rv_policy::reference, nb::keep_alive<0, 1>(), "The operators of a level.");
}
