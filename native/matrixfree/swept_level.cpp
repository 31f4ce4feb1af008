#include "matrixfree/swept_level.hpp"

#include <algorithm>

namespace amrpic::matrixfree {

SweptLevel::SweptLevel(MPI_Comm comm, std::shared_ptr<Level const> level, Ends const& ends,
                       Relaxation const& relaxation, int halo)
    : level_(std::move(level)),
      scale_(smallest_spacing(*level_) * smallest_spacing(*level_)),
      layout_(*level_, halo),
      stencil_(*level_, layout_, ends, relaxation.factor),
      sweep_(layout_, stencil_, relaxation.kernels),
      r_(layout_.size()),
      e_(layout_.size()) {
  std::vector<Wanted> copies;
  for (Halo const& copy : layout_.halo()) copies.push_back({copy.source, copy.cells, layout_.halo_place(copy)});
  halo_ = RectangleExchange(comm, *level_, layout_, copies);
}

std::vector<PlaneStage> SweptLevel::relaxations(int sweeps, bool from_zero, int further) {
  std::vector<PlaneStage> out;
  if (from_zero && sweeps == 0) std::fill(e_.begin(), e_.end(), 0.0f);
  int reach = further + 2 * sweeps - 1;  // each half-sweep reads one cell beyond what it relaxes
  for (int s = 0; s < sweeps; ++s)
    for (int colour : {0, 1}) {
      bool const fresh = from_zero && s == 0 && colour == 0;
      out.push_back([this, colour, fresh, reach](std::size_t b, int k) {
        if (layout_.distance(b, k) > reach) return;
        if (fresh)
          sweep_.relax_from_zero(b, k, colour, r_, e_);
        else
          sweep_.relax(b, k, colour, r_, e_);
      });
      --reach;
    }
  return out;
}

void SweptLevel::run(std::vector<PlaneStage> const& stages) {
  wavefront(layout_, stages, [this](int plane) {
    halo_.poll();
    if (plane + 1 >= layout_.first_halo_plane()) finish_exchange();
  });
  finish_exchange();
}

void SweptLevel::exchange_halo(bool corrections, bool right_hand_sides) {
  if (!has_halo()) return;
  finish_exchange();
  if (corrections) under_way_.emplace_back(e_.data(), e_.data());
  if (right_hand_sides) under_way_.emplace_back(r_.data(), r_.data());
  halo_.start(under_way_);
}

void SweptLevel::finish_exchange() {
  if (under_way_.empty()) return;
  halo_.finish(under_way_);
  under_way_.clear();
}

}  // namespace amrpic::matrixfree
