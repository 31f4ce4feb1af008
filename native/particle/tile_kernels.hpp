// Deposit, gather and push where loops over particles are executed elsewhere, many boxes at a time.
#pragma once

#include <deque>
#include <functional>
#include <utility>
#include <vector>

#include "particle/mover.hpp"
#include "particle/tile.hpp"

namespace amrpic {

/// Particles of a box, and the tiles that their clouds touch.
struct OnTiles {
  /// What kernels need of a `Tile`.
  struct Numbers {
    TileFrame frame;
    Real* values;
    std::ptrdiff_t count, corner, stride_y, stride_z;
  };
  std::int64_t first, last;
  BoxBuffer const* buffer;        ///< null if all clouds lie in the first tile
  std::vector<Numbers> by_depth;  ///< of coarsening
};

/// The loops over particles. Each returns the first particle that lies outside its box, -1 if none does.
class TileKernels {
 public:
  virtual ~TileKernels() = default;
  /// How many cells' tiles make it worth while to run.
  virtual std::int64_t cells_at_once() const = 0;
  /// Add the clouds of particles, in real particles per cell, to tiles that are zero before.
  virtual std::int64_t deposit(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on) const = 0;
  /// Average the tiles over the clouds.
  virtual std::int64_t gather(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on,
                              std::array<Real*, 3> const& out) const = 0;
  /// The same, and move the particles by it.
  virtual std::int64_t push(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on,
                            Mover const& mover) const = 0;
};

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
      on.by_depth.push_back({TileFrame(mesh_.locator().coordinates(of_level), cells), tile.values(), count,
                             tile.box_corner(), tile.stride_y(), tile.stride_z()});
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
