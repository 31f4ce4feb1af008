// The ranks that work together: all that passes between them goes through here, and is counted.
#pragma once

#include <mpi.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/types.hpp"

namespace amrpic {

/// What this process has sent to other ranks so far, and the collective calls that it took part in.
struct Traffic {
  std::int64_t messages = 0, bytes = 0, collectives = 0;

  void add_since(Traffic const& before, Traffic const& now) {
    messages += now.messages - before.messages;
    bytes += now.bytes - before.bytes;
    collectives += now.collectives - before.collectives;
  }
};
Traffic& traffic();

/// What all ranks hold, rank after rank, and how much each gave.
template <class T>
struct Gathered {
  std::vector<T> values;
  std::vector<int> counts;
};

/// What MPI calls a type; one of its own for structures, made once, so that MPI counts whole elements.
MPI_Datatype new_datatype(std::size_t size);
template <class T>
MPI_Datatype datatype() {
  static_assert(std::is_trivially_copyable_v<T>);
  if constexpr (std::is_same_v<T, double>) return MPI_DOUBLE;
  if constexpr (std::is_same_v<T, float>) return MPI_FLOAT;
  if constexpr (std::is_same_v<T, int>) return MPI_INT;
  if constexpr (std::is_same_v<T, std::int64_t>) return MPI_INT64_T;
  if constexpr (std::is_same_v<T, char>) return MPI_SIGNED_CHAR;
  static MPI_Datatype const structure = new_datatype(sizeof(T));
  return structure;
}

/// The ranks of an MPI communicator, which must be the library's own: see `amrpic.parallel.own`. All that is not said
/// to be local is collective. Of one rank, nothing communicates.
///
/// A virtual rank is one of any number that need not exist: what follows from metadata alone, such as boxes, owners and
/// plans of exchanges, is the same for it as for a real one. What it sends is counted and goes nowhere, what it
/// receives stays as it was, and what all ranks hold together is its own part alone. So whatever a real rank does can
/// be gone through for its traffic, with wrong numbers.
class Communicator {
 public:
  explicit Communicator(MPI_Comm comm);
  Communicator(int rank, int ranks);  ///< a virtual rank, which must lie in [0, ranks). Local.
  bool is_virtual() const { return comm_ == MPI_COMM_NULL; }

  int rank() const { return rank_; }
  int ranks() const { return ranks_; }
  MPI_Comm handle() const { return comm_; }  ///< for libraries; what they send is not counted

  // ---- one value of all ranks, or one for each place of a list ----
  template <class T>
  T sum(T value) const {
    return reduced(value, MPI_SUM);
  }
  template <class T>
  T largest(T value) const {
    return reduced(value, MPI_MAX);
  }
  template <class T>
  T smallest(T value) const {
    return reduced(value, MPI_MIN);
  }
  bool any(bool here) const { return largest(int(here)) != 0; }
  bool all(bool here) const { return smallest(int(here)) != 0; }
  template <class List>
  void sum_each(List& values) const {
    reduce(values.data(), values.size(), MPI_SUM);
  }
  template <class List>
  void largest_each(List& values) const {
    reduce(values.data(), values.size(), MPI_MAX);
  }
  /// Each place of a list joined with those of the other ranks by `add`, in the order of ranks; the same on all ranks.
  template <class T>
  void add_each(std::vector<T>& values) const {
    static MPI_Op const adding = [] {
      MPI_Op made;
      auto const add = [](void* of_lower, void* of_higher, int* count, MPI_Datatype*) {
        for (int i = 0; i < *count; ++i) {
          T sum = static_cast<T*>(of_lower)[i];
          sum.add(static_cast<T*>(of_higher)[i]);
          static_cast<T*>(of_higher)[i] = sum;
        }
      };
      MPI_Op_create(add, false, &made);
      return made;
    }();
    reduce(values.data(), values.size(), adding);
  }
  /// For each place the bits that any rank has set: the value itself where all others hold zeros.
  void unite_each(std::vector<std::int64_t>& values) const { reduce(values.data(), values.size(), MPI_BOR); }
  /// The largest value and the lowest rank that holds it.
  std::pair<Real, int> largest_and_rank(Real value) const;

  /// The lists of all ranks, on every rank.
  template <class T, class Allocator>
  Gathered<T> gather(std::vector<T, Allocator> const& mine) const {
    Gathered<T> out;
    out.counts = counts(mine.size());
    std::vector<int> starts{0};
    for (int n : out.counts) starts.push_back(starts.back() + n);
    out.values.resize(std::size_t(starts.back()));
    gather_into(mine.data(), out.counts, starts, out.values.data());
    return out;
  }
  /// The same where it is known how much each rank gives.
  template <class T>
  void gather_into(T const* mine, std::vector<int> const& counts, std::vector<int> const& starts, T* all) const {
    count_collective();
    if (is_virtual()) {
      std::copy_n(mine, counts[std::size_t(rank_)], all + starts[std::size_t(rank_)]);
      return;
    }
    MPI_Allgatherv(mine, counts[std::size_t(rank_)], datatype<T>(), all, counts.data(), starts.data(), datatype<T>(),
                   comm_);
  }

  /// What each rank of `from` sends this one, in that order, where only the senders know how much; `to`: what this one
  /// sends, by rank. Empty lists travel too: whom a rank expects something from sends it.
  template <class T>
  std::vector<T> swapped(std::map<int, std::vector<T>> const& to, std::vector<int> const& from) const {
    std::vector<MPI_Request> sending;
    for (auto const& [rank, values] : to)
      send_list(values.data(), values.size(), sizeof(T), datatype<T>(), rank, sending.emplace_back());
    std::vector<T> out;
    for (int rank : from) {
      MPI_Message message;
      std::size_t const count = wait_for_list(rank, datatype<T>(), message), before = out.size();
      out.resize(before + count);
      take_list(out.data() + before, count, datatype<T>(), message);
    }
    wait(sending);
    return out;
  }

  /// Count a message to a rank in the traffic of this process. Local.
  void count_sent(int rank, std::size_t bytes) const;

  /// End all ranks with one sentence, which says that this rank failed. Local; does not return.
  [[noreturn]] void abort(std::string const& what) const;

 private:
  template <class T>
  T reduced(T value, MPI_Op op) const {
    reduce(&value, 1, op);
    return value;
  }
  template <class T>
  void reduce(T* values, std::size_t count, MPI_Op op) const {
    if (ranks_ == 1) return;
    count_collective();
    if (is_virtual()) return;
    MPI_Allreduce(MPI_IN_PLACE, values, int(count), datatype<T>(), op, comm_);
  }
  std::vector<int> counts(std::size_t mine) const;
  void send_list(void const* values, std::size_t count, std::size_t size, MPI_Datatype type, int rank,
                 MPI_Request& request) const;
  std::size_t wait_for_list(int rank, MPI_Datatype type, MPI_Message& message) const;
  void take_list(void* into, std::size_t count, MPI_Datatype type, MPI_Message& message) const;
  static void wait(std::vector<MPI_Request>& requests);
  void count_collective() const {
    if (ranks_ > 1) ++traffic().collectives;
  }

  MPI_Comm comm_;
  int rank_ = 0, ranks_ = 1;
};

/// Messages of one exchange between ranks that know what they send to each other.
class Messages {
 public:
  template <class T>
  void receive(Communicator const& comm, T* into, std::size_t count, int rank) {
    post(comm, into, count, sizeof(T), datatype<T>(), rank, false);
  }
  template <class T>
  void send(Communicator const& comm, T const* values, std::size_t count, int rank) {
    post(comm, const_cast<T*>(values), count, sizeof(T), datatype<T>(), rank, true);
  }
  /// Let messages move. Whoever computes meanwhile calls this at times, since they may not move by themselves.
  void poll();
  void wait_for_received() { wait(receiving_); }
  void wait_for_sent() { wait(sending_); }
  void wait_for_all() {
    wait_for_received();
    wait_for_sent();
  }

 private:
  void post(Communicator const& comm, void* values, std::size_t count, std::size_t size, MPI_Datatype type, int rank,
            bool sends);
  static void wait(std::vector<MPI_Request>& requests);

  std::vector<MPI_Request> receiving_, sending_;
};

/// Let a failure of MPI on a communicator of the library end the job with one sentence.
void end_job_on_failure(MPI_Comm comm);

}  // namespace amrpic
