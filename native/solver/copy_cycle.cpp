#include "solver/copy_cycle.hpp"

namespace amrpic {

namespace {

SolverOptions with_sweeps(SolverOptions options, Sweeps const& sweeps) {
  options.pre_sweeps = sweeps.before;
  options.post_sweeps = sweeps.after;
  return options;
}

/// Relaxes points, and lets the copies correct what the next coarser level left or brought in.
class WithCopies : public Smoother {
 public:
  WithCopies(Communicator const& comm, LevelOperators const& operators, std::vector<LevelCopy> const& copies,
             SolverOptions const& options, Sweeps const& on_copies)
      : beside_(make_smoother(
            operators, true,
            with_sweeps(options, {beside_local_cycle(options.pre_sweeps), beside_local_cycle(options.post_sweeps)}))),
        last_(make_smoother(operators, true, with_sweeps(options, {0, on_copies.after}))),
        copies_(comm, operators, copies.data(), copies.size(), with_sweeps(options, on_copies)) {}

  void smooth_from_zero(LevelVector const& f, LevelVector& x) override { beside_->smooth_from_zero(f, x); }
  void smooth(Side side, LevelVector const& f, LevelVector& x) override {
    beside_->smooth(side, f, x);
    copies_.correct(f, x);
    last_->smooth(Side::after, f, x);
  }
  std::vector<LevelOperators const*> own_levels() const override { return copies_.levels(); }

 private:
  std::unique_ptr<Smoother> beside_, last_;
  CopyCycle copies_;
};

}  // namespace

CopyCycle::CopyCycle(Communicator const& comm, LevelOperators const& above, LevelCopy const* copies, std::size_t count,
                     SolverOptions const& options)
    : above_(above),
      copy_(copy_operators(comm, above.level, *copies, shift_of(options))),
      smoother_(make_smoother(*copy_.level, true, options)),
      residual_(copy_.above),
      f_(copy_.level->cells),
      x_(copy_.level->cells) {
  if (count > 1) next_ = std::make_unique<CopyCycle>(comm, *copy_.level, copies + 1, count - 1, options);
}

void CopyCycle::correct(LevelVector const& f, LevelVector& x) {
  x.update_swept_halo();
  above_.no_fine.subtract(f, x, residual_);
  residual_.update_halo();
  copy_.restriction.multiply(residual_, f_);
  smoother_->smooth_from_zero(f_, x_);
  if (next_) {
    next_->correct(f_, x_);
    smoother_->smooth(Side::after, f_, x_);
  }
  x_.update_halo();
  copy_.prolongation.add(1, x_, x);
}

std::vector<LevelOperators const*> CopyCycle::levels() const {
  auto out = next_ ? next_->levels() : std::vector<LevelOperators const*>{};
  out.push_back(copy_.level.get());
  return out;
}

std::unique_ptr<Smoother> make_refined_smoother(Communicator const& comm, LevelOperators const& operators,
                                                std::vector<LevelCopy> const& copies, SolverOptions const& options) {
  if (copies.empty()) return make_smoother(operators, true, options);
  return std::make_unique<WithCopies>(comm, operators, copies, options,
                                      sweeps_of_copies({options.pre_sweeps, options.post_sweeps}));
}

}  // namespace amrpic
