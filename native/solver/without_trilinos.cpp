// In place of all that needs Trilinos, in a build without it.
#include "solver/backend.hpp"
#include "solver/compressed_rows.hpp"
#include "solver/node_aggregates.hpp"

namespace amrpic {

namespace {

[[noreturn]] void refuse(std::string const& what) {
  throw SolverError(what + " needs Trilinos, and amrpic was built without it; build it again with AMRPIC_TRILINOS on");
}

}  // namespace

std::unique_ptr<Backend> make_crs_backend(Problem const&, Reusable&) { refuse("backend = \"crs\""); }
std::shared_ptr<Assembled const> assemble_to_show(Problem const&) { refuse("an operator as compressed rows"); }
LevelOperators const& operators_of(Assembled const&, int) { refuse("an operator as compressed rows"); }

PointSolution solve_points(Communicator const&, SharedRows const&, std::vector<Real> const&, std::size_t, Real, int) {
  refuse("an equation on scattered points");
}

struct NodeAggregates::Library {};
NodeAggregates::NodeAggregates(Communicator const&, fem::NodeBlocks const&, bool) {
  refuse("an equation on nodes whose coarsest level is large");
}
NodeAggregates::~NodeAggregates() = default;
void NodeAggregates::apply(std::vector<Real> const&, std::vector<Real>&) {}

}  // namespace amrpic
