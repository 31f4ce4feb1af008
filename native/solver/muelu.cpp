#include <MueLu_CreateTpetraPreconditioner.hpp>

#include "solver/trilinos_solvers.hpp"

namespace amrpic {

Teuchos::RCP<TpetraTypes::Operator> muelu_cycle(Teuchos::RCP<TpetraTypes::Matrix> const& matrix,
                                                Teuchos::ParameterList parameters) {
  return MueLu::CreateTpetraPreconditioner<Real, LocalIndex, TpetraTypes::Global, TpetraTypes::Node>(
      Teuchos::rcp_implicit_cast<TpetraTypes::Operator>(matrix), parameters);
}

}  // namespace amrpic
