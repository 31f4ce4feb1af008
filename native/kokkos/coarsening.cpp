#include "kokkos/coarsening.hpp"

#include <unordered_map>

#include "stencil/relaxation.hpp"

namespace amrpic::kokkos {

using matrixfree::Parents;

Coarsening::Coarsening(Communicator const& comm, matrixfree::Coarsening& plan, SweptLevel& fine, SweptLevel& coarse)
    : plan_(plan),
      fine_(fine),
      coarse_(coarse),
      values_(plan.values_.data(), plan.values_.size()),
      sources_(on_device(plan.sources_)),
      taking_(on_device(plan.in_place_ ? plan.targets_ : plan.sources_)) {
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
  parent_rows_ = on_device(rows), blocks_ = on_device(blocks);
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
  ghosts_ = on_device(ghosts);
  parents_ = CellCopies(comm, plan.parents_, CellCopies::Use::update);
  if (!plan.in_place_) targets_of_residuals_ = CellCopies(comm, plan.targets_of_residuals_, CellCopies::Use::add);
  if (plan.refines_) interface_ = InterfaceCells(plan.interface_, layout);
}

Array<float> const& Coarsening::target() const {
  return plan_.in_place_ ? coarse_.right_hand_side().array() : values_.array();
}

namespace {

/// What the children of a row of parents add up to, each weighed by that of its place.
template <bool of_residual>
struct ChildRow {
  Row row;
  float const *e, *r, *diagonal;
  RowsBeside<true> beside;
  float before, after;

  KOKKOS_INLINE_FUNCTION ChildRow(LevelTables const& level, Row const& of, float const* all_e, float const* all_r)
      : row(of),
        e(all_e + of.place),
        r(all_r + of.place),
        diagonal(&level.coefficients(of.coefficients)),
        beside(level, of, all_e),
        before(of.factor[0] * all_e[of.end[0]]),
        after(of.factor[1] * all_e[of.end[1]]) {}

  template <bool composed>
  KOKKOS_INLINE_FUNCTION float value(RowsBeside<composed> const& rows, int i, float x, float y) const {
    return remaining(r[i], rows.sum(i, x, y), diagonal[i], e[i]);
  }
  KOKKOS_INLINE_FUNCTION float operator()(int i) const {
    if constexpr (!of_residual) return r[i];
    return value(beside, i, i > 0 ? e[i - 1] : before, i + 1 < row.cells ? e[i + 1] : after);
  }
  /// Those of cells [first, last).
  KOKKOS_INLINE_FUNCTION void store(LevelTables const& level, float const* all_e, int first, int last,
                                    float* out) const {
    auto const run = [&](auto const& rows) {
      along(first, last, row.cells, e, before, after,
            [&](int i, float x, float y) { out[i - first] = value(rows, i, x, y); });
    };
    if constexpr (!of_residual)
      for (int i = first; i < last; ++i) out[i - first] = r[i];
    else if (row.is_composed)
      run(beside);
    else
      run(RowsBeside<false>(level, row, all_e));
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
  auto const parent_rows = parent_rows_;
  auto const blocks = blocks_;
  auto const taking = taking_;
  auto const e = fine_.correction().array(), r = fine_.right_hand_side().array(), out = target();
  float const weight = plan_.weight();
  for_each_row(
      "restrict", parent_rows, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        ParentRow const& of = parent_rows(n);
        Parents const& parents = taking(of.block);
        Block const& block = blocks(of.block);
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
        if constexpr (on_host) {
          constexpr int parents_at_once = chunk / 2;
          float children[chunk], sums[parents_at_once];
          for (int begin = 0; begin < count; begin += parents_at_once) {
            int const end = least(begin + parents_at_once, count);
            for (int p = begin; p < end; ++p) sums[p - begin] = 0;
            for_each_child_row([&](ChildRow<of_residual> const& row, float of_row) {
              int const origin = begin * ratio - odd;  // of the children, of which the first and the last may lack
              int const first = most(origin, 0), last = least(end * ratio - odd, row.row.cells);
              for (int i = origin; i < first; ++i) children[i - origin] = 0;
              row.store(level, e.data(), first, last, children + (first - origin));
              for (int i = last; i < end * ratio - odd; ++i) children[i - origin] = 0;
              if (parents.last[0] >= 0)
                for (int i = first; i < last; ++i) children[i - origin] *= parents.weight_of(0, i);
              if (ratio == 1)
                for (int p = 0; p < end - begin; ++p) sums[p] += of_row * children[p];
              else
                for (int p = 0; p < end - begin; ++p) sums[p] += of_row * (children[2 * p] + children[2 * p + 1]);
            });
            for (int p = begin; p < end; ++p) to[p] = sums[p - begin];
          }
        } else {
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
        }
      });
}

void Coarsening::restrict_residual() {
  if (has_gaps()) update_gaps();
  fine_.prepare_residual();
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

/// Up to four rows of parents, and what a fine row takes of each.
struct RowsOfParents {
  std::array<float const*, 4> row;
  std::array<float, 4> weight;
  int count;

  KOKKOS_INLINE_FUNCTION RowsOfParents(Parents const& parents, RowPlace const& of, float const* values) : count(0) {
    float const* const here = values + parents.cells.place(0, parents.parent(1, of.j), parents.parent(2, of.k));
    int const y = parents.toward(1, of.j), z = parents.toward(2, of.k);
    float const far_y = parents.far(1, of.j), far_z = parents.far(2, of.k);
    for (int beyond_z = 0; beyond_z <= (z != 0); ++beyond_z)
      for (int beyond_y = 0; beyond_y <= (y != 0); ++beyond_y, ++count) {
        row[std::size_t(count)] = here + beyond_y * y * parents.cells.pitch_y + beyond_z * z * parents.cells.pitch_z;
        weight[std::size_t(count)] = (beyond_y ? far_y : 1 - far_y) * (beyond_z ? far_z : 1 - far_z);
      }
  }
  KOKKOS_INLINE_FUNCTION float mean(int place) const {
    float sum = weight[0] * row[0][place];
    if (count > 1) sum += weight[1] * row[1][place];
    if (count > 2) sum += weight[2] * row[2][place], sum += weight[3] * row[3][place];
    return sum;
  }
};

}  // namespace

void Coarsening::prolong(matrixfree::Coarsening::Into into) {
  parents_.update(coarse_.correction().array(), values_.array());
  auto const values = values_.array();
  auto const ghosts = ghosts_;
  for_each(
      "ghosts of coarse corrections", ghosts,
      KOKKOS_LAMBDA(std::int32_t n) { values(ghosts(n).to) = ghosts(n).factor * values(ghosts(n).from); });
  if (plan_.refines_) interface_.subtract_coarse(values, fine_.right_hand_side().array());

  bool const set = into == matrixfree::Coarsening::Into::place;
  auto const e = fine_.correction().array();
  auto const own = fine_.own_rows();
  auto const rows = fine_.tables().rows;
  auto const sources = sources_;
  for_each_row(
      "prolong", own, KOKKOS_LAMBDA(Worker const& worker, std::int32_t n) {
        RowPlace const& of = own(n);
        Parents const& parents = sources(of.block);
        RowsOfParents const from(parents, of, values.data());
        float* const to = &e(rows(n).place);
        int const cells = rows(n).cells, ratio = parents.ratio[0], odd = parents.odd[0];
        auto const put = [=](int i, float value) { to[i] = (set ? 0 : to[i]) + value; };
        auto const one = [&](int i, auto const& mean) {
          int const p = parents.parent(0, i);
          return ratio == 1 ? mean(p) : prolonged(parents.far(0, i), mean(p), mean(p + parents.toward(0, i)));
        };
        if constexpr (on_host) {
          constexpr float near = prolongation::near, far = prolongation::far;
          constexpr int parents_at_once = chunk / 2;
          float buffer[parents_at_once + 2];
          int const count = (cells + odd + ratio - 1) / ratio;
          for (int begin = 0; begin < count; begin += parents_at_once) {
            int const end = least(begin + parents_at_once, count);
            int const margin = ratio - 1;
            float const* const mean = buffer + 1;  // counted from the first parent here, with one on either side
            worker.for_each(end - begin + 2 * margin,
                            [&](int m) { buffer[m + 1 - margin] = from.mean(begin - margin + m); });
            int const first = most(begin * ratio - odd, 0), last = least(end * ratio - odd, cells);
            if (ratio == 1) {
              worker.for_each(last - first, [=](int m) { put(first + m, mean[m]); });
            } else if (parents.seam[0] > 0) {
              for (int i = first; i < last; ++i) put(i, one(i, [=](int p) { return mean[p - begin]; }));
            } else {
              int const whole = odd != 0 && begin == 0, pairs = (last + odd) / 2;  // parents with both children here
              if (whole) put(0, near * mean[0] + far * mean[1]);
              worker.for_each(pairs - (begin + whole), [=](int m) {
                int const p = begin + whole + m, i = 2 * p - odd;
                float const* const at = mean + (p - begin);
                float const here = near * at[0];
                put(i, here + far * at[-1]);
                put(i + 1, here + far * at[1]);
              });
              if (2 * pairs - odd < last) put(last - 1, near * mean[pairs - begin] + far * mean[pairs - begin - 1]);
            }
          }
        } else {
          worker.for_each(cells, [&](int i) { put(i, one(i, [&](int p) { return from.mean(p); })); });
        }
      });
  fine_.corrections_are_new();
  if (has_gaps()) update_gaps();
  fine_.exchange_corrections(plan_.refines_);
}

std::size_t Coarsening::bytes() const {
  return parents_.bytes() + targets_of_residuals_.bytes() + interface_.bytes() + ghosts_.extent(0) * sizeof(Ghost) +
         parent_rows_.extent(0) * sizeof(ParentRow);
}

}  // namespace amrpic::kokkos
