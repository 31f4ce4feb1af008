#include "matrixfree/sweep.hpp"

#include <algorithm>

#include "matrixfree/portable_sweep.hpp"
#include "matrixfree/rows.hpp"

namespace amrpic::matrixfree {

void wavefront(Layout const& layout, std::vector<PlaneStage> const& stages) {
  int const first = layout.first_plane(), count = layout.planes(), depth = int(stages.size());
  for (int step = 0; step < count + depth - 1; ++step)
    for (int s = std::max(0, step - count + 1); s < std::min(depth, step + 1); ++s)
      for (int b : layout.on_plane(first + step - s)) stages[std::size_t(s)](std::size_t(b), first + step - s);
}

Sweep::Sweep(Layout const& layout, Stencil const& stencil, Kernels kernels)
    : layout_(layout), stencil_(stencil), kernels_(kernels) {
  std::ptrdiff_t pitch = 0;
  for (Block const& b : layout.blocks()) pitch = std::max(pitch, b.cells.pitch_y);
  for (Vector& row : buffer_) row.resize(std::size_t(pitch) + 64);
}

/// The row behind a face, without the part of the cell before the face: in place if it is one piece of another block's
/// row, else put together in `buffer`.
float const* Sweep::ghost_row(std::size_t block, int axis, int side, int t, float const* e, float* buffer) const {
  BlockStencil const& s = stencil_.block(block);
  auto const& runs = s.runs[std::size_t(axis - 1)][std::size_t(side)];
  auto const& first = s.first_run[std::size_t(axis - 1)][std::size_t(side)];
  Run const* run = &runs[std::size_t(first[std::size_t(t)])];
  Run const* const end = &runs[0] + first[std::size_t(t) + 1];
  if (run + 1 == end && run->factor == 1) return e + run->source;
  for (; run < end; ++run) {
    float const factor = run->factor;
    float const* const from = e + run->source;
    float* const to = buffer + run->place;
    for (int i = 0; i < run->count; ++i) to[i] = factor * from[i];
  }
  return buffer;
}

/// Call f(row, j, number of the row in the block) for the rows of a plane; `alternating`: first every second one, so
/// that what one row stores has left the store buffer when the next but one reads it.
template <class F>
void Sweep::for_each_row(std::size_t block, int k, float* e, bool alternating, F&& f) const {
  Block const& b = layout_.blocks()[block];
  BlockStencil const& s = stencil_.block(block);
  int const ny = b.box.extent(1), nz = b.box.extent(2), plane = k - b.box.lower[2];
  Row row;
  row.vectors = b.vectors();
  row.last = (b.box.extent(0) - 1) % b.lanes;
  auto buffer = [&](std::size_t n) { return buffer_[n].data(); };
  for (int start = 0; start < (alternating ? 2 : 1); ++start)
    for (int j = start; j < ny; j += alternating ? 2 : 1) {
      row.here = e + b.cells.place(0, j, plane);
      row.y_below = j > 0 ? row.here - b.cells.pitch_y : ghost_row(block, 1, 0, plane, e, buffer(0));
      row.y_above = j < ny - 1 ? row.here + b.cells.pitch_y : ghost_row(block, 1, 1, plane, e, buffer(1));
      row.z_below = plane > 0 ? row.here - b.cells.pitch_z : ghost_row(block, 2, 0, j, e, buffer(2));
      row.z_above = plane < nz - 1 ? row.here + b.cells.pitch_z : ghost_row(block, 2, 1, j, e, buffer(3));
      std::size_t const number = std::size_t(j + ny * plane);
      row.left = s.x[0][number].factor * e[s.x[0][number].source];
      row.right = s.x[1][number].factor * e[s.x[1][number].source];
      f(row, j, number);
    }
}

namespace {

/// Call f(lanes, isotropic) with both as constants.
template <class F>
void with_kind(int lanes, bool isotropic, F&& f) {
  using std::integral_constant;
  auto choose = [&](auto n) {
    isotropic ? f(n, integral_constant<bool, true>()) : f(n, integral_constant<bool, false>());
  };
  lanes == 16 ? choose(integral_constant<int, 16>()) : choose(integral_constant<int, 8>());
}

/// Parity of the places in a row whose cells have a colour.
int parity(Block const& b, int j, int k, int colour) { return (colour + b.box.lower[0] + b.box.lower[1] + j + k) & 1; }

}  // namespace

void Sweep::relax_from_zero(std::size_t block, int k, int colour, Vector const& r, Vector& e) const {
  if (kernels_ == Kernels::portable)
    return portable::relax_from_zero({layout_.blocks()[block], stencil_.block(block), stencil_, k}, colour, r.data(),
                                     e.data());
  Block const& b = layout_.blocks()[block];
  BlockStencil const& s = stencil_.block(block);
  int const ny = b.box.extent(1), plane = k - b.box.lower[2];
  with_kind(b.lanes, true, [&](auto n, auto) {
    for (int j = 0; j < ny; ++j) {
      std::ptrdiff_t const place = b.cells.place(0, j, plane);
      std::int32_t const coefficients = s.coefficients[std::size_t(j + ny * plane)];
      matrixfree::relax_from_zero<n()>(&e[std::size_t(place)], &r[std::size_t(place)],
                                       stencil_.step(coefficients, b.cells.pitch_y, parity(b, j, k, colour)),
                                       b.vectors());
    }
  });
}

void Sweep::relax(std::size_t block, int k, int colour, Vector const& r, Vector& e) const {
  if (kernels_ == Kernels::portable)
    return portable::relax({layout_.blocks()[block], stencil_.block(block), stencil_, k}, colour, r.data(), e.data());
  Block const& b = layout_.blocks()[block];
  BlockStencil const& s = stencil_.block(block);
  with_kind(b.lanes, stencil_.isotropic(), [&](auto n, auto isotropic) {
    for_each_row(block, k, e.data(), true, [&](Row const& row, int j, std::size_t number) {
      int const odd = parity(b, j, k, colour);
      matrixfree::relax<n(), isotropic()>(row, stencil_.weight(), r.data() + (row.here - e.data()),
                                          stencil_.step(s.coefficients[number], b.cells.pitch_y, odd), stencil_.keep(),
                                          odd);
    });
  });
}

void Sweep::restrict_residual(std::size_t block, int k, Vector const& r, Vector& e, Parents const& parents, float share,
                              Vector& coarse) const {
  if (kernels_ == Kernels::portable)
    return portable::restrict_residual({layout_.blocks()[block], stencil_.block(block), stencil_, k}, r.data(),
                                       e.data(), parents, share, coarse.data());
  Block const& b = layout_.blocks()[block];
  BlockStencil const& s = stencil_.block(block);
  int const plane = k - b.box.lower[2];
  float* const left = buffer_[4].data();
  with_kind(b.lanes, stencil_.isotropic(), [&](auto n, auto isotropic) {
    for_each_row(block, k, e.data(), false, [&](Row const& row, int j, std::size_t number) {
      residual<n(), isotropic()>(row, stencil_.weight(), r.data() + (row.here - e.data()),
                                 stencil_.diagonal(s.coefficients[number]), left);
      bool const set = j % parents.ratio[1] == 0 && plane % parents.ratio[2] == 0;
      float* const to = coarse.data() + parents.cells.place(0, j / parents.ratio[1], plane / parents.ratio[2]);
      restrict_row<n()>(left, b.box.extent(0) / parents.ratio[0], parents.ratio[0], share, set, to);
    });
  });
}

void Sweep::prolong(std::size_t block, int k, Parents const& parents, Vector const& coarse, Vector& e) const {
  if (kernels_ == Kernels::portable)
    return portable::prolong({layout_.blocks()[block], stencil_.block(block), stencil_, k}, parents, coarse.data(),
                             e.data());
  Block const& b = layout_.blocks()[block];
  int const plane = k - b.box.lower[2], ny = b.box.extent(1);
  // a fine row lies between its parents' row and the next one on its own side
  auto other = [](int fine, int ratio) { return ratio == 1 ? 0 : fine % 2 == 0 ? -1 : 1; };
  for (int j = 0; j < ny; ++j) {
    CoarseRows rows;
    rows.count = 0;
    int const y = other(j, parents.ratio[1]), z = other(plane, parents.ratio[2]);
    float const* const here = coarse.data() + parents.cells.place(0, j / parents.ratio[1], plane / parents.ratio[2]);
    for (int far_z = 0; far_z <= (z != 0); ++far_z)
      for (int far_y = 0; far_y <= (y != 0); ++far_y) {
        rows.row[std::size_t(rows.count)] =
            here + far_y * y * parents.cells.pitch_y + far_z * z * parents.cells.pitch_z;
        rows.share[std::size_t(rows.count)] = (y == 0  ? 1.0f
                                               : far_y ? 0.25f
                                                       : 0.75f) *
                                              (z == 0  ? 1.0f
                                               : far_z ? 0.25f
                                                       : 0.75f);
        ++rows.count;
      }
    float* const to = &e[std::size_t(b.cells.place(0, j, plane))];
    with_kind(b.lanes, true, [&](auto n, auto) { prolong_row<n()>(rows, parents.ratio[0], b.vectors(), to); });
  }
}

}  // namespace amrpic::matrixfree
