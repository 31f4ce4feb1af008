// Bricks whose particles one rank serves and whose cells another one owns.
#pragma once

#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "mesh/electric_field.hpp"
#include "mesh/exchange.hpp"
#include "mesh/field.hpp"
#include "particle/buffer_zone.hpp"
#include "particle/locate.hpp"
#include "particle/servers.hpp"

namespace amrpic {

inline Box cells_of(Hierarchy const& hierarchy, Home const& brick) {
  return Bricks(hierarchy.level(brick.level).box(brick.box))[brick.brick];
}

/// The cells of one level around a brick that the clouds of its particles touch.
struct Region {
  int level;
  Box cells;                   ///< what lies behind walls or beyond the level included
  std::vector<Overlap> parts;  ///< of the level's boxes
  bool whole;                  ///< whether the level has all cells that lie behind no wall
};

/// Call f(cell) for the cells of a region that lie behind no wall and that its level lacks.
template <class F>
void for_each_missing(Level const& level, Region const& region, F&& f) {
  ArrayOnBox<char> exists(region.cells, 0);
  for (Overlap const& o : region.parts) exists.fill(o.part, 1);
  for_each_cell(level.cut_at_walls(region.cells), [&](Index3 const& cell) {
    if (!exists(cell)) f(cell);
  });
}

/// A brick with the levels that its particles touch.
struct BrickRegions {
  Home home;
  Box cells;
  BoxBuffer buffer;
  /// That of the brick's level; of the next coarser one, where the first is not whole or clouds are matched; of those
  /// that matched clouds touch.
  std::vector<Region> regions;
};

/// Follows from the boxes alone; `matched`: whether clouds are; `reach`: layers of cells around the brick. Local.
BrickRegions regions_of(Hierarchy const& hierarchy, Home const& brick, bool matched, int reach = tile_reach);

/// The lowest of the ranks that serve particles of each of some bricks. Local.
std::vector<int> first_servers(Hierarchy const& hierarchy, Servers const& servers, std::vector<Home> const& bricks);

/// The plan of what passes between this rank and others because of bricks that one serves and the other owns. Of
/// several ranks that serve the same brick the first alone meets the owners of its cells: it passes on what it reads to
/// the others, and sums what they add.
///
/// The values of all regions of a rank's bricks are stored one region after the other, x fastest.
class RemotePlan {
 public:
  /// `bricks`: remote ones of this rank, ascending; `servers`: the first of each. Other ranks do not know of them yet.
  /// Local.
  RemotePlan(Hierarchy const& hierarchy, std::vector<Home> const& bricks, std::vector<int> const& servers, bool matched,
             int reach);

  bool is_announced() const { return is_announced_; }
  void announce() { announce_with(nullptr, nullptr); }  ///< let others know. Collective; before `read`

  std::vector<BrickRegions> const& bricks() const { return bricks_; }  ///< then those that this rank passes on alone
  std::size_t cells() const { return cells_; }                         ///< of all regions
  std::size_t first(std::size_t brick, std::size_t region) const { return first_[brick][region]; }

  /// The electric field in the cells of all regions, three components for each. Collective.
  std::vector<Real> read(ElectricField const& field) const;
  /// A density there. Collective.
  std::vector<Real> read(Field const& density) const;

  /// Add densities in the cells of all regions, or of those of this rank's own bricks, to those of the owners, who need
  /// not know of the bricks yet: then they learn of them by the same messages. Collective.
  void add(std::vector<Real> values, Field& density);

 private:
  /// Cells of this rank's box, numbered from its first one of the level, that another rank reads or this one itself.
  struct OwnPart {
    int level, box;
    Box cells;
  };
  /// Cells of a region, from a place among all its values on.
  struct RegionPart {
    Box region, cells;
    std::size_t first;
  };
  struct LocalPart {
    OwnPart own;
    RegionPart region;
  };
  /// The values of `per_cell` numbers that write(own part, out) gives. Collective.
  template <class Write>
  std::vector<Real> read(std::size_t per_cell, Write const& write) const;

  void append(BrickRegions brick, int server);
  /// Let others know, and give them what is to be added, if anything.
  void announce_with(std::vector<Real>* values, Field* density);
  void meet_servers(std::vector<Real>* values);
  void meet_owners(std::vector<Real>* values, Field* density);
  static Real* pack(std::vector<Real> const& values, RegionPart const& from, Real* out);
  static Real const* add_to_region(Real const* in, RegionPart const& to, std::vector<Real>& values);
  Real const* add_to_cells(Real const* in, OwnPart const& to, Field& density) const;
  void add_local(std::vector<Real> const& values, Field& density) const;

  RegionPart part_of(std::size_t brick, std::size_t region, Overlap const& o) const {
    return {bricks_[brick].regions[region].cells, o.part, first_[brick][region]};
  }

  Hierarchy const* hierarchy_;
  bool matched_;
  int reach_;
  bool is_announced_ = false;
  std::vector<BrickRegions> bricks_;
  std::vector<int> servers_;                     ///< the first of each
  std::vector<std::vector<std::size_t>> first_;  ///< of each region of each brick
  std::size_t cells_ = 0;
  std::vector<OwnPart> asked_;      ///< by other ranks
  std::vector<RegionPart> wanted_;  ///< of other ranks
  std::vector<LocalPart> local_;
  Exchange<Real> exchange_;
  std::vector<RegionPart> passed_on_, brought_;  ///< to other servers, and by first servers
  Exchange<Real> between_servers_;
};

/// The remote bricks in which this rank has particles.
class RemoteBricks {
 public:
  /// `bricks`: ascending; `servers`: the first of each. Local.
  RemoteBricks(std::shared_ptr<Hierarchy const> hierarchy, std::vector<Home> bricks, std::vector<int> servers)
      : hierarchy_(std::move(hierarchy)), bricks_(std::move(bricks)), servers_(std::move(servers)) {}
  RemoteBricks(RemoteBricks const&) = delete;
  RemoteBricks& operator=(RemoteBricks const&) = delete;

  Hierarchy const& hierarchy() const { return *hierarchy_; }
  std::vector<Home> const& bricks() const { return bricks_; }

  /// What passes because of them, for clouds that are matched or not and each reach. The first call, unless charge was
  /// added before, lets others know: collective.
  RemotePlan const& plan(bool matched, int reach = tile_reach) const;
  /// The same, of which others may not know yet. Local.
  RemotePlan& own_plan(bool matched, int reach = tile_reach) const;

 private:
  std::shared_ptr<Hierarchy const> hierarchy_;
  std::vector<Home> bricks_;
  std::vector<int> servers_;
  mutable std::map<std::pair<bool, int>, RemotePlan> plans_;
};

}  // namespace amrpic
