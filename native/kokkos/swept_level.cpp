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
  std::vector<matrixfree::ScaledRun> composition;
  std::int32_t composed = 0;
  for (std::size_t b = 0; b < plan.faces().size(); ++b) {
    auto const& block = layout.blocks()[b];
    auto const& of_block = stencil.block(b);
    Box const& box = block.box;
    first_rows_.push_back(std::int32_t(rows.size()));
    std::int32_t const pitch = std::int32_t(block.cells.pitch_y), first_composed = composed;
    std::int32_t const first_run = std::int32_t(composition.size());
    for (std::size_t c = 0; c + 1 < of_block.first_run.size(); ++c, composed += pitch)
      for (std::int32_t n = of_block.first_run[c]; n < of_block.first_run[c + 1]; ++n) {
        composition.push_back(of_block.runs[std::size_t(n)]);
        composition.back().place += composed;
      }
    for (int k = 0; k < box.extent(2); ++k)
      for (int j = 0; j < box.extent(1); ++j) {
        auto const& at = of_block.rows[std::size_t(j + box.extent(1) * k)];
        Row row{std::int32_t(block.cells.place(0, j, k)),
                at.beside,
                at.end,
                at.factor,
                at.coefficients,
                pitch,
                box.extent(0),
                std::int8_t(block.lanes),
                std::int8_t((box.lower[0] + box.lower[1] + j + box.lower[2] + k) & 1),
                b < layout.own_blocks() ? std::int8_t(0) : layout.steps_to_own(b, box.lower[2] + k)[j]};
        for (std::int32_t& beside : row.beside)
          if (beside < 0) beside = ~(first_composed + ~beside * pitch);
        rows.push_back(row);
        if (b < layout.own_blocks()) own.push_back({std::int32_t(b), j, k});
      }
    if (together_.empty() || plan.has_odd_ring()) together_.push_back({{first_rows_.back(), 0}, {first_run, 0}});
    together_.back().rows.last = std::int32_t(rows.size());
    together_.back().composition.last = std::int32_t(composition.size());
  }
  tables_ = {on_device(rows),
             on_device(composition),
             Array<float>("composed rows", std::size_t(composed)),
             on_device(stencil.coefficients()),
             stencil.weight(),
             stencil.isotropic(),
             stencil.keep(),
             stencil.in_differences(),
             std::int32_t(layout.zero_row())};
  own_rows_ = on_device(own);
  if (plan.is_thin()) {
    for (std::size_t colour : {0, 1})
      halo_of_colour_[colour] = CellCopies(comm, plan.halo_of_colour(colour), CellCopies::Use::update);
  } else {
    halo_ = CellCopies(comm, plan.halo(), CellCopies::Use::update);
    edge_halo_ = CellCopies(comm, plan.edge_halo(), CellCopies::Use::update);
  }
}

/// Set composed rows, or their differences to the rows that they lie beside.
void SweptLevel::compose(Part const& runs, bool differences) {
  LevelTables const level = tables_;
  auto const e = e_.array();
  for_each_row(
      "compose rows", runs, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        matrixfree::ScaledRun const run = level.composition(n);
        float const *const from = e.data() + run.source, *const own = e.data() + run.own;
        float* const to = level.composed.data() + run.place;
        worker.for_each(run.count, [=](int i) { to[i] = run.factor * (differences ? from[i] - own[i] : from[i]); });
      });
}

/// One colour of some rows, at most `reach` steps from own cells.
template <bool from_zero>
void SweptLevel::half_sweep(Part const& rows, int colour, int reach) {
  LevelTables const level = tables_;
  auto const r = r_.array(), e = e_.array();
  for_each_row(
      "relax", rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        Row const& row = level.rows(n);
        if (row.steps > reach) return;
        int const parity = (row.parity + colour) & 1;
        float const *const right = &r(row.place), *const step =
                                                      &level.coefficients(row.coefficients + (1 + parity) * row.pitch);
        float* const here = &e(row.place);
        if constexpr (from_zero) {
          worker.for_each(row.pitch, [=](int i) { here[i] = relaxed_from_zero(step[i], right[i]); });
        } else {
          matrixfree::CorrectionRow const at = level.correction(row, e.data());
          if constexpr (on_host)
            matrixfree::with_kind(row.lanes, level.isotropic, [&](auto lanes, auto isotropic) {
              matrixfree::relax<lanes(), isotropic()>(at, level.weight, right, step, level.keep, parity);
            });
          else
            worker.for_each((row.cells - parity + 1) / 2, [&](int half) {
              int const i = 2 * half + parity;
              here[i] = relaxed(level.keep, here[i], step[i], level.sum(row, at, i), right[i]);
            });
        }
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

void SweptLevel::relax(int sweeps, bool from_zero, int further) {
  if (from_zero && sweeps == 0) {
    Kokkos::deep_copy(e_.array(), 0.0f);
    stale_ = 0;
  }
  int reach = further + 2 * sweeps - 1;
  for (int half = 0; half < 2 * sweeps; ++half, --reach) {
    matrixfree::HalfSweep const h(half, from_zero);
    bring(h.reads);
    for (Together const& part : together_) {
      if (!h.is_fresh) compose(part.composition, false);
      h.is_fresh ? half_sweep<true>(part.rows, h.colour, reach) : half_sweep<false>(part.rows, h.colour, reach);
    }
    stale_ |= h.changes;
  }
}

void SweptLevel::prepare_residual() {
  bring(matrixfree::both_colours);
  if (plan_.has_odd_ring()) exchange_corrections(false);  // copies behind it have not been swept as their cells were
  compose({0, std::int32_t(tables_.composition.extent(0))}, tables_.in_differences);
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
         tables_.composition.extent(0) * sizeof(matrixfree::ScaledRun) +
         (tables_.composed.extent(0) + tables_.coefficients.extent(0)) * sizeof(float) + halo_.bytes() +
         edge_halo_.bytes() + halo_of_colour_[0].bytes() + halo_of_colour_[1].bytes();
}

}  // namespace amrpic::kokkos
