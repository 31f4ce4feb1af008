#pragma once

#include "operators/row.hpp"

namespace amrpic {

/// Terms of a row, apart by the level of the columns: what `outward_gradient` emits to.
struct Terms {
  Row own_row, coarse_row, fine_row;
  void clear() { own_row.clear(), coarse_row.clear(), fine_row.clear(); }
  void own(GlobalIndex cell, Real value) { own_row.add(cell, value); }
  void coarse(GlobalIndex cell, Real value) { coarse_row.add(cell, value); }
  void fine(GlobalIndex cell, Real value) { fine_row.add(cell, value); }
};

}  // namespace amrpic
