// Trilinos' solvers behind functions of ours, each compiled in a file of its own and once: their headers take seconds.
#pragma once

#include <Teuchos_ParameterList.hpp>
#include <functional>
#include <memory>
#include <string>

#include "matrices/tpetra.hpp"

namespace amrpic {

/// A cycle of MueLu's for a matrix. Collective.
Teuchos::RCP<TpetraTypes::Operator> muelu_cycle(Teuchos::RCP<TpetraTypes::Matrix> const& matrix,
                                                Teuchos::ParameterList parameters);

/// Solves A x = b by KLU2's factors of A, whenever it is called. Collective.
std::function<void()> klu2_solve(Teuchos::RCP<TpetraTypes::Matrix> const& matrix,
                                 Teuchos::RCP<TpetraTypes::MultiVector> const& x,
                                 Teuchos::RCP<TpetraTypes::MultiVector> const& b);

/// Iterations of Belos for A x = b.
class BelosIterations {
 public:
  enum class Side { left, right };  ///< of the preconditioner, which may be null
  BelosIterations(std::string const& method, Teuchos::RCP<TpetraTypes::Matrix> const& matrix,
                  Teuchos::RCP<TpetraTypes::MultiVector> const& x, Teuchos::RCP<TpetraTypes::MultiVector> const& b,
                  Teuchos::RCP<TpetraTypes::Operator> const& preconditioner, Side side,
                  Teuchos::ParameterList const& parameters);
  ~BelosIterations();

  /// Improve x; returns how many iterations that took. Throws std::logic_error where they break down. Collective.
  int run();

 private:
  struct Library;
  std::unique_ptr<Library> library_;
};

}  // namespace amrpic
