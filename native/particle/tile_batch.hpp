#pragma once

#include <deque>
#include <functional>
#include <utility>
#include <vector>

#include "particle/tile.hpp"
#include "particle/tile_kernels.hpp"

namespace amrpic {

/// Boxes with tiles of their own until there are enough for kernels to run.
template <class Tile, int components>
class TileBatch {
 public:
  using Run = std::function<std::int64_t(TileKernels const&, std::vector<OnTiles> const&)>;
  TileBatch(ParticleMesh const& mesh, TileKernels const& kernels, ParticleView const& particles, Run run)
      : mesh_(mesh), kernels_(kernels), particles_(particles), run_(std::move(run)) {}

  /// Tiles for the next box, by coarsening depth; they stay until kernels have run.
  std::vector<Tile>& next() {
    if (on_.size() == tiles_.size()) tiles_.emplace_back(std::size_t(mesh_.hierarchy().level_count()));
    return tiles_[on_.size()];
  }
  /// Particles [first, last) lie in the box of these tiles. Throws Stray if one of those before, or of these, does not.
  void add(int level, Box const& box, BoxBuffer const* buffer, std::int64_t first, std::int64_t last,
           std::function<void()> then = {}) {
    std::vector<Tile>& tiles = next();
    OnTiles on{first, last, buffer, {}};
    auto const add_tile = [&](int of_level, Box const& cells) {
      Tile& tile = tiles[on.by_depth.size()];
      std::ptrdiff_t const count = components * std::ptrdiff_t(tile.cells().cells());
      on.by_depth.push_back({{mesh_.locator().coordinates(of_level), cells},
                             tile.values(),
                             count,
                             tile.box_corner(),
                             tile.stride_y(),
                             tile.stride_z()});
      cells_ += tile.cells().cells();
    };
    add_tile(level, box);
    for (std::size_t r = 0; buffer && r < buffer->coarse.size(); ++r)
      add_tile(buffer->coarse[r].level, buffer->coarse[r].box);
    on_.push_back(std::move(on));
    then_.push_back(std::move(then));
    if (cells_ >= kernels_.cells_at_once()) run();
  }
  /// Run the kernels for all boxes that wait, and then what is to follow for each.
  void run() {
    if (on_.empty()) return;
    if (std::int64_t const stray = run_(kernels_, on_); stray >= 0) throw Stray{particles_.id[stray]};
    for (auto const& then : then_)
      if (then) then();
    on_.clear(), then_.clear();
    cells_ = 0;
  }

 private:
  ParticleMesh const& mesh_;
  TileKernels const& kernels_;
  ParticleView const& particles_;
  Run run_;
  std::deque<std::vector<Tile>> tiles_;
  std::vector<OnTiles> on_;
  std::vector<std::function<void()>> then_;
  std::int64_t cells_ = 0;
};

}  // namespace amrpic
