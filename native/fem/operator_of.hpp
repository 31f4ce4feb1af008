// From a function of a point to an operator: its products, its diagonal, its matrices of elements.
#pragma once

#include "fem/at_gauss.hpp"
#include "fem/at_points.hpp"
#include "fem/degrees.hpp"
#include "fem/element_matrix.hpp"
#include "fem/operators.hpp"

namespace amrpic::fem {

/// What slopes in space are over those in the coordinates of an element.
inline Real3 slope_scale(Lattice const& lattice) {
  Real3 out = lattice.elements().spacing();
  for (Real& h : out) h = 2 / h;
  return out;
}

/// What `D` makes of one component's value and slopes, where all others are zero, in the same component: both parts of
/// an operator's diagonal there.
template <class D, int C>
struct OnDiagonal {
  static constexpr bool values = D::values, slopes = D::slopes;
  D const& d;

  void operator()(std::int64_t block, SquaresAtPoint<C>& at) const {
    for (int c = 0; c < C; ++c) {
      if constexpr (values) {
        AtPoint<C> unit{};
        unit.value[c] = V{} + Real(1);
        d(block, unit);
        at.value[c] = unit.value[c];
      }
      if constexpr (slopes)
        for (std::size_t e = 0; e < 3; ++e) {
          AtPoint<C> unit{};
          unit.slope[c][e] = V{} + Real(1);
          d(block, unit);
          at.slope[c][e] = unit.slope[c];
        }
    }
  }
};

/// The operator of a function D at points: d(block, at), as in `AtPoints`, is linear and symmetric. At Gauss's points
/// its kernel is D::at_gauss<nodes along an axis, components>(points). D says whether it may be `in_single` precision:
/// whether what it keeps is within the range of that in all units that are of use.
template <class D, int C>
class OperatorOf : public Operator {
 public:
  OperatorOf(std::shared_ptr<Points const> points, D d) : Operator(std::move(points), C), d_(std::move(d)) {}

  void apply(Real const* u, Real* v) const override {
    with_kernel([&](auto nodes, auto const& kernel) { sum_over_elements<nodes(), C>(points(), u, v, kernel); });
  }

  void apply_nearly(Real const* u, Real* v) const override {
    if constexpr (D::in_single)
      if (!points().gauss())
        return with_degree(points().lattice().degree(), [&](auto nodes) {
          AtPoints<nodes(), C, D, true> const kernel{points(), d_};
          sum_over_elements<nodes(), C>(points(), u, v, kernel);
        });
    apply(u, v);
  }

  std::vector<Real> diagonal() const override {
    std::vector<Real> out(unknowns());
    with_degree(points().lattice().degree(), [&](auto nodes) {
      DiagonalAtPoints<nodes(), C, OnDiagonal<D, C>> const kernel{points(), {d_}};
      sum_over_elements<nodes(), C>(points(), nullptr, out.data(), kernel);
    });
    return out;
  }

  std::unique_ptr<Operator> on(std::shared_ptr<Points const> points) const override {
    return std::make_unique<OperatorOf>(std::move(points), d_);
  }

  bool has_rigid_modes() const override { return D::rigid_modes; }

  std::vector<Real> stiffness_of_points() const override {
    BlockValues blocks(std::size_t(points().blocks() * native_lane_count), 0);
    if constexpr (D::slopes)
      for (std::int64_t block = 0; block < points().blocks(); ++block) {
        SquaresAtPoint<C> at{};
        OnDiagonal<D, C>{d_}(block, at);
        V sum{};
        for (auto const& slopes : at.slope)
          for (std::size_t e = 0; e < 3; ++e) sum += slopes[e][e];
        store(&blocks[std::size_t(block * native_lane_count)], sum);
      }
    return points().unblocked(blocks.data(), 1);
  }

  void for_each_matrix_of(std::vector<Points::Filled> const& elements, TakeMatrix const& f) const override {
    std::vector<Real> matrix;
    auto const each = [&](auto&& fill) {
      for (std::size_t p = 0; p < elements.size(); ++p)
        for (std::size_t e = 0; e < elements[p].element.size(); ++e) {
          fill(elements[p].element[e]);
          f(p, elements[p].corner[e], matrix);
        }
    };
    with_degree(points().lattice().degree(), [&](auto nodes) {
      auto const fill_by = [&](auto const& kernel) {
        each([&](LocalIndex element) { fill_matrix(GroupKernel<nodes(), C>::of(kernel), element, matrix); });
      };
      if (points().gauss()) return fill_by(d_.template at_gauss<nodes(), C>(points()));
      if constexpr (D::slopes && !D::values) {
        ElementMatrix<nodes(), C> made(points(), PointFunction<C>::of(d_));
        each([&](LocalIndex element) { made.fill(element, matrix); });
      } else {
        fill_by(AtPoints<nodes(), C, D>{points(), d_});
      }
    });
  }

 private:
  template <class F>
  void with_kernel(F&& f) const {
    with_degree(points().lattice().degree(), [&](auto nodes) {
      if (points().gauss())
        f(nodes, d_.template at_gauss<nodes(), C>(points()));
      else
        f(nodes, AtPoints<nodes(), C, D>{points(), d_});
    });
  }

  D d_;
};

}  // namespace amrpic::fem
