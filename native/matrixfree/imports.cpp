#include "matrixfree/imports.hpp"

#include <type_traits>

namespace amrpic {

namespace {
constexpr int tag_plan = 7201;
constexpr int tag_values = 7202;
constexpr int ints = sizeof(Piece) / sizeof(int);
static_assert(std::is_trivially_copyable_v<Piece> && ints * sizeof(int) == sizeof(Piece));
}  // namespace

std::int32_t Imports::ask(int owner, Piece const& piece) {
  if (slot_.size() <= std::size_t(owner)) slot_.resize(std::size_t(owner) + 1, -1);
  int& slot = slot_[std::size_t(owner)];
  if (slot < 0) {
    slot = int(sources_.size());
    sources_.emplace_back().rank = owner;
    asked_.push_back(0);
  }
  sources_[std::size_t(slot)].pieces.push_back(piece);
  std::int32_t const place = asked_[std::size_t(slot)];
  asked_[std::size_t(slot)] += std::int32_t(piece.part.cells());
  return place;
}

void Imports::connect(MPI_Comm comm) {
  comm_ = comm;
  int ranks;
  MPI_Comm_size(comm, &ranks);
  if (ranks == 1) return;
  std::vector<int> ask(std::size_t(ranks), 0), answer(std::size_t(ranks), 0);
  for (auto const& n : sources_) ask[std::size_t(n.rank)] = int(n.pieces.size());
  MPI_Alltoall(ask.data(), 1, MPI_INT, answer.data(), 1, MPI_INT, comm);
  for (int r = 0; r < ranks; ++r)
    if (answer[std::size_t(r)] > 0) {
      readers_.emplace_back().rank = r;
      readers_.back().pieces.resize(std::size_t(answer[std::size_t(r)]));
    }
  for (auto& n : readers_)
    MPI_Irecv(n.pieces.data(), int(n.pieces.size()) * ints, MPI_INT, n.rank, tag_plan, comm, &requests_.emplace_back());
  for (auto& n : sources_)
    MPI_Isend(n.pieces.data(), int(n.pieces.size()) * ints, MPI_INT, n.rank, tag_plan, comm, &requests_.emplace_back());
  MPI_Waitall(int(requests_.size()), requests_.data(), MPI_STATUSES_IGNORE);
  for (std::size_t s = 0; s < sources_.size(); ++s) {
    sources_[s].values.resize(std::size_t(asked_[s]));
    std::vector<Piece>().swap(sources_[s].pieces);
  }
  for (auto& n : readers_) {
    GlobalIndex count = 0;
    for (Piece const& piece : n.pieces) count += piece.part.cells();
    n.values.resize(std::size_t(count));
  }
}

void Imports::post() {
  std::size_t request = 0;
  for (auto& n : sources_)
    MPI_Irecv(n.values.data(), int(n.values.size()), MPI_DOUBLE, n.rank, tag_values, comm_, &requests_[request++]);
  for (auto& n : readers_) {
    MPI_Isend(n.values.data(), int(n.values.size()), MPI_DOUBLE, n.rank, tag_values, comm_, &requests_[request++]);
    ++messages_;
    bytes_ += std::int64_t(n.values.size() * sizeof(Real));
  }
}

void Imports::finish() { MPI_Waitall(int(requests_.size()), requests_.data(), MPI_STATUSES_IGNORE); }

std::size_t Imports::memory() const {
  std::size_t sum = 0;
  for (auto const* list : {&sources_, &readers_})
    for (auto const& n : *list) sum += n.pieces.capacity() * sizeof(Piece) + n.values.capacity() * sizeof(Real);
  return sum;
}

}  // namespace amrpic
