#include "fem/elements.hpp"

#include "fem/degrees.hpp"

namespace amrpic::fem {

/// By groups of columns: a lane each.
template <int P, int C>
void fill_matrix(GroupKernel<P, C> const& kernel, LocalIndex element, std::vector<Real>& matrix) {
  constexpr int nodes = P * P * P, all = C * nodes;
  matrix.resize(std::size_t(all) * all);
  std::array<LocalIndex, native_lane_count> same;
  same.fill(element);
  for (int first = 0; first < all; first += native_lane_count) {
    int const count = std::min(native_lane_count, all - first);
    GroupValues<P, C> values{};
    for (int c = 0; c < C; ++c)
      for (int n = 0; n < nodes; ++n)
        for (int l = 0; l < native_lane_count; ++l) values.value[c][n][l] = first + l == c * nodes + n;
    kernel(same.data(), count, values);
    for (int row = 0; row < all; ++row)
      for (int l = 0; l < count; ++l)
        matrix[std::size_t(row) * all + std::size_t(first + l)] = values.value[row / nodes][row % nodes][l];
  }
}

#define AMRPIC_OF_SHAPE(P, C) template void fill_matrix(GroupKernel<P, C> const&, LocalIndex, std::vector<Real>&);
AMRPIC_FOR_EACH_SHAPE(AMRPIC_OF_SHAPE)

}  // namespace amrpic::fem
