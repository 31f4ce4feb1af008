#include "solver/krylov.hpp"

#include <cmath>
#include <deque>

namespace amrpic {

namespace {

/// y = scale y + a x.
void combine(Real scale, CompositeVector& y, Real a, CompositeVector const& x) {
  for (std::size_t l = 0; l < y.size(); ++l) y[l].own().update(a, x[l].own(), scale);
}
void scale(CompositeVector& y, Real factor) {
  for (LevelVector& level : y) level.own().scale(factor);
}
void assign(CompositeVector& to, CompositeVector const& from) {
  for (std::size_t l = 0; l < to.size(); ++l) to[l].assign(from[l]);
}

/// Flexible GMRES in the form of generalised conjugate residuals: the same approximations in exact arithmetic, with the
/// residual at hand in every norm after each cycle. Of many directions the oldest are dropped.
class FlexibleGmres : public Krylov {
 public:
  explicit FlexibleGmres(CompositeEquations equations)
      : equations_(std::move(equations)), residual_(equations_.zero()), step_(equations_.zero()) {}

  CompositeVector const& direction(CompositeVector const& residual) override {
    assign(residual_, residual);
    return residual_;
  }

  CompositeVector const& step(CompositeVector const& correction) override {
    if (kept_.size() == most_directions) {
      kept_.push_back(std::move(kept_.front()));
      kept_.pop_front();
    } else {
      kept_.push_back({equations_.zero(), equations_.zero()});
    }
    Direction& now = kept_.back();
    assign(now.change, correction);
    equations_.multiply(now.change, now.image);
    for (std::size_t k = 0; k + 1 < kept_.size(); ++k) {
      Real const common = equations_.dot(now.image, kept_[k].image);
      combine(1, now.change, -common, kept_[k].change);
      combine(1, now.image, -common, kept_[k].image);
    }
    Real const size = std::sqrt(equations_.dot(now.image, now.image));
    if (!(size > 0)) {  // nothing new: the correction is zero, or lies in the space of the others
      kept_.pop_back();
      scale(step_, 0);
      return step_;
    }
    scale(now.change, 1 / size);
    scale(now.image, 1 / size);
    combine(0, step_, equations_.dot(residual_, now.image), now.change);
    return step_;
  }

 private:
  static constexpr std::size_t most_directions = 20;
  struct Direction {
    CompositeVector change, image;  ///< of the approximation, and A times it; images are orthonormal
  };
  CompositeEquations equations_;
  std::deque<Direction> kept_;
  CompositeVector residual_, step_;
};

/// BiCGStab (van der Vorst), two cycles to an iteration.
class BiCgStab : public Krylov {
 public:
  explicit BiCgStab(CompositeEquations equations)
      : equations_(std::move(equations)),
        residual_(equations_.zero()),
        shadow_(equations_.zero()),
        search_(equations_.zero()),
        image_(equations_.zero()),
        half_image_(equations_.zero()),
        step_(equations_.zero()) {}

  CompositeVector const& direction(CompositeVector const& residual) override {
    assign(residual_, residual);
    if (half_) return residual_;
    Real next = started_ ? equations_.dot(shadow_, residual_) : 0;
    Real const size = equations_.dot(residual_, residual_);
    if (std::abs(next) < 1e-12 * size || !started_) {  // begin, or begin again where the iteration breaks down
      assign(shadow_, residual_);
      started_ = true;
      next = size;
      assign(search_, residual_);
    } else {
      Real const beta = next / product_ * alpha_ / omega_;
      combine(beta, search_, -beta * omega_, image_);
      combine(1, search_, 1, residual_);
    }
    product_ = next;
    return search_;
  }

  CompositeVector const& step(CompositeVector const& correction) override {
    assign(step_, correction);
    CompositeVector& image = half_ ? half_image_ : image_;
    equations_.multiply(step_, image);
    if (half_) {
      omega_ = quotient(equations_.dot(image, residual_), equations_.dot(image, image));
      scale(step_, omega_);
      if (omega_ == 0) started_ = false;
    } else {
      alpha_ = quotient(product_, equations_.dot(shadow_, image));
      scale(step_, alpha_);
    }
    half_ = !half_;
    return step_;
  }

 private:
  static Real quotient(Real a, Real b) { return b == 0 ? 0 : a / b; }

  CompositeEquations equations_;
  bool started_ = false;
  bool half_ = false;  ///< the next cycle is the second one of an iteration
  Real product_ = 1, alpha_ = 1, omega_ = 1;
  CompositeVector residual_, shadow_, search_, image_, half_image_, step_;
};

}  // namespace

std::unique_ptr<Krylov> make_krylov(KrylovKind kind, CompositeEquations equations) {
  if (kind == KrylovKind::fgmres) return std::make_unique<FlexibleGmres>(std::move(equations));
  if (kind == KrylovKind::bicgstab) return std::make_unique<BiCgStab>(std::move(equations));
  return nullptr;
}

}  // namespace amrpic
