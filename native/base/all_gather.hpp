// Lists gathered from all ranks.
#pragma once

#include <mpi.h>

#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace amrpic {

/// What all ranks hold, rank after rank, and how much each gave.
template <class T>
struct Gathered {
  std::vector<T> values;
  std::vector<int> counts;
};

/// The lists of all ranks, on every rank. Collective.
template <class T, class Allocator>
Gathered<T> all_gather(MPI_Comm comm, std::vector<T, Allocator> const& mine) {
  static_assert(std::is_trivially_copyable_v<T>);
  int ranks = 1;
  MPI_Comm_size(comm, &ranks);
  Gathered<T> out;
  out.counts.resize(std::size_t(ranks));
  int const count = int(mine.size());
  MPI_Allgather(&count, 1, MPI_INT, out.counts.data(), 1, MPI_INT, comm);
  std::int64_t total = 0;
  for (int n : out.counts) total += n;
  if (total > std::numeric_limits<int>::max())
    throw std::length_error(std::to_string(total) +
                            " elements to gather on every rank, more than MPI counts; use fewer");
  std::vector<int> starts{0};
  for (int n : out.counts) starts.push_back(starts.back() + n);
  out.values.resize(std::size_t(starts.back()));
  MPI_Datatype type;  // whole elements, so that counts stay small
  MPI_Type_contiguous(int(sizeof(T)), MPI_BYTE, &type);
  MPI_Type_commit(&type);
  MPI_Allgatherv(mine.data(), count, type, out.values.data(), out.counts.data(), starts.data(), type, comm);
  MPI_Type_free(&type);
  return out;
}

}  // namespace amrpic
