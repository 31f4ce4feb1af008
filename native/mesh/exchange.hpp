#pragma once

#include <mpi.h>

#include <memory>
#include <vector>

#include "mesh/array_on_box.hpp"

namespace amrpic {

constexpr LocalIndex no_place = -1;

/// The cells of other ranks among some numbers, as an Exchange takes them: ascending, each once. Negative numbers stand
/// for no cell.
std::vector<GlobalIndex> remote_cells(Level const& level, std::vector<GlobalIndex> numbers);

/// Append the numbers of a level's cells in a region that other ranks own; periodic images included.
void append_remote(Level const& level, Box const& region, std::vector<GlobalIndex>& out);

/// The plan by which a rank reads cells of a level that other ranks own, and gives charge back to them.
///
/// Values of a level are stored as [own cells | halo], the halo in ascending global number. All that passes between two
/// ranks, for all boxes and all fields of a call, is one message. Made once per hierarchy; a call allocates nothing
/// after the first with as many fields.
class Exchange {
 public:
  Exchange() = default;

  /// Plan for a halo of the given cells (ascending global numbers, none of them owned here). Collective.
  Exchange(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> halo);

  /// Plan for a part of another plan's halo, into that plan's places; `subset` ascending. Collective.
  Exchange(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> const& whole_halo,
           std::vector<GlobalIndex> const& subset);

  /// The same plan for values of which `owned` are kept, those of an own cell at place(its place among all of them).
  /// It can `update` the halo; cells are found by the plan that it comes from.
  template <class Place>
  Exchange kept_elsewhere(LocalIndex owned, Place const& place) const {
    Exchange out = *this;
    out.owned_ = owned;
    out.messages_ = out.bytes_ = 0;
    for (auto& n : out.readers_)
      for (LocalIndex& cell : n.cells) cell = place(cell);
    return out;
  }

  LocalIndex owned() const { return owned_; }
  LocalIndex halo_size() const { return LocalIndex(halo_.size()); }
  std::vector<GlobalIndex> const& halo_numbers() const { return halo_; }

  /// Place of a cell in [own cells | halo]; the cell must be in one of both.
  LocalIndex local(GlobalIndex cell) const;

  /// Places of a level's cells in a region, `no_place` where a cell is neither owned nor in the halo or does not exist;
  /// periodic images included.
  ArrayOnBox<LocalIndex> places(Level const& level, Box const& region) const;

  /// Fill the halo of each field from its owners; values of a field lie `stride` numbers apart. Collective.
  void update(std::vector<Real const*> const& own, std::vector<Real*> const& halo, std::ptrdiff_t stride = 1) const;

  /// The same for one field stored as [own cells | halo].
  void update(Real* field) const { update({field}, {field + owned_}); }

  /// Add each field's halo to its owners' cells, in the order of ranks; the halo keeps its values. Collective.
  void fold(std::vector<Real*> const& own, std::vector<Real const*> const& halo) const;

  std::int64_t messages() const { return messages_; }  ///< sent by this rank so far
  std::int64_t bytes() const { return bytes_; }

 private:
  struct Neighbour {
    int rank;
    std::vector<LocalIndex> cells;  ///< places in the halo, or among the own cells
    mutable std::vector<Real> buffer;
  };
  void make(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> const& wanted);
  void write_places(GlobalIndex first, LocalIndex count, LocalIndex* out) const;
  static void pack(std::vector<Neighbour> const& neighbours, std::vector<Real const*> const& fields,
                   std::ptrdiff_t stride);
  void post(std::vector<Neighbour> const& receive, std::vector<Neighbour> const& send, std::size_t fields) const;

  MPI_Comm comm_ = MPI_COMM_NULL;
  GlobalIndex first_ = 0;
  LocalIndex owned_ = 0;
  std::vector<GlobalIndex> halo_;
  std::vector<Neighbour> sources_;  ///< ranks that own my halo; places in the halo
  std::vector<Neighbour> readers_;  ///< ranks that read my cells; places among the own cells
  mutable std::vector<MPI_Request> requests_;
  mutable std::int64_t messages_ = 0;
  mutable std::int64_t bytes_ = 0;
};

}  // namespace amrpic
