#include "matrixfree/interface_cells.hpp"

#include "matrixfree/fits.hpp"
#include "mesh/window.hpp"

namespace amrpic::matrixfree {

namespace {

constexpr std::size_t ahead = 16;  ///< groups for whose cells memory is asked in advance: they lie far apart

/// 1 for the cells of a region that hold a potential of their own: cells of the level that no finer one covers.
Window<char> usable_cells(Level const& level, Level const& finer, Box const& region) {
  Window<char> out(region, 0);
  auto mark = [&](Box const& part, char value) {
    for (int k = part.lower[2]; k <= part.upper[2]; ++k)
      for (int j = part.lower[1]; j <= part.upper[1]; ++j)
        std::fill_n(&out({part.lower[0], j, k}), part.extent(0), value);
  };
  level.for_each_overlap(region, [&](int, Box const& part, Index3 const&) { mark(part, 1); });
  finer.for_each_overlap(region.refine({2, 2, 2}), [&](int, Box const& part, Index3 const&) {
    mark(part.coarsen({2, 2, 2}), 0);
  });
  return out;
}

/// The usable ones among the 25 cells of the plane around a cell; `stride`: steps in the window along its two axes.
unsigned usable_around(char const* cell, std::array<std::ptrdiff_t, 2> const& stride) {
  unsigned out = 0;
  for (int i = -2; i <= 2; ++i)
    for (int j = -2; j <= 2; ++j)
      if (cell[i * stride[0] + j * stride[1]]) out |= plane_bit(i, j);
  return out;
}

}  // namespace

InterfaceCells::InterfaceCells(Level const& level, Level const& coarser, Layout const& layout,
                               std::vector<Surroundings> const& surroundings, std::array<float, 3> const& weight,
                               std::array<float, 3> const& coarse_weight) {
  std::vector<std::array<std::ptrdiff_t, 2>> tangential;  // of each face, in the surroundings
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    Block const& block = layout.blocks()[b];
    Surroundings const& around = surroundings[b];
    Window<char> usable({}, 0);
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        Box layer = block.box;
        layer.lower[axis] = layer.upper[axis] = side == 0 ? block.box.lower[axis] - 1 : block.box.upper[axis] + 1;
        if (!level.periodic()[axis] && !level.domain().contains(layer)) continue;
        Window<char> level_has(layer, 0);
        GlobalIndex missing = layer.cells();
        level.for_each_overlap(layer, [&](int, Box const& part, Index3 const&) {
          missing -= part.cells();
          for_each_cell(part, [&](Index3 const& c) { level_has(c) = 1; });
        });
        if (missing == 0) continue;
        if (usable.values().empty()) usable = usable_cells(coarser, level, block.box.coarsen({2, 2, 2}).grow(3));
        auto const [u, v] = tangential_axes(axis);
        Box const& window = usable.box();
        std::array<std::ptrdiff_t, 3> const step{1, window.extent(0),
                                                 std::ptrdiff_t(window.extent(0)) * window.extent(1)};
        for_each_cell(layer.coarsen({2, 2, 2}), [&, u = u, v = v](Index3 const& parent) {
          Index3 ghost{2 * parent[0], 2 * parent[1], 2 * parent[2]};
          ghost[axis] = layer.lower[axis];
          if (level_has(ghost)) return;
          ghost[axis] += side == 0 ? 1 : -1;
          groups_.push_back({std::int32_t(block.place(ghost)), std::int32_t(around.place(parent)),
                             fit_number(usable_around(&usable(parent), {step[u], step[v]}))});
        });
        Face face;
        face.end = groups_.size();
        face.inward = block.cells.stride(axis) * (side == 0 ? 1 : -1);
        face.member = {0, block.cells.stride(u), block.cells.stride(v), block.cells.stride(u) + block.cells.stride(v)};
        face.weight = float(weight[axis] * interface_ghost::coarse);
        // over the coarse cell width a gradient counts double, and each fine face has a quarter of the coarse one
        face.flux_weight = 0.5f * coarse_weight[axis];
        faces_.push_back(face);
        tangential.push_back({around.cells.stride(u), around.cells.stride(v)});
      }
  }
  FitNumber most = 0;
  for (Group const& group : groups_) most = std::max(most, FitNumber(group.fit));
  for (int number = 0; number <= most; ++number) {
    NumberedFit const& from = numbered_fit(FitNumber(number));
    Fit& fit = fits_.emplace_back();
    fit.count = from.count;
    for (int t = 0; t < from.count; ++t)
      for (int q = 0; q < 4; ++q)
        fit.weight[t][q] = float(from.terms[std::size_t(t)].weight[std::size_t(q / 2)][std::size_t(q % 2)]);
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      auto& steps = faces_[f].steps.emplace_back();
      for (int t = 0; t < from.count; ++t)
        steps[std::size_t(t)] =
            from.terms[std::size_t(t)].i * tangential[f][0] + from.terms[std::size_t(t)].j * tangential[f][1];
    }
  }
}

void InterfaceCells::subtract_coarse(Vector const& surroundings, Vector& r) const {
  std::size_t n = 0;
  for (Face const& face : faces_)
    for (; n < face.end; ++n) {
      if (n + ahead < groups_.size())
        for (std::ptrdiff_t member : face.member)
          __builtin_prefetch(&r[std::size_t(groups_[n + ahead].cell + member)], 1);
      Group const& group = groups_[n];
      Fit const& fit = fits_[std::size_t(group.fit)];
      auto const& steps = face.steps[std::size_t(group.fit)];
      float const* const parent = &surroundings[std::size_t(group.parent)];
      Four sum[3] = {};  // independent of each other, so that one need not wait for the other
      for (std::size_t t = 0; t < std::size_t(fit.count); ++t) sum[t % 3] += fit.weight[t] * parent[steps[t]];
      Four const mean = sum[0] + sum[1] + sum[2];
      for (std::size_t q = 0; q < 4; ++q) r[std::size_t(group.cell + face.member[q])] -= face.weight * mean[q];
    }
}

void InterfaceCells::subtract_flux(Vector const& e, Vector& surroundings) const {
  constexpr float first = float(1 - interface_ghost::first), second = float(-interface_ghost::second);
  std::size_t n = 0;
  for (Face const& face : faces_)
    for (; n < face.end; ++n) {
      if (n + ahead < groups_.size())
        for (std::ptrdiff_t member : face.member) __builtin_prefetch(&e[std::size_t(groups_[n + ahead].cell + member)]);
      float sum = 0;
      for (std::ptrdiff_t member : face.member) {
        float const* const cell = &e[std::size_t(groups_[n].cell + member)];
        sum += first * cell[0] + second * cell[face.inward];
      }
      surroundings[std::size_t(groups_[n].parent)] -= face.flux_weight * sum;
    }
}

std::size_t InterfaceCells::bytes() const {
  std::size_t sum = groups_.size() * sizeof(Group) + fits_.size() * sizeof(Fit);
  for (Face const& face : faces_) sum += face.steps.size() * sizeof(face.steps[0]);
  return sum;
}

}  // namespace amrpic::matrixfree
