#pragma once

#include <stdexcept>
#include <type_traits>

namespace amrpic::fem {

/// Call f(nodes along an axis), an integral constant.
template <class F>
void with_degree(int degree, F&& f) {
  switch (degree) {
    case 1:
      return f(std::integral_constant<int, 2>{});
    case 2:
      return f(std::integral_constant<int, 3>{});
    case 3:
      return f(std::integral_constant<int, 4>{});
    case 4:
      return f(std::integral_constant<int, 5>{});
  }
  throw std::invalid_argument("elements have degree 1 to 4");
}

/// Call f(nodes along an axis, components), each an integral constant.
template <class F>
void with_shape(int degree, int components, F&& f) {
  with_degree(degree, [&](auto nodes) {
    if (components == 1)
      f(nodes, std::integral_constant<int, 1>{});
    else
      f(nodes, std::integral_constant<int, 3>{});
  });
}

/// The same as a list: f(nodes along an axis, components) for each.
#define AMRPIC_FOR_EACH_SHAPE(f) f(2, 1) f(3, 1) f(4, 1) f(5, 1) f(2, 3) f(3, 3) f(4, 3) f(5, 3)

}  // namespace amrpic::fem
