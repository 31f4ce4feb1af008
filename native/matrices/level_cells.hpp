#pragma once

#include <memory>

#include "base/runtime.hpp"
#include "matrices/tpetra.hpp"
#include "mesh/halo.hpp"

namespace amrpic {

/// The cells of a level that this rank's vectors have places for, [own cells | halo], as Tpetra numbers and exchanges
/// them. Those of the halo that sweeps read come first in it, so that a sweep brings these alone.
class LevelCells {
 public:
  /// `halo`: all cells of other ranks that any operator reads; `swept`: those that sweeps read, all if not given.
  /// Collective.
  LevelCells(Communicator const& comm, std::shared_ptr<Level const> level, Halo halo);
  LevelCells(Communicator const& comm, std::shared_ptr<Level const> level, Halo halo, CellReads const& swept);

  Level const& level() const { return *level_; }
  LocalIndex rows() const { return level_->local_cells(); }
  LocalIndex columns() const { return rows() + halo_.size(); }
  Halo const& halo() const { return halo_; }

  /// Global numbers of all cells that have places, in the order of these.
  std::vector<GlobalIndex> numbers() const;

  /// Places of the level's cells in a region, `no_place` where a cell has none or does not exist; periodic images
  /// included.
  ArrayOnBox<LocalIndex> places(Box const& region) const;

  /// Tpetra's maps of own cells, of all, and of own ones with what sweeps read; imports are null of one rank.
  struct Maps {
    Teuchos::RCP<TpetraTypes::Map const> own, all, swept;
    Teuchos::RCP<TpetraTypes::Import const> to_all, to_swept;
  };
  Maps const& maps() const { return *maps_; }

 private:
  using MapAndImport = std::pair<Teuchos::RCP<TpetraTypes::Map const>, Teuchos::RCP<TpetraTypes::Import const>>;
  Maps map_all(Communicator const& comm) const;
  MapAndImport with_halo(Communicator const& comm, Teuchos::RCP<TpetraTypes::Map const> const& own,
                         LocalIndex count) const;

  std::shared_ptr<Level const> level_;
  Halo halo_;
  std::vector<LocalIndex> place_;  ///< of each cell of the halo, in that order
  LocalIndex swept_ = 0;           ///< number of cells that sweeps read
  UntilFinalize<Maps> maps_;
};

/// Values in the cells of a level, in the memory of Tpetra's node. Moved, not copied.
class LevelVector {
 public:
  explicit LevelVector(std::shared_ptr<LevelCells const> cells);  ///< zeros
  LevelVector(LevelVector&&) = default;
  LevelVector& operator=(LevelVector&&) = default;

  LevelCells const& cells() const { return *cells_; }
  TpetraTypes::MultiVector& own() { return *vectors_->own; }  ///< own cells, all as below
  TpetraTypes::MultiVector const& own() const { return *vectors_->own; }
  TpetraTypes::MultiVector& all() { return *vectors_->all; }
  TpetraTypes::MultiVector const& all() const { return *vectors_->all; }
  DeviceArray<Real> values() { return column_of(all()); }  ///< own cells and halo
  DeviceArray<Real const> values() const { return column_of(all()); }

  void set_zero() { all().putScalar(0); }
  void assign(LevelVector const& other) { Tpetra::deep_copy(own(), other.own()); }  ///< own cells
  void update_halo();        ///< from the owners of its cells. Collective.
  void update_swept_halo();  ///< the part of it that sweeps read. Collective.

 private:
  struct Vectors {
    Teuchos::RCP<TpetraTypes::MultiVector> all, own, swept;
  };
  std::shared_ptr<LevelCells const> cells_;
  UntilFinalize<Vectors> vectors_;
};

}  // namespace amrpic
