#include "cycle/swept_level.hpp"

#include <algorithm>
#include <utility>

#include "base/error.hpp"

namespace amrpic::cycle {

namespace {

/// Of the first so many blocks.
LevelFaces faces_of_blocks(Level const& level, Layout const& layout, std::size_t count) {
  LevelFaces out;
  out.reserve(count);
  for (std::size_t b = 0; b < count; ++b) out.emplace_back(level, layout.blocks()[b].box);
  return out;
}

std::vector<Box> boxes_of(Layout const& layout) {
  std::vector<Box> out;
  for (CellBlock const& block : layout.blocks()) out.push_back(block.box);
  return out;
}

}  // namespace

SweptLevel::SweptLevel(Communicator const& comm, std::shared_ptr<Level const> level, GhostRules const& rules,
                       Faces const& boundary, Real shift, Relaxation const& relaxation, int halo, MetalIn const& metal)
    : level_(std::move(level)),
      scale_(smallest_spacing(*level_) * smallest_spacing(*level_)),
      equation_(scaled(equation_on(level_->spacing(), shift), scale_)),
      is_thin_(halo == 1),
      may_have_metal_(metal != nullptr),
      layout_(*level_, halo, rules.seams()),
      faces_(faces_of_blocks(*level_, layout_, is_thin_ ? layout_.own_blocks() : layout_.blocks().size())),
      stencil_(*level_, layout_, faces_, rules, equation_, relaxation.factor,
               !metal && is_nearly_free(*level_, boundary, shift), metal ? metal(boxes_of(layout_)) : MetalCells{}),
      sweep_(layout_, stencil_),
      r_(layout_.size()),
      e_(layout_.size()) {
  std::vector<Copied> images, images_at_edges;
  for (Image const& image : layout_.images())
    layout_.for_each_copied_part(image.cells.shift(image.shift), [&](Box const& part, Placement const& copy) {
      images.push_back({image.box, part.shift_back(image.shift), copy});
    });
  auto const copies = [this](Box const& box, VisitPart const& f) { layout_.for_each_copied_part(box, f); };
  if (is_thin_) {
    for (Colours colours : {Colours::first, Colours::second})
      halo_of_colour_[std::size_t(colours)] =
          RectangleExchange(comm, layout_, images, layout_.across_ranks(), copies, colours);
    return;
  }
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

void SweptLevel::relax(Relaxed cells, int sweeps, bool from_zero, int further) {
  if (rehearsal_ && cells == Relaxed::all)
    rehearsal_->sweeps += sweeps, rehearsal_->relaxed += relaxed_cells(sweeps, further);
  if (from_zero && sweeps == 0) {
    std::fill(e_.begin(), e_.end(), 0.0f);
    stale_ = 0;
  }
  int reach = further + 2 * sweeps - 1;  // each half-sweep reads one cell further than it relaxes
  for (int half = 0; half < 2 * sweeps; ++half, --reach) {
    HalfSweep const h(half, from_zero);
    bool const is_last = half + 1 == 2 * sweeps;
    auto const relax = [this, h, reach, is_last, cells](std::size_t b, int k, RowChoice const& some) {
      RowChoice const rows = is_thin_ ? some : layout_.rows_in_reach(b, k, reach);
      if (cells == Relaxed::beside_metal) return sweep_.relax_beside_metal(b, k, h.colour, rows, r_, e_);
      sweep_.relax(b, k, h.colour, h.is_fresh, is_last, rows, r_, e_);
    };
    then({relax, h.reads, h.changes});
  }
}

Real SweptLevel::relaxed_cells(int sweeps, int further) const {
  if (is_thin_) return Real(sweeps) * level_->local_cells();
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

SweptLevel::PlaceAndDiagonal SweptLevel::place_and_diagonal(Index3 const& cell) const {
  for (int b : layout_.on_plane(cell[2])) {
    CellBlock const& block = layout_.blocks()[std::size_t(b)];
    if (std::size_t(b) >= layout_.own_blocks() || !block.box.contains(cell)) continue;
    int const i = cell[0] - block.box.lower[0], j = cell[1] - block.box.lower[1], k = cell[2] - block.box.lower[2];
    return {std::size_t(block.place(cell)), stencil_.diagonal(std::size_t(b), block.box.extent(1), {i, j, k})};
  }
  fail_alone("the cell is not one of this rank's");
}

/// Run a stage over the rows of own blocks that rows(block, plane) chooses.
template <class Rows>
void SweptLevel::pass(PlaneStage const& stage, Rows&& rows) {
  if (rehearsal_) return;
  for (int k = layout_.first_plane(); k < layout_.first_plane() + layout_.planes(); ++k) {
    for (auto const& [plan, values] : under_way_) plan->poll();
    for (int b : layout_.on_plane(k))
      if (std::size_t(b) < layout_.own_blocks()) stage.act(std::size_t(b), k, rows(std::size_t(b), k));
  }
}

/// Stages over thin copies: each is run over the whole level, first over the rows that others have copies of where they
/// need them next.
void SweptLevel::run_one_by_one(std::vector<PlaneStage> const& stages) {
  for (std::size_t n = 0; n < stages.size(); ++n) {
    PlaneStage const& stage = stages[n];
    begin(stage.reads & stale_);
    finish_exchanges();
    stale_ |= stage.changes;
    int const next = n + 1 < stages.size() ? stages[n + 1].reads & stage.changes : 0;
    if (next != 0) {
      pass(stage, [this](std::size_t b, int k) { return layout_.rows_by_copies(b, k, true); });
      begin(next);
      pass(stage, [this](std::size_t b, int k) { return layout_.rows_by_copies(b, k, false); });
    } else {
      pass(stage, [](std::size_t, int) { return RowChoice{}; });
    }
  }
  for (auto const& halo : halo_of_colour_) halo.settle();
}

void SweptLevel::run() {
  std::vector<PlaneStage> stages = std::exchange(stages_, {});
  if (is_thin_) return run_one_by_one(stages);
  if (rehearsal_) stages.clear();
  wavefront(layout_, stages, [this](int plane) {
    halo_.poll();
    if (plane + 1 >= layout_.first_halo_plane()) finish_exchanges();
  });
  finish_exchanges();
  halo_.settle();
  edge_halo_.settle();
}

void SweptLevel::exchange_right_hand_sides() {
  if (is_thin_) return;
  finish_exchanges();
  begin(halo_, r_);
}

void SweptLevel::exchange_corrections(bool boundary_changed) {
  if (is_thin_) return;
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

/// The same for the thin copies of corrections of some colours.
void SweptLevel::begin(int colours) {
  for (int colour : {0, 1})
    if (colours & colour_bit(colour)) begin(halo_of_colour_[std::size_t(colour)], e_);
  stale_ &= ~colours;
}

void SweptLevel::finish_exchanges() {
  for (auto const& [plan, values] : under_way_) plan->finish(values->data());
  under_way_.clear();
}

}  // namespace amrpic::cycle
