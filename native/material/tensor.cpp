#include "material/tensor.hpp"

#include <algorithm>
#include <cmath>

namespace amrpic::material {

Eigen eigen_of(Tensor a) {
  Tensor vectors = unit_tensor();
  for (int sweep = 0; sweep < 30; ++sweep) {
    Real const off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
    if (off <= 1e-34 * contraction(a, a)) break;
    for (std::size_t p = 0; p < 2; ++p)
      for (std::size_t q = p + 1; q < 3; ++q) {
        if (a[p][q] == 0) continue;
        Real const ratio = (a[q][q] - a[p][p]) / (2 * a[p][q]);
        Real const tangent = std::copysign(1 / (std::abs(ratio) + std::hypot(ratio, 1)), ratio);
        Real const cosine = 1 / std::hypot(tangent, 1), sine = tangent * cosine;
        Tensor turn = unit_tensor();
        turn[p][p] = turn[q][q] = cosine, turn[p][q] = sine, turn[q][p] = -sine;
        a = product(transposed(turn), product(a, turn));
        vectors = product(vectors, turn);
      }
  }
  return {{a[0][0], a[1][1], a[2][2]}, vectors};
}

Real smallest_eigenvalue(Tensor const& a) {
  constexpr Real third_of_turn = 2.0943951023931953;
  Real const mean = trace(a) / 3;
  Tensor const deviator = sum(a, -mean, unit_tensor());
  Real const radius = std::sqrt(contraction(deviator, deviator) / 6);
  if (!(radius > 0)) return mean;
  Real const cosine = determinant(scaled(1 / radius, deviator)) / 2;
  return mean + 2 * radius * std::cos(std::acos(std::clamp(cosine, Real(-1), Real(1))) / 3 + third_of_turn);
}

}  // namespace amrpic::material
