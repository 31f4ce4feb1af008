#include "matrices/halos.hpp"

#include "mesh/fits_behind.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

/// Rows of cells beside the next finer level: phi* is fitted to this level's cells.
void add_beside_finer(CellReads& reads, Level const& level, Level const& finer) {
  reads.add(
      level, [](Box const& o) { return o.grow(plane_reach); },
      [&](int b, auto&& read) {
        Box const& box = level.box(b);
        if (finer.intersects(box.grow(1).refine(refinement_ratio))) read(box.grow(plane_reach));
      });
}

/// The same rows: two layers of the finer level's cells behind each face.
void add_behind_fine_faces(CellReads& reads, Level const& coarser) {
  reads.add(
      coarser, [](Box const& o) { return o.coarsen(refinement_ratio).grow(1); },
      [&](int b, auto&& read) {
        for (int face = 0; face < 6; ++face) read(coarser.box(b).layer(face / 2, face % 2, 1).refine(refinement_ratio));
      });
}

/// What prolongation to `children` reads.
void add_parents(CellReads& reads, Level const& children, Index3 const& ratio, Prolongation kind) {
  reads.add(
      children, [&](Box const& o) { return o.grow(1).refine(ratio); },
      [&](int b, auto&& read) { read(parents_read(children.box(b), ratio, kind)); });
}

}  // namespace

CellReads stencil_reads(Level const& level) {
  CellReads out(level);
  out.add(reads_beyond_faces(level));
  return out;
}

CellReads relaxation_reads(MultigridLevels const& multigrid, std::size_t l) {
  CellReads out = stencil_reads(*multigrid.levels[l]);
  if (multigrid.refines(l))
    out.add(fine_reads_in_gaps(*multigrid.levels[l], *multigrid.faces[l], *multigrid.levels[l - 1]));
  return out;
}

void add_children(CellReads& reads, Level const& parents, Index3 const& ratio) {
  reads.add(
      parents, [&](Box const& o) { return o.coarsen(ratio).grow(1); },
      [&](int b, auto&& read) { read(parents.box(b).refine(ratio)); });
}

CellReads operator_reads(MultigridLevels const& multigrid, std::size_t l, Prolongation kind) {
  CellReads out = relaxation_reads(multigrid, l);
  if (l > 0) {
    Level const& coarser = *multigrid.levels[l - 1];
    add_children(out, coarser, multigrid.ratio[l]);
    if (multigrid.refines(l)) {
      add_behind_fine_faces(out, coarser);
      out.add(fine_reads_before_gaps(coarser, *multigrid.levels[l]));
    }
  }
  if (l + 1 < multigrid.levels.size()) {
    Level const& finer = *multigrid.levels[l + 1];
    add_parents(out, finer, multigrid.ratio[l + 1], kind);
    if (multigrid.refines(l + 1)) {
      add_beside_finer(out, *multigrid.levels[l], finer);
      out.add(reads_behind_edges(finer, *multigrid.faces[l + 1],
                                 *multigrid.levels[l]));  // phi* in the rows at the finer one's edge
      out.add(coarse_reads_in_gaps(finer, *multigrid.faces[l + 1], *multigrid.levels[l]));
    }
  }
  return out;
}

Box parents_read(Box const& box, Index3 const& ratio, Prolongation kind) {
  Box out = box.coarsen(ratio);
  for (int d = 0; d < 3; ++d) {
    if (kind == Prolongation::constant || ratio[d] == 1) continue;
    if (box.lower[d] % 2 == 0) --out.lower[d];
    if (box.upper[d] % 2 != 0) ++out.upper[d];
  }
  return out;
}

}  // namespace amrpic
