#include "mesh/remote_reads.hpp"

#include <limits>
#include <string>

namespace amrpic {

void RemoteReads::add(int purpose, Reads const& reads) {
  for (Read const& read : reads.asked) asked_.push_back({purpose, read});
  for (Read const& read : reads.wanted) wanted_.push_back({purpose, read});
}

void RemoteReads::plan(Communicator const& comm) {
  auto parcels = [](std::vector<Piece>& pieces) {
    std::stable_sort(pieces.begin(), pieces.end(),
                     [](Piece const& a, Piece const& b) { return a.read.rank < b.read.rank; });
    std::vector<Parcel> out;
    for (Piece const& piece : pieces) out.push_back({piece.read.rank, piece.read.part.cells()});
    return out;
  };
  auto const asked = parcels(asked_);
  exchange_ = Exchange<Real>(comm, asked, parcels(wanted_));
  for (auto const& [purpose, read] : wanted_) {
    places_[{purpose, read.reader, read.region, read.owner, read.shift}] = {first_.back(), read.part};
    std::int64_t const last = first_.back() + read.part.cells();
    if (last > std::numeric_limits<std::int32_t>::max())
      comm.abort("a rank reads " + std::to_string(last) +
                 " values of other ranks at once, more than 32 bits count; use more ranks");
    first_.push_back(std::int32_t(last));
  }
  std::vector<Piece>().swap(wanted_);
}

RemoteReads::Values RemoteReads::find(int purpose, int reader, int region, int owner, Index3 const& shift,
                                      Box const& part) const {
  auto const& [from, all] = places_.at({purpose, reader, region, owner, shift});
  return {from + std::int32_t(all.offset(part.lower)), all.extent(0), all.extent(0) * all.extent(1)};
}

std::size_t RemoteReads::memory() const {
  return asked_.capacity() * sizeof(Piece) + places_.size() * (sizeof(Key) + sizeof(Place) + 4 * sizeof(void*)) +
         first_.capacity() * sizeof(std::int32_t) + exchange_.bytes();
}

Reads coarsened(Reads reads, Index3 const& ratio) {
  for (auto* list : {&reads.wanted, &reads.asked})
    for (Read& read : *list) {
      read.part = read.part.coarsen(ratio);
      for (int d = 0; d < 3; ++d) read.shift[d] /= ratio[d];
    }
  return reads;
}

}  // namespace amrpic
