#include "fem/operators.hpp"

#include "fem/at_gauss.hpp"
#include "fem/at_points.hpp"
#include "fem/degrees.hpp"
#include "mesh/array_on_box.hpp"

namespace amrpic::fem {

namespace {

/// What a slope in space is, squared, over that in the coordinates of an element.
Real3 metric_of(Lattice const& lattice) {
  Real3 out;
  for (std::size_t d = 0; d < 3; ++d) {
    Real const scale = 2 / lattice.elements().spacing()[d];
    out[d] = scale * scale;
  }
  return out;
}

/// Volume of an element over that of [-1, 1]^3.
Real volume_of(Lattice const& lattice) { return lattice.elements().cell_volume() / 8; }

struct Mass {
  static constexpr bool reads = true, writes = true, values = true, slopes = false;
  Points const& points;

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    V const weight = weights_of(points, block);
    for (V& value : at.value) value *= weight;
  }
};

struct Poisson {
  static constexpr bool reads = true, writes = true, values = false, slopes = true;
  Points const& points;
  Real3 metric;

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    V const weight = weights_of(points, block);
    Vector3<V> const factor{weight * metric[0], weight * metric[1], weight * metric[2]};
    for (auto& slope : at.slope)
      for (std::size_t d = 0; d < 3; ++d) slope[d] *= factor[d];
  }
};

struct DiagonalOfMass {
  static constexpr bool reads = false, writes = true, values = true, slopes = false;
  Points const& points;

  void operator()(std::int64_t block, AtPoint<1>& at) const { at.value[0] = weights_of(points, block); }
};

struct DiagonalOfPoisson {
  static constexpr bool reads = false, writes = true, values = false, slopes = true;
  Points const& points;
  Real3 metric;

  void operator()(std::int64_t block, AtPoint<1>& at) const {
    V const weight = weights_of(points, block);
    at.slope[0] = {weight * metric[0], weight * metric[1], weight * metric[2]};
  }
};

/// Call f(kernel) for the operator's kernel.
template <int P, int C, class F>
void with_kernel(Points const& points, Term term, F&& f) {
  Lattice const& lattice = points.lattice();
  if (points.gauss() && term == Term::mass)
    f(MassAtGauss<P, C>{volume_of(lattice)});
  else if (points.gauss())
    f(PoissonAtGauss<P, C>{volume_of(lattice), metric_of(lattice)});
  else if (term == Term::mass)
    f(AtPoints<P, C, Mass>{points, {points}});
  else
    f(AtPoints<P, C, Poisson>{points, {points, metric_of(lattice)}});
}

/// Add the matrix of one element, by groups of columns.
template <int P, int C, class Kernel>
void add_element(Kernel const& kernel, LocalIndex element, std::vector<GlobalIndex> const& number, Entries& to) {
  constexpr int nodes = P * P * P, all = C * nodes;
  std::vector<LocalIndex> const same(native_lane_count, element);
  for (int first = 0; first < all; first += native_lane_count) {
    int const count = std::min(native_lane_count, all - first);
    GroupValues<P, C> values;
    for (int c = 0; c < C; ++c)
      for (int n = 0; n < nodes; ++n)
        for (int l = 0; l < native_lane_count; ++l) values.value[c][n][l] = first + l == c * nodes + n;
    kernel(same.data(), count, values);
    for (int l = 0; l < count; ++l) {
      int const column = first + l;
      for (int c = 0; c < C; ++c)
        for (int n = 0; n < nodes; ++n) {
          to.row.push_back(number[std::size_t(n)] * C + c);
          to.column.push_back(number[std::size_t(column % nodes)] * C + column / nodes);
          to.value.push_back(values.value[c][n][l]);
        }
    }
  }
}

}  // namespace

void Operator::apply(Real const* u, Real* v) const {
  with_shape(points_->lattice().degree(), components_, [&](auto nodes, auto components) {
    with_kernel<nodes(), components()>(
        *points_, term_, [&](auto const& kernel) { sum_over_elements<nodes(), components()>(*points_, u, v, kernel); });
  });
}

std::vector<Real> Operator::diagonal() const {
  Lattice const& lattice = points_->lattice();
  std::vector<Real> one(std::size_t(lattice.own_nodes()));
  with_shape(lattice.degree(), 1, [&](auto nodes, auto) {
    constexpr int P = nodes();
    if (term_ == Term::mass)
      sum_over_elements<P, 1>(*points_, nullptr, one.data(),
                              AtPoints<P, 1, DiagonalOfMass, SquaredRows<P>>{*points_, {*points_}});
    else
      sum_over_elements<P, 1>(
          *points_, nullptr, one.data(),
          AtPoints<P, 1, DiagonalOfPoisson, SquaredRows<P>>{*points_, {*points_, metric_of(lattice)}});
  });
  std::vector<Real> out;
  for (Real value : one) out.insert(out.end(), std::size_t(components_), value);
  return out;
}

Entries Operator::entries() const {
  Lattice const& lattice = points_->lattice();
  Entries out;
  with_shape(lattice.degree(), components_, [&](auto nodes, auto components) {
    constexpr int P = nodes(), C = components();
    with_kernel<P, C>(*points_, term_, [&](auto const& kernel) {
      for (std::size_t p = 0; p < lattice.parts().size(); ++p) {
        Box const& box = lattice.parts()[p].nodes;
        auto const numbers = cell_numbers(lattice.nodes(), box);
        auto const& filled = points_->filled()[p];
        for (std::size_t e = 0; e < filled.element.size(); ++e) {
          std::vector<GlobalIndex> of_element;
          for_each_node<P>(box, [&](int, std::ptrdiff_t at) {
            of_element.push_back(numbers.values()[std::size_t(filled.corner[e] + at)]);
          });
          add_element<P, C>(kernel, filled.element[e], of_element, out);
        }
      }
    });
  });
  return out;
}

}  // namespace amrpic::fem
