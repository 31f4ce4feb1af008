/* Poisson's equation on the unit cube of n³ cells, zero on its faces (cell-centred, ghosts of opposite sign), by
 * hypre's conjugate gradients around PFMG (a structured multigrid) and around BoomerAMG (an algebraic one).
 *
 *   mpiexec -n RANKS hypre_driver n runs rhs solution
 *
 * `rhs` holds n³ doubles, x fastest: the right-hand side times h², of minus the Laplacian. The potential that PFMG
 * leads to goes to `solution`.pfmg, BoomerAMG's to `solution`.amg. One line per solver and run goes to standard output:
 *   name set-up-seconds solve-seconds iterations
 * Ranks take slabs along z. Solves start from zero and end at 1e-10 of the right-hand side in the 2-norm.
 */
#include <HYPRE.h>
#include <HYPRE_krylov.h>
#include <HYPRE_parcsr_ls.h>
#include <HYPRE_struct_ls.h>
#include <mpi.h>
#include <stdio.h>
#include <stdlib.h>

#define TOLERANCE 1e-10
#define MAX_ITERATIONS 200

typedef struct {
  int n, lower, planes; /* this rank's planes of cells, from `lower` on */
  long first, size;     /* this rank's cells */
} Slab;

static double* allocate(long count) {
  double* out = malloc(sizeof(double) * count);
  if (!out) {
    fprintf(stderr, "hypre_driver: no memory for %ld numbers; take a smaller n\n", count);
    MPI_Abort(MPI_COMM_WORLD, 1);
  }
  return out;
}

static void transfer(char const* path, Slab s, double* values, int writing) {
  MPI_File file;
  int const mode = writing ? MPI_MODE_CREATE | MPI_MODE_WRONLY : MPI_MODE_RDONLY;
  if (MPI_File_open(MPI_COMM_WORLD, path, mode, MPI_INFO_NULL, &file) != MPI_SUCCESS) {
    fprintf(stderr, "hypre_driver: cannot open %s\n", path);
    MPI_Abort(MPI_COMM_WORLD, 1);
  }
  MPI_Offset const offset = (MPI_Offset)(sizeof(double) * s.first);
  if (writing)
    MPI_File_write_at_all(file, offset, values, (int)s.size, MPI_DOUBLE, MPI_STATUS_IGNORE);
  else
    MPI_File_read_at_all(file, offset, values, (int)s.size, MPI_DOUBLE, MPI_STATUS_IGNORE);
  MPI_File_close(&file);
}

static double now(void) {
  MPI_Barrier(MPI_COMM_WORLD);
  return MPI_Wtime();
}

/* Diagonal of cell (i, j, k): six, and one more for each face of the cube that it touches. */
static double diagonal(int n, int i, int j, int k) {
  return 6 + (i == 0) + (i == n - 1) + (j == 0) + (j == n - 1) + (k == 0) + (k == n - 1);
}

static void tell(char const* name, double setup, double solve, int iterations) {
  int rank;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  if (rank == 0) printf("%s %.9g %.9g %d\n", name, setup, solve, iterations);
}

/* ---- PFMG ---- */

static int const OFFSETS[7][3] = {{0, 0, 0}, {-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}};

static HYPRE_StructMatrix struct_matrix(Slab s, HYPRE_StructGrid grid, int* lower, int* upper) {
  HYPRE_StructStencil stencil;
  HYPRE_StructMatrix matrix;
  HYPRE_StructStencilCreate(3, 7, &stencil);
  for (int e = 0; e < 7; ++e) HYPRE_StructStencilSetElement(stencil, e, (int*)OFFSETS[e]);
  HYPRE_StructMatrixCreate(MPI_COMM_WORLD, grid, stencil, &matrix);
  HYPRE_StructMatrixInitialize(matrix);
  double* values = allocate(7 * s.size);
  long at = 0;
  for (int k = s.lower; k < s.lower + s.planes; ++k)
    for (int j = 0; j < s.n; ++j)
      for (int i = 0; i < s.n; ++i) {
        int const place[3] = {i, j, k};
        values[at++] = diagonal(s.n, i, j, k);
        for (int e = 1; e < 7; ++e) {
          int const axis = (e - 1) / 2, there = place[axis] + OFFSETS[e][axis];
          values[at++] = there < 0 || there >= s.n ? 0 : -1;
        }
      }
  int entries[7] = {0, 1, 2, 3, 4, 5, 6};
  HYPRE_StructMatrixSetBoxValues(matrix, lower, upper, 7, entries, values);
  HYPRE_StructMatrixAssemble(matrix);
  HYPRE_StructStencilDestroy(stencil);
  free(values);
  return matrix;
}

static HYPRE_StructVector struct_vector(HYPRE_StructGrid grid) {
  HYPRE_StructVector out;
  HYPRE_StructVectorCreate(MPI_COMM_WORLD, grid, &out);
  HYPRE_StructVectorInitialize(out);
  return out;
}

static void pfmg(Slab s, int runs, double* rhs, double* phi) {
  int lower[3] = {0, 0, s.lower}, upper[3] = {s.n - 1, s.n - 1, s.lower + s.planes - 1};
  HYPRE_StructGrid grid;
  HYPRE_StructGridCreate(MPI_COMM_WORLD, 3, &grid);
  HYPRE_StructGridSetExtents(grid, lower, upper);
  HYPRE_StructGridAssemble(grid);
  HYPRE_StructMatrix matrix = struct_matrix(s, grid, lower, upper);
  HYPRE_StructVector b = struct_vector(grid), x = struct_vector(grid);
  HYPRE_StructVectorSetBoxValues(b, lower, upper, rhs);
  HYPRE_StructVectorAssemble(b);
  for (int run = 0; run < runs; ++run) {
    HYPRE_StructVectorSetConstantValues(x, 0.0);
    HYPRE_StructVectorAssemble(x);
    double const start = now();
    HYPRE_StructSolver cg, mg;
    HYPRE_StructPCGCreate(MPI_COMM_WORLD, &cg);
    HYPRE_StructPCGSetTol(cg, TOLERANCE);
    HYPRE_StructPCGSetMaxIter(cg, MAX_ITERATIONS);
    HYPRE_StructPCGSetTwoNorm(cg, 1);
    HYPRE_StructPFMGCreate(MPI_COMM_WORLD, &mg);
    HYPRE_StructPFMGSetMaxIter(mg, 1);
    HYPRE_StructPFMGSetTol(mg, 0.0);
    HYPRE_StructPFMGSetZeroGuess(mg);
    HYPRE_StructPFMGSetRelaxType(mg, 2); /* red-black Gauss-Seidel, symmetric */
    HYPRE_StructPCGSetPrecond(cg, HYPRE_StructPFMGSolve, HYPRE_StructPFMGSetup, mg);
    HYPRE_StructPCGSetup(cg, matrix, b, x);
    double const middle = now();
    HYPRE_StructPCGSolve(cg, matrix, b, x);
    double const end = now();
    int iterations;
    HYPRE_StructPCGGetNumIterations(cg, &iterations);
    tell("PFMG-CG", middle - start, end - middle, iterations);
    HYPRE_StructPCGDestroy(cg);
    HYPRE_StructPFMGDestroy(mg);
  }
  HYPRE_StructVectorGetBoxValues(x, lower, upper, phi);
  HYPRE_StructVectorDestroy(b);
  HYPRE_StructVectorDestroy(x);
  HYPRE_StructMatrixDestroy(matrix);
  HYPRE_StructGridDestroy(grid);
}

/* ---- BoomerAMG ---- */

static HYPRE_IJMatrix ij_matrix(Slab s) {
  HYPRE_IJMatrix matrix;
  HYPRE_IJMatrixCreate(MPI_COMM_WORLD, s.first, s.first + s.size - 1, s.first, s.first + s.size - 1, &matrix);
  HYPRE_IJMatrixSetObjectType(matrix, HYPRE_PARCSR);
  HYPRE_IJMatrixInitialize(matrix);
  for (int k = s.lower; k < s.lower + s.planes; ++k)
    for (int j = 0; j < s.n; ++j)
      for (int i = 0; i < s.n; ++i) {
        int const place[3] = {i, j, k};
        HYPRE_BigInt row = ((long)k * s.n + j) * s.n + i, columns[7];
        double values[7];
        int count = 1;
        columns[0] = row;
        values[0] = diagonal(s.n, i, j, k);
        for (int e = 1; e < 7; ++e) {
          int const axis = (e - 1) / 2, there = place[axis] + OFFSETS[e][axis];
          if (there < 0 || there >= s.n) continue;
          long const stride = axis == 0 ? 1 : axis == 1 ? s.n : (long)s.n * s.n;
          columns[count] = (HYPRE_BigInt)(row + stride * OFFSETS[e][axis]);
          values[count++] = -1;
        }
        HYPRE_IJMatrixSetValues(matrix, 1, &count, &row, columns, values);
      }
  HYPRE_IJMatrixAssemble(matrix);
  return matrix;
}

static HYPRE_IJVector ij_vector(Slab s, double* values) {
  HYPRE_IJVector out;
  HYPRE_BigInt* rows = malloc(sizeof(HYPRE_BigInt) * s.size);
  for (long i = 0; i < s.size; ++i) rows[i] = (HYPRE_BigInt)(s.first + i);
  HYPRE_IJVectorCreate(MPI_COMM_WORLD, s.first, s.first + s.size - 1, &out);
  HYPRE_IJVectorSetObjectType(out, HYPRE_PARCSR);
  HYPRE_IJVectorInitialize(out);
  HYPRE_IJVectorSetValues(out, (int)s.size, rows, values);
  HYPRE_IJVectorAssemble(out);
  free(rows);
  return out;
}

static void amg(Slab s, int runs, double* rhs, double* phi) {
  HYPRE_IJMatrix ij = ij_matrix(s);
  HYPRE_IJVector of_b = ij_vector(s, rhs), of_x = ij_vector(s, rhs);
  HYPRE_ParCSRMatrix matrix;
  HYPRE_ParVector b, x;
  HYPRE_IJMatrixGetObject(ij, (void**)&matrix);
  HYPRE_IJVectorGetObject(of_b, (void**)&b);
  HYPRE_IJVectorGetObject(of_x, (void**)&x);
  for (int run = 0; run < runs; ++run) {
    HYPRE_ParVectorSetConstantValues(x, 0.0);
    double const start = now();
    HYPRE_Solver cg, mg;
    HYPRE_ParCSRPCGCreate(MPI_COMM_WORLD, &cg);
    HYPRE_PCGSetTol(cg, TOLERANCE);
    HYPRE_PCGSetMaxIter(cg, MAX_ITERATIONS);
    HYPRE_PCGSetTwoNorm(cg, 1);
    HYPRE_BoomerAMGCreate(&mg);
    HYPRE_BoomerAMGSetMaxIter(mg, 1);
    HYPRE_BoomerAMGSetTol(mg, 0.0);
    HYPRE_BoomerAMGSetCoarsenType(mg, 8); /* PMIS */
    HYPRE_BoomerAMGSetInterpType(mg, 6);  /* extended+i */
    HYPRE_BoomerAMGSetPMaxElmts(mg, 4);
    HYPRE_BoomerAMGSetAggNumLevels(mg, 1);
    HYPRE_BoomerAMGSetRelaxType(mg, 6); /* symmetric Gauss-Seidel */
    HYPRE_BoomerAMGSetStrongThreshold(mg, 0.25);
    HYPRE_PCGSetPrecond(cg, (HYPRE_PtrToSolverFcn)HYPRE_BoomerAMGSolve, (HYPRE_PtrToSolverFcn)HYPRE_BoomerAMGSetup, mg);
    HYPRE_ParCSRPCGSetup(cg, matrix, b, x);
    double const middle = now();
    HYPRE_ParCSRPCGSolve(cg, matrix, b, x);
    double const end = now();
    int iterations;
    HYPRE_PCGGetNumIterations(cg, &iterations);
    tell("BoomerAMG-CG", middle - start, end - middle, iterations);
    HYPRE_ParCSRPCGDestroy(cg);
    HYPRE_BoomerAMGDestroy(mg);
  }
  HYPRE_BigInt* rows = malloc(sizeof(HYPRE_BigInt) * s.size);
  for (long i = 0; i < s.size; ++i) rows[i] = (HYPRE_BigInt)(s.first + i);
  HYPRE_IJVectorGetValues(of_x, (int)s.size, rows, phi);
  free(rows);
  HYPRE_IJVectorDestroy(of_b);
  HYPRE_IJVectorDestroy(of_x);
  HYPRE_IJMatrixDestroy(ij);
}

int main(int argc, char** argv) {
  int rank, ranks;
  MPI_Init(&argc, &argv);
  if (argc != 5) {
    fprintf(stderr, "usage: hypre_driver n runs rhs solution\n");
    MPI_Abort(MPI_COMM_WORLD, 1);
  }
  HYPRE_Init();
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  MPI_Comm_size(MPI_COMM_WORLD, &ranks);
  int const n = atoi(argv[1]), runs = atoi(argv[2]);
  int const lower = (int)((long)n * rank / ranks), upper = (int)((long)n * (rank + 1) / ranks);
  Slab const s = {n, lower, upper - lower, (long)lower * n * n, (long)(upper - lower) * n * n};
  double *rhs = allocate(s.size), *phi = allocate(s.size);
  char path[4096];
  transfer(argv[3], s, rhs, 0);
  pfmg(s, runs, rhs, phi);
  snprintf(path, sizeof path, "%s.pfmg", argv[4]);
  transfer(path, s, phi, 1);
  amg(s, runs, rhs, phi);
  snprintf(path, sizeof path, "%s.amg", argv[4]);
  transfer(path, s, phi, 1);
  free(rhs);
  free(phi);
  HYPRE_Finalize();
  MPI_Finalize();
  return 0;
}
