#include "kokkos/coarsening.hpp"

#include <unordered_map>

namespace amrpic::kokkos {

using cycle::Parents;

Coarsening::Coarsening(Communicator const& comm, cycle::Coarsening& plan, SweptLevel& fine, SweptLevel& coarse)
    : plan_(plan), fine_(fine), coarse_(coarse), values_(plan.values_.data(), plan.values_.size()) {
  cycle::Layout const& layout = fine.plan().layout();
  std::vector<ParentRow> rows;
  std::vector<Block> blocks;
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    Box const& box = layout.blocks()[b].box;
    blocks.push_back({fine.plan().stencil().first_rows()[b], box.extent(1), box.extent(2)});
    Index3 const& extent = plan.sources_[b].extent;
    for (int z = 0; z < extent[2]; ++z)
      for (int y = 0; y < extent[1]; ++y) rows.push_back({std::int32_t(b), y, z});
  }
  // A ghost may be a multiple of another one, which was filled before it.
  std::vector<Ghost> ghosts;
  std::unordered_map<std::int32_t, std::size_t> known;
  for (auto const& copy : plan.ghosts_) {
    auto const before = known.find(copy.from);
    Ghost ghost{copy.from, copy.to, copy.factor};
    if (before != known.end()) {
      ghost.from = ghosts[before->second].from;
      ghost.factor *= ghosts[before->second].factor;
    }
    known[copy.to] = ghosts.size();
    ghosts.push_back(ghost);
  }
  lists_ = {on_device(plan.sources_), on_device(plan.in_place_ ? plan.targets_ : plan.sources_), on_device(rows),
            on_device(blocks), on_device(ghosts)};
  parents_ = CellCopies(comm, plan.parents_, CellCopies::Use::update);
  if (!plan.in_place_) targets_of_residuals_ = CellCopies(comm, plan.targets_of_residuals_, CellCopies::Use::add);
  if (plan.refines_) interface_ = InterfaceCells(plan.interface_, layout);
}

Array<float> const& Coarsening::target() const {
  return plan_.in_place_ ? coarse_.right_hand_side().array() : values_.array();
}

/// The sums over the children of all parents, of residuals or of right-hand sides.
template <bool of_residual, bool with_metal>
void Coarsening::restrict_rows() {
  if (!plan_.in_place_) fill(values_.array(), 0.0f);
  LevelTables const level = fine_.tables();
  Lists const on = lists_;
  auto const e = fine_.correction().array(), r = fine_.right_hand_side().array(), out = target();
  float const weight = plan_.weight();
  for_each_row(
      "restrict", on.parent_rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        ParentRow const& of = on.parent_rows(n);
        Block const& block = on.blocks(of.block);
        cycle::restrict_to<of_residual, with_metal>(on.taking(of.block), of.y, of.z, level,
                                                    level.rows + block.first_row, block.ny, block.nz, weight,
                                                    level.composed_rows(), r.data(), e.data(), out.data(), worker);
      });
}

void Coarsening::prepare_residual() {
  if (has_gaps()) update_gaps();
  fine_.prepare_residual();
}

void Coarsening::restrict_residual() {
  fine_.tables().metal_of ? restrict_rows<true, true>() : restrict_rows<true, false>();
  if (plan_.refines_) interface_.subtract_flux(fine_.correction().array(), target());
  add_to_coarse_level();
}

void Coarsening::restrict_right_hand_side() {
  fine_.tables().metal_of ? restrict_rows<false, true>() : restrict_rows<false, false>();
  add_to_coarse_level();
}

/// Add the target to the coarser right-hand side, on whichever ranks the parents are. What all ranks hold of a coarse
/// level is gathered by the host.
void Coarsening::add_to_coarse_level() {
  if (plan_.in_place_) return;
  auto const& r = coarse_.right_hand_side();
  if (!plan_.refines_) fill(r.array(), 0.0f);
  targets_of_residuals_.add(values_.array(), r.array());
  if (plan_.own_parts_ == 0) return;
  r.to_host();
  plan_.gather_from_others(coarse_.plan().right_hand_side());
  r.to_device();
}

void Coarsening::update_gaps() {
  fine_.exchange_corrections(false);
  interface_.subtract_in_gaps(fine_.correction().array(), fine_.right_hand_side().array());
}

void Coarsening::refresh_gaps() {
  update_gaps();
  fine_.exchange_corrections(true);
}

/// The coarser correction, as it has come, into that of own rows: in its place, or added to it.
void Coarsening::prolong_rows(bool set) {
  auto const values = values_.array(), e = fine_.correction().array(), r = fine_.right_hand_side().array();
  auto const own = fine_.own_rows();
  LevelTables const level = fine_.tables();
  Lists const on = lists_;
  for_each_row(
      "prolong", own, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        RowPlace const& of = own(n);
        cycle::Row const& row = level.rows[n];
        worker.with_kind(row.lanes, true, [&](auto lanes, auto) {
          cycle::prolong<lanes()>(on.sources(of.block), of.j, of.k, row, values.data(), set, r.data(), e.data(),
                                  worker);
        });
        worker.barrier();
        clear_solid(level, row, e.data() + row.place, worker);
      });
}

void Coarsening::prolong(cycle::Into into) {
  parents_.update(coarse_.correction().array(), values_.array());
  auto const values = values_.array();
  auto const ghosts = lists_.ghosts;
  for_each(
      "ghosts of coarse corrections", ghosts,
      KOKKOS_LAMBDA(std::int32_t n) { values(ghosts(n).to) = ghosts(n).factor * values(ghosts(n).from); });
  if (plan_.refines_) interface_.subtract_coarse(values, fine_.right_hand_side().array());
  prolong_rows(into == cycle::Into::place);
  fine_.corrections_are_new();
  if (has_gaps()) update_gaps();
  fine_.exchange_corrections(plan_.refines_);
}

std::size_t Coarsening::bytes() const {
  return parents_.bytes() + targets_of_residuals_.bytes() + interface_.bytes() +
         lists_.ghosts.extent(0) * sizeof(Ghost) + lists_.parent_rows.extent(0) * sizeof(ParentRow);
}

}  // namespace amrpic::kokkos
