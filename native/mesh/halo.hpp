#pragma once

#include <map>
#include <vector>

#include "base/communicator.hpp"
#include "mesh/array_on_box.hpp"
#include "mesh/exchange.hpp"
#include "mesh/reads.hpp"

namespace amrpic {

constexpr LocalIndex no_place = -1;

/// Consecutive cells.
struct NumberRun {
  GlobalIndex first;
  LocalIndex count;
  bool operator==(NumberRun const& other) const { return first == other.first && count == other.count; }
};

/// The cells of a level that this rank reads of others, and that others read of it. Both follow from the boxes.
class CellReads {
 public:
  explicit CellReads(Level const& owners) : owners_(&owners) {}

  /// Each box of `readers` reads the cells in some regions; `near`, `regions`: as in `reads_across_ranks`.
  template <class Near, class Regions>
  void add(Level const& readers, Near&& near, Regions&& regions) {
    add(reads_across_ranks(readers, *owners_, near, regions));
  }
  void add(Reads const& reads);

  /// The same where numbers(box) lists the cells one by one, and must give the same on all ranks; negative numbers
  /// stand for no cell.
  template <class Near, class Numbers>
  void add_numbers(Level const& readers, Near&& near, Numbers&& numbers) {
    if (owners_->ranks() == 1) return;
    for (int b = readers.first_local_box(); b < readers.last_local_box(); ++b)
      for (GlobalIndex n : numbers(b))
        if (n >= 0 && !owners_->owns(n)) wanted_.push_back({n, 1});
    for_each_reader(readers, *owners_, near, [&](int b) {
      auto& asked = asked_[readers.owner(b)];
      for (GlobalIndex n : numbers(b))
        if (n >= 0 && owners_->owns(n)) asked.push_back({n, 1});
    });
  }

  Level const& owners() const { return *owners_; }
  std::vector<NumberRun> wanted() const;                ///< ascending, each cell once
  std::map<int, std::vector<NumberRun>> asked() const;  ///< the same for each rank that reads any

 private:
  void add_part(Read const& read, std::vector<NumberRun>& out) const;

  Level const* owners_;
  std::vector<NumberRun> wanted_;
  std::map<int, std::vector<NumberRun>> asked_;
};

/// The halo of a rank on a level: the cells of other ranks that it reads, and gives charge back to.
///
/// Values of a level are stored as [own cells | halo], the halo in ascending order of numbers. All that passes between
/// two ranks, for all boxes and all fields of a call, is one message.
class Halo {
 public:
  Halo() = default;
  /// Local, as all plans are.
  Halo(Communicator const& comm, CellReads const& reads);

  /// The same cells where values of but `owned` own ones are kept, that of an own cell at place(its place among all).
  /// It can `update`; cells are found by the halo that it comes from.
  template <class Place>
  Halo kept_elsewhere(LocalIndex owned, Place const& place) const {
    Halo out = *this;
    out.owned_ = owned;
    for (auto& runs : out.asked_) {
      std::vector<PlaceRun> moved;
      for (PlaceRun const& run : runs)
        for (LocalIndex n = 0; n < run.count; ++n) append(moved, place(run.first + n));
      runs = std::move(moved);
    }
    return out;
  }

  LocalIndex owned() const { return owned_; }
  LocalIndex size() const { return size_; }
  std::vector<GlobalIndex> numbers() const;
  bool has_cells_of(Halo const& other) const { return cells_ == other.cells_; }  ///< and no others

  /// Place of a cell in [own cells | halo]; the cell must be in one of both.
  LocalIndex local(GlobalIndex cell) const {
    GlobalIndex const own = cell - first_;
    return own >= 0 && own < owned_ ? LocalIndex(own) : place_in_halo(cell);
  }
  std::vector<LocalIndex> local(std::vector<GlobalIndex> const& cells) const;  ///< negative numbers stay

  /// Places of a level's cells in a region, `no_place` where a cell is neither owned nor in the halo or does not exist;
  /// periodic images included.
  ArrayOnBox<LocalIndex> places(Level const& level, Box const& region) const;

  /// Fill the halo of each field from its owners; values of a field lie `stride` numbers apart. Collective.
  void update(std::vector<Real const*> const& own, std::vector<Real*> const& halo, std::ptrdiff_t stride = 1) const;

  /// Add each field's halo to its owners' cells, in the order of ranks; the halo keeps its values. Collective.
  void fold(std::vector<Real*> const& own, std::vector<Real const*> const& halo, std::ptrdiff_t stride = 1) const;

 private:
  /// Values that follow each other, among those of own cells or of the halo.
  struct PlaceRun {
    LocalIndex first, count;
  };
  static void append(std::vector<PlaceRun>& runs, LocalIndex place) {
    if (!runs.empty() && runs.back().first + runs.back().count == place)
      ++runs.back().count;
    else
      runs.push_back({place, 1});
  }
  LocalIndex place_in_halo(GlobalIndex cell) const;
  void write_places(GlobalIndex first, LocalIndex count, LocalIndex* out) const;
  std::size_t first_run_from(GlobalIndex cell) const;

  GlobalIndex first_ = 0;
  LocalIndex owned_ = 0, size_ = 0;
  std::vector<NumberRun> cells_;                       ///< of the halo
  std::vector<LocalIndex> places_;                     ///< where each of these runs starts in the halo
  std::vector<std::vector<PlaceRun>> wanted_, asked_;  ///< of each rank: places in the halo, or among the own cells
  Exchange<Real> exchange_;
};

}  // namespace amrpic
