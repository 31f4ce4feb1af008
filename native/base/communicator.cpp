#include "base/communicator.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "base/brought.hpp"
#include "base/destinations.hpp"
#include "base/error.hpp"

namespace amrpic {

namespace {

constexpr int tag_values = 7101, tag_announcement = 7102 /* and the next one */, tag_lists = 7104;
constexpr std::size_t longest = std::size_t(1) << 30;  ///< elements of a message, which MPI counts with 31 bits

[[noreturn]] void end_job(MPI_Comm comm, std::string const& what) {
  int rank = 0, ranks = 1;
  MPI_Comm_rank(comm, &rank);
  MPI_Comm_size(comm, &ranks);
  std::fflush(stdout);
  std::fprintf(stderr, "amrpic: %s (on rank %d of %d alone)\n", what.c_str(), rank, ranks);
  std::fflush(stderr);
  MPI_Abort(comm, 1);
  std::abort();
}

void on_failure(MPI_Comm* comm, int* code, ...) {
  char text[MPI_MAX_ERROR_STRING];
  int length = 0;
  MPI_Error_string(*code, text, &length);
  end_job(*comm, "a message between ranks failed: " + std::string(text, std::size_t(length)));
}

/// How many announcements a communicator has had: kept with it, since another one may get the handle of one that is
/// freed.
int& rounds_of(MPI_Comm comm) {
  static int const key = [] {
    int made;
    auto const forget = [](MPI_Comm, int, void* rounds, void*) {
      return delete static_cast<int*>(rounds), MPI_SUCCESS;
    };
    MPI_Comm_create_keyval(MPI_COMM_NULL_COPY_FN, forget, &made, nullptr);
    return made;
  }();
  int* rounds = nullptr;
  int known = 0;
  MPI_Comm_get_attr(comm, key, static_cast<void*>(&rounds), &known);
  if (!known) MPI_Comm_set_attr(comm, key, rounds = new int(0));
  return *rounds;
}

}  // namespace

void fail_alone(std::string const& what) {
  int ranks = 1;
  MPI_Comm_size(MPI_COMM_WORLD, &ranks);
  if (ranks == 1) throw std::logic_error(what);
  end_job(MPI_COMM_WORLD, what);
}

Traffic& traffic() {
  static Traffic all;
  return all;
}

std::map<int, std::int64_t>& destinations() {
  static std::map<int, std::int64_t> all;
  return all;
}

MPI_Datatype new_datatype(std::size_t size) {
  MPI_Datatype out;
  MPI_Type_contiguous(int(size), MPI_BYTE, &out);
  MPI_Type_commit(&out);
  return out;
}

Communicator::Communicator(MPI_Comm comm) : comm_(comm) {
  MPI_Comm_rank(comm, &rank_);
  MPI_Comm_size(comm, &ranks_);
}

Communicator::Communicator(int rank, int ranks) : comm_(MPI_COMM_NULL), rank_(rank), ranks_(ranks) {
  if (rank < 0 || rank >= ranks)
    throw std::invalid_argument("virtual rank " + std::to_string(rank) + " is not one of " + std::to_string(ranks) +
                                "; give one from 0 to " + std::to_string(ranks - 1));
}

void Communicator::count_sent(int rank, std::size_t bytes) const {
  if (is_virtual()) destinations()[rank] += std::int64_t(bytes);
  ++traffic().messages;
  traffic().bytes += std::int64_t(bytes);
}

std::pair<Real, int> Communicator::largest_and_rank(Real value) const {
  struct {
    double value;
    int rank;
  } out{value, rank_};
  count_collective();
  if (is_virtual()) return {value, rank_};
  MPI_Allreduce(MPI_IN_PLACE, &out, 1, MPI_DOUBLE_INT, MPI_MAXLOC, comm_);
  return {out.value, out.rank};
}

std::vector<int> Communicator::counts(std::size_t mine) const {
  std::vector<int> out(std::size_t(ranks_), 0);
  int const count = int(mine);
  count_collective();
  if (is_virtual())
    out[std::size_t(rank_)] = count;
  else
    MPI_Allgather(&count, 1, MPI_INT, out.data(), 1, MPI_INT, comm_);
  std::int64_t total = 0;
  for (int n : out) total += n;
  if (total > std::numeric_limits<int>::max())
    throw std::length_error(std::to_string(total) +
                            " elements to gather on every rank, more than MPI counts; use fewer");
  return out;
}

namespace {

/// Of a list that is one message.
std::size_t checked_length(std::size_t count) {
  if (count > longest)
    throw std::length_error(std::to_string(count) + " elements in one message, more than MPI counts; use more ranks");
  return count;
}

}  // namespace

std::vector<std::pair<int, std::vector<std::int64_t>>> brought(Communicator const& comm,
                                                               std::map<int, std::vector<std::int64_t>> const& to) {
  std::vector<std::pair<int, std::vector<std::int64_t>>> out;
  if (comm.ranks() == 1) return out;
  for (auto const& [rank, values] : to) comm.count_sent(rank, values.size() * sizeof values[0]);
  ++traffic().collectives;
  if (comm.is_virtual()) return out;
  // A rank may be one round ahead of another, and must not be taken for one of the round before: two tags take turns.
  int const tag = tag_announcement + rounds_of(comm.handle())++ % 2;
  std::vector<MPI_Request> sending;
  for (auto const& [rank, values] : to)
    MPI_Issend(values.data(), int(checked_length(values.size())), MPI_INT64_T, rank, tag, comm.handle(),
               &sending.emplace_back());
  // A rank whose lists have all arrived waits for the others to say so too; until then more may come.
  MPI_Request everyone = MPI_REQUEST_NULL;
  bool has_arrived = false;
  for (int done = 0; !done;) {
    MPI_Message message;
    MPI_Status status;
    int waits = 0;
    MPI_Improbe(MPI_ANY_SOURCE, tag, comm.handle(), &waits, &message, &status);
    if (waits) {
      int count = 0;
      MPI_Get_count(&status, MPI_INT64_T, &count);
      auto& values = out.emplace_back(status.MPI_SOURCE, std::vector<std::int64_t>(std::size_t(count))).second;
      MPI_Mrecv(values.data(), count, MPI_INT64_T, &message, MPI_STATUS_IGNORE);
    }
    if (has_arrived) {
      MPI_Test(&everyone, &done, MPI_STATUS_IGNORE);
    } else {
      int sent = 0;
      MPI_Testall(int(sending.size()), sending.data(), &sent, MPI_STATUSES_IGNORE);
      if (sent) MPI_Ibarrier(comm.handle(), &everyone);
      has_arrived = sent != 0;
    }
  }
  std::sort(out.begin(), out.end(), [](auto const& a, auto const& b) { return a.first < b.first; });
  return out;
}

void Communicator::send_list(void const* values, std::size_t count, std::size_t size, MPI_Datatype type, int rank,
                             MPI_Request& request) const {
  int const length = int(checked_length(count));
  request = MPI_REQUEST_NULL;
  if (!is_virtual()) MPI_Isend(values, length, type, rank, tag_lists, comm_, &request);
  count_sent(rank, count * size);
}

std::size_t Communicator::wait_for_list(int rank, MPI_Datatype type, MPI_Message& message) const {
  if (is_virtual()) return 0;
  MPI_Status status;
  int count = 0;
  MPI_Mprobe(rank, tag_lists, comm_, &message, &status);
  MPI_Get_count(&status, type, &count);
  return std::size_t(count);
}

void Communicator::take_list(void* into, std::size_t count, MPI_Datatype type, MPI_Message& message) const {
  if (!is_virtual()) MPI_Mrecv(into, int(count), type, &message, MPI_STATUS_IGNORE);
}

void Communicator::wait(std::vector<MPI_Request>& requests) {
  for (MPI_Request& request : requests) MPI_Wait(&request, MPI_STATUS_IGNORE);
}

void Communicator::abort(std::string const& what) const {
  if (is_virtual()) throw std::logic_error(what);
  end_job(comm_, what.substr(0, what.find('\n')));
}

void Messages::post(Communicator const& comm, void* values, std::size_t count, std::size_t size, MPI_Datatype type,
                    int rank, bool sends) {
  for (std::size_t first = 0; first < count; first += longest) {
    int const n = int(std::min(longest, count - first));
    char* const at = static_cast<char*>(values) + first * size;
    if (!sends) {
      if (!comm.is_virtual()) MPI_Irecv(at, n, type, rank, tag_values, comm.handle(), &receiving_.emplace_back());
      continue;
    }
    if (!comm.is_virtual()) MPI_Isend(at, n, type, rank, tag_values, comm.handle(), &sending_.emplace_back());
    comm.count_sent(rank, std::size_t(n) * size);
  }
}

void Messages::poll() {
  for (auto* requests : {&receiving_, &sending_}) {
    if (requests->empty()) continue;
    int done;
    MPI_Testall(int(requests->size()), requests->data(), &done, MPI_STATUSES_IGNORE);
    if (done) requests->clear();
  }
}

void Messages::wait(std::vector<MPI_Request>& requests) {
  // One by one: Open MPI 4 may wait for ever for all of several, one of which has failed.
  for (MPI_Request& request : requests) MPI_Wait(&request, MPI_STATUS_IGNORE);
  requests.clear();
}

void end_job_on_failure(MPI_Comm comm) {
  static MPI_Errhandler handler = MPI_ERRHANDLER_NULL;
  if (handler == MPI_ERRHANDLER_NULL) MPI_Comm_create_errhandler(on_failure, &handler);
  MPI_Comm_set_errhandler(comm, handler);
}

}  // namespace amrpic
