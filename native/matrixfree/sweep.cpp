#include "matrixfree/sweep.hpp"

#include <algorithm>

namespace amrpic::matrixfree {

void wavefront(Layout const& layout, std::vector<PlaneStage> const& stages, std::function<void(int)> const& before) {
  int const first = layout.first_plane(), count = layout.planes(), depth = int(stages.size());
  for (int step = 0; step < count + depth - 1; ++step) {
    if (step < count) before(first + step);
    for (int s = std::max(0, step - count + 1); s < std::min(depth, step + 1); ++s)
      for (int b : layout.on_plane(first + step - s)) stages[std::size_t(s)].act(std::size_t(b), first + step - s, {});
  }
}

Sweep::Sweep(Layout const& layout, Stencil const& stencil) : layout_(layout), stencil_(stencil) {
  std::ptrdiff_t pitch = 0;
  for (CellBlock const& b : layout.blocks()) pitch = std::max(pitch, b.cells.pitch_y);
  for (Vector& row : buffer_) row.resize(std::size_t(pitch) + 96);
}

/// A row beside another one that is composed of runs, or its differences to that, put together in a buffer.
float const* Sweep::composed(BlockStencil const& stencil, std::int32_t beside, float const* e, Vector& buffer,
                             bool differences) const {
  std::int32_t const* const run = &stencil.first_run[std::size_t(~beside)];
  for (std::int32_t n = run[0]; n < run[1]; ++n) {
    ScaledRun const& r = stencil.runs[std::size_t(n)];
    float const factor = r.factor;
    float const* const from = e + r.source;
    float* const to = buffer.data() + r.place;
    if (differences)
      for (int i = 0; i < r.count; ++i) to[i] = factor * (from[i] - e[r.own + i]);
    else
      for (int i = 0; i < r.count; ++i) to[i] = factor * from[i];
  }
  return buffer.data();
}

/// A row for a residual of differences.
DifferenceRow Sweep::in_differences(std::size_t block, RowStencil const& stencil, CorrectionRow const& row,
                                    float const* e) const {
  int const last = layout_.blocks()[block].box.extent(0) - 1;
  float const* const zeros = e + layout_.zero_row();
  DifferenceRow out{row, {}, last + 1};
  for (std::size_t side = 0; side < 4; ++side) {
    bool const is_composed = stencil.beside[side] < 0;
    if (is_composed) out.beside[side] = composed(stencil_.block(block), stencil.beside[side], e, buffer_[side], true);
    out.less[side] = is_composed || row.beside[side] == zeros ? zeros : row.here;
  }
  out.left = stencil.factor[0] * (e[stencil.end[0]] - row.here[0]);
  out.right = stencil.factor[1] * (e[stencil.end[1]] - row.here[last]);
  return out;
}

/// Call f(row, j, its stencil) for rows of a plane.
template <class F>
void Sweep::for_each_row(std::size_t block, int k, RowChoice const& rows, float* e, F&& f) const {
  CellBlock const& b = layout_.blocks()[block];
  BlockStencil const& s = stencil_.block(block);
  int const ny = b.box.extent(1), plane = k - b.box.lower[2];
  RowStencil const* at = &s.rows[std::size_t(ny * plane)];
  CorrectionRow row;
  row.vectors = b.vectors();
  row.last = (b.box.extent(0) - 1) % b.lanes;
  row.here = e + b.cells.place(0, 0, plane);
  for (int j = 0; j < ny; ++j, ++at, row.here += b.cells.pitch_y) {
    if (!rows.contains(j)) continue;
    for (std::size_t side = 0; side < 4; ++side) row.beside[side] = e + at->beside[side];
    if ((at->beside[0] | at->beside[1] | at->beside[2] | at->beside[3]) < 0)
      for (std::size_t side = 0; side < 4; ++side)
        if (at->beside[side] < 0) row.beside[side] = composed(s, at->beside[side], e, buffer_[side]);
    row.left = at->factor[0] * e[at->end[0]];
    row.right = at->factor[1] * e[at->end[1]];
    f(row, j, *at);
  }
}

namespace {

/// Parity of the places in a row whose cells have a colour.
int parity(CellBlock const& b, int j, int k, int colour) {
  return (colour + b.box.lower[0] + b.box.lower[1] + j + k) & 1;
}

}  // namespace

void Sweep::relax_from_zero(std::size_t block, int k, int colour, RowChoice const& rows, Vector const& r,
                            Vector& e) const {
  CellBlock const& b = layout_.blocks()[block];
  BlockStencil const& s = stencil_.block(block);
  int const plane = k - b.box.lower[2];
  int const ny = b.box.extent(1);
  RowStencil const* const at = &s.rows[std::size_t(ny * plane)];
  with_kind(b.lanes, true, [&](auto n, auto) {
    for (int j = 0; j < ny; ++j) {
      if (!rows.contains(j)) continue;
      std::ptrdiff_t const place = b.cells.place(0, j, plane);
      matrixfree::relax_from_zero<n()>(e.data() + place, r.data() + place,
                                       stencil_.step(at[j].coefficients, b.cells.pitch_y, parity(b, j, k, colour)),
                                       b.vectors());
    }
  });
}

void Sweep::relax(std::size_t block, int k, int colour, RowChoice const& rows, Vector const& r, Vector& e) const {
  CellBlock const& b = layout_.blocks()[block];
  with_kind(b.lanes, stencil_.isotropic(), [&](auto n, auto isotropic) {
    for_each_row(block, k, rows, e.data(), [&](CorrectionRow const& row, int j, RowStencil const& s) {
      int const odd = parity(b, j, k, colour);
      matrixfree::relax<n(), isotropic()>(row, stencil_.weight(), r.data() + (row.here - e.data()),
                                          stencil_.step(s.coefficients, b.cells.pitch_y, odd), stencil_.keep(), odd);
    });
  });
}

/// Whether the rows of a block are whole pairs of children of equal weight.
static bool are_pairs(CellBlock const& b, Parents const& parents) {
  return parents.last[0] < 0 && parents.odd[0] == 0 && b.box.extent(0) % parents.ratio[0] == 0;
}

/// Make whole pairs of a row of values, which lies at `line_of`; returns where they begin.
float const* Sweep::in_pairs(CellBlock const& b, Parents const& parents, float* line) const {
  int const nx = b.box.extent(0);
  if (int const last = parents.last[0]; last >= 0) {
    line[last] *= float(parents.weight[0].last);
    if (last > 0) line[last - 1] *= float(parents.weight[0].before);
  }
  if ((nx + parents.odd[0]) % parents.ratio[0] != 0) line[nx] = 0;  // half a pair lacks its second child
  if (parents.odd[0]) *--line = 0;
  return line;
}

/// Restrict a row of fine values in pairs.
template <int lanes>
void Sweep::restrict_row(CellBlock const& b, int j, int k, float const* fine, Parents const& parents, float weight,
                         Vector& coarse) const {
  int const plane = k - b.box.lower[2], y = parents.parent(1, j), z = parents.parent(2, plane);
  if (y >= parents.extent[1] || z >= parents.extent[2]) return;
  bool const set = parents.is_first_child(1, j) && parents.is_first_child(2, plane);
  matrixfree::restrict_row<lanes>(fine, parents.extent[0], parents.ratio[0],
                                  weight * parents.weight_of(1, j) * parents.weight_of(2, plane), set,
                                  coarse.data() + parents.cells.place(0, y, z));
}

void Sweep::restrict_residual(std::size_t block, int k, Vector const& r, Vector const& e, Parents const& parents,
                              float weight, Vector& coarse) const {
  CellBlock const& b = layout_.blocks()[block];
  float* const left = line_of(parents);
  float* const values = const_cast<float*>(e.data());  // rows are read alone
  with_kind(b.lanes, stencil_.isotropic(), [&](auto n, auto isotropic) {
    for_each_row(block, k, {}, values, [&](CorrectionRow const& row, int j, RowStencil const& s) {
      float const* const right = r.data() + (row.here - values);
      if (stencil_.in_differences())
        residual(in_differences(block, s, row, values), stencil_.weight(), right,
                 stencil_.held(s.coefficients, b.cells.pitch_y), left);
      else
        residual<n(), isotropic()>(row, stencil_.weight(), right, stencil_.diagonal(s.coefficients), left);
      restrict_row<n()>(b, j, k, are_pairs(b, parents) ? left : in_pairs(b, parents, left), parents, weight, coarse);
    });
  });
}

void Sweep::restrict_right_hand_side(std::size_t block, int k, Vector const& r, Parents const& parents, float weight,
                                     Vector& coarse) const {
  CellBlock const& b = layout_.blocks()[block];
  with_kind(b.lanes, true, [&](auto n, auto) {
    float* const line = line_of(parents);
    for (int j = 0; j < b.box.extent(1); ++j) {
      float const* row = r.data() + b.cells.place(0, j, k - b.box.lower[2]);
      if (!are_pairs(b, parents)) {
        std::copy_n(row, b.box.extent(0), line);
        row = in_pairs(b, parents, line);
      }
      restrict_row<n()>(b, j, k, row, parents, weight, coarse);
    }
  });
}

void Sweep::prolong(std::size_t block, int k, RowChoice const& rows, Parents const& parents, Vector const& coarse,
                    bool set, Vector const& r, Vector& e) const {
  CellBlock const& b = layout_.blocks()[block];
  int const plane = k - b.box.lower[2], nx = b.box.extent(0), z = parents.toward(2, plane);
  // a fine row lies between its parents' row and the next one on its own side
  auto weight = [&](int axis, int i, int far) { return far ? parents.far(axis, i) : 1 - parents.far(axis, i); };
  with_kind(b.lanes, true, [&](auto n, auto) {
    for (int j = 0; j < b.box.extent(1); ++j) {
      if (!rows.contains(j)) continue;
      int const y = parents.toward(1, j);
      float const* const here = coarse.data() + parents.cells.place(0, parents.parent(1, j), parents.parent(2, plane));
      CoarseRows from;
      from.count = 0;
      for (int far_z = 0; far_z <= (z != 0); ++far_z)
        for (int far_y = 0; far_y <= (y != 0); ++far_y, ++from.count) {
          from.row[std::size_t(from.count)] =
              here + far_y * y * parents.cells.pitch_y + far_z * z * parents.cells.pitch_z;
          from.weight[std::size_t(from.count)] = weight(1, j, far_y) * weight(2, plane, far_z);
        }
      std::ptrdiff_t const row = b.cells.place(0, j, plane);
      if (!parents.odd[0] && parents.seam[0] == 0) {
        prolong_row<n()>(from, parents.ratio[0], b.vectors(), set, r.data() + row, e.data() + row);
        continue;
      }
      float* const line = buffer_[4].data();
      prolong_row<n()>(from, parents.ratio[0], (nx + 1 + n() - 1) / n(), true, r.data() + row, line);
      for (int i = 0; i < nx && parents.seam[0] > 0; ++i)
        if (float const far = parents.far(0, i); far != float(prolongation::far)) {
          int const place = parents.parent(0, i);
          line[i + parents.odd[0]] = prolonged(far, mean(from, place), mean(from, place + parents.toward(0, i)));
        }
      for (int i = 0; i < nx; ++i)
        e[std::size_t(row + i)] = (set ? 0 : e[std::size_t(row + i)]) + line[i + parents.odd[0]];
    }
  });
}

}  // namespace amrpic::matrixfree
