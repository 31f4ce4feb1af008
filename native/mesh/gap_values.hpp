#pragma once

#include <vector>

#include "mesh/box.hpp"
#include "stencil/gap_fit.hpp"

namespace amrpic {

/// What lies around the gaps behind a face of a box: cells of one level in a box, x fastest; those that the level lacks
/// are never read.
template <class T>
class GapValues {
 public:
  void set_box(Box const& box) {
    box_ = box;
    values_.resize(std::size_t(box.cells()));
  }
  /// Copy values of a part of the box from memory where rows and planes have their own distances.
  void copy_in(Box const& part, T const* from, std::ptrdiff_t pitch_y, std::ptrdiff_t pitch_z) {
    for (int k = 0; k < part.extent(2); ++k)
      for (int j = 0; j < part.extent(1); ++j)
        std::copy_n(from + j * pitch_y + k * pitch_z, part.extent(0),
                    &values_[std::size_t(box_.offset({part.lower[0], part.lower[1] + j, part.lower[2] + k}))]);
  }
  T operator()(Index3 const& from, GapFit::Term const& term) const {
    return values_[std::size_t(
        box_.offset({from[0] + term.offset[0], from[1] + term.offset[1], from[2] + term.offset[2]}))];
  }
  std::size_t bytes() const { return values_.capacity() * sizeof(T); }

 private:
  Box box_;
  std::vector<T> values_;
};

}  // namespace amrpic
