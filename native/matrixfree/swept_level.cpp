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

std::vector<PlaneStage> SweptLevel::relaxations(int sweeps, bool from_zero) {
  std::vector<PlaneStage> out;
  if (from_zero && sweeps == 0) std::fill(e_.begin(), e_.end(), 0.0f);
  for (int s = 0; s < sweeps; ++s)
    for (int colour : {0, 1})
      if (from_zero && s == 0 && colour == 0)
        out.push_back([this](std::size_t b, int k) { sweep_.relax_from_zero(b, k, 0, r_, e_); });
      else
        out.push_back([this, colour](std::size_t b, int k) { sweep_.relax(b, k, colour, r_, e_); });
  return out;
}

void SweptLevel::exchange_halo(bool corrections, bool right_hand_sides) {
  if (!has_halo()) return;
  std::vector<std::pair<float const*, float*>> fields;
  if (corrections) fields.emplace_back(e_.data(), e_.data());
  if (right_hand_sides) fields.emplace_back(r_.data(), r_.data());
  halo_.update(fields);
}

}  // namespace amrpic::matrixfree
