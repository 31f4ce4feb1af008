#include "mesh/transfer.hpp"

#include <algorithm>

#include "mesh/means.hpp"

namespace amrpic {

namespace {

/// Call `f(first, stride_y, stride_z)` for the 2 x 2 x 2 children of each parent in the order of `LevelPair::place`:
/// the place of the first child among this rank's cells, and the distances to its neighbours along y and z.
template <class F>
void for_each_family(Level const& fine, F&& f) {
  for (int b = fine.first_local_box(); b < fine.last_local_box(); ++b) {
    Box const& box = fine.box(b);
    LocalIndex const stride_y = box.extent(0), stride_z = stride_y * box.extent(1), first = fine.local_offset(b);
    for (int k = 0; k < box.extent(2); k += 2)
      for (int j = 0; j < box.extent(1); j += 2)
        for (int i = 0; i < box.extent(0); i += 2) f(first + i + j * stride_y + k * stride_z, stride_y, stride_z);
  }
}

/// Places, ascending, of own covered cells of a level whose children other ranks own.
std::vector<LocalIndex> with_children_elsewhere(LevelFaces const& faces, Level const& fine) {
  std::vector<LocalIndex> out;
  LocalIndex first = 0;
  for (BoxFaces const& at : faces) {
    for (Overlap const& o : at.covered)
      if (fine.owner(o.box) != fine.rank())
        for_each_cell(o.part, [&](Index3 const& cell) { out.push_back(first + LocalIndex(at.box.offset(cell))); });
    first += LocalIndex(at.box.cells());
  }
  std::sort(out.begin(), out.end());
  return out;
}

}  // namespace

Transfer::Transfer(std::shared_ptr<Hierarchy const> hierarchy) : hierarchy_(std::move(hierarchy)) {
  for (int l = 0; hierarchy_->has_finer(l); ++l) pairs_.push_back(make_pair(l));
}

Transfer::LevelPair Transfer::make_pair(int l) const {
  Level const& coarse = hierarchy_->level(l);
  Level const& fine = hierarchy_->level(l + 1);

  CellReads reads(coarse);
  reads.add(
      fine, [](Box const& o) { return o.refine(refinement_ratio); },
      [&](int b, auto&& read) { read(fine.box(b).coarsen(refinement_ratio)); });
  LevelPair pair;
  pair.parents = Halo(hierarchy_->comm(), reads);
  pair.place.reserve(std::size_t(fine.local_cells()) / 8);
  for (int b = fine.first_local_box(); b < fine.last_local_box(); ++b) {
    auto const places = pair.parents.places(coarse, fine.box(b).coarsen(refinement_ratio));
    pair.place.insert(pair.place.end(), places.values().begin(), places.values().end());
  }
  if (coarse.ranks() > 1) pair.children_elsewhere = with_children_elsewhere(hierarchy_->faces(l), fine);
  return pair;
}

void Transfer::average_down(std::vector<Field*> const& fields) const {
  for (int l = int(pairs_.size()) - 1; l >= 0; --l) {
    LevelPair const& pair = pairs_[l];
    std::vector<Real*> own;
    std::vector<Real const*> halos;
    std::vector<std::vector<Real>> halo(fields.size(), std::vector<Real>(std::size_t(pair.parents.size())));
    for (std::size_t f = 0; f < fields.size(); ++f) {
      Real const* fine = fields[f]->level(l + 1).data();
      Real* coarse = fields[f]->level(l).data();
      for (LocalIndex cell : pair.children_elsewhere) coarse[cell] = 0;
      std::size_t n = 0;
      LocalIndex const owned = pair.parents.owned();
      for_each_family(hierarchy_->level(l + 1), [&](LocalIndex child, LocalIndex y, LocalIndex z) {
        LocalIndex const place = pair.place[n++];
        average_children(1, fine + child, y, z, place < owned ? coarse + place : &halo[f][std::size_t(place - owned)]);
      });
      own.push_back(coarse);
      halos.push_back(halo[f].data());
    }
    pair.parents.fold(own, halos);
  }
}

void Transfer::spread(Field& field) const {
  for (int l = 0; l < int(pairs_.size()); ++l) {
    LevelPair const& pair = pairs_[l];
    Real const* coarse = field.level(l).data();
    Real* fine = field.level(l + 1).data();
    std::vector<Real> halo(std::size_t(pair.parents.size()));
    pair.parents.update({coarse}, {halo.data()});
    std::size_t n = 0;
    LocalIndex const owned = pair.parents.owned();
    for_each_family(hierarchy_->level(l + 1), [&](LocalIndex child, LocalIndex y, LocalIndex z) {
      LocalIndex const place = pair.place[n++];
      Real const value = place < owned ? coarse[place] : halo[std::size_t(place - owned)];
      for (LocalIndex c : {child, child + y, child + z, child + y + z}) fine[c] += value, fine[c + 1] += value;
    });
  }
}

}  // namespace amrpic
