#include "solver/node_rows.hpp"

#include "mesh/array_on_box.hpp"

namespace amrpic {

SharedRows compressed(fem::NodeBlocks const& blocks) {
  Level const& nodes = *blocks.nodes;
  int const components = blocks.components;
  SharedRows out;
  Real const* node = blocks.value.data();
  for (int b = nodes.first_local_box(); b < nodes.last_local_box(); ++b) {
    Box const& box = nodes.box(b);
    auto const number = cell_numbers(nodes, box.grow(1));
    for_each_cell(box, [&](Index3 const& at) {
      for (int r = 0; r < components; ++r) {
        int n = 0;
        for_each_cell(Box{at, at}.grow(1), [&](Index3 const& other) {
          for (int c = 0; c < components; ++c) {
            Real value = node[(n * components + r) * components + c];
            if (other == at && c == r && !(value > 0)) value = 1;
            if (value == 0) continue;
            out.column.push_back(number(other) * components + c);
            out.value.push_back(value);
          }
          ++n;
        });
        out.row_start.push_back(out.column.size());
      }
      node += blocks.width();
    });
  }
  return out;
}

}  // namespace amrpic
