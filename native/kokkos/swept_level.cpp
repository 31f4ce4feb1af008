#include "kokkos/swept_level.hpp"

namespace amrpic::kokkos {

SweptLevel::SweptLevel(Communicator const& comm, cycle::SweptLevel& plan)
    : plan_(plan),
      r_(plan.right_hand_side().data(), plan.right_hand_side().size()),
      e_(plan.correction().data(), plan.correction().size()) {
  cycle::Stencil const& stencil = plan.stencil();
  auto const &first_rows = stencil.first_rows(), &first_composed = stencil.first_composed();
  auto const together = [&](std::size_t first, std::size_t last) {
    auto const first_run = [&](std::size_t block) { return stencil.first_runs()[std::size_t(first_composed[block])]; };
    together_.push_back({{first_rows[first], first_rows[last]}, {first_run(first), first_run(last)}});
  };
  std::size_t const blocks = plan.faces().size();
  for (std::size_t b = 0; plan.has_odd_ring() && b < blocks; ++b) together(b, b + 1);
  if (!plan.has_odd_ring()) together(0, blocks);
  std::vector<RowPlace> own;
  for (std::size_t b = 0; b < plan.layout().own_blocks(); ++b) {
    Box const& box = plan.layout().blocks()[b].box;
    for (int k = 0; k < box.extent(2); ++k)
      for (int j = 0; j < box.extent(1); ++j) own.push_back({std::int32_t(b), j, k});
  }
  own_rows_ = on_device(own);
  rows_ = on_device(stencil.all_rows());
  runs_ = on_device(stencil.runs());
  coefficients_ = on_device(stencil.coefficients());
  static_cast<cycle::RowTable&>(tables_) = stencil.table();
  tables_.rows = rows_.data(), tables_.runs = runs_.data(), tables_.coefficients = coefficients_.data();
  tables_.first_run = nullptr;  // rows are composed run by run
  metal_of_ = on_device(stencil.metal_of()), metal_rows_ = on_device(stencil.metal_rows());
  cuts_ = on_device(stencil.cuts()), solids_ = on_device(stencil.solids());
  cut_values_ = Array<float>("values of cut cells", cuts_.extent(0));
  tables_.metal_of = metal_of_.extent(0) > 0 ? metal_of_.data() : nullptr;
  tables_.metal_rows = metal_rows_.data(), tables_.cuts = cuts_.data(), tables_.solids = solids_.data();
  tables_.cut_values = cut_values_.data();
  composed_ = Array<float>("composed rows", std::size_t(first_composed.back()) * std::size_t(tables_.composed_pitch));
  tables_.composed = composed_.data();
  if (plan.is_thin()) {
    for (std::size_t colour : {0, 1})
      halo_of_colour_[colour] = CellCopies(comm, plan.halo_of_colour(colour), CellCopies::Use::update);
  } else {
    halo_ = CellCopies(comm, plan.halo(), CellCopies::Use::update);
    edge_halo_ = CellCopies(comm, plan.edge_halo(), CellCopies::Use::update);
  }
}

/// Set composed rows, or their differences to the rows that they lie beside.
void SweptLevel::compose(Range const& runs, bool differences) {
  LevelTables const level = tables_;
  auto const e = e_.array();
  for_each_row(
      "compose rows", runs, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        level.runs[n].compose(e.data(), differences, level.composed + level.runs[n].place, worker);
      });
}

/// One colour of some rows, at most `reach` steps from own cells. A kernel asks for nothing that is the same in all
/// rows: on the host rows are short, on a card registers are few.
template <bool with_metal>
void SweptLevel::half_sweep(Range const& rows, cycle::HalfSweep const& half, int reach) {
  LevelTables const level = tables_;
  auto const r = r_.array(), e = e_.array();
  int const colour = half.colour;
  if (half.is_fresh)
    for_each_row(
        "relax from zero", rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
          cycle::Row const& row = level.rows[n];
          if (row.steps > reach) return;
          worker.with_kind(row.lanes, true, [&](auto lanes, auto) {
            cycle::relax_from_zero<lanes(), with_metal>(level, row, colour, r.data(), e.data(), worker);
          });
        });
  else
    for_each_row(
        "relax", rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
          cycle::Row const& row = level.rows[n];
          if (row.steps > reach) return;
          worker.with_kind(row.lanes, level.isotropic, [&](auto lanes, auto isotropic) {
            cycle::relax<lanes(), isotropic(), with_metal>(level, row, colour, level.composed_rows(), r.data(),
                                                           e.data(), worker);
          });
        });
}
/// The cut cells of one colour.
void SweptLevel::half_sweep_beside_metal(Range const& rows, cycle::HalfSweep const& half, int reach) {
  LevelTables const level = tables_;
  auto const r = r_.array(), e = e_.array();
  int const colour = half.colour;
  for_each_row(
      "relax beside metal", rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        cycle::Row const& row = level.rows[n];
        if (row.steps <= reach)
          cycle::relax_beside_metal(level, row, colour, level.composed_rows(), r.data(), e.data(), worker);
      });
}

/// Bring thin copies of some colours, where they are not up to date.
void SweptLevel::bring(int colours) {
  if (!plan_.is_thin() || !plan_.has_halo()) return;
  for (int colour : {0, 1})
    if (colours & stale_ & cycle::colour_bit(colour))
      halo_of_colour_[std::size_t(colour)].update(e_.array(), e_.array());
  stale_ &= ~colours;
}

void SweptLevel::relax(cycle::Relaxed cells, int sweeps, bool from_zero, int further) {
  if (from_zero && sweeps == 0) {
    fill(e_.array(), 0.0f);
    stale_ = 0;
  }
  int reach = further + 2 * sweeps - 1;
  for (int half = 0; half < 2 * sweeps; ++half, --reach) {
    cycle::HalfSweep const h(half, from_zero);
    bring(h.reads);
    for (Together const& part : together_) {
      if (!h.is_fresh) compose(part.runs, false);
      if (cells == cycle::Relaxed::beside_metal)
        half_sweep_beside_metal(part.rows, h, reach);
      else
        tables_.metal_of ? half_sweep<true>(part.rows, h, reach) : half_sweep<false>(part.rows, h, reach);
    }
    stale_ |= h.changes;
  }
}

void SweptLevel::prepare_residual() {
  bring(cycle::both_colours);
  if (plan_.has_odd_ring()) exchange_corrections(false);  // copies behind it have not been swept as their cells were
  compose({0, std::int32_t(runs_.extent(0))}, tables_.in_differences);
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
  return rows_.extent(0) * sizeof(cycle::Row) + own_rows_.extent(0) * sizeof(RowPlace) +
         runs_.extent(0) * sizeof(cycle::ScaledRun) + metal_rows_.extent(0) * sizeof(cycle::MetalRow) +
         cuts_.extent(0) * sizeof(cycle::CutPlace) + solids_.extent(0) * sizeof(cycle::SolidRun) +
         (cut_values_.extent(0) + composed_.extent(0) + coefficients_.extent(0)) * sizeof(float) + halo_.bytes() +
         edge_halo_.bytes() + halo_of_colour_[0].bytes() + halo_of_colour_[1].bytes();
}

}  // namespace amrpic::kokkos
