#include "freespace/density.hpp"

#include <utility>

namespace amrpic::freespace {

std::vector<ChargeBox> charges_of(Field const& density, Hierarchy const& hierarchy, double factor) {
  std::vector<ChargeBox> out;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      Box const box = level.box(b);
      ChargeBox charge{l, box.lower, box.upper, &density.level(l)[level.local_offset(b)], factor * level.cell_volume()};
      if (hierarchy.has_finer(l))
        hierarchy.level(l + 1).for_each_overlap(box.refine(refinement_ratio), [&](int, Box const& part, Index3 const&) {
          Box const covered = part.coarsen(refinement_ratio);
          charge.covered.push_back({covered.lower, covered.upper});
        });
      out.push_back(std::move(charge));
    }
  }
  return out;
}

}  // namespace amrpic::freespace
