#include "solver/compressed_rows.hpp"

#include "matrices/operators.hpp"
#include "solver/backend.hpp"

namespace amrpic {

std::shared_ptr<Assembled const> assemble_to_show(Problem const& problem) {
  auto const out = std::make_shared<Assembled>(
      assemble(problem.hierarchy->comm(), refinement_levels(*problem.hierarchy, shift_of(problem.options)),
               problem.options.prolongation, {}, problem.metal.get()));
  assemble_gradient(out->multigrid, out->operators);
  return out;
}

LevelOperators const& operators_of(Assembled const& assembled, int level) {
  return *assembled.operators[std::size_t(level)];
}

}  // namespace amrpic
