#include "matrixfree/portable_sweep.hpp"

#include <Kokkos_Core.hpp>

#include "stencil/laplacian.hpp"

namespace amrpic::matrixfree::portable {

namespace {

using Space = Kokkos::DefaultHostExecutionSpace;
using Policy = Kokkos::TeamPolicy<Space>;
using Member = Policy::member_type;
using Scratch = Kokkos::View<float*, Space::scratch_memory_space, Kokkos::MemoryUnmanaged>;

/// A row of a plane and its neighbours' values.
struct RowView {
  float const *here, *y_below, *y_above, *z_below, *z_above;
  float left, right;
  int n;
  KOKKOS_INLINE_FUNCTION float sum(int i, std::array<float, 3> const& w) const {
    float const x = (i > 0 ? here[i - 1] : left) + (i + 1 < n ? here[i + 1] : right);
    return weighted_sum(w, x, y_below[i] + y_above[i], z_below[i] + z_above[i]);
  }
};

/// The row beside another one: in place, or put together in scratch memory by the whole team.
float const* row_beside(Member const& team, Plane const& p, std::int32_t beside, float const* e,
                        Scratch const& buffer) {
  if (beside >= 0) return e + beside;
  std::int32_t const* const run = &p.ghosts.first_run[std::size_t(~beside)];
  for (std::int32_t n = run[0]; n < run[1]; ++n) {
    ScaledRun const r = p.ghosts.runs[std::size_t(n)];
    Kokkos::parallel_for(Kokkos::TeamVectorRange(team, r.count),
                         [&](int i) { buffer(r.place + i) = r.factor * e[r.source + i]; });
  }
  team.team_barrier();
  return buffer.data();
}

RowStencil const& stencil_of(Plane const& p, int j) {
  return p.ghosts.rows[std::size_t(j + p.block.box.extent(1) * p.number())];
}

Policy policy(Plane const& p) { return Policy(p.block.box.extent(1), Kokkos::AUTO); }

/// Run f(team, row number j, row) for the rows of a plane, each by a team.
template <class F>
void for_each_row(Plane const& p, float const* e, F const& f) {
  int const nx = p.block.box.extent(0);
  std::size_t const bytes = 4 * Scratch::shmem_size(std::size_t(nx));
  Kokkos::parallel_for("rows", policy(p).set_scratch_size(0, Kokkos::PerTeam(int(bytes))), [&](Member const& team) {
    int const j = team.league_rank();
    if (!p.rows.contains(j)) return;
    RowStencil const& s = stencil_of(p, j);
    std::array<float const*, 4> beside;
    for (std::size_t side = 0; side < 4; ++side)
      beside[side] = row_beside(team, p, s.beside[side], e, Scratch(team.team_scratch(0), std::size_t(nx)));
    f(team, j,
      RowView{e + p.block.cells.place(0, j, p.number()), beside[0], beside[1], beside[2], beside[3],
              s.factor[0] * e[s.end[0]], s.factor[1] * e[s.end[1]], nx});
  });
}

/// Parity of the places in a row whose cells have a colour.
int parity(Plane const& p, int j, int colour) {
  return (colour + p.block.box.lower[0] + p.block.box.lower[1] + j + p.k) & 1;
}

}  // namespace

void relax_from_zero(Plane const& p, int colour, float const* r, float* e) {
  int const k = p.number();
  Kokkos::parallel_for("relax from zero", policy(p), [&](Member const& team) {
    int const j = team.league_rank();
    if (!p.rows.contains(j)) return;
    std::ptrdiff_t const row = p.block.cells.place(0, j, k);
    float const* const step =
        p.stencil.step(stencil_of(p, j).coefficients, p.block.cells.pitch_y, parity(p, j, colour));
    Kokkos::parallel_for(Kokkos::TeamVectorRange(team, p.block.box.extent(0)),
                         [&](int i) { e[row + i] = -step[i] * r[row + i]; });
  });
}

void relax(Plane const& p, int colour, float const* r, float* e) {
  auto const weight = p.stencil.weight();
  float const keep = p.stencil.keep();
  for_each_row(p, e, [&](Member const& team, int j, RowView const& row) {
    int const odd = parity(p, j, colour);
    float const* const step = p.stencil.step(stencil_of(p, j).coefficients, p.block.cells.pitch_y, odd);
    float* const here = e + (row.here - e);
    float const* const right_hand_side = r + (row.here - e);
    // cells of one colour read none of their own, so any order gives the same
    Kokkos::parallel_for(Kokkos::TeamVectorRange(team, (row.n - odd + 1) / 2), [&](int half) {
      int const i = 2 * half + odd;
      here[i] = keep * here[i] + step[i] * (row.sum(i, weight) - right_hand_side[i]);
    });
  });
}

namespace {

/// Add row j to its parents: `weight` times the weighted sum of value(i) over the children. Rows that share
/// parents come one after the other, by their `offset`.
template <class F>
void add_to_parents(Plane const& p, Parents const& parents, float weight, float* coarse, Member const& team, int j,
                    int n, F const& value) {
  int const plane = p.number(), y = parents.parent(1, j), z = parents.parent(2, plane);
  if (y >= parents.extent[1] || z >= parents.extent[2]) return;
  float* const to = coarse + parents.cells.place(0, y, z);
  bool const set = parents.is_first_child(1, j) && parents.is_first_child(2, plane);
  float const row_weight = weight * parents.weight_of(1, j) * parents.weight_of(2, plane);
  int const ratio = parents.ratio[0], odd = parents.odd[0];
  Kokkos::parallel_for(Kokkos::TeamVectorRange(team, parents.extent[0]), [&](int parent) {
    float sum = 0;
    for (int child = parent * ratio; child < (parent + 1) * ratio; ++child)
      if (int const i = child - odd; i >= 0 && i < n) sum += parents.weight_of(0, i) * value(i);
    to[parent] = (set ? 0 : to[parent]) + row_weight * sum;
  });
}

/// Whether a row is the `offset`-th child of its parents.
bool has_offset(Parents const& parents, int j, int offset) { return (j + parents.odd[1]) % parents.ratio[1] == offset; }

}  // namespace

void restrict_residual(Plane const& p, float const* r, float const* e, Parents const& parents, float weight,
                       float* coarse) {
  auto const neighbour_weight = p.stencil.weight();
  for (int offset = 0; offset < parents.ratio[1]; ++offset)
    for_each_row(p, e, [&](Member const& team, int j, RowView const& row) {
      if (!has_offset(parents, j, offset)) return;
      float const* const diagonal = p.stencil.diagonal(stencil_of(p, j).coefficients);
      float const* const right_hand_side = r + (row.here - e);
      add_to_parents(p, parents, weight, coarse, team, j, row.n, [&](int i) {
        return right_hand_side[i] - (row.sum(i, neighbour_weight) - diagonal[i] * row.here[i]);
      });
    });
}

void restrict_right_hand_side(Plane const& p, float const* r, Parents const& parents, float weight, float* coarse) {
  for (int offset = 0; offset < parents.ratio[1]; ++offset)
    Kokkos::parallel_for("restrict", policy(p), [&](Member const& team) {
      int const j = team.league_rank();
      if (!has_offset(parents, j, offset)) return;
      float const* const row = r + p.block.cells.place(0, j, p.number());
      add_to_parents(p, parents, weight, coarse, team, j, p.block.box.extent(0), [&](int i) { return row[i]; });
    });
}

void prolong(Plane const& p, Parents const& parents, float const* coarse, bool set, float* e) {
  int const k = p.number();
  Index3 const ratio = parents.ratio;
  std::array<std::ptrdiff_t, 3> const stride{1, parents.cells.pitch_y, parents.cells.pitch_z};
  Kokkos::parallel_for("prolong", policy(p), [&](Member const& team) {
    int const j = team.league_rank();
    if (!p.rows.contains(j)) return;
    float* const row = e + p.block.cells.place(0, j, k);
    Kokkos::parallel_for(Kokkos::TeamVectorRange(team, p.block.box.extent(0)), [&](int i) {
      int const cell[3] = {i, j, k};
      float const* const parent =
          coarse + parents.cells.place(parents.parent(0, i), parents.parent(1, j), parents.parent(2, k));
      float sum = 0;
      for (int corner = 0; corner < 8; ++corner) {
        float weight = 1;
        std::ptrdiff_t at = 0;
        for (int d = 0; d < 3; ++d) {
          bool const far = (corner >> d) & 1;
          if (ratio[d] == 1) {
            weight *= far ? 0 : 1;
            continue;
          }
          weight *= far ? parents.far(d, cell[d]) : 1 - parents.far(d, cell[d]);
          if (far) at += parents.toward(d, cell[d]) * stride[std::size_t(d)];
        }
        if (weight != 0) sum += weight * parent[at];
      }
      row[i] = (set ? 0 : row[i]) + sum;
    });
  });
}

}  // namespace amrpic::matrixfree::portable
