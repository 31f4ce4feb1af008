#pragma once

#include <stdexcept>
#include <type_traits>

namespace amrpic::fem {

/// Call f(nodes along an axis, components), each an integral constant.
template <class F>
void with_shape(int degree, int components, F&& f) {
  auto const with_nodes = [&](auto nodes) {
    if (components == 1)
      f(nodes, std::integral_constant<int, 1>{});
    else
      f(nodes, std::integral_constant<int, 3>{});
  };
  switch (degree) {
    case 1:
      return with_nodes(std::integral_constant<int, 2>{});
    case 2:
      return with_nodes(std::integral_constant<int, 3>{});
    case 3:
      return with_nodes(std::integral_constant<int, 4>{});
    case 4:
      return with_nodes(std::integral_constant<int, 5>{});
  }
  throw std::invalid_argument("elements have degree 1 to 4");
}

}  // namespace amrpic::fem
