#include "kokkos/swept_level.hpp"

#include "stencil/relaxation.hpp"

namespace amrpic::kokkos {

SweptLevel::SweptLevel(Communicator const& comm, matrixfree::SweptLevel& plan)
    : plan_(plan),
      r_(plan.right_hand_side().data(), plan.right_hand_side().size()),
      e_(plan.correction().data(), plan.correction().size()) {
  matrixfree::Layout const& layout = plan.layout();
  matrixfree::Stencil const& stencil = plan.stencil();
  std::vector<Row> rows;
  std::vector<RowPlace> own;
  std::vector<ComposedCell> composed;
  for (std::size_t b = 0; b < plan.faces().size(); ++b) {
    auto const& block = layout.blocks()[b];
    auto const& of_block = stencil.block(b);
    Box const& box = block.box;
    first_rows_.push_back(std::int32_t(rows.size()));
    // Cells of composed rows, one row after the other.
    std::vector<std::int32_t> first_cell;
    for (std::size_t c = 0; c + 1 < of_block.first_run.size(); ++c) {
      first_cell.push_back(std::int32_t(composed.size()));
      for (std::int32_t n = of_block.first_run[c]; n < of_block.first_run[c + 1]; ++n)
        for (int i = 0; i < of_block.runs[std::size_t(n)].count; ++i)
          composed.push_back({of_block.runs[std::size_t(n)].factor == 0 ? 0 : of_block.runs[std::size_t(n)].source + i,
                              of_block.runs[std::size_t(n)].factor});
    }
    for (int k = 0; k < box.extent(2); ++k)
      for (int j = 0; j < box.extent(1); ++j) {
        auto const& at = of_block.rows[std::size_t(j + box.extent(1) * k)];
        Row row{std::int32_t(block.cells.place(0, j, k)),
                at.beside,
                at.end,
                at.factor,
                at.coefficients,
                std::int32_t(block.cells.pitch_y),
                box.extent(0),
                std::int8_t((box.lower[0] + box.lower[1] + j + box.lower[2] + k) & 1),
                b < layout.own_blocks() ? std::int8_t(0) : layout.steps_to_own(b, box.lower[2] + k)[j],
                false};
        for (std::int32_t& beside : row.beside)
          if (beside < 0) beside = ~first_cell[std::size_t(~beside)], row.is_composed = true;
        rows.push_back(row);
        if (b < layout.own_blocks()) own.push_back({std::int32_t(b), j, k});
      }
    if (together_.empty() || plan.has_odd_ring()) together_.push_back({first_rows_.back(), 0});
    together_.back().last = std::int32_t(rows.size());
  }
  tables_ = {on_device(rows), on_device(composed), on_device(stencil.coefficients()), stencil.weight(), stencil.keep()};
  own_rows_ = on_device(own);
  if (plan.is_thin()) {
    for (std::size_t colour : {0, 1})
      halo_of_colour_[colour] = CellCopies(comm, plan.halo_of_colour(colour), CellCopies::Use::update);
  } else {
    halo_ = CellCopies(comm, plan.halo(), CellCopies::Use::update);
    edge_halo_ = CellCopies(comm, plan.edge_halo(), CellCopies::Use::update);
  }
}

void SweptLevel::relax(int sweeps, bool from_zero, int further) {
  if (from_zero && sweeps == 0) {
    Kokkos::deep_copy(e_.array(), 0.0f);
    stale_ = 0;
  }
  int reach = further + 2 * sweeps - 1;
  for (int half = 0; half < 2 * sweeps; ++half, --reach) {
    matrixfree::HalfSweep const h(half, from_zero);
    bring(h.reads);
    for (Part const& rows : together_) half_sweep(rows, h.colour, h.is_fresh, reach);
    stale_ |= h.changes;
  }
}

/// One colour of some rows, at most `reach` steps from own cells.
void SweptLevel::half_sweep(Part const& rows, int colour, bool from_zero, int reach) {
  LevelTables const level = tables_;
  auto const r = r_.array(), e = e_.array();
  if (from_zero) {
    for_each_row(
        "relax from zero", rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
          Row const& row = level.rows(n);
          if (row.steps > reach) return;
          float* const here = &e(row.place);
          float const *const right = &r(row.place), *const step = &level.coefficients(
                                                        row.coefficients +
                                                        (1 + ((row.parity + colour) & 1)) * row.pitch);
          worker.for_each(row.cells, [=](int i) { here[i] = relaxed_from_zero(step[i], right[i]); });
        });
    return;
  }
  for_each_row(
      "relax", rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        Row const& row = level.rows(n);
        if (row.steps > reach) return;
        int const parity = (row.parity + colour) & 1;
        float* const here = &e(row.place);
        float const *const right = &r(row.place), *const step =
                                                      &level.coefficients(row.coefficients + (1 + parity) * row.pitch);
        float const before = row.factor[0] * e(row.end[0]), after = row.factor[1] * e(row.end[1]), keep = level.keep;
        auto const run = [&](auto const& beside) {
          worker.relax(row.cells, parity, here, before, after, [=](int i, float x, float y) {
            return relaxed(keep, here[i], step[i], beside.sum(i, x, y), right[i]);
          });
        };
        if (row.is_composed)
          run(RowsBeside<true>(level, row, e.data()));
        else
          run(RowsBeside<false>(level, row, e.data()));
      });
}

/// Bring thin copies of some colours, where they are not up to date.
void SweptLevel::bring(int colours) {
  if (!plan_.is_thin() || !plan_.has_halo()) return;
  for (int colour : {0, 1})
    if (colours & stale_ & matrixfree::colour_bit(colour))
      halo_of_colour_[std::size_t(colour)].update(e_.array(), e_.array());
  stale_ &= ~colours;
}

void SweptLevel::prepare_residual() {
  bring(matrixfree::both_colours);
  if (plan_.has_odd_ring()) exchange_corrections(false);  // copies behind it have not been swept as their cells were
}

void SweptLevel::exchange_right_hand_sides() {
  if (!plan_.is_thin() && plan_.has_halo()) halo_.update(r_.array(), r_.array());
}

void SweptLevel::exchange_corrections(bool boundary_changed) {
  if (plan_.is_thin() || !plan_.has_halo()) return;
  halo_.update(e_.array(), e_.array());
  if (boundary_changed) edge_halo_.update(r_.array(), r_.array());
}

std::size_t SweptLevel::bytes() const {
  return tables_.rows.extent(0) * sizeof(Row) + own_rows_.extent(0) * sizeof(RowPlace) +
         tables_.composed.extent(0) * sizeof(ComposedCell) + tables_.coefficients.extent(0) * sizeof(float) +
         halo_.bytes() + edge_halo_.bytes() + halo_of_colour_[0].bytes() + halo_of_colour_[1].bytes();
}

}  // namespace amrpic::kokkos
