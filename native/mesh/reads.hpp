// Who reads what of whom: it follows from the boxes, which all ranks know, without any message.
#pragma once

#include <algorithm>
#include <set>
#include <vector>

#include "base/communicator.hpp"
#include "mesh/faces.hpp"

namespace amrpic {

/// Cells of one box that another one reads.
struct Read {
  int rank;           ///< the other one: which owns what this one reads, or reads what this one owns
  int reader, owner;  ///< boxes, each on its level
  int region;         ///< which of the regions that the reader reads
  Box part;           ///< in the indices of the region; `part` minus `shift` lies in the owner's box
  Index3 shift;

  Box cells() const { return part.shift_back(shift); }
};

/// What this rank reads of others, and what others read of it: in ascending order of the other rank, and for each pair
/// of ranks in the same order on both.
struct Reads {
  std::vector<Read> wanted, asked;

  void sort() {  // by ranks
    for (auto* list : {&wanted, &asked})
      std::stable_sort(list->begin(), list->end(), [](Read const& a, Read const& b) { return a.rank < b.rank; });
  }
};

/// Call f(box) for each box of other ranks on `readers` that may read cells of this rank's boxes on `owners`,
/// ascending. `near(box)`: on `readers`, where the boxes are that may read cells of such a box on `owners`.
template <class Near, class F>
void for_each_reader(Level const& readers, Level const& owners, Near&& near, F&& f) {
  if (owners.ranks() == 1 || readers.ranks() == 1) return;
  std::set<int> boxes;
  for (int o = owners.first_local_box(); o < owners.last_local_box(); ++o)
    readers.for_each_overlap(near(owners.box(o)), [&](int b, Box const&, Index3 const&) {
      if (readers.owner(b) != readers.rank()) boxes.insert(b);
    });
  for (int b : boxes) f(b);
}

/// Call f(owner, read) for what a box of `readers` reads of any rank.
template <class Regions, class F>
void for_each_read_of_box(Level const& readers, Level const& owners, Regions&& regions, int reader, F&& f) {
  int number = 0;
  regions(reader, [&](Box const& region) {
    owners.for_each_overlap(region, [&](int o, Box const& part, Index3 const& shift) {
      int const owner = owners.owner(o), other = owner == owners.rank() ? readers.owner(reader) : owner;
      f(owner, Read{other, reader, o, number, part, shift});
    });
    ++number;
  });
}

/// Call asked(read) for what others read of this rank; see below.
template <class Near, class Regions, class Asked>
void for_each_read_by_others(Level const& readers, Level const& owners, Near&& near, Regions&& regions, Asked&& asked) {
  for_each_reader(readers, owners, near, [&](int b) {
    for_each_read_of_box(readers, owners, regions, b, [&](int owner, Read const& read) {
      if (owner == owners.rank()) asked(read);
    });
  });
}

/// Call wanted(read) for what this rank reads of others, and asked(read) for what others read of it, where a box of
/// `readers` reads the cells of `owners` in some regions: `regions(box, read)` calls read(region) for each, and must
/// give the same on all ranks. `near`: as in `for_each_reader`.
template <class Near, class Regions, class Wanted, class Asked>
void for_each_read_across_ranks(Level const& readers, Level const& owners, Near&& near, Regions&& regions,
                                Wanted&& wanted, Asked&& asked) {
  if (owners.ranks() == 1 || readers.ranks() == 1) return;
  for (int b = readers.first_local_box(); b < readers.last_local_box(); ++b)
    for_each_read_of_box(readers, owners, regions, b, [&](int owner, Read const& read) {
      if (owner != owners.rank()) wanted(read);
    });
  for_each_read_by_others(readers, owners, near, regions, asked);
}

/// A list of all of them.
template <class Near, class Regions>
Reads reads_across_ranks(Level const& readers, Level const& owners, Near&& near, Regions&& regions) {
  Reads out;
  for_each_read_across_ranks(
      readers, owners, near, regions, [&](Read const& read) { out.wanted.push_back(read); },
      [&](Read const& read) { out.asked.push_back(read); });
  out.sort();
  return out;
}

/// The cells beyond the six faces of each box of a level; the region is the number of the face.
Reads reads_beyond_faces(Level const& level);

/// The coarser cells behind the faces of boxes where a level ends, with those around them that phi* is fitted to.
/// `own`: the faces of this rank's boxes. The region is the number of the face.
Reads reads_behind_edges(Level const& level, LevelFaces const& own, Level const& coarser);

/// The uncovered cells of a level beside each box of the next finer one, whose fluxes the level's boxes read; the
/// region is 6 times the place in `BoxFaces::beside` plus the number of the finer box's face.
Reads reads_of_fine_fluxes(Level const& level, LevelFaces const& own, Level const& finer);

}  // namespace amrpic
