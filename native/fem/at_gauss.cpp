#include "fem/at_gauss.hpp"

namespace amrpic::fem {

template <int P, int C>
template <bool back>
void SlopesAtGauss<P, C>::along(int axis, V const* u, V* out) const {
  int const stride = line_stride<P>(axis);
  Matrix<P> const& m = back ? rule.transposed_slope : rule.slope;
  for (int n = 0; n < P * P; ++n) {
    int const start = line_start<P>(axis, n);
    for (int i = 0; i < P; ++i) {
      V sum = m[i][0] * u[start];
      for (int l = 1; l < P; ++l) sum += m[i][l] * u[start + l * stride];
      V& to = out[start + i * stride];
      to = back ? to + sum : sum;
    }
  }
}

template <int P, int C>
void SlopesAtGauss<P, C>::at_block(std::int64_t block, int lane, int first, V (&slope)[C][3][count]) const {
  AtPoint<C> at{};
  int const here = std::min(native_lane_count, count - first);
  for (int c = 0; c < C; ++c)
    for (std::size_t a = 0; a < 3; ++a)
      for (int n = 0; n < here; ++n) at.slope[c][a][n] = slope[c][a][first + n][lane];
  d(block, at);
  for (int c = 0; c < C; ++c)
    for (std::size_t a = 0; a < 3; ++a)
      for (int n = 0; n < here; ++n) slope[c][a][first + n][lane] = at.slope[c][a][n];
}

template <int P, int C>
void SlopesAtGauss<P, C>::operator()(LocalIndex const* elements, int lanes, GroupValues<P, C>& values) const {
  V slope[C][3][count];
  for (int c = 0; c < C; ++c) {
    transform(rule.from_nodes, values.value[c]);
    for (int axis = 0; axis < 3; ++axis) along<false>(axis, values.value[c], slope[c][axis]);
  }
  for (int lane = 0; lane < lanes; ++lane)
    for (int first = 0; first < count; first += native_lane_count)
      at_block(points.first_block(elements[lane]) + first / native_lane_count, lane, first, slope);
  for (int c = 0; c < C; ++c) {
    for (V& sum : values.value[c]) sum = V{};
    for (int axis = 0; axis < 3; ++axis) along<true>(axis, slope[c][axis], values.value[c]);
    transform(rule.to_nodes, values.value[c]);
  }
}

template struct SlopesAtGauss<2, 3>;
template struct SlopesAtGauss<3, 3>;
template struct SlopesAtGauss<4, 3>;
template struct SlopesAtGauss<5, 3>;

}  // namespace amrpic::fem
