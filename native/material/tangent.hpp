#pragma once

#include "material/tensor.hpp"

namespace amrpic::material {

/// How the stress at a point changes, in the current configuration: c : e = a tr(e) 1 + b e - d (s tr(e) + (s : e) 1),
/// where s is the deviator of a stress.
struct IsotropicModuli {
  Real a, b;
  Real d = 0;
  Tensor deviator = {};

  Tensor operator()(Tensor const& e) const {
    Tensor const along = sum(unit_tensor(a * trace(e) - d * contraction(deviator, e)), b, e);
    return sum(along, -d * trace(e), deviator);
  }
};

/// The same by stiffnesses along the directions of principal stretches: c_iijj, and c_ijij for i, j = 12, 20, 01.
struct PrincipalModuli {
  Tensor direction;  ///< columns
  Tensor along;
  std::array<Real, 3> shear;

  Tensor operator()(Tensor const& e) const {
    Tensor const turned = product(transposed(direction), product(e, direction));
    Tensor out{};
    for_each_entry([&](std::size_t i, std::size_t j) {
      if (i != j) {
        out[i][j] = shear[3 - i - j] * turned[i][j];
        return;
      }
      for (std::size_t k = 0; k < 3; ++k) out[i][i] += along[i][k] * turned[k][k];
    });
    return product(direction, product(out, transposed(direction)));
  }
};

/// P changes by this, times F' on the right, where the displacement's gradient in the present configuration changes by
/// `h`: what is tested with such gradients, per initial volume.
template <class Moduli>
Tensor change_of_stress(Tensor const& kirchhoff, Moduli const& moduli, Tensor const& h) {
  return sum(product(h, kirchhoff), 1, moduli(symmetric_part(h)));
}

}  // namespace amrpic::material
