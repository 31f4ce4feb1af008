#include "solver/node_multigrid.hpp"

#include <MueLu_CreateTpetraPreconditioner.hpp>
#include <utility>

#include "mesh/array_on_box.hpp"
#include "solver/tpetra_rows.hpp"

namespace amrpic {

namespace {

/// Numbers in (-1/2, 1/2) without order, that depend on nodes' places in the mesh alone.
std::vector<Real> disordered(fem::Lattice const& lattice, int components) {
  std::vector<Real> out;
  Level const& nodes = lattice.nodes();
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b)
    for_each_cell(nodes.box(b), [&](Index3 const& at) {
      auto const number = std::uint64_t(nodes.domain().offset(at)) * 3;
      for (int c = 0; c < components; ++c)
        out.push_back(Real((number + std::uint64_t(c)) * 2654435761u % 65537) / 65537 - Real(0.5));
    });
  return out;
}

/// Which of 27 colours a node has: no two nodes that share an element have the same.
int colour_of(Index3 const& at) { return at[0] % 3 + 3 * (at[1] % 3 + 3 * (at[2] % 3)); }

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

}  // namespace

SharedRows corner_rows(fem::Operator const& a, std::vector<char> const& fixed) {
  fem::Lattice const& lattice = a.points().lattice();
  Level const& nodes = lattice.nodes();
  int const components = a.components();
  std::size_t const size = a.unknowns();
  std::vector<std::vector<Real>> product(std::size_t(27 * components), std::vector<Real>(size));
  std::vector<int> colour;
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b)
    for_each_cell(nodes.box(b), [&](Index3 const& at) { colour.push_back(colour_of(at)); });
  std::vector<Real> picked(size);
  for (int n = 0; n < 27 * components; ++n) {
    for (std::size_t i = 0; i < size; ++i) {
      std::size_t const node = i / std::size_t(components);
      picked[i] = !fixed[i] && colour[node] * components + int(i % std::size_t(components)) == n;
    }
    a.apply(picked.data(), product[std::size_t(n)].data());
  }
  SharedRows out;
  std::size_t row = 0;
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b) {
    Box const& box = nodes.box(b);
    auto const number = cell_numbers(nodes, box.grow(1));
    for_each_cell(box, [&](Index3 const& at) {
      for (int r = 0; r < components; ++r, ++row) {
        for_each_cell(Box{at, at}.grow(1), [&](Index3 const& other) {
          if (number(other) == no_cell) return;
          for (int c = 0; c < components; ++c) {
            bool const diagonal = other == at && c == r;
            Real value = fixed[row] ? 0 : product[std::size_t(colour_of(other) * components + c)][row];
            if (diagonal && !(value > 0)) value = 1;
            if (value == 0) continue;
            out.column.push_back(number(other) * components + c);
            out.value.push_back(value);
          }
        });
        out.row_start.push_back(out.column.size());
      }
    });
  }
  return out;
}

class NodeMultigrid::Corners {
 public:
  Corners(Communicator const& comm, SharedRows const& rows, int components, std::vector<char> fixed)
      : fixed_(std::move(fixed)) {
    auto const ranks = Teuchos::rcp(new Teuchos::MpiComm<int>(comm.handle()));
    auto const unknown = Teuchos::OrdinalTraits<Tpetra::global_size_t>::invalid();
    Teuchos::RCP<TpetraTypes::Map const> const own =
        Teuchos::rcp(new TpetraTypes::Map(unknown, std::size_t(rows.rows()), 0, ranks));
    matrix_ = tpetra_matrix(rows, own);
    x_ = Teuchos::rcp(new TpetraTypes::MultiVector(own, 1)), b_ = Teuchos::rcp(new TpetraTypes::MultiVector(own, 1));
    auto parameters = aggregation(components);
    cycle_ = MueLu::CreateTpetraPreconditioner<Real, LocalIndex, TpetraTypes::Global, TpetraTypes::Node>(
        Teuchos::rcp_implicit_cast<TpetraTypes::Operator>(matrix_), parameters);
  }

  void apply(std::vector<Real> r, std::vector<Real>& z) {
    for (std::size_t i = 0; i < r.size(); ++i)
      if (fixed_[i]) r[i] = 0;
    copy_in(r, *b_);
    x_->putScalar(0);
    cycle_->apply(*b_, *x_);
    copy_out(*x_, z);
  }

 private:
  std::vector<char> fixed_;
  Teuchos::RCP<TpetraTypes::Matrix> matrix_;
  Teuchos::RCP<TpetraTypes::MultiVector> x_, b_;
  Teuchos::RCP<TpetraTypes::Operator> cycle_;
};

NodeMultigrid::~NodeMultigrid() = default;

NodeMultigrid::NodeMultigrid(fem::Operator const& a, std::vector<Real> const& inverse) : fine_(a), inverse_(inverse) {
  auto const lattice = a.points().share_lattice();
  int const components = a.components(), degree = lattice->degree();
  corners_ = degree == 1 ? lattice : std::make_shared<fem::Lattice const>(lattice->share_hierarchy(), 1);
  std::vector<char> fixed;
  if (degree == 1) {
    for (Real value : inverse_) fixed.push_back(value == 0);
    coarse_ = std::make_unique<Corners>(lattice->comm(), corner_rows(a, fixed), components, fixed);
    return;
  }
  between_ = std::make_unique<fem::Interpolation>(lattice, corners_);
  fem::Operator const coarse(std::make_shared<fem::Points const>(corners_, a.points()), a.term(), components);
  coarse_r_.resize(coarse.unknowns()), coarse_z_.resize(coarse.unknowns()), residual_.resize(a.unknowns());
  // A corner is fixed if it is so as a node of the finer degree.
  for (Real value : between_->at_corners(components, inverse_.data())) fixed.push_back(value == 0);
  coarse_ = std::make_unique<Corners>(lattice->comm(), corner_rows(coarse, fixed), components, fixed);
  auto const apply = [this](std::vector<Real> const& x, std::vector<Real>& y) { fine_.apply(x.data(), y.data()); };
  smoother_ = std::make_unique<Chebyshev>(lattice->comm(), apply, inverse_, disordered(*lattice, components));
}

void NodeMultigrid::apply(std::vector<Real> const& r, std::vector<Real>& z) {
  if (!between_) {
    coarse_->apply(r, z);
  } else {
    int const components = fine_.components();
    smoother_->smooth(r, z, true);
    fine_.apply(z.data(), residual_.data());
    for (std::size_t i = 0; i < r.size(); ++i) residual_[i] = inverse_[i] == 0 ? 0 : r[i] - residual_[i];
    between_->transposed(components, residual_.data(), coarse_r_.data());
    coarse_->apply(coarse_r_, coarse_z_);
    between_->add(components, coarse_z_.data(), z.data());
    for (std::size_t i = 0; i < z.size(); ++i)
      if (inverse_[i] == 0) z[i] = 0;
    smoother_->smooth(r, z, false);
  }
  for (std::size_t i = 0; i < z.size(); ++i)
    if (inverse_[i] == 0) z[i] = 0;
}

}  // namespace amrpic
