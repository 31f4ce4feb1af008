#include "freespace/heat_sums.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "freespace/near_field.hpp"

namespace amrpic::freespace {

namespace {

constexpr double pi = 3.14159265358979323846;

using Times = std::array<TimeNode, lane_count>;
using Reals = std::vector<double>;  ///< eight for each entry, by time

/// Cells of a level along an axis, with weights: the potential at a ghost is what they have together.
using Mean = std::vector<std::pair<int, double>>;

/// The cells of a level between which a ghost of another one lies, as the tables of near fields take it.
Mean mean_at(int ghost, int ghost_level, int level, int operator_order) {
  LatticePlace const place = place_in_level(ghost, ghost_level, level);
  bool const half = level > ghost_level;  // half way between cells
  double const curvature = operator_order == 4 ? between_means(level, ghost_level, half) : 0;
  InterpolationStencil const stencil = stencil_at(place.point + (half ? 0 : place.shift), curvature);
  Mean out;
  for (int m = 0; m < stencil.count; ++m)
    for (int behind = 0; behind <= int(half); ++behind)
      out.emplace_back(stencil.at[m] + behind, (half ? 0.5 : 1) * stencil.weight[m]);
  return out;
}

/// The heat kernel of a level along one axis, at eight times.
class AxisHeat {
 public:
  AxisHeat(std::vector<AxisImages::Copy> copies, int period, int cells, int level, double spacing, int operator_order)
      : copies_(std::move(copies)), ring_(period << level), level_(level), spacing_(spacing), order_(operator_order) {
    int const sum = std::accumulate(copies_.begin(), copies_.end(), 0, [](int n, auto const& c) { return n + c.sign; });
    has_mean_ = sum != 0;
    for (auto const& copy : copies_)
      for (int end : {-(beyond << level), cells + (beyond << level)}) {
        int const place = mapped(copy, end);
        furthest_ = std::max({furthest_, std::abs(place), std::abs(place - cells + 1)});
      }
  }

  /// Where the images map the cells that a ghost lies between.
  Mean places(int ghost, int ghost_level) const {
    Mean out;
    for (auto const& [cell, weight] : mean_at(ghost, ghost_level, level_, order_))
      for (auto const& copy : copies_) {
        int const place = mapped(copy, cell);
        out.emplace_back(ring_ > 0 ? (place % ring_ + ring_) % ring_ : place, copy.sign * weight);
      }
    return out;
  }

  /// The longest distance between a cell and an image of a ghost, or a period.
  double reach() const { return spacing_ * (ring_ > 0 ? ring_ : furthest_ + 1); }

  void set(Times const& times) {
    kernel_.assign(std::size_t(lane_count * (ring_ > 0 ? ring_ : furthest_ + 1)), 0.0);
    for (int n = 0; n < lane_count; ++n) {
      double const time = times[std::size_t(n)].time / (spacing_ * spacing_);
      auto const values = ring_ > 0 ? ring_heat(time, ring_, order_, has_mean_) : line_heat(time, furthest_, order_);
      for (std::size_t i = 0; i < values.size(); ++i)  // no product of three of them is denormal
        if (std::abs(values[i]) > 1e-40) kernel_[lane_count * i + std::size_t(n)] = values[i];
    }
  }
  bool has_faded() const {
    return std::all_of(kernel_.begin(), kernel_.end(), [](double value) { return value == 0; });
  }

  /// Between so many cells from the first one on and some ghosts, ghost by ghost for each cell.
  Reals between(int first, int count, std::vector<Mean> const& ghosts) const {
    Reals out(lane_count * std::size_t(count) * ghosts.size());
    double* to = out.data();
    for (int cell = first; cell < first + count; ++cell)
      for (Mean const& ghost : ghosts) {
        Lanes sum{};
        for (auto const& [place, weight] : ghost) {
          int const apart = std::abs(place - cell);  // the kernel is even, on rings too
          sum += weight * load<Lanes>(kernel_.data() + lane_count * apart);
        }
        store(to, sum);
        to += lane_count;
      }
    return out;
  }

 private:
  static constexpr int beyond = patch_points + 4;  ///< cells of the base up to ghosts and what they lie between

  int mapped(AxisImages::Copy const& copy, int cell) const {
    return Image{{copy.reflects, false, false}, {copy.shift, 0, 0}, copy.sign}.cell(0, cell, level_);
  }

  std::vector<AxisImages::Copy> copies_;
  int ring_, level_;
  double spacing_;
  int order_;
  bool has_mean_;
  int furthest_ = 0;
  Reals kernel_{};  ///< by distance in cells
};

/// The charge of a level.
struct Source {
  struct Charged {
    Box box;
    double const* charges;  ///< x fastest
  };
  std::vector<Charged> boxes;
  Box around;
  double volume;
  std::array<AxisHeat, 3> along;

  /// Charge times values for each cell along an axis, summed over all of these: by place in the plane, lower axis
  /// fastest. In the order of the cells, whatever the boxes.
  Reals summed(int normal, Reals const& values) const;
};

Reals Source::summed(int normal, Reals const& values) const {
  auto const axes = plane_axes(normal);
  Reals out(std::size_t(lane_count * around.extent(axes[0]) * around.extent(axes[1])), 0.0);
  std::array<std::ptrdiff_t, 3> step{};
  step[std::size_t(axes[0])] = lane_count;
  step[std::size_t(axes[1])] = std::ptrdiff_t(lane_count) * around.extent(axes[0]);
  auto in_order = boxes;
  std::stable_sort(in_order.begin(), in_order.end(),
                   [&](Charged const& a, Charged const& b) { return a.box.lower[normal] < b.box.lower[normal]; });
  for (auto [box, charge] : in_order)
    for_each_row(box, [&, charge = charge, count = box.extent(0)](Index3 const& cell) mutable {
      double* to = out.data();
      for (int d = 0; d < 3; ++d) to += step[std::size_t(d)] * (cell[d] - around.lower[d]);
      double const* value = values.data() + lane_count * (cell[normal] - around.lower[normal]);
      if (normal == 0) {
        auto sum = load<Lanes>(to);
        for (int i = 0; i < count; ++i, value += lane_count) sum += *charge++ * load<Lanes>(value);
        store(to, sum);
      } else {
        auto const weight = load<Lanes>(value);
        for (int i = 0; i < count; ++i, to += lane_count) store(to, load<Lanes>(to) + *charge++ * weight);
      }
    });
  return out;
}

/// The ghosts of one layer behind a wall, in blocks.
struct Layer {
  int normal;
  std::array<int, 2> first, count;                     ///< along the axes of the plane, around all blocks
  std::vector<std::array<std::vector<Mean>, 3>> from;  ///< by source and axis
  Reals sums;                                          ///< by ghost, lower axis fastest
};

/// A matrix of eight numbers each.
struct Rows {
  double const* values;
  std::size_t rows, columns, to_next_row, to_next_column;
};

/// Add to `to` the product of two matrices, the second one and the result row by row.
void add_product(Rows const& a, double const* b, std::size_t columns, double* to) {
  for (std::size_t r = 0; r < a.rows; ++r, to += lane_count * columns)
    for (std::size_t j = 0; j < a.columns; ++j) {
      auto const factor = load<Lanes>(a.values + lane_count * (r * a.to_next_row + j * a.to_next_column));
      double const* const row = b + lane_count * columns * j;
      for (std::size_t c = 0; c < lane_count * columns; c += lane_count)
        store(to + c, load<Lanes>(to + c) + factor * load<Lanes>(row + c));
    }
}

class HeatSums {
 public:
  HeatSums(WallPlan const& plan, Options const& options, std::vector<double> const& charges, Which which)
      : plan_(plan), mesh_(plan.geometry().mesh), shape_(mesh_.lattice.shape()), which_(which) {
    find_sources(charges, options.operator_order);
    find_layers();
  }

  std::vector<double> values() {
    if (layers_.empty()) return {};
    std::vector<TimeNode> nodes = times();
    double const background = total_ * of_background(nodes);
    while (nodes.size() % lane_count != 0) nodes.push_back({nodes.back().time, 0});
    for (std::size_t first = 0; first < nodes.size(); first += lane_count) {
      Times at;
      std::copy_n(nodes.begin() + std::ptrdiff_t(first), lane_count, at.begin());
      if (!set(at)) break;  // and so at all times from then on
      for (Layer& layer : layers_)
        for (std::size_t s = 0; s < sources_.size(); ++s) add(sources_[s], layer.from[s], at, layer);
    }
    std::vector<double> out(plan_.wall_blocks.size() * patch_values, -background);
    for (std::size_t n = 0; n < plan_.wall_blocks.size(); ++n) {
      GhostBlock const& block = block_of(n);
      Layer const& layer = layers_[layer_of_[n]];
      for (int v = 0; v < patch_points; ++v)
        for (int u = 0; u < patch_points; ++u) {
          int const from = patch_points * block.place[0] + u - layer.first[0] +
                           layer.count[0] * (patch_points * block.place[1] + v - layer.first[1]);
          out[n * patch_values + std::size_t(u + patch_points * v)] +=
              sum_of(load<Lanes>(layer.sums.data() + lane_count * from));
        }
    }
    return out;
  }

 private:
  GhostBlock const& block_of(std::size_t n) const {
    return plan_.geometry().patches.blocks()[std::size_t(plan_.wall_blocks[n])];
  }

  void find_sources(std::vector<double> const& charges, int operator_order) {
    double const* charge = charges.data();
    for (int l = 0; l < int(mesh_.levels.size()); ++l) {
      Level const& level = mesh_.level(l);
      Point h;
      for (int d = 0; d < 3; ++d) h[d] = std::ldexp(shape_[d], -l);
      auto const along = [&](int d) {
        return AxisHeat(mesh_.images.copies_along(d, which_), mesh_.images.axis(d).period, level.domain().extent(d), l,
                        h[d], operator_order);
      };
      Source& source =
          sources_.emplace_back(Source{{}, level.box(0), h[0] * h[1] * h[2], {along(0), along(1), along(2)}});
      for (Box const& box : level.boxes()) {
        source.boxes.push_back({box, charge});
        source.around = source.around.hull(box);
        charge += box.cells();
      }
      Reals const sums = source.summed(0, Reals(std::size_t(lane_count * source.around.extent(0)), 1.0));
      total_ += std::accumulate(sums.begin(), sums.end(), 0.0) / lane_count;
    }
  }

  void find_layers() {
    std::map<std::array<int, 3>, std::size_t> numbers;
    for (std::size_t n = 0; n < plan_.wall_blocks.size(); ++n) {
      GhostBlock const& block = block_of(n);
      auto const [found, is_new] = numbers.try_emplace({block.face, block.layer, block.level}, layers_.size());
      Layer& layer = is_new ? layers_.emplace_back() : layers_[found->second];
      layer_of_.push_back(found->second);
      for (std::size_t t = 0; t < 2; ++t) {
        int const first = patch_points * block.place[t], end = first + patch_points;
        int const before = is_new ? first : std::min(first, layer.first[t]);
        layer.count[t] = (is_new ? end : std::max(end, layer.first[t] + layer.count[t])) - before;
        layer.first[t] = before;
      }
    }
    for (auto const& [key, number] : numbers) {
      auto const [face, at, level] = key;
      Layer& layer = layers_[number];
      layer.normal = face / 2;
      layer.sums.assign(std::size_t(lane_count * layer.count[0] * layer.count[1]), 0.0);
      auto const axes = plane_axes(layer.normal);
      int const behind = GhostPatch{face, at, level, {}, {}, -1}.behind(mesh_.lattice.cells[layer.normal] << level);
      for (Source const& source : sources_) {
        auto& from = layer.from.emplace_back();
        from[layer.normal].push_back(source.along[layer.normal].places(behind, level));
        for (int t : {0, 1})
          for (int n = 0; n < layer.count[t]; ++n)
            from[axes[t]].push_back(source.along[axes[t]].places(layer.first[t] + n, level));
      }
    }
  }

  /// Until the kernels have spread far past all charge and its images.
  std::vector<TimeNode> times() const {
    double extent2 = 0;
    for (int d = 0; d < 3; ++d) {
      double extent = 0;
      for (Source const& source : sources_) extent = std::max(extent, source.along[d].reach());
      extent2 += extent * extent;
    }
    double const longest = longest_spacing(shape_);
    double const shortest = std::ldexp(std::min({shape_[0], shape_[1], shape_[2]}), 1 - int(sources_.size()));
    return time_nodes(shortest, 4 * extent2 + 64 * longest * longest);
  }

  /// What a unit charge has for having a net one beside lattices without conductors: at late times its kernel is that
  /// of a line or a sheet, whose integral over time diverges. That at the distance of a period is left out, as the zero
  /// of the potential asks for, see `Closing`.
  double of_background(std::vector<TimeNode> const& nodes) const {
    Images const& images = mesh_.images;
    double const period = images.longest_period();
    double share = 1;
    for (int d = 0; d < 3; ++d) {
      double sum = 0;
      for (auto const& copy : images.copies_along(d, which_)) sum += copy.sign;
      share *= images.axis(d).period > 0 ? sum / (images.axis(d).period * shape_[d]) : sum;
    }
    if (share == 0) return 0;
    double out = images.lattices() == 2 ? 0.5 * period : 0;
    for (TimeNode const& node : nodes)
      out += node.weight * std::pow(4 * pi * node.time, 0.5 * images.lattices() - 1.5) *
             std::exp(-period * period / (4 * node.time));
    return share * out;
  }

  /// Let all kernels be those at some times. Returns whether any is left.
  bool set(Times const& times) {
    std::array<bool, 3> any{};
    for (Source& source : sources_)
      for (int d = 0; d < 3; ++d) {
        source.along[d].set(times);
        any[d] = any[d] || !source.along[d].has_faded();
      }
    return any[0] && any[1] && any[2];
  }

  void add(Source const& source, std::array<std::vector<Mean>, 3> const& ghosts, Times const& times, Layer& layer) {
    auto const axes = plane_axes(layer.normal);
    auto const extent = [&](int d) { return std::size_t(source.around.extent(d)); };
    auto const kernel = [&](int d) {
      return source.along[d].between(source.around.lower[d], source.around.extent(d), ghosts[d]);
    };
    Reals through = kernel(layer.normal);
    if (std::all_of(through.begin(), through.end(), [](double value) { return value == 0; })) return;
    for (std::size_t n = 0; n < through.size(); ++n) through[n] *= times[n % lane_count].weight / source.volume;
    Reals const plane = source.summed(layer.normal, through);
    Reals const u = kernel(axes[0]), v = kernel(axes[1]);
    std::size_t const columns = ghosts[axes[0]].size(), rows = ghosts[axes[1]].size();
    Reals along_u(lane_count * extent(axes[1]) * columns, 0.0);
    add_product({plane.data(), extent(axes[1]), extent(axes[0]), extent(axes[0]), 1}, u.data(), columns,
                along_u.data());
    add_product({v.data(), rows, extent(axes[1]), 1, rows}, along_u.data(), columns, layer.sums.data());
  }

  WallPlan const& plan_;
  WallMesh const& mesh_;
  Point shape_;
  Which which_;
  std::vector<Source> sources_;
  std::vector<Layer> layers_;
  std::vector<std::size_t> layer_of_;  ///< by block
  double total_ = 0;
};

}  // namespace

std::vector<double> sums_by_axes(WallPlan const& plan, Options const& options, std::vector<double> const& charges,
                                 Which which) {
  return HeatSums(plan, options, charges, which).values();
}

}  // namespace amrpic::freespace
