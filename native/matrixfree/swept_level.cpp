#include "matrixfree/swept_level.hpp"

#include <algorithm>

namespace amrpic::matrixfree {

namespace {

LevelFaces faces_of_blocks(Level const& level, Layout const& layout) {
  LevelFaces out;
  out.reserve(layout.blocks().size());
  for (CellBlock const& block : layout.blocks()) out.emplace_back(level, block.box);
  return out;
}

}  // namespace

SweptLevel::SweptLevel(Communicator const& comm, std::shared_ptr<Level const> level, GhostRules const& rules,
                       Real shift, Relaxation const& relaxation, int halo)
    : level_(std::move(level)),
      scale_(smallest_spacing(*level_) * smallest_spacing(*level_)),
      layout_(*level_, halo, rules.seams()),
      faces_(faces_of_blocks(*level_, layout_)),
      stencil_(*level_, layout_, faces_, rules, scaled(equation_on(level_->spacing(), shift), scale_),
               relaxation.factor),
      sweep_(layout_, stencil_, relaxation.kernels),
      r_(layout_.size()),
      e_(layout_.size()) {
  std::vector<Copied> images, images_at_edges;
  for (Image const& image : layout_.images())
    layout_.for_each_copied_part(image.cells.shift(image.shift), [&](Box const& part, Placement const& copy) {
      images.push_back({image.box, part.shift_back(image.shift), copy});
    });
  auto const copies = [this](Box const& box, Part const& f) { layout_.for_each_copied_part(box, f); };
  halo_ = RectangleExchange(comm, layout_, images, layout_.across_ranks(), copies);
  if (level_->cells() == level_->domain().cells()) return;
  for (Copied const& image : images)
    for_each_layer_at_edge(*level_, image.cells, [&](Box const& layer) {
      Copied at_edge = image;
      at_edge.cells = layer;
      at_edge.copy.origin =
          image.copy.place(layer.lower[0] - image.cells.lower[0], layer.lower[1] - image.cells.lower[1],
                           layer.lower[2] - image.cells.lower[2]);
      images_at_edges.push_back(at_edge);
    });
  edge_halo_ = RectangleExchange(comm, layout_, images_at_edges, at_edges(*level_, layout_.across_ranks()), copies);
}

std::vector<PlaneStage> SweptLevel::relaxations(int sweeps, bool from_zero, int further) {
  std::vector<PlaneStage> out;
  if (from_zero && sweeps == 0) std::fill(e_.begin(), e_.end(), 0.0f);
  int reach = further + 2 * sweeps - 1;  // each half-sweep reads one cell further than it relaxes
  for (int s = 0; s < sweeps; ++s)
    for (int colour : {0, 1}) {
      bool const fresh = from_zero && s == 0 && colour == 0;
      out.push_back([this, colour, fresh, reach](std::size_t b, int k) {
        RowChoice const rows = layout_.rows_in_reach(b, k, reach);
        if (fresh)
          sweep_.relax_from_zero(b, k, colour, rows, r_, e_);
        else
          sweep_.relax(b, k, colour, rows, r_, e_);
      });
      --reach;
    }
  return out;
}

Real SweptLevel::relaxed_cells(int sweeps, int further) const {
  std::int64_t cells = 0;
  for (int reach = further; reach < further + 2 * sweeps; ++reach)
    for (std::size_t b = 0; b < layout_.blocks().size(); ++b) {
      Box const& box = layout_.blocks()[b].box;
      for (int k = box.lower[2]; k <= box.upper[2]; ++k) {
        RowChoice const rows = layout_.rows_in_reach(b, k, reach);
        for (int j = 0; j < box.extent(1); ++j) cells += rows.contains(j) ? box.extent(0) : 0;
      }
    }
  return Real(cells) / 2;
}

Traffic SweptLevel::of_corrections(bool boundary_changed) const {
  if (!has_halo()) return {};
  return boundary_changed ? halo_.of_update() + edge_halo_.of_update() : halo_.of_update();
}

void SweptLevel::run(std::vector<PlaneStage> const& stages) {
  wavefront(layout_, stages, [this](int plane) {
    halo_.poll();
    if (plane + 1 >= layout_.first_halo_plane()) finish_exchanges();
  });
  finish_exchanges();
  halo_.settle();
  edge_halo_.settle();
}

void SweptLevel::exchange_right_hand_sides() {
  finish_exchanges();
  begin(halo_, r_);
}

void SweptLevel::exchange_corrections(bool boundary_changed) {
  finish_exchanges();
  begin(halo_, e_);
  if (boundary_changed) begin(edge_halo_, r_);
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
