#include "solver/smoother.hpp"

#include <Ifpack2_Factory.hpp>
#include <algorithm>
#include <array>

#include "base/for_rows.hpp"
#include "base/runtime.hpp"
#include "operators/semicoarse.hpp"
#include "operators/tpetra.hpp"

namespace amrpic {

namespace {

/// Rows of a level by the parity of i + j + k in the level's global indices, which no decomposition changes; around an
/// odd number of cells two of one parity meet, so the last ones are colours of their own.
std::vector<std::vector<LocalIndex>> colours(Level const& level) {
  std::array<int, 3> odd_last;
  int rings = 0;
  for (int d = 0; d < 3; ++d) {
    bool const odd = level.periodic()[d] && level.domain().extent(d) % 2 != 0;
    odd_last[d] = odd ? level.domain().upper[d] : -1;
    rings += odd;
  }
  std::vector<std::vector<LocalIndex>> out(rings > 0 ? 16 : 2);
  LocalIndex row = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    for_each_cell(level.box(b), [&](Index3 const& c) {
      std::size_t place = 0;
      for (int d = 0; d < 3; ++d) place += c[d] == odd_last[d] ? std::size_t(1) << d : 0;
      out[out.size() / 2 * std::size_t((c[0] + c[1] + c[2]) & 1) + place].push_back(row++);
    });
  return out;
}

/// Over-relaxed Gauss-Seidel, one colour after the other: rows of a colour do not couple with each other.
class RedBlack : public Smoother {
 public:
  RedBlack(LevelOperators const& operators, bool v_cycle, SolverOptions const& options)
      : operators_(operators),
        pre_sweeps_(options.pre_sweeps),
        post_sweeps_(options.post_sweeps),
        relaxation_(relaxation_on(*operators.level, shift_of(options), v_cycle, options.relaxation)),
        colour_(colours(*operators.level)) {}

  void smooth_from_zero(std::vector<Real> const& f, std::vector<Real>& x) override {
    std::fill(x.begin(), x.end(), 0.0);
    if (pre_sweeps_ == 0) return;
    relax(colour_[0], f, x);  // there is nothing to read yet
    for (std::size_t c = 1; c < colour_.size(); ++c) {
      operators_.stencil_halo.update(x.data());
      relax(colour_[c], f, x);
    }
    sweep(pre_sweeps_ - 1, f, x);
  }
  void smooth(Side side, std::vector<Real> const& f, std::vector<Real>& x) override {
    sweep(side == Side::before ? pre_sweeps_ : post_sweeps_, f, x);
  }

 private:
  void sweep(int sweeps, std::vector<Real> const& f, std::vector<Real>& x) {
    for (int s = 0; s < sweeps; ++s)
      for (auto const& rows : colour_) {
        operators_.stencil_halo.update(x.data());
        relax(rows, f, x);
      }
  }
  void relax(std::vector<LocalIndex> const& rows, std::vector<Real> const& right, std::vector<Real>& values) {
    Crs const& a = operators_.no_fine;
    Real* const x = values.data();
    Real const* const f = right.data();
    for_rows(LocalIndex(rows.size()), [&, x, f](LocalIndex k) {
      LocalIndex const row = rows[std::size_t(k)];
      Real const diagonal = a.value[a.row_start[row]];
      x[row] += relaxation_ * (f[row] - a.dot(row, x)) / diagonal;
    });
  }

  LevelOperators const& operators_;
  int pre_sweeps_, post_sweeps_;
  Real relaxation_;
  std::vector<std::vector<LocalIndex>> colour_;
};

/// Smallest eigenvalue, over the diagonal, of an error that oscillates along an axis which the next coarser level has
/// half the cells of.
Real oscillating(Real3 const& spacing) {
  Real const finest = *std::min_element(spacing.begin(), spacing.end());
  Real least = 0, sum = 0;
  for (Real h : spacing) {
    sum += 1 / h / h;
    if (h <= 1.5 * finest && (least == 0 || 1 / h / h < least)) least = 1 / h / h;
  }
  return least / sum;
}

/// A smoother of Ifpack2, on a copy of the matrix; over several ranks each relaxes its own rows at a time.
class LibrarySmoother : public Smoother {
 public:
  LibrarySmoother(Communicator const& comm, LevelOperators const& operators, SolverOptions const& options) {
    Real3 const& h = operators.level->spacing();
    scale_ = 0;
    for (Real spacing : h) scale_ -= 2 / spacing / spacing;
    scale_ = 1 / scale_;
    Crs scaled = operators.no_fine;
    for (Real& v : scaled.value) v *= scale_;
    matrix_ = tpetra_matrix(comm, scaled, operators, operators);
    x_ = Teuchos::rcp(new MultiVector(matrix_->getDomainMap(), 1));
    f_ = Teuchos::rcp(new MultiVector(matrix_->getRangeMap(), 1));
    if (options.post_sweeps > 0) after_ = made(options, options.post_sweeps, false, oscillating(h));
    if (options.pre_sweeps > 0) {
      from_zero_ = made(options, options.pre_sweeps, true, oscillating(h));
      bool const same = options.pre_sweeps == options.post_sweeps;
      before_ = same ? after_ : made(options, options.pre_sweeps, false, oscillating(h));
    }
  }

  void smooth_from_zero(std::vector<Real> const& f, std::vector<Real>& x) override {
    std::fill(x.begin(), x.end(), 0.0);
    apply(from_zero_, f, x);
  }
  void smooth(Side side, std::vector<Real> const& f, std::vector<Real>& x) override {
    apply(side == Side::before ? before_ : after_, f, x);
  }

 private:
  using MultiVector = TpetraTypes::MultiVector;
  using Preconditioner = Ifpack2::Preconditioner<Real, LocalIndex, TpetraTypes::Global, TpetraTypes::Node>;

  Teuchos::RCP<Preconditioner> made(SolverOptions const& options, int sweeps, bool from_zero, Real oscillating) {
    auto out = Ifpack2::Factory::create<TpetraTypes::RowMatrix>(ifpack2_name(options.smoother), matrix_);
    out->setParameters(ifpack2_parameters(options, sweeps, from_zero, oscillating));
    out->initialize();
    out->compute();
    return out;
  }
  void apply(Teuchos::RCP<Preconditioner> const& method, std::vector<Real> const& f, std::vector<Real>& x) {
    if (method.is_null()) return;  // no sweeps
    copy_in(f, *f_);
    f_->scale(scale_);
    copy_in(x, *x_);
    method->apply(*f_, *x_);
    copy_out(*x_, x);
  }

  Real scale_;  ///< one over the diagonal of a plain row, so that no threshold of the library meets the units
  Teuchos::RCP<TpetraTypes::Matrix> matrix_;
  Teuchos::RCP<MultiVector> x_, f_;
  Teuchos::RCP<Preconditioner> from_zero_, before_, after_;
  AtFinalize release_{
      [this] { from_zero_ = before_ = after_ = Teuchos::null, x_ = f_ = Teuchos::null, matrix_ = Teuchos::null; }};
};

}  // namespace

std::unique_ptr<Smoother> make_smoother(Communicator const& comm, LevelOperators const& operators, bool v_cycle,
                                        SolverOptions const& options) {
  if (options.smoother == SmootherKind::red_black) return std::make_unique<RedBlack>(operators, v_cycle, options);
  return std::make_unique<LibrarySmoother>(comm, operators, options);
}

}  // namespace amrpic
