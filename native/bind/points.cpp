#include "bind/bind.hpp"
#include "bind/convert.hpp"
#include "solver/point_equations.hpp"

void bind_points(nb::module_& m) {
  m.def(
      "solve_points",
      [](int ranks, bind::Starts row_start, bind::Starts column, bind::Reals value, bind::RealRows right_hand_sides,
         Real tolerance, int most_iterations) {
        SharedRows rows;
        rows.row_start.assign(row_start.data(), row_start.data() + row_start.size());
        rows.column.assign(column.data(), column.data() + column.size());
        rows.value.assign(value.data(), value.data() + value.size());
        std::vector<Real> const b(right_hand_sides.data(), right_hand_sides.data() + right_hand_sides.size());
        auto found = bind::released([&] {
          return solve_points(Communicator(MPI_Comm_f2c(ranks)), rows, b, right_hand_sides.shape(0), tolerance,
                              most_iterations);
        });
        return nb::make_tuple(
            bind::to_array(std::move(found.x), {right_hand_sides.shape(0), right_hand_sides.shape(1)}),
            found.iterations, found.residual);
      },
      "comm"_a, "row_start"_a, "column"_a, "value"_a, "right_hand_sides"_a, "tolerance"_a, "most_iterations"_a,
      "This rank's rows of the solutions (vectors, rows), iterations and relative residual. Collective.");
}
