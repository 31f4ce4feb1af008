#include <Amesos2.hpp>

#include "solver/trilinos_solvers.hpp"

namespace amrpic {

std::function<void()> klu2_solve(Teuchos::RCP<TpetraTypes::Matrix> const& matrix,
                                 Teuchos::RCP<TpetraTypes::MultiVector> const& x,
                                 Teuchos::RCP<TpetraTypes::MultiVector> const& b) {
  auto const factors = Amesos2::create<TpetraTypes::Matrix, TpetraTypes::MultiVector>("KLU2", matrix, x, b);
  factors->symbolicFactorization().numericFactorization();
  return [factors] { factors->solve(); };
}

}  // namespace amrpic
