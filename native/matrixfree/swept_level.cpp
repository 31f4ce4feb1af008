#include "matrixfree/swept_level.hpp"

#include <algorithm>

namespace amrpic::matrixfree {

namespace {

LevelFaces faces_of_blocks(Level const& level, Layout const& layout) {
  LevelFaces out;
  for (CellBlock const& block : layout.blocks()) out.emplace_back(level, block.box);
  return out;
}

/// Add those layers of wanted cells that have coarser cells beside them.
void add_boundary_layers(Level const& level, Wanted const& wanted, std::vector<Wanted>& out) {
  BoxFaces const faces(level, wanted.cells);
  for (int f = 0; f < 6; ++f) {
    if (!faces.sides[std::size_t(f)].has_coarser) continue;
    Wanted layer = wanted;
    layer.cells = wanted.cells.layer(f / 2, f % 2, 0);
    Index3 const& first = layer.cells.lower;
    layer.copy.origin = wanted.copy.place(first[0] - wanted.cells.lower[0], first[1] - wanted.cells.lower[1],
                                          first[2] - wanted.cells.lower[2]);
    out.push_back(layer);
  }
}

}  // namespace

SweptLevel::SweptLevel(MPI_Comm comm, std::shared_ptr<Level const> level, GhostRules const& rules, Real shift,
                       Relaxation const& relaxation, int halo)
    : level_(std::move(level)),
      scale_(smallest_spacing(*level_) * smallest_spacing(*level_)),
      layout_(*level_, halo, rules.seams()),
      faces_(faces_of_blocks(*level_, layout_)),
      stencil_(*level_, layout_, faces_, rules, scaled(equation_on(level_->spacing(), shift), scale_),
               relaxation.factor),
      sweep_(layout_, stencil_, relaxation.kernels),
      r_(layout_.size()),
      e_(layout_.size()) {
  bool const has_boundary = level_->cells() < level_->domain().cells();
  std::vector<Wanted> copies, at_boundary;
  for (Halo const& copy : layout_.halo()) {
    Wanted const all{copy.source, copy.cells, layout_.halo_place(copy)};
    copies.push_back(all);
    if (has_boundary) add_boundary_layers(*level_, all, at_boundary);
  }
  halo_ = RectangleExchange(comm, *level_, layout_, copies);
  if (has_boundary) boundary_halo_ = RectangleExchange(comm, *level_, layout_, at_boundary);
}

std::vector<PlaneStage> SweptLevel::relaxations(int sweeps, bool from_zero, int further) {
  std::vector<PlaneStage> out;
  if (from_zero && sweeps == 0) std::fill(e_.begin(), e_.end(), 0.0f);
  int reach = further + 2 * sweeps - 1;  // each half-sweep reads one cell further than it relaxes
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
    if (plane + 1 >= layout_.first_halo_plane()) finish_exchanges();
  });
  finish_exchanges();
  halo_.settle();
  boundary_halo_.settle();
}

void SweptLevel::exchange_right_hand_sides() {
  finish_exchanges();
  begin(halo_, r_);
}

void SweptLevel::exchange_corrections(bool boundary_changed) {
  finish_exchanges();
  begin(halo_, e_);
  if (boundary_changed) begin(boundary_halo_, r_);
}

void SweptLevel::begin(RectangleExchange const& plan, Vector& values) {
  if (!has_halo()) return;
  plan.settle();
  plan.start(values.data(), values.data());
  under_way_.emplace_back(&plan, &values);
}

void SweptLevel::finish_exchanges() {
  for (auto const& [plan, values] : under_way_) plan->finish(values->data());
  under_way_.clear();
}

}  // namespace amrpic::matrixfree
