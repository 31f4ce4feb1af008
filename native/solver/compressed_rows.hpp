// What solvers have of compressed rows, whose types not all builds know.
#pragma once

#include <memory>

#include "solver/reusable.hpp"

namespace amrpic {

class Backend;
struct LevelOperators;
struct Problem;

/// The backend of compressed rows. Throws SolverError if this was built without Trilinos. Collective.
std::unique_ptr<Backend> make_crs_backend(Problem const& problem, Reusable& reusable);

/// The operators of all refinement levels, those of E among them, for a backend that has none itself. The same.
std::shared_ptr<Assembled const> assemble_to_show(Problem const& problem);
LevelOperators const& operators_of(Assembled const& assembled, int level);

}  // namespace amrpic
