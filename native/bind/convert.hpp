// Arrays and boxes between Python and C++.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <vector>

#include "mesh/box.hpp"

namespace amrpic::bind {

namespace nb = nanobind;

using Starts = nb::ndarray<std::int64_t const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using IntRows = nb::ndarray<int const, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using RealRows = nb::ndarray<Real const, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Reals = nb::ndarray<Real const, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

/// A NumPy array that owns a copy of the values.
template <class T>
nb::ndarray<nb::numpy, T> to_array(std::vector<T> values, std::initializer_list<std::size_t> shape) {
  auto* kept = new std::vector<T>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T>(kept->data(), shape, owner);
}

template <class T>
nb::ndarray<nb::numpy, T> to_array(std::vector<T> values) {
  std::size_t const n = values.size();
  return to_array(std::move(values), {n});
}

/// What f gives, while Python may run something else.
template <class F>
auto released(F&& f) {
  nb::gil_scoped_release release;
  return f();
}

/// Rows of lower x, y, z, upper x, y, z.
inline std::vector<Box> to_boxes(IntRows const& rows) {
  std::vector<Box> out;
  for (std::size_t b = 0; b < rows.shape(0); ++b)
    out.push_back({{rows(b, 0), rows(b, 1), rows(b, 2)}, {rows(b, 3), rows(b, 4), rows(b, 5)}});
  return out;
}

inline nb::ndarray<nb::numpy, int> from_boxes(std::vector<Box> const& boxes) {
  std::vector<int> rows;
  for (Box const& b : boxes) {
    rows.insert(rows.end(), b.lower.begin(), b.lower.end());
    rows.insert(rows.end(), b.upper.begin(), b.upper.end());
  }
  return to_array(std::move(rows), {boxes.size(), 6});
}

}  // namespace amrpic::bind
