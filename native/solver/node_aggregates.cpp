#include "solver/node_aggregates.hpp"

#include "solver/node_rows.hpp"
#include "solver/tpetra_rows.hpp"
#include "solver/trilinos_solvers.hpp"

namespace amrpic {

namespace {

Teuchos::ParameterList aggregation(int components) {
  Teuchos::ParameterList list, sweeps;
  list.set("verbosity", "none");
  list.set("number of equations", components);
  list.set("smoother: type", "CHEBYSHEV");
  sweeps.set("chebyshev: degree", 3);
  list.set("smoother: params", sweeps);
  list.set("coarse: max size", 200);
  list.set("coarse: type", "RELAXATION");  // KLU2 gives wrong answers on several ranks
  Teuchos::ParameterList relaxation;
  relaxation.set("relaxation: type", "Symmetric Gauss-Seidel");
  relaxation.set("relaxation: sweeps", 20);
  list.set("coarse: params", relaxation);
  return list;
}

/// Three translations and three rotations about the middle, as columns.
Teuchos::RCP<TpetraTypes::MultiVector> rigid_modes(Level const& nodes,
                                                   Teuchos::RCP<TpetraTypes::Map const> const& own) {
  auto const out = Teuchos::rcp(new TpetraTypes::MultiVector(own, 6));
  auto const view = out->getLocalViewHost(Tpetra::Access::OverwriteAll);
  Real3 const& h = nodes.spacing();
  std::size_t row = 0;
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b)
    for_each_cell(nodes.box(b), [&](Index3 const& at) {
      Real3 x;
      for (std::size_t d = 0; d < 3; ++d) x[d] = (at[d] - Real(nodes.domain().upper[d]) / 2) * h[d] / h[0];
      for (std::size_t c = 0; c < 3; ++c, ++row)
        for (std::size_t mode = 0; mode < 3; ++mode) {
          view(row, mode) = mode == c;
          // e_mode x x
          std::size_t const next = (mode + 1) % 3, last = (mode + 2) % 3;
          view(row, 3 + mode) = c == next ? -x[last] : c == last ? x[next] : 0;
        }
    });
  return out;
}

}  // namespace

struct NodeAggregates::Library {
  Teuchos::RCP<TpetraTypes::Matrix> matrix;
  Teuchos::RCP<TpetraTypes::MultiVector> x, b;
  Teuchos::RCP<TpetraTypes::Operator> cycle;
};

NodeAggregates::~NodeAggregates() = default;

NodeAggregates::NodeAggregates(Communicator const& comm, fem::NodeBlocks const& blocks, bool rigid)
    : library_(std::make_unique<Library>()) {
  SharedRows const rows = compressed(blocks);
  auto const ranks = Teuchos::rcp(new Teuchos::MpiComm<int>(comm.handle()));
  auto const unknown = Teuchos::OrdinalTraits<Tpetra::global_size_t>::invalid();
  Teuchos::RCP<TpetraTypes::Map const> const own =
      Teuchos::rcp(new TpetraTypes::Map(unknown, std::size_t(rows.rows()), 0, ranks));
  library_->matrix = tpetra_matrix(rows, own);
  library_->x = Teuchos::rcp(new TpetraTypes::MultiVector(own, 1));
  library_->b = Teuchos::rcp(new TpetraTypes::MultiVector(own, 1));
  auto parameters = aggregation(blocks.components);
  if (rigid) parameters.sublist("user data").set("Nullspace", rigid_modes(*blocks.nodes, own));
  library_->cycle = muelu_cycle(library_->matrix, parameters);
}

void NodeAggregates::apply(std::vector<Real> const& r, std::vector<Real>& z) {
  copy_in(r, *library_->b);
  library_->x->putScalar(0);
  library_->cycle->apply(*library_->b, *library_->x);
  copy_out(*library_->x, z);
}

}  // namespace amrpic
