#include "solver/node_multigrid.hpp"

#include <utility>

namespace amrpic {

namespace {

/// 1 where unknowns are free, 0 where they are fixed.
std::vector<Real> free_of(std::vector<Real> inverse) {
  for (Real& value : inverse) value = value != 0;
  return inverse;
}

/// Of what the smoother damps: the corners of a high degree's elements hold a smaller part of its spectrum.
Real lower_end(int degree) { return degree > 2 ? 0.06 : 0.1; }

/// Of the largest eigenvalue with solves of uneven elements. It is about 10, and hundreds where the matrix of an
/// element is hardly positive, near states that are not stable; what else there is would not be damped then.
constexpr Real most_with_elements = 30;

}  // namespace

NodeMultigrid::NodeMultigrid(fem::Operator const& a, std::vector<Real> inverse, CornerCycle kind, bool solves_elements)
    : fine_(&a) {
  for (Real value : inverse) fixed_.push_back(value == 0);
  auto const lattice = a.points().share_lattice();
  std::unique_ptr<fem::Operator> coarse;
  if (lattice->degree() == 1) {
    corners_free_ = free_of(std::move(inverse));
  } else {
    auto const corners = std::make_shared<fem::Lattice const>(lattice->share_hierarchy(), 1);
    between_ = std::make_unique<fem::Interpolation>(lattice, corners);
    coarse = a.on(std::make_shared<fem::Points const>(corners, a.points()));
    coarse_r_.resize(coarse->unknowns()), coarse_z_.resize(coarse->unknowns());
    // A corner is fixed if it is so as a node of the finer degree.
    corners_free_ = free_of(between_->at_corners(a.components(), inverse.data()));
  }
  auto blocks = fem::node_blocks(coarse ? *coarse : a, corners_free_);
  if (kind == CornerCycle::aggregation)
    aggregates_ = std::make_unique<NodeAggregates>(lattice->comm(), blocks, a.has_rigid_modes());
  else
    levels_ = std::make_unique<NodeLevels>(lattice->comm(), std::move(blocks));
  if (between_) make_smoother(a, std::move(inverse), solves_elements);
}

void NodeMultigrid::make_smoother(fem::Operator const& a, std::vector<Real> inverse, bool solves_elements) {
  fem::Lattice const& lattice = a.points().lattice();
  auto const apply = [this](std::vector<Real> const& x, std::vector<Real>& y) {
    fine_->apply_nearly(x.data(), y.data());
  };
  auto const smooth_with = [&](Chebyshev::Apply precondition) {
    smoother_ = std::make_unique<Chebyshev>(lattice.comm(), apply, std::move(precondition),
                                            disordered(lattice.nodes(), a.components()), lower_end(lattice.degree()));
  };
  if (solves_elements) elements_ = std::make_unique<ElementSolves>(a, inverse);
  if (elements_ && elements_->elements() > 0)
    smooth_with([this](std::vector<Real> const& r, std::vector<Real>& z) { elements_->apply(r, z); });
  if (!smoother_ || smoother_->largest_eigenvalue() > most_with_elements) {
    smooth_with(by_diagonal(std::move(inverse)));
    elements_.reset();
  }
}

void NodeMultigrid::smooth_for(fem::Operator const& a, std::vector<Real> inverse) {
  fine_ = &a;
  if (smoother_) smoother_->precondition_by(by_diagonal(std::move(inverse)));
}

void NodeMultigrid::solve_corners(std::vector<Real> const& r, std::vector<Real>& z) {
  if (levels_)
    levels_->apply(r, z);
  else
    aggregates_->apply(r, z);
}

void NodeMultigrid::apply(std::vector<Real> const& r, std::vector<Real>& z) {
  auto const keep_fixed = [&] {
    for (std::size_t i = 0; i < z.size(); ++i)
      if (fixed_[i]) z[i] = 0;
  };
  if (!between_) {
    solve_corners(r, z);
    return keep_fixed();
  }
  int const components = fine_->components();
  smoother_->smooth(r, z, true);
  auto& residual = smoother_->residual(r, z);
  for (std::size_t i = 0; i < r.size(); ++i)
    if (fixed_[i]) residual[i] = 0;
  between_->transposed(components, residual.data(), coarse_r_.data());
  for (std::size_t i = 0; i < coarse_r_.size(); ++i) coarse_r_[i] *= corners_free_[i];
  solve_corners(coarse_r_, coarse_z_);
  between_->add(components, coarse_z_.data(), z.data());
  keep_fixed();  // smoothing leaves what is fixed as it is
  smoother_->smooth(r, z, false);
}

}  // namespace amrpic
