#include "kokkos/coarsening.hpp"

#include <unordered_map>
#include <utility>

#include "stencil/relaxation.hpp"

namespace amrpic::kokkos {

using matrixfree::Parents;

Coarsening::Coarsening(Communicator const& comm, matrixfree::Coarsening& plan, SweptLevel& fine, SweptLevel& coarse)
    : plan_(plan), fine_(fine), coarse_(coarse), values_(plan.values_.data(), plan.values_.size()) {
  matrixfree::Layout const& layout = fine.plan().layout();
  std::vector<ParentRow> rows;
  std::vector<Block> blocks;
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    Box const& box = layout.blocks()[b].box;
    blocks.push_back({fine.first_rows()[b], box.extent(1), box.extent(2)});
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

namespace {

/// A row of children of which parents take residuals, or right-hand sides.
template <bool of_residual>
struct ChildRow {
  LevelTables const& level;
  Row const& row;
  float const *r, *diagonal;
  matrixfree::DifferenceRow at;

  KOKKOS_INLINE_FUNCTION ChildRow(LevelTables const& tables, Row const& of, float* e, float const* all_r)
      : level(tables),
        row(of),
        r(all_r + of.place),
        diagonal(&tables.coefficients(of.coefficients)),
        at(tables.in_differences ? tables.differences(of, e)
                                 : matrixfree::DifferenceRow{tables.correction(of, e), {}, of.cells}) {}

  KOKKOS_INLINE_FUNCTION float operator()(int i) const {
    if (!of_residual) return r[i];
    if (level.in_differences)
      return at.remaining(level.weight, r[i], diagonal[matrixfree::Stencil::held_place * row.pitch + i], i);
    return remaining(r[i], level.sum(row, at, i), diagonal[i], at.here[i]);
  }
  /// Add `weight` times the values of pairs of whole vectors to parents, or set these, part by part.
  template <int lanes, bool isotropic>
  void restrict_pairs(int ratio, float weight, bool set, float* parents) const {
    if constexpr (!of_residual) {
      matrixfree::restrict_row<lanes>(r, row.cells / ratio, ratio, weight, set, parents);
    } else {
      float left[chunk + 2 * widest];
      for (int first = 0; first < row.cells; first += chunk) {
        bool const is_last = first + chunk >= row.cells;
        matrixfree::CorrectionRow part = at;
        part.here += first;
        for (float const*& beside : part.beside) beside += first;
        if (first > 0) part.left = part.here[-1];
        if (!is_last) part.right = part.here[chunk], part.last = lanes - 1;
        part.vectors = is_last ? at.vectors - first / lanes : chunk / lanes;
        matrixfree::residual<lanes, isotropic>(part, level.weight, r + first, diagonal + first, left);
        matrixfree::restrict_row<lanes>(left, (is_last ? row.cells - first : chunk) / ratio, ratio, weight, set,
                                        parents + first / ratio);
      }
    }
  }
};

KOKKOS_INLINE_FUNCTION int most(int a, int b) { return a > b ? a : b; }
KOKKOS_INLINE_FUNCTION int least(int a, int b) { return a < b ? a : b; }

}  // namespace

/// The sums over the children of all parents, of residuals or of right-hand sides.
template <bool of_residual>
void Coarsening::restrict_rows() {
  if (!plan_.in_place_) Kokkos::deep_copy(values_.array(), 0.0f);
  LevelTables const level = fine_.tables();
  Lists const on = lists_;
  auto const e = fine_.correction().array(), r = fine_.right_hand_side().array(), out = target();
  float const weight = plan_.weight();
  for_each_row(
      "restrict", on.parent_rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        ParentRow const& of = on.parent_rows(n);
        Parents const& parents = on.taking(of.block);
        Block const& block = on.blocks(of.block);
        float* const to = &out(std::int32_t(parents.cells.place(0, of.y, of.z)));
        int const ratio = parents.ratio[0], odd = parents.odd[0], count = parents.extent[0];
        auto const for_each_child_row = [&](auto const& f) {
          for (int z = 0; z < parents.ratio[2]; ++z)
            for (int y = 0; y < parents.ratio[1]; ++y) {
              int const j = of.y * parents.ratio[1] - parents.odd[1] + y,
                        k = of.z * parents.ratio[2] - parents.odd[2] + z;
              if (j < 0 || j >= block.ny || k < 0 || k >= block.nz) continue;
              f(ChildRow<of_residual>(level, level.rows(block.first_row + j + block.ny * k), e.data(), r.data()),
                weight * parents.weight_of(1, j) * parents.weight_of(2, k));
            }
        };
        if constexpr (on_host)
          if (Row const& first = level.rows(block.first_row);
              !level.in_differences && parents.last[0] < 0 && odd == 0 && first.cells % ratio == 0) {
            bool set = true;
            matrixfree::with_kind(first.lanes, level.isotropic, [&](auto lanes, auto isotropic) {
              for_each_child_row([&](ChildRow<of_residual> const& row, float of_row) {
                row.template restrict_pairs<lanes(), isotropic()>(ratio, of_row, std::exchange(set, false), to);
              });
            });
            return;
          }
        worker.for_each(count, [&](int p) {
          float sum = 0;
          for_each_child_row([&](ChildRow<of_residual> const& row, float of_row) {
            int const first = most(p * ratio - odd, 0), last = least((p + 1) * ratio - odd, row.row.cells);
            float of_children = 0;
            for (int i = first; i < last; ++i) of_children += parents.weight_of(0, i) * row(i);
            sum += of_row * of_children;
          });
          to[p] = sum;
        });
      });
}

void Coarsening::prepare_residual() {
  if (has_gaps()) update_gaps();
  fine_.prepare_residual();
}

void Coarsening::restrict_residual() {
  restrict_rows<true>();
  if (plan_.refines_) interface_.subtract_flux(fine_.correction().array(), target());
  add_to_coarse_level();
}

void Coarsening::restrict_right_hand_side() {
  restrict_rows<false>();
  add_to_coarse_level();
}

/// Add the target to the coarser right-hand side, on whichever ranks the parents are. What all ranks hold of a coarse
/// level is gathered by the host.
void Coarsening::add_to_coarse_level() {
  if (plan_.in_place_) return;
  auto const& r = coarse_.right_hand_side();
  if (!plan_.refines_) Kokkos::deep_copy(r.array(), 0.0f);
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

namespace {

/// The rows of parents of a fine row.
KOKKOS_INLINE_FUNCTION matrixfree::CoarseRows rows_of_parents(Parents const& parents, RowPlace const& of,
                                                              float const* values) {
  matrixfree::CoarseRows out;
  out.count = 0;
  float const* const here = values + parents.cells.place(0, parents.parent(1, of.j), parents.parent(2, of.k));
  int const y = parents.toward(1, of.j), z = parents.toward(2, of.k);
  float const far_y = parents.far(1, of.j), far_z = parents.far(2, of.k);
  for (int beyond_z = 0; beyond_z <= (z != 0); ++beyond_z)
    for (int beyond_y = 0; beyond_y <= (y != 0); ++beyond_y, ++out.count) {
      out.row[std::size_t(out.count)] =
          here + beyond_y * y * parents.cells.pitch_y + beyond_z * z * parents.cells.pitch_z;
      out.weight[std::size_t(out.count)] = (beyond_y ? far_y : 1 - far_y) * (beyond_z ? far_z : 1 - far_z);
    }
  return out;
}

}  // namespace

/// The coarser correction, as it has come, into that of own rows: in its place, or added to it.
template <bool set>
void Coarsening::prolong_rows() {
  auto const values = values_.array(), e = fine_.correction().array(), r = fine_.right_hand_side().array();
  auto const own = fine_.own_rows();
  auto const rows = fine_.tables().rows;
  Lists const on = lists_;
  for_each_row(
      "prolong", own, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        RowPlace const& of = own(n);
        Parents const& parents = on.sources(of.block);
        matrixfree::CoarseRows const from = rows_of_parents(parents, of, values.data());
        Row const& row = rows(n);
        float* const to = &e(row.place);
        float const* const right = &r(row.place);
        int const ratio = parents.ratio[0];
        if constexpr (on_host)
          if (parents.odd[0] == 0 && parents.seam[0] == 0)
            return matrixfree::with_kind(row.lanes, true, [&](auto lanes, auto) {
              matrixfree::prolong_row<lanes()>(from, ratio, row.pitch / row.lanes, set, right, to);
            });
        worker.for_each(row.cells, [&](int i) {
          int const p = parents.parent(0, i);
          float const here = mean(from, p);
          to[i] = (set ? 0 : to[i]) +
                  (ratio == 1 ? here : prolonged(parents.far(0, i), here, mean(from, p + parents.toward(0, i))));
        });
      });
}

void Coarsening::prolong(matrixfree::Into into) {
  parents_.update(coarse_.correction().array(), values_.array());
  auto const values = values_.array();
  auto const ghosts = lists_.ghosts;
  for_each(
      "ghosts of coarse corrections", ghosts,
      KOKKOS_LAMBDA(std::int32_t n) { values(ghosts(n).to) = ghosts(n).factor * values(ghosts(n).from); });
  if (plan_.refines_) interface_.subtract_coarse(values, fine_.right_hand_side().array());
  into == matrixfree::Into::place ? prolong_rows<true>() : prolong_rows<false>();
  fine_.corrections_are_new();
  if (has_gaps()) update_gaps();
  fine_.exchange_corrections(plan_.refines_);
}

std::size_t Coarsening::bytes() const {
  return parents_.bytes() + targets_of_residuals_.bytes() + interface_.bytes() +
         lists_.ghosts.extent(0) * sizeof(Ghost) + lists_.parent_rows.extent(0) * sizeof(ParentRow);
}

}  // namespace amrpic::kokkos
