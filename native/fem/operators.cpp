#include "fem/operators.hpp"

#include "fem/operator_of.hpp"
#include "mesh/array_on_box.hpp"

namespace amrpic::fem {

namespace {

/// Volume of an element over that of [-1, 1]^3.
Real volume_of(Lattice const& lattice) { return lattice.elements().cell_volume() / 8; }

struct Mass {
  static constexpr bool reads = true, writes = true, values = true, slopes = false, rigid_modes = false,
                        in_single = false;
  Real const* weights;

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    V const weight = of_block(weights, block);
    for (V& value : at.value) value *= weight;
  }
  template <int P, int C>
  MassAtGauss<P, C> at_gauss(Points const& points) const {
    return {volume_of(points.lattice())};
  }
};

struct Poisson {
  static constexpr bool reads = true, writes = true, values = false, slopes = true, rigid_modes = false,
                        in_single = false;
  Real const* weights;
  Real3 metric;  ///< what a slope in space is, squared, over that in the coordinates of an element

  template <int C>
  void operator()(std::int64_t block, AtPoint<C>& at) const {
    V const weight = of_block(weights, block);
    Vector3<V> const factor{weight * metric[0], weight * metric[1], weight * metric[2]};
    for (auto& slope : at.slope)
      for (std::size_t d = 0; d < 3; ++d) slope[d] *= factor[d];
  }
  template <int P, int C>
  PoissonAtGauss<P, C> at_gauss(Points const& points) const {
    return {volume_of(points.lattice()), metric};
  }
};

template <class D>
std::unique_ptr<Operator> made(std::shared_ptr<Points const> points, int components, D d) {
  if (components == 1) return std::make_unique<OperatorOf<D, 1>>(std::move(points), d);
  return std::make_unique<OperatorOf<D, 3>>(std::move(points), d);
}

}  // namespace

std::unique_ptr<Operator> mass(std::shared_ptr<Points const> points, int components) {
  Mass const d{points->weights()};
  return made(std::move(points), components, d);
}

std::unique_ptr<Operator> poisson(std::shared_ptr<Points const> points, int components) {
  Real3 metric = slope_scale(points->lattice());
  for (Real& m : metric) m *= m;
  Poisson const d{points->weights(), metric};
  return made(std::move(points), components, d);
}

Entries Operator::entries() const {
  Lattice const& lattice = points_->lattice();
  Entries out;
  std::vector<ArrayOnBox<GlobalIndex>> numbers;
  for (auto const& part : lattice.parts()) numbers.push_back(cell_numbers(lattice.nodes(), part.nodes));
  for_each_element_matrix([&](std::size_t p, LocalIndex corner, std::vector<Real> const& matrix) {
    std::vector<GlobalIndex> unknown;
    for (int c = 0; c < components_; ++c)
      with_degree(lattice.degree(), [&](auto nodes) {
        for_each_node<nodes()>(lattice.parts()[p].nodes, [&](int, std::ptrdiff_t at) {
          unknown.push_back(numbers[p].values()[std::size_t(corner + at)] * components_ + c);
        });
      });
    for (GlobalIndex row : unknown) out.row.insert(out.row.end(), unknown.size(), row);
    for (std::size_t row = 0; row < unknown.size(); ++row)
      out.column.insert(out.column.end(), unknown.begin(), unknown.end());
    out.value.insert(out.value.end(), matrix.begin(), matrix.end());
  });
  return out;
}

}  // namespace amrpic::fem
