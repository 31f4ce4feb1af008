#include <BelosSolverFactory_Tpetra.hpp>  // of methods that the library has compiled
#include <BelosTpetraAdapter.hpp>

#include "solver/trilinos_solvers.hpp"

namespace amrpic {

namespace {

using MultiVector = TpetraTypes::MultiVector;
using Operator = TpetraTypes::Operator;

}  // namespace

struct BelosIterations::Library {
  Teuchos::RCP<Belos::LinearProblem<Real, MultiVector, Operator>> linear;
  Teuchos::RCP<Belos::SolverManager<Real, MultiVector, Operator>> method;
};

BelosIterations::BelosIterations(std::string const& method, Teuchos::RCP<TpetraTypes::Matrix> const& matrix,
                                 Teuchos::RCP<MultiVector> const& x, Teuchos::RCP<MultiVector> const& b,
                                 Teuchos::RCP<Operator> const& preconditioner, Side side,
                                 Teuchos::ParameterList const& parameters)
    : library_(std::make_unique<Library>()) {
  auto& [linear, iterations] = *library_;
  linear = Teuchos::rcp(new Belos::LinearProblem<Real, MultiVector, Operator>(matrix, x, b));
  if (!preconditioner.is_null())
    side == Side::left ? linear->setLeftPrec(preconditioner) : linear->setRightPrec(preconditioner);
  auto const list = Teuchos::rcp(new Teuchos::ParameterList(parameters));
  list->set("Verbosity", int(Belos::Errors));
  iterations = Belos::TpetraSolverFactory<Real, MultiVector, Operator>().create(method, list);
  iterations->setProblem(linear);
}

BelosIterations::~BelosIterations() = default;

int BelosIterations::run() {
  library_->linear->setProblem();
  library_->method->solve();
  return library_->method->getNumIters();
}

}  // namespace amrpic
