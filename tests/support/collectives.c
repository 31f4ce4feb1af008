/* Counts the collective calls of MPI of this process, whoever makes them, and the most bytes that one of them sends or
   receives: a library to preload. `collectives_begin()` sets all to zero. */
#include <mpi.h>

struct Counts {
  long calls, all_to_all, pickled, most_bytes;
};
static struct Counts counts;
struct Counts* collectives_begin(void) {
  counts = (struct Counts){0, 0, 0, 0};
  return &counts;
}

static long bytes_of(MPI_Datatype type, long count) {
  int size = 0;
  if (count > 0) PMPI_Type_size(type, &size);
  return size * count;
}
static long ranks_of(MPI_Comm comm) {
  int ranks;
  PMPI_Comm_size(comm, &ranks);
  return ranks;
}
static long sum(const int* values, MPI_Comm comm) {
  long out = 0;
  for (long r = 0; r < ranks_of(comm); ++r) out += values[r];
  return out;
}
static void count(MPI_Comm comm, long sent, long received) {
  long const most = sent > received ? sent : received;
  if (ranks_of(comm) == 1) return;
  ++counts.calls;
  if (most > counts.most_bytes) counts.most_bytes = most;
}

#define COUNTED(call, comm, sent, received, ...) \
  int MPI_##call {                               \
    count(comm, sent, received);                 \
    return PMPI_##__VA_ARGS__;                   \
  }

COUNTED(Barrier(MPI_Comm c), c, 0, 0, Barrier(c))
COUNTED(Ibarrier(MPI_Comm c, MPI_Request* r), c, 0, 0, Ibarrier(c, r))
COUNTED(Bcast(void* a, int n, MPI_Datatype t, int root, MPI_Comm c), c, bytes_of(t, n), 0, Bcast(a, n, t, root, c))
COUNTED(Allreduce(const void* a, void* b, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c), c, bytes_of(t, n), 0,
        Allreduce(a, b, n, t, o, c))
COUNTED(Iallreduce(const void* a, void* b, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c, MPI_Request* r), c,
        bytes_of(t, n), 0, Iallreduce(a, b, n, t, o, c, r))
COUNTED(Reduce(const void* a, void* b, int n, MPI_Datatype t, MPI_Op o, int root, MPI_Comm c), c, bytes_of(t, n), 0,
        Reduce(a, b, n, t, o, root, c))
COUNTED(Scan(const void* a, void* b, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c), c, bytes_of(t, n), 0,
        Scan(a, b, n, t, o, c))
COUNTED(Exscan(const void* a, void* b, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c), c, bytes_of(t, n), 0,
        Exscan(a, b, n, t, o, c))
COUNTED(Gather(const void* a, int n, MPI_Datatype t, void* b, int m, MPI_Datatype u, int root, MPI_Comm c), c,
        bytes_of(t, n), bytes_of(t, n) * ranks_of(c), Gather(a, n, t, b, m, u, root, c))
COUNTED(Gatherv(const void* a, int n, MPI_Datatype t, void* b, const int* m, const int* d, MPI_Datatype u, int root,
                MPI_Comm c),
        c, bytes_of(t, n), 0, Gatherv(a, n, t, b, m, d, u, root, c))
COUNTED(Allgather(const void* a, int n, MPI_Datatype t, void* b, int m, MPI_Datatype u, MPI_Comm c), c, bytes_of(t, n),
        bytes_of(u, m) * ranks_of(c), Allgather(a, n, t, b, m, u, c))
COUNTED(Allgatherv(const void* a, int n, MPI_Datatype t, void* b, const int* m, const int* d, MPI_Datatype u,
                   MPI_Comm c),
        c, bytes_of(t, n), bytes_of(u, sum(m, c)), Allgatherv(a, n, t, b, m, d, u, c))
COUNTED(Comm_dup(MPI_Comm c, MPI_Comm* d), c, 0, 0, Comm_dup(c, d))
COUNTED(Comm_split(MPI_Comm c, int color, int key, MPI_Comm* d), c, 0, 8 * ranks_of(c), Comm_split(c, color, key, d))
COUNTED(Comm_split_type(MPI_Comm c, int kind, int key, MPI_Info i, MPI_Comm* d), c, 0, 8 * ranks_of(c),
        Comm_split_type(c, kind, key, i, d))

#define ALL_TO_ALL(call, comm, ...)             \
  int MPI_##call {                              \
    count(comm, 0, 0);                          \
    if (ranks_of(comm) > 1) ++counts.all_to_all; \
    return PMPI_##__VA_ARGS__;                  \
  }

ALL_TO_ALL(Alltoall(const void* a, int n, MPI_Datatype t, void* b, int m, MPI_Datatype u, MPI_Comm c), c,
           Alltoall(a, n, t, b, m, u, c))
ALL_TO_ALL(Alltoallv(const void* a, const int* n, const int* d, MPI_Datatype t, void* b, const int* m, const int* e,
                     MPI_Datatype u, MPI_Comm c),
           c, Alltoallv(a, n, d, t, b, m, e, u, c))
ALL_TO_ALL(Alltoallw(const void* a, const int* n, const int* d, const MPI_Datatype* t, void* b, const int* m,
                     const int* e, const MPI_Datatype* u, MPI_Comm c),
           c, Alltoallw(a, n, d, t, b, m, e, u, c))

/* What mpi4py's collectives of pickled objects send by themselves; our own messages do not block. */
int MPI_Send(const void* a, int n, MPI_Datatype t, int to, int tag, MPI_Comm c) {
  ++counts.pickled;
  return PMPI_Send(a, n, t, to, tag, c);
}
