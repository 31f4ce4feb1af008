#include "solver/damping.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "mesh/fits.hpp"

namespace amrpic {

namespace {

/// c over that which leaves 3/4 of the modes that alternate along all axes. The cycle finds a little less of these than
/// the inverse of its operator does, and this much took the fewest cycles.
constexpr Real share = 0.9;

/// Of that in cells at a wall of the domain, for each wall: the operators are stiffer there. Between 0.4 and 0.6 solves
/// take as many cycles; from 0.8 on more where Dirichlet walls meet.
constexpr float at_wall = 0.5f;

constexpr int no_plane = std::numeric_limits<int>::min();

}  // namespace

Damping::Damping(CompositeMesh const& mesh, Blocks<float> const& residual, cycle::Cycle& cycle)
    : mesh_(mesh), cycle_(cycle), runs_(std::size_t(mesh.levels())) {
  for (int l = 0; l < mesh_.levels(); ++l) {
    cycle::SweptLevel const& swept = cycle_.level(std::size_t(l));
    factor_.push_back(float(share / (8 * swept.scale() * mesh_.equation(l).diagonal())));
    for (int b = 0; b < mesh_.boxes(l); ++b) {
      add_interfaces(l, b, residual);
      add_refined(l, b, residual);
    }
    auto& runs = runs_[std::size_t(l)];
    std::stable_sort(runs.begin(), runs.end(), [](Run const& x, Run const& y) { return x.plane < y.plane; });
    runs.shrink_to_fit();
    cycle_.level(std::size_t(l))
        .set_last_stage({[this, l](std::size_t block, int plane, cycle::RowChoice const&) {
                           if (acts_) act(l, block, plane);
                         },
                         0, 0});
  }
}

Damping::Run& Damping::add_run(int l, int b, Blocks<float> const& residual, Index3 const& first, int axis, int count) {
  Block<float> const& block = residual[std::size_t(l)][std::size_t(b)];
  std::ptrdiff_t const step[3] = {1, block.pitch_y, block.pitch_z};
  float* const place = block.origin + first[0] + first[1] * step[1] + first[2] * step[2];
  return runs_[std::size_t(l)].emplace_back(Run{mesh_.box(l, b).lower[2] + first[2], count, place, step[axis], -1});
}

/// The cells before faces with coarser cells beyond.
void Damping::add_interfaces(int l, int b, Blocks<float> const& residual) {
  for (int f = 0; f < 6; ++f) {
    int const number = mesh_.plan(l, b).faces[std::size_t(f)].interface, axis = f / 2;
    if (number < 0) continue;
    Interface const& i = mesh_.plan(l).interfaces[std::size_t(number)];
    Index3 cell;
    cell[axis] = f % 2 == 0 ? 0 : mesh_.box(l, b).extent(axis) - 1;
    auto const [u, v] = tangential_axes(axis);
    for (int coarse_v = 0; coarse_v < i.nv; ++coarse_v)
      for_each_run(&mesh_.plan(l).fits[std::size_t(i.fits + coarse_v * i.nu)], i.nu,
                   [&, u = u, v = v](int coarse_u, int count, FitNumber) {
                     cell[u] = 2 * (i.u + coarse_u);
                     for (int half = 0; half < 2; ++half) {
                       cell[v] = 2 * (i.v + coarse_v) + half;
                       add_run(l, b, residual, cell, u, 2 * count);
                     }
                   });
  }
}

/// The cells before faces with finer cells beyond.
void Damping::add_refined(int l, int b, Blocks<float> const& residual) {
  for (int s = mesh_.plan(l, b).refined.first; s < mesh_.plan(l, b).refined.last; ++s) {
    RefinedSide const& side = mesh_.plan(l).refined[std::size_t(s)];
    auto const [u, v] = tangential_axes(side.axis);
    Index3 cell = side.cells.lower;
    for (; cell[v] <= side.cells.upper[v]; ++cell[v]) {
      int const count = side.cells.extent(u);
      add_run(l, b, residual, cell, u, count).remembered = std::ptrdiff_t(remembered_.size());
      remembered_.resize(remembered_.size() + std::size_t(count));
    }
  }
}

void Damping::remember() {
  for (auto const& runs : runs_)
    for (Run const& run : runs)
      for (int n = 0; run.remembered >= 0 && n < run.count; ++n)
        remembered_[std::size_t(run.remembered + n)] = run.first[n * run.step];
}

void Damping::run() {
  remember();
  prepared_ = no_plane;
  acts_ = true;
  cycle_.run();
  acts_ = false;
}

/// Set the residuals before coarse-fine faces to what is taken of them, in a plane of a level.
void Damping::prepare(int l, int plane) {
  if (std::exchange(prepared_, plane) == plane) return;
  auto const& runs = runs_[std::size_t(l)];
  auto run = std::lower_bound(runs.begin(), runs.end(), plane, [](Run const& x, int p) { return x.plane < p; });
  for (; run != runs.end() && run->plane == plane; ++run)
    for (int n = 0; n < run->count; ++n)
      run->first[n * run->step] = run->remembered < 0 ? 0 : remembered_[std::size_t(run->remembered + n)];
}

/// The part of c in cells with this index along an axis.
float Damping::weight(int l, int axis, int index) const {
  Level const& level = mesh_.level(l);
  if (level.periodic()[axis]) return 1;
  float out = 1;
  for (int end : {level.domain().lower[axis], level.domain().upper[axis]})
    if (index == end) out *= at_wall;
  return out;
}

/// Let damped corrections take the place of residuals in a plane of an own block.
void Damping::act(int l, std::size_t b, int plane) {
  cycle::SweptLevel& swept = cycle_.level(std::size_t(l));
  if (b >= swept.layout().own_blocks()) return;
  prepare(l, plane);
  auto const& block = swept.layout().blocks()[b];
  Box const& box = block.box;
  int const last = box.extent(0) - 1;
  float const of_plane = factor_[std::size_t(l)] * weight(l, 2, plane);
  float const of_first = weight(l, 0, box.lower[0]), of_last = weight(l, 0, box.upper[0]);
  for (int j = 0; j < box.extent(1); ++j) {
    std::ptrdiff_t const place = block.cells.place(0, j, plane - box.lower[2]);
    float const* __restrict const e = swept.correction().data() + place;
    float* __restrict const r = swept.right_hand_side().data() + place;
    float const factor = of_plane * weight(l, 1, box.lower[1] + j);
    float const first = e[0] + factor * of_first * r[0], end = e[last] + factor * of_last * r[last];
    for (int i = 0; i <= last; ++i) r[i] = e[i] + factor * r[i];
    r[last] = end;
    r[0] = first;
  }
}

std::size_t Damping::bytes() const {
  std::size_t out = remembered_.capacity() * sizeof(float);
  for (auto const& runs : runs_) out += runs.capacity() * sizeof(Run);
  return out;
}

}  // namespace amrpic
