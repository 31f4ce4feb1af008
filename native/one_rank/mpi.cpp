// An MPI for a process that is alone, in place of MPICH's library, for wheels that do without one. What a single rank
// calls of it is here; that it sends nothing is `Communicator`'s promise.
#include <mpi.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>

namespace {

std::map<int, void*>& attributes() {
  static std::map<int, void*> all;
  return all;
}

int keys = 0;

/// Of a type of this file, whose handle is its size below zero, or of MPICH's, whose handles hold it.
std::size_t size_of(MPI_Datatype type) { return std::size_t(type < 0 ? -type : (type >> 8) & 0xff); }

void copy(void const* from, void* to, std::size_t bytes) {
  if (from != MPI_IN_PLACE) std::memcpy(to, from, bytes);
}

int sends() {
  std::fputs("amrpic: one rank alone has sent a message; install mpi4py and mpich, and report it\n", stderr);
  std::abort();
}

}  // namespace

extern "C" {

int MPI_Initialized(int* flag) { return *flag = 1, MPI_SUCCESS; }
int MPI_Comm_size(MPI_Comm, int* size) { return *size = 1, MPI_SUCCESS; }
int MPI_Comm_rank(MPI_Comm, int* rank) { return *rank = 0, MPI_SUCCESS; }
int MPI_Abort(MPI_Comm, int status) { std::_Exit(status); }
double MPI_Wtime() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}
int MPI_Get_library_version(char* text, int* length) {
  return *length = std::snprintf(text, MPI_MAX_LIBRARY_VERSION_STRING, "none: one rank alone"), MPI_SUCCESS;
}
int MPI_Error_string(int, char* text, int* length) { return *length = std::snprintf(text, 8, "error"), MPI_SUCCESS; }
int MPI_Comm_create_errhandler(MPI_Comm_errhandler_function*, MPI_Errhandler*) { return MPI_SUCCESS; }
int MPI_Comm_set_errhandler(MPI_Comm, MPI_Errhandler) { return MPI_SUCCESS; }
int MPI_Comm_create_keyval(MPI_Comm_copy_attr_function*, MPI_Comm_delete_attr_function*, int* key, void*) {
  return *key = ++keys, MPI_SUCCESS;
}
int MPI_Comm_set_attr(MPI_Comm, int key, void* value) { return attributes()[key] = value, MPI_SUCCESS; }
int MPI_Comm_get_attr(MPI_Comm, int key, void* value, int* known) {
  auto const at = attributes().find(key);
  if ((*known = at != attributes().end())) *static_cast<void**>(value) = at->second;
  return MPI_SUCCESS;
}

// ---- types and reductions ----
int MPI_Type_contiguous(int count, MPI_Datatype type, MPI_Datatype* out) {
  return *out = -count * int(size_of(type)), MPI_SUCCESS;
}
int MPI_Type_commit(MPI_Datatype*) { return MPI_SUCCESS; }
int MPI_Op_create(MPI_User_function*, int, MPI_Op*) { return MPI_SUCCESS; }
int MPI_Allreduce(void const* from, void* to, int count, MPI_Datatype type, MPI_Op, MPI_Comm) {
  return copy(from, to, std::size_t(count) * size_of(type)), MPI_SUCCESS;
}
int MPI_Allgather(void const* from, int count, MPI_Datatype type, void* to, int, MPI_Datatype, MPI_Comm) {
  return copy(from, to, std::size_t(count) * size_of(type)), MPI_SUCCESS;
}
int MPI_Allgatherv(void const* from, int count, MPI_Datatype type, void* to, int const[], int const[], MPI_Datatype,
                   MPI_Comm) {
  return copy(from, to, std::size_t(count) * size_of(type)), MPI_SUCCESS;
}
int MPI_Ibarrier(MPI_Comm, MPI_Request* request) { return *request = MPI_REQUEST_NULL, MPI_SUCCESS; }

// ---- what waits for messages finds none ----
int MPI_Wait(MPI_Request*, MPI_Status*) { return MPI_SUCCESS; }
int MPI_Test(MPI_Request*, int* done, MPI_Status*) { return *done = 1, MPI_SUCCESS; }
int MPI_Testall(int, MPI_Request[], int* done, MPI_Status*) { return *done = 1, MPI_SUCCESS; }
int MPI_Improbe(int, int, MPI_Comm, int* waits, MPI_Message*, MPI_Status*) { return *waits = 0, MPI_SUCCESS; }
int MPI_Isend(void const*, int, MPI_Datatype, int, int, MPI_Comm, MPI_Request*) { return sends(); }
int MPI_Issend(void const*, int, MPI_Datatype, int, int, MPI_Comm, MPI_Request*) { return sends(); }
int MPI_Irecv(void*, int, MPI_Datatype, int, int, MPI_Comm, MPI_Request*) { return sends(); }
int MPI_Mprobe(int, int, MPI_Comm, MPI_Message*, MPI_Status*) { return sends(); }
int MPI_Mrecv(void*, int, MPI_Datatype, MPI_Message*, MPI_Status*) { return sends(); }
int MPI_Get_count(MPI_Status const*, MPI_Datatype, int*) { return sends(); }

}  // extern "C"
