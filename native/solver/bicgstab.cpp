#include "solver/bicgstab.hpp"

#include <cmath>
#include <utility>

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
/// Over the cells of all ranks. Collective.
Real dot(CompositeVector const& x, CompositeVector const& y) {
  Real sum = 0;
  for (std::size_t l = 0; l < x.size(); ++l) sum += x[l].own().getVector(0)->dot(*y[l].own().getVector(0));
  return sum;
}
Real quotient(Real a, Real b) { return b == 0 ? 0 : a / b; }

}  // namespace

BiCgStab::BiCgStab(CompositeEquations equations)
    : equations_(std::move(equations)),
      residual_(equations_.zero()),
      shadow_(equations_.zero()),
      search_(equations_.zero()),
      image_(equations_.zero()),
      half_image_(equations_.zero()),
      step_(equations_.zero()) {}

CompositeVector const& BiCgStab::direction(CompositeVector const& residual) {
  assign(residual_, residual);
  if (half_) return residual_;
  Real next = started_ ? dot(shadow_, residual_) : 0;
  Real const size = dot(residual_, residual_);
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

CompositeVector const& BiCgStab::step(CompositeVector const& correction) {
  assign(step_, correction);
  CompositeVector& image = half_ ? half_image_ : image_;
  equations_.multiply(step_, image);
  if (half_) {
    omega_ = quotient(dot(image, residual_), dot(image, image));
    scale(step_, omega_);
    if (omega_ == 0) started_ = false;
  } else {
    alpha_ = quotient(product_, dot(shadow_, image));
    scale(step_, alpha_);
  }
  half_ = !half_;
  return step_;
}

}  // namespace amrpic
